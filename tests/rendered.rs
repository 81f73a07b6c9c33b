//! Images of robosuite tasks that ingest renders equal those of robosuite, also after interruptions.
//!
//! `RE4_IMAGES=all cargo test -p re4-pipe rendered::` compares all images, which takes minutes.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::support::{
    Answer, Gate, Place, Process, assert_same_bytes, filters, repository, scripted_and_simulators, wait_for,
};
use insta::{assert_snapshot, with_settings};
use re4_artifact::{Row as _, Stage, col_binary, col_text, col_u32};
use re4_ingest::{EpisodeRow, ImageRow};

fn pipeline(place: &Place, name: &str, task: &str, source: &Path, rest: &str) {
    let source = source.display();
    let text = format!("task = \"{task}\"\n[ingest]\nsource = \"{source}\"\n{rest}\n[segment]\n");
    place.write(&format!("{name}.toml"), text);
}

fn command(place: &Place, simulators: &Path, arguments: &str) -> Command {
    let mut command = place.command();
    command
        .env("RE4_SIMULATORS", simulators)
        .args(arguments.split_whitespace());
    command
}

fn run(place: &Place, simulators: &Path, arguments: &str) -> Answer {
    let output = command(place, simulators, arguments).output().unwrap();
    Answer::new(&output, place.path())
}

/// Camera, episode, frame and bytes of all images.
fn images(place: &Place) -> Vec<(String, u32, u32, Vec<u8>)> {
    let table = place.artifact(Stage::Ingest).table(ImageRow::table()).unwrap();
    let table = table.read_all().unwrap();
    let cameras = col_text(&table, "camera").unwrap();
    let (episodes, frames) = (col_u32(&table, "episode").unwrap(), col_u32(&table, "frame").unwrap());
    let images = col_binary(&table, "image").unwrap();
    (0..table.num_rows())
        .map(|row| {
            (
                cameras[row].unwrap().to_owned(),
                episodes[row],
                frames[row],
                images.value(row).to_vec(),
            )
        })
        .collect()
}

#[test]
fn images_equal_those_that_robosuite_recorded() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let all = std::env::var("RE4_IMAGES").is_ok_and(|value| value == "all");
    for (task, first) in [("lift", 2), ("can", 1), ("square", 1)] {
        let select = format!("select = {{ first = {} }}", if all { 5 } else { first });
        let recorded = Place::empty();
        pipeline(&recorded, task, task, &data.join(task).join("image_5.hdf5"), &select);
        run(&recorded, &simulators, &format!("ingest {task}.toml")).done();
        let rendered = Place::empty();
        let render = format!("{select}\nrender = [\"robot0_eye_in_hand\", \"agentview\"]");
        pipeline(&rendered, task, task, &data.join(task).join("low_dim.hdf5"), &render);
        let output = run(&rendered, &simulators, &format!("ingest {task}.toml --json"))
            .done()
            .json();
        assert!(
            output["summary"]["rendered"]["by"]
                .as_str()
                .unwrap()
                .starts_with("MuJoCo 2.3.7 with ")
        );
        let (recorded, rendered) = (images(&recorded), images(&rendered));
        assert!(recorded.len() >= 100 && recorded.len() == rendered.len());
        let other = recorded
            .iter()
            .zip(&rendered)
            .position(|(recorded, rendered)| recorded != rendered);
        // Equal pixels give equal bytes, because both went through the same PNG encoder.
        assert_eq!(
            other.map(|row| (&recorded[row].0, recorded[row].1, recorded[row].2)),
            None,
            "{task}"
        );
    }
}

/// The processes that any thread of a process has started.
fn children(process: u32) -> Vec<u32> {
    let threads = fs::read_dir(format!("/proc/{process}/task")).into_iter().flatten();
    // A thread or the process may have ended meanwhile.
    let lists = threads.filter_map(|thread| fs::read_to_string(thread.ok()?.path().join("children")).ok());
    let lists: Vec<String> = lists.collect();
    let numbers = lists.iter().flat_map(|list| list.split_whitespace());
    numbers.map(|number| number.parse().unwrap()).collect()
}

/// Peak memory of each rendering process in MiB, the largest first, and the program's output.
fn peaks(place: &Place, simulators: &Path, arguments: &str) -> (Vec<u64>, Answer) {
    let mut child = command(place, simulators, arguments);
    let mut child = child.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut peaks = BTreeMap::new();
    while child.try_wait().unwrap().is_none() {
        for worker in children(child.id()) {
            for process in children(worker).into_iter().chain([worker]) {
                // The process may have ended meanwhile.
                let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
                let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
                let kilobytes = line.and_then(|line| line.trim().strip_suffix(" kB"));
                let peak: u64 = kilobytes.map_or(0, |number| number.trim().parse().unwrap());
                let known = peaks.entry(process).or_insert(0);
                *known = peak.max(*known);
            }
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let mut peaks: Vec<u64> = peaks.into_values().map(|peak| peak >> 10).collect();
    peaks.sort_unstable_by(|a, b| b.cmp(a));
    (peaks, Answer::new(&child.wait_with_output().unwrap(), place.path()))
}

#[test]
fn memory_is_bounded_for_any_number_of_jobs() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let rest = "select = { first = 8 }\nrender = [\"agentview\", \"robot0_eye_in_hand\"]";
    let places = [1, 16].map(|jobs| {
        let place = Place::empty();
        pipeline(&place, "lift", "lift", &data.join("lift/low_dim.hdf5"), rest);
        let (peaks, answer) = peaks(&place, &simulators, &format!("ingest lift.toml --jobs {jobs}"));
        answer.done();
        println!("{jobs} jobs: {peaks:?} MiB");
        // A lower bound: a rendering process needs at least the memory of its libraries.
        assert!((100..512).contains(&peaks[0]), "{jobs} jobs: {peaks:?} MiB");
        assert!(peaks.len() <= 4 && (peaks.len() == 1) == (jobs == 1));
        place
    });
    assert_same_bytes(&places[0].bytes(), &places[1].bytes());
}

#[test]
fn helpers_that_end_change_nothing() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let rest = "select = { first = 6 }\nrender = [\"agentview\"]";
    let place = || {
        let place = Place::empty();
        pipeline(&place, "lift", "lift", &data.join("lift/low_dim.hdf5"), rest);
        place
    };
    let alone = place();
    run(&alone, &simulators, "ingest lift.toml --jobs 1").done();
    let helper = |worker: &Process| wait_for("a helper", || children(worker.id()).into_iter().find_map(Process::of));
    let killed = place();
    let mut program = command(&killed, &simulators, "ingest lift.toml --jobs 2");
    let gate = Gate::before(&mut program, &killed, 60);
    let mut program = program.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let worker = gate.wait(&mut program);
    helper(&worker).end_by("KILL");
    gate.open();
    Answer::new(&program.wait_with_output().unwrap(), killed.path()).done();
    assert_same_bytes(&killed.bytes(), &alone.bytes());
    // A helper ends with its worker.
    let abandoned = place();
    let mut program = command(&abandoned, &simulators, "ingest lift.toml --jobs 2 --quiet");
    let gate = Gate::before(&mut program, &abandoned, 60);
    let mut program = program.spawn().unwrap();
    let worker = gate.wait(&mut program);
    let left = helper(&worker);
    worker.end_by("KILL");
    left.wait();
    program.kill().unwrap();
    program.wait().unwrap();
}

/// Files of the spool, which has a single folder.
fn spooled(place: &Place) -> Vec<PathBuf> {
    let folders = fs::read_dir(place.artifacts().join("spool")).into_iter().flatten();
    folders
        .flat_map(|folder| fs::read_dir(folder.unwrap().path()).unwrap())
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.file_name().unwrap().to_str().unwrap().starts_with("robot0"))
        .collect()
}

/// Starts the program and kills it after `demos` demonstrations have been rendered, and before all are. `frames` are their
/// lengths.
fn kill_after(place: &Place, simulators: &Path, demos: usize, frames: &[usize]) {
    // Two threads render one demonstration each. This number of images is more than `demos - 1` whole demonstrations and parts of
    // two others can have, so at least `demos` are complete.
    let mut frames = frames.to_vec();
    frames.sort_unstable_by(|a, b| b.cmp(a));
    let images = frames[..demos - 1].iter().sum::<usize>() + 2 * frames[0];
    assert!(images < frames.iter().sum(), "too few demonstrations");
    let mut command = command(place, simulators, "ingest lift.toml --jobs 2 --quiet");
    let gate = Gate::before(&mut command, place, images);
    let mut child = command.spawn().unwrap();
    let worker = gate.wait(&mut child);
    wait_for("the files of rendered demonstrations", || {
        (spooled(place).len() >= demos).then_some(())
    });
    child.kill().unwrap();
    child.wait().unwrap();
    worker.wait();
}

#[test]
fn a_killed_run_continues() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let rest = "select = { first = 9 }\nrender = [\"robot0_eye_in_hand\"]";
    let place = || {
        let place = Place::empty();
        pipeline(&place, "lift", "lift", &data.join("lift/low_dim.hdf5"), rest);
        place
    };
    let undisturbed = place();
    run(&undisturbed, &simulators, "ingest lift.toml --jobs 1").done();
    assert!(!undisturbed.artifacts().join("spool").exists());
    let episodes = undisturbed.artifact(Stage::Ingest);
    let episodes = episodes.table(EpisodeRow::table()).unwrap().read_all().unwrap();
    let frames: Vec<usize> = col_u32(&episodes, "frames")
        .unwrap()
        .iter()
        .map(|&frames| frames as usize)
        .collect();
    let place = place();
    for demos in [2, 4] {
        kill_after(&place, &simulators, demos, &frames);
    }
    let mut kept = spooled(&place);
    kept.sort();
    assert!(kept.len() >= 4);
    // Finished demonstrations are not rendered again; damaged files are.
    let times = |paths: &[PathBuf]| -> Vec<_> {
        paths
            .iter()
            .map(|path| path.metadata().unwrap().modified().unwrap())
            .collect()
    };
    let before = times(&kept[1..]);
    fs::write(&kept[0], b"damaged").unwrap();
    kill_after(&place, &simulators, 5, &frames);
    assert_eq!(times(&kept[1..]), before);
    run(&place, &simulators, "ingest lift.toml --jobs 2").done();
    assert_same_bytes(&place.bytes(), &undisturbed.bytes());
    assert!(!place.artifacts().join("spool").exists() && place.temporaries().is_empty());
    let again = run(&place, &simulators, "ingest lift.toml").done();
    assert!(again.stderr.contains("unchanged"), "{}", again.stderr);
}

#[test]
fn conflicting_settings() {
    let place = Place::empty();
    let sample = place.path().join("data/can.hdf5");
    fs::copy(repository().join("data/can-sample.hdf5"), &sample).unwrap();
    let mut errors = String::new();
    for rest in [
        "render = [\"image\"]",
        "render = [\"frontview\"]",
        "render = [\"agentview\", \"agentview\"]",
        "render = [\"agentview\"]\nimages = false",
        "render = [\"agentview\"]\ncameras = [\"agentview\"]",
    ] {
        pipeline(&place, "can", "can", &sample, rest);
        writeln!(errors, "{rest}\n  {}", place.run("ingest can.toml").refused()).unwrap();
    }
    let planar = "[segment]\nrule = \"always_transit\"";
    place.write(
        "planar.toml",
        format!("task = \"pusht\"\n[ingest]\nsource = \"small.zarr\"\nrender = [\"agentview\"]\n{planar}\n"),
    );
    writeln!(errors, "Push-T\n  {}", place.run("ingest planar.toml").refused()).unwrap();
    pipeline(&place, "can", "can", &sample, "render = [\"agentview\"]");
    let output = command(&place, place.path(), "ingest can.toml")
        .env("RE4_GL", "glx")
        .output()
        .unwrap();
    writeln!(errors, "RE4_GL=glx\n  {}", Answer::new(&output, place.path()).refused()).unwrap();
    with_settings!({ filters => filters() }, { assert_snapshot!(errors) });
}

#[test]
fn missing_simulators_and_unusable_models() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::empty();
    let lift = data.join("lift/low_dim.hdf5");
    let rest = "select = { first = 2 }\nrender = [\"agentview\"]";
    let mut errors = String::new();
    let mut refuse = |what: &str, answer: Answer| writeln!(errors, "{what}\n  {}", answer.refused()).unwrap();

    pipeline(&place, "lift", "lift", &lift, rest);
    refuse(
        "no library",
        run(&place, &place.path().join("none"), "ingest lift.toml"),
    );
    let some = place.path().join("some");
    fs::create_dir(&some).unwrap();
    std::os::unix::fs::symlink(simulators.join("mujoco-2.3.7"), some.join("mujoco-2.3.7")).unwrap();
    refuse("no assets", run(&place, &some, "ingest lift.toml"));
    fs::create_dir(some.join("mujoco-3.2.7")).unwrap();
    fs::remove_file(some.join("mujoco-2.3.7")).unwrap();
    std::os::unix::fs::symlink(simulators.join("mujoco-3.2.7"), some.join("mujoco-2.3.7")).unwrap();
    refuse("another version", run(&place, &some, "ingest lift.toml"));
    fs::remove_file(some.join("mujoco-2.3.7")).unwrap();
    fs::create_dir(some.join("mujoco-2.3.7")).unwrap();
    fs::write(some.join("mujoco-2.3.7/libmujoco.so"), b"no library").unwrap();
    refuse("no shared object", run(&place, &some, "ingest lift.toml"));
    pipeline(&place, "lift", "lift", &data.join("lift/image_5.hdf5"), rest);
    refuse("recorded images", run(&place, &simulators, "ingest lift.toml"));
    let mut filters = filters();
    let (data, simulators_text) = (data.display().to_string(), simulators.display().to_string());
    filters.push((&data, "[data]"));
    filters.push((&simulators_text, "[simulators]"));

    if let Some(python) = std::env::var_os("RE4_PYTHON") {
        let folder = place.path().join("data/models");
        let made = Command::new(python)
            .arg(repository().join("tests/make_models.py"))
            .args([&lift, &folder])
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let mut files: Vec<_> = fs::read_dir(&folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        files.sort();
        let mut models = String::new();
        for file in files {
            let name = file.file_stem().unwrap().to_str().unwrap();
            pipeline(&place, "model", "lift", &file, "render = [\"agentview\"]");
            let answer = run(&place, &simulators, "ingest model.toml --jobs 2");
            writeln!(models, "{name}\n  {}", answer.refused()).unwrap();
            assert!(place.temporaries().is_empty(), "{name}");
        }
        with_settings!({ filters => filters.clone() }, { assert_snapshot!("models", models) });
    } else {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
    }
    with_settings!({ filters => filters }, { assert_snapshot!(errors) });
}
