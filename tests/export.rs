//! Exports: what other programs read is what the artifacts contain, and nothing remains of an export that did not end.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use re4_artifact::episodes::{FrameRow, ImageRow, PlanarColumns, SpatialColumns, StateRow};
use re4_artifact::{Artifact, Stage};
use re4_lerobot::{Cameras, Dataset, LerobotError};
use re4_rollout::{PlaneResultRow, PlaneStepRow};
use serde_json::Value;

use crate::support::{Place, repository};

const SIDE: usize = crate::support::dataset::SIDE;

/// Contents of all files below a path, by relative path.
fn contents(path: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![path.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let file = entry.unwrap().path();
            if file.is_dir() {
                folders.push(file);
            } else {
                found.insert(file.strip_prefix(path).unwrap().to_path_buf(), fs::read(&file).unwrap());
            }
        }
    }
    found
}

/// A folder with ingested and segmented demonstrations; their `episodes` and `modes` relative to it.
fn segmented() -> (Place, String, String) {
    let place = Place::new();
    place.run("segment small.toml").done();
    let path = |stage: Stage| {
        let artifact = place.artifact(stage);
        format!("artifacts/{}/{}", stage.artifact(), artifact.key().short())
    };
    let (episodes, modes) = (path(Stage::Ingest), path(Stage::Segment));
    (place, episodes, modes)
}

/// The values of a feature over the whole dataset.
fn column(dataset: &Dataset, name: &str) -> Vec<f64> {
    let mut all = Vec::new();
    for number in 0..dataset.episodes().len() {
        let frames = dataset.episode(number).unwrap();
        let values = &frames.column(name).unwrap_or_else(|| panic!("no {name}")).values;
        all.extend((0..).map_while(|at| values.number(at)));
    }
    all
}

fn open(path: &Path) -> Dataset {
    Dataset::open(path, &Cameras::All, &|| false).unwrap()
}

/// The pixels of all images of a camera.
fn pixels(dataset: &Dataset, camera: &str) -> Vec<u8> {
    let mut all = Vec::new();
    let episodes = 0..dataset.episodes().len();
    dataset
        .images(camera, episodes, &|| false, |block| {
            all.extend(block.unwrap().bytes);
            Ok::<(), LerobotError>(())
        })
        .unwrap();
    all
}

fn flat<const N: usize>(rows: &[FrameRow<PlanarColumns>], of: impl Fn(&PlanarColumns) -> [f64; N]) -> Vec<f64> {
    rows.iter().flat_map(|row| of(&row.recorded)).collect()
}

fn single(values: Vec<f64>) -> Vec<f64> {
    values.into_iter().map(|value| f64::from(value as f32)).collect()
}

#[test]
fn demonstrations_of_pusht_are_equal_in_both_versions_of_lerobot() {
    let (place, episodes, modes) = segmented();
    let artifact = place.artifact(Stage::Ingest);
    let rows: Vec<FrameRow<PlanarColumns>> = artifact.read().unwrap();
    let images: Vec<ImageRow> = artifact.read().unwrap();
    for (format, jobs) in [("lerobot", 1), ("lerobot-v2.1", 2)] {
        let answer = place
            .run(&format!(
                "export {episodes} {format} --format {format} --modes {modes} --jobs {jobs} --json"
            ))
            .done()
            .json();
        assert_eq!(
            (&answer["episodes"], &answer["frames"]),
            (&12.into(), &rows.len().into())
        );
        let dataset = open(&place.path().join(format));
        assert!(dataset.notes().is_empty(), "{:?}", dataset.notes());
        let eef = flat(&rows, |frame| [frame.eef.x, frame.eef.y]);
        assert_eq!(column(&dataset, "observation.state"), single(eef));
        assert_eq!(
            column(&dataset, "action"),
            single(flat(&rows, |frame| [frame.action.x, frame.action.y]))
        );
        let poses = flat(&rows, |frame| {
            let pose = frame.object.unwrap();
            [pose.x, pose.y, pose.theta]
        });
        assert_eq!(column(&dataset, "re4.object_pose"), poses);
        assert_eq!(column(&dataset, "re4.mode"), vec![0.0; rows.len()]);
        let contacts = flat(&rows, |frame| [frame.contacts.unwrap()]);
        assert_eq!(column(&dataset, "re4.contacts"), contacts);
        // The reward of a frame is the coverage of the next one, by the episode.
        let rewards = column(&dataset, "next.reward");
        for (at, row) in rows.iter().enumerate() {
            let next = rows
                .get(at + 1)
                .filter(|next| next.episode == row.episode)
                .unwrap_or(row);
            let coverage = re4_sim::coverage(next.recorded.object.unwrap(), re4_sim::GOAL);
            assert_eq!(rewards[at], f64::from((coverage / 0.95).min(1.0) as f32));
        }
        let decoded = pixels(&dataset, "observation.image");
        let expected: Vec<u8> = images
            .iter()
            .flat_map(|row| image::load_from_memory(&row.image).unwrap().into_rgb8().into_raw())
            .collect();
        assert_eq!(expected.len(), rows.len() * SIDE * SIDE * 3);
        assert_eq!(decoded, expected);
        let info: Value =
            serde_json::from_slice(&fs::read(place.path().join(format).join("meta/info.json")).unwrap()).unwrap();
        assert_eq!(info["re4"]["key"], artifact.key().to_string());
        assert_eq!(info["fps"], 10);
    }
    // The same bytes on another run with other threads.
    place
        .run(&format!("export {episodes} again --modes {modes} --jobs 2"))
        .done();
    assert!(contents(&place.path().join("lerobot")) == contents(&place.path().join("again")));
    assert!(place.temporaries().is_empty());
}

#[test]
fn the_zarr_store_has_the_same_episodes() {
    let (place, episodes, _) = segmented();
    place
        .run(&format!("export {episodes} data/again.zarr --format pusht-zarr"))
        .done();
    let pipeline = fs::read_to_string(place.path().join("small.toml")).unwrap();
    place.write("again.toml", pipeline.replace("small.zarr", "again.zarr"));
    place.run("ingest again.toml --artifacts other").done();
    let read = |folder: PathBuf| -> Vec<FrameRow<PlanarColumns>> { Artifact::open(&folder).unwrap().read().unwrap() };
    let other = fs::read_dir(place.path().join("other/episodes"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.is_dir());
    let (before, after) = (read(place.path().join(&episodes)), read(other.unwrap()));
    // Keypoints of a recording are those of the pose.
    let same = |row: &FrameRow<PlanarColumns>| {
        (
            row.episode,
            row.frame,
            row.recorded.eef,
            row.recorded.object,
            row.recorded.action,
        )
    };
    assert_eq!(
        before.iter().map(same).collect::<Vec<_>>(),
        after.iter().map(same).collect::<Vec<_>>()
    );
}

#[test]
fn rollouts_are_exported_with_their_decisions() {
    let place = Place::new();
    place.run("rollout small.toml").done();
    let artifact = place.artifact(Stage::Rollout);
    let results: Vec<PlaneResultRow> = artifact.read().unwrap();
    let steps: Vec<PlaneStepRow> = artifact.read().unwrap();
    let folder = format!("artifacts/rollouts/{}", artifact.key().short());
    place.run(&format!("export {folder} out --float64")).done();
    let dataset = open(&place.path().join("out"));
    let lengths: Vec<usize> = dataset.episodes().iter().map(|episode| episode.length).collect();
    assert_eq!(
        lengths,
        results.iter().map(|row| row.core.steps as usize).collect::<Vec<_>>()
    );
    let actions: Vec<f64> = steps.iter().flat_map(|step| [step.action.x, step.action.y]).collect();
    assert_eq!(column(&dataset, "action"), actions);
    let states = column(&dataset, "observation.state");
    assert_eq!(states[..2], [results[0].eef.x, results[0].eef.y]);
    assert_eq!(states[2..4], [steps[0].eef.x, steps[0].eef.y]);
    let decisions: Vec<f64> = steps.iter().map(|step| f64::from(step.core.decision)).collect();
    assert_eq!(column(&dataset, "re4.decision"), decisions);
    let scores: Vec<f64> = steps.iter().map(|step| f64::from(step.score as f32)).collect();
    assert_eq!(column(&dataset, "next.reward"), scores);
    // A keep-list of seeds, with a comment.
    place.write("keep.txt", "# two\nseed 501\n\nseed 504\n");
    place.run(&format!("export {folder} two --keep keep.txt")).done();
    let two = open(&place.path().join("two"));
    assert_eq!(
        two.episodes().iter().map(|episode| episode.length).collect::<Vec<_>>(),
        [lengths[1], lengths[4]]
    );
    let refused = place.run(&format!("export {folder} three --modes {folder}")).refused();
    assert!(
        refused.contains("modes and poses are those of demonstrations"),
        "{refused}"
    );
}

#[test]
fn what_cannot_be_exported_is_refused_and_leaves_nothing() {
    let (place, episodes, modes) = segmented();
    let before = contents(place.path()).into_keys().collect::<Vec<_>>();
    place.write("keep.txt", "episode 3\nepisode 99\n");
    let refused = |arguments: &str| place.run(&format!("export {arguments}")).refused();
    let message = refused(&format!("{episodes} out --keep keep.txt"));
    assert!(message.contains("names \"episode 99\""), "{message}");
    let message = refused(&format!("{modes} out"));
    assert!(
        message.contains("an artifact of kind modes, not episodes or rollouts"),
        "{message}"
    );
    let message = refused(&format!("{episodes} out --modes {episodes}"));
    assert!(message.contains("it is an artifact of kind episodes"), "{message}");
    let message = refused(&format!("{episodes} out --format robomimic"));
    assert!(message.contains("is that of robosuite's tasks"), "{message}");
    let message = refused(&format!("{episodes} data"));
    assert!(
        message.contains("that path exists and is not an empty folder"),
        "{message}"
    );
    let message = refused(&format!("{episodes} {episodes}/out"));
    assert!(message.contains("is inside the artifact"), "{message}");
    let message = refused(&format!("{episodes} no/out"));
    assert!(message.contains("cannot create a folder beside it"), "{message}");
    let message = refused(&format!("{episodes} out --format pusht-zarr --video h264"));
    assert!(message.contains("only LeRobot datasets have videos"), "{message}");
    fs::remove_file(place.path().join("keep.txt")).unwrap();
    assert_eq!(contents(place.path()).into_keys().collect::<Vec<_>>(), before);
}

#[test]
fn a_killed_export_leaves_nothing_at_the_path() {
    let (place, episodes, _) = segmented();
    let (mut killed, mut wait) = (0, 0);
    for number in 0..20 {
        let mut child = place.start(&format!("export {episodes} out{number}"));
        std::thread::sleep(std::time::Duration::from_millis(wait));
        child.kill().unwrap();
        let ended = child.wait().unwrap().code().is_some();
        let out = place.path().join(format!("out{number}"));
        if out.exists() {
            // Complete: the reader compares all counts.
            assert_eq!(open(&out).episodes().len(), 12);
        } else {
            killed += 1;
        }
        wait = if ended { wait / 2 } else { wait + 5 };
    }
    assert!(killed > 0);
}

/// The sample of Can, ingested with states.
fn can(place: &Place, source: &Path, artifacts: &str) -> Artifact {
    let pipeline = fs::read_to_string(repository().join("pipelines/can-sample-audit.toml")).unwrap();
    place.write(
        "can.toml",
        pipeline.replace("can-sample.hdf5", source.to_str().unwrap()),
    );
    place.run(&format!("segment can.toml --artifacts {artifacts}")).done();
    let folder = place.path().join(artifacts).join("episodes");
    let found = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.is_dir());
    Artifact::open(&found.unwrap()).unwrap()
}

#[test]
fn the_hdf5_file_has_the_same_episodes() {
    let place = Place::empty();
    let first = can(&place, &repository().join("data/can-sample.hdf5"), "one");
    let out = place.path().join("out.hdf5");
    let export = |out: &Path| {
        let arguments = [
            "export",
            first.path().to_str().unwrap(),
            out.to_str().unwrap(),
            "--format",
            "robomimic",
        ];
        place.run_each(&arguments)
    };
    export(&out).done();
    let again = place.path().join("again.hdf5");
    export(&again).done();
    assert!(fs::read(&out).unwrap() == fs::read(&again).unwrap());
    assert!(export(&out).refused().contains("that path exists"));
    let second = can(&place, &out, "two");
    let frames = |artifact: &Artifact| artifact.read::<FrameRow<SpatialColumns>>().unwrap();
    assert_eq!(frames(&first), frames(&second));
    let demos = |artifact: &Artifact| artifact.read::<re4_artifact::episodes::DemoRow>().unwrap();
    let names = |artifact: &Artifact| {
        demos(artifact)
            .into_iter()
            .map(|row| (row.demo, row.filter_keys))
            .collect::<Vec<_>>()
    };
    assert_eq!(names(&first), names(&second));
    if first.has::<StateRow>() {
        let states = |artifact: &Artifact| artifact.read::<StateRow>().unwrap();
        assert_eq!(states(&first), states(&second));
    }
    // The library and h5py read it, too.
    let Some(python) = std::env::var_os("RE4_PYTHON") else {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
        return;
    };
    let program = "import h5py, json, sys\n\
        f = h5py.File(sys.argv[1])\n\
        json.loads(f['data'].attrs['env_args'])\n\
        demos = sorted(f['data'], key=lambda name: int(name[5:]))\n\
        assert int(f['data'].attrs['total']) == sum(len(f['data'][d]['actions']) for d in demos)\n\
        for d in demos:\n    \
            g = f['data'][d]\n    \
            n = int(g.attrs['num_samples'])\n    \
            assert all(len(g['obs'][k][()]) == n for k in g['obs'])\n    \
            assert len(g['rewards'][()]) == len(g['dones'][()]) == n\n\
        for key in f.get('mask', {}):\n    \
            assert all(name.decode() in demos for name in f['mask'][key][:])\n\
        print(len(demos))\n";
    let output = Command::new(python).args(["-c", program]).arg(&out).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(
        String::from_utf8_lossy(&output.stdout).trim(),
        names(&first).len().to_string()
    );
}

#[test]
fn demonstrations_in_space_are_equal_in_lerobot() {
    let place = Place::empty();
    let artifact = can(&place, &repository().join("data/can-sample.hdf5"), "one");
    place
        .run_each(&["export", artifact.path().to_str().unwrap(), "out", "--float64"])
        .done();
    let dataset = open(&place.path().join("out"));
    let rows: Vec<FrameRow<SpatialColumns>> = artifact.read().unwrap();
    let state: Vec<f64> = rows
        .iter()
        .flat_map(|row| {
            let (pose, q) = (row.recorded.eef, row.recorded.eef.rotation.coords);
            let [first, second] = row.recorded.fingers;
            [
                pose.translation.x,
                pose.translation.y,
                pose.translation.z,
                q.x,
                q.y,
                q.z,
                q.w,
                first,
                second,
            ]
        })
        .collect();
    assert_eq!(column(&dataset, "observation.state"), state);
    let actions: Vec<f64> = rows
        .iter()
        .flat_map(|row| row.recorded.delta.0.into_iter().chain([row.recorded.gripper]))
        .collect();
    assert_eq!(column(&dataset, "action"), actions);
    assert_eq!(dataset.info().fps, 20.0);
}

/// The first three human demonstrations equal those of the published conversion, which another program wrote.
#[test]
fn human_demonstrations_equal_a_foreign_dataset() {
    let Some(data) = std::env::var_os("RE4_DATA").map(PathBuf::from) else {
        println!("skipped: set RE4_DATA to the folder of the datasets");
        return;
    };
    let foreign = data.join("lerobot/pusht-v3.0-image");
    let source = data.join("pusht/pusht_cchi_v7_replay.zarr");
    if !foreign.exists() || !source.exists() {
        println!("skipped: {} has no lerobot/pusht-v3.0-image", data.display());
        return;
    }
    let place = Place::empty();
    let pipeline = fs::read_to_string(place.path().join("small.toml")).unwrap();
    place.write("human.toml", pipeline.replace("small.zarr", source.to_str().unwrap()));
    place
        .run_each(&["ingest", "human.toml", "--set", "ingest.select={first=3}"])
        .done();
    let folder = format!("artifacts/episodes/{}", place.artifact(Stage::Ingest).key().short());
    place.run(&format!("export {folder} out")).done();
    let (own, foreign) = (open(&place.path().join("out")), open(&foreign));
    for name in ["observation.state", "action", "next.done", "next.success"] {
        assert_eq!(column(&own, name), column(&foreign, name), "{name}");
    }
    // The coverage of another library differs in the last digits.
    for (own, foreign) in column(&own, "next.reward").iter().zip(column(&foreign, "next.reward")) {
        assert!((own - foreign).abs() < 1e-5, "{own} {foreign}");
    }
    assert!(pixels(&own, "observation.image") == pixels(&foreign, "observation.image"));
}

#[test]
fn an_exported_lerobot_dataset_is_ingested_again() {
    let (place, episodes, _) = segmented();
    place
        .run(&format!("export {episodes} data/set --format lerobot --float64"))
        .done();
    place.write(
        "again.toml",
        "task = \"pusht\"\n[ingest]\nsource = \"set\"\n[segment]\nrule = \"always_transit\"\n",
    );
    let again = place
        .run("ingest again.toml --artifacts again --json --quiet")
        .done()
        .json();
    let again = Artifact::open(&place.path().join(again["artifact"].as_str().unwrap())).unwrap();
    let numbers = |artifact: &Artifact| {
        let rows: Vec<FrameRow<PlanarColumns>> = artifact.read().unwrap();
        let of = |frame: &PlanarColumns| {
            let pose = frame.object.unwrap();
            let (eef, action) = (frame.eef, frame.action);
            [eef.x, eef.y, pose.x, pose.y, pose.theta, action.x, action.y]
        };
        (rows.len(), flat(&rows, of))
    };
    assert_eq!(numbers(&again), numbers(&place.artifact(Stage::Ingest)));
    let conventions: Vec<re4_ingest::Convention> = again.read().unwrap();
    let reward = conventions.iter().find(|row| &*row.convention == "reward").unwrap();
    assert_eq!((&*reward.value, &*reward.basis), ("coverage_next_frame", "proven"));
}
