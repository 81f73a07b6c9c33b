//! The front-ends in `scripts/engines` run plans: on this machine, on three Slurm nodes and on three Ray nodes, which are real and on the
//! loopback. Nodes are killed in the middle of a task, and lost nodes go on writing.
//!
//! The tests on Slurm need root and the Debian packages of Slurm and MUNGE, those on Ray need a Python with `ray` in the variable
//! `RE4_RAY`; `scripts/setup-engines.sh` installs both. Otherwise they report that they are skipped.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::support::{Answer, Place, Process, assert_same_bytes, folders_in, repository, wait_for};

/// Rollouts of six parts, the last of which is smaller.
const SIX_PARTS: [&str; 5] = [
    "small.toml",
    "--set",
    "rollout.seeds=300000..306000",
    "--set",
    "rollout.max_steps=4",
];

/// Two policies with rollouts of two parts each.
const SUITE: &str = r#"
pipeline = "small.toml"
seeds = "300000..301100"
set = { rollout.max_steps = 4 }

[[row]]
name = "ours"

[[row]]
name = "RE2"
policy = "re2"

[[column]]
name = "few"
"#;

/// A file of the repository, as an argument.
fn file(name: &str) -> String {
    repository().join(name).to_str().unwrap().to_owned()
}

/// The plan of [`SIX_PARTS`], with more arguments of `re4-pipe plan`.
fn plan(place: &Place, more: &[&str]) -> Value {
    planned(place, &[&SIX_PARTS[..], more].concat())
}

/// The plan of a pipeline or a suite.
fn planned(place: &Place, arguments: &[&str]) -> Value {
    let mut plan = place.run_each(&[&["plan", "--json"], arguments].concat()).done().json();
    // `Answer` has replaced it.
    plan["directory"] = place.path().to_str().unwrap().into();
    plan
}

/// What one process makes of [`SIX_PARTS`].
fn unsharded() -> BTreeMap<String, Vec<u8>> {
    let place = Place::new();
    place.run_each(&[&["rollout"], &SIX_PARTS[..]].concat()).done();
    made_in(&place)
}

/// The artifacts that rollouts need. The command `segment`, which is in every plan, also audits.
fn made_in(place: &Place) -> BTreeMap<String, Vec<u8>> {
    let mut bytes = place.bytes();
    bytes.retain(|name, _| !name.starts_with("audit/"));
    bytes
}

/// A group of tasks that need no artifacts.
fn group(id: &str, count: u32, after: &[&str], command: &[&str]) -> Value {
    json!({
        "id": id, "stage": id, "count": count, "after": after, "cpus": 1, "memory_mb": 100, "gpus": 0, "outputs": [], "command": command
    })
}

fn plan_of(place: &Place, groups: &[Value]) -> Value {
    json!({
        "format": 1, "directory": place.path(), "pipeline": "none", "artifacts": "artifacts", "shards": 1, "sources": [],
        "groups": groups
    })
}

/// Lets the task `at` of a group do as `mode` says ([`tests/engine_task.py`]).
fn stop_at(place: &Place, plan: &mut Value, id: &str, at: u32, mode: &str) {
    let groups = plan["groups"].as_array_mut().unwrap();
    let group = groups.iter_mut().find(|group| group["id"] == id).unwrap();
    let script = file("tests/engine_task.py");
    let folder = place.path().to_str().unwrap();
    let mut command: Vec<Value> = ["python3", &script, folder, "{index}", &at.to_string(), mode]
        .map(Value::from)
        .to_vec();
    command.extend(group["command"].as_array().unwrap().clone());
    group["command"] = command.into();
}

/// A running front-end. Its logs are in the folder `logs`. It is killed if the test fails.
struct Engine(Option<Child>);

impl Engine {
    /// Starts `scripts/engines/NAME` with a plan, in the folder of the test.
    fn start(place: &Place, cluster: &Cluster, plan: &Value, more: &[&str]) -> Self {
        place.write("plan.json", plan.to_string());
        let _ = fs::remove_dir_all(place.path().join("logs"));
        let mut command = Command::new(&cluster.python);
        command
            .arg(file(&format!("scripts/engines/{}", cluster.engine)))
            .args(["plan.json", "--logs", "logs"])
            .args(&cluster.options)
            .args(more)
            .current_dir(place.path())
            .env("RE4_DATA", place.path().join("data"))
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .env_remove("RAY_ADDRESS")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        if let Some(configuration) = &cluster.configuration {
            command.env("SLURM_CONF", configuration);
        }
        Self(Some(command.spawn().unwrap()))
    }

    /// Waits for the end of the front-end, and does something meanwhile.
    #[track_caller]
    fn finish(mut self, place: &Place, mut meanwhile: impl FnMut()) -> Answer {
        let mut child = self.0.take().unwrap();
        let start = Instant::now();
        wait_for("the end of the front-end", || {
            meanwhile();
            std::thread::sleep(Duration::from_millis(200));
            child.try_wait().unwrap()
        });
        println!("the front-end took {:.0} s", start.elapsed().as_secs_f64());
        Answer::new(&child.wait_with_output().unwrap(), place.path())
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        if let Some(mut child) = self.0.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// A cluster that a script in `tests/` started and ends, or this machine, which needs none.
struct Cluster {
    engine: &'static str,
    /// The interpreter of the front-end.
    python: PathBuf,
    options: Vec<String>,
    configuration: Option<PathBuf>,
    script: Option<(Child, ChildStdin, BufReader<ChildStdout>)>,
}

impl Cluster {
    /// This machine.
    fn local() -> Self {
        Self {
            engine: "local",
            python: "python3".into(),
            options: ["--jobs", "2"].map(str::to_owned).to_vec(),
            configuration: None,
            script: None,
        }
    }

    /// Three Slurm nodes; if they cannot be started here, prints that the test is skipped. 11 as `MaxArraySize` makes an array of 12
    /// tasks two arrays.
    fn slurm(place: &Place) -> Option<Self> {
        let programs = ["slurmctld", "slurmd", "sbatch", "munged", "python3"];
        let folders: Vec<PathBuf> = std::env::split_paths(&std::env::var_os("PATH")?).collect();
        let missing = |name: &&str| !folders.iter().any(|folder| folder.join(name).exists());
        if let Some(name) = programs.iter().find(|name| missing(name)) {
            println!("skipped: no {name} on the PATH; run scripts/setup-engines.sh");
            return None;
        }
        if fs::metadata("/proc/self").unwrap().uid() != 0 {
            println!("skipped: the daemons of Slurm and MUNGE need root");
            return None;
        }
        let mut cluster = Self::local();
        cluster.engine = "slurm";
        cluster.options = ["--every", "1"].map(str::to_owned).to_vec();
        let facts = cluster.up("tests/loopback_slurm.py", place, &["11"]);
        cluster.configuration = Some(facts["SLURM_CONF"].as_str().unwrap().into());
        Some(cluster)
    }

    /// Three Ray nodes; if no Python has Ray, prints that the test is skipped.
    fn ray(place: &Place) -> Option<Self> {
        let Some(python) = std::env::var_os("RE4_RAY") else {
            println!(
                "skipped: RE4_RAY names no Python with ray; run scripts/setup-engines.sh ray and set it to target/ray/bin/python"
            );
            return None;
        };
        let mut cluster = Self::local();
        cluster.engine = "ray";
        cluster.python = python.into();
        let facts = cluster.up("tests/loopback_ray.py", place, &[]);
        let text = |name: &str| facts[name].as_str().unwrap().to_owned();
        cluster.options = vec![
            "--address".to_owned(),
            text("address"),
            "--node-ip-address".to_owned(),
            text("node_ip_address"),
        ];
        Some(cluster)
    }

    /// Starts the nodes, and returns what the script says about them.
    fn up(&mut self, script: &str, place: &Place, more: &[&str]) -> Value {
        let start = Instant::now();
        let mut child = Command::new(&self.python)
            .arg(file(script))
            .arg(place.path().join("cluster"))
            .args(more)
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .env_remove("RAY_ADDRESS")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (input, output) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        self.script = Some((child, input, BufReader::new(output)));
        let facts = self.answer();
        println!("the nodes were up after {:.0} s", start.elapsed().as_secs_f64());
        facts
    }

    /// The next line of the script that is JSON; other lines are those of Ray.
    #[track_caller]
    fn answer(&mut self) -> Value {
        let (_, _, output) = self.script.as_mut().unwrap();
        loop {
            let mut line = String::new();
            assert!(output.read_line(&mut line).unwrap() > 0, "the cluster has ended");
            if let Ok(value) = serde_json::from_str(&line) {
                return value;
            }
        }
    }

    #[track_caller]
    fn ask(&mut self, command: &str) -> Value {
        writeln!(self.script.as_mut().unwrap().1, "{command}").unwrap();
        self.answer()
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        if let Some((mut child, input, _)) = self.script.take() {
            // The script kills all nodes at the end of its input.
            drop(input);
            let _ = child.wait();
        }
    }
}

/// Waits until the task `at` has stopped in its first try, and returns its process and the node it runs on.
#[track_caller]
fn stopped(place: &Place, id: &str, at: u32) -> (Process, String) {
    let process = wait_for("a task that waits", || {
        let text = fs::read_to_string(place.path().join(format!("{at}.waiting"))).ok()?;
        Process::of(text.parse().ok()?)
    });
    let log = fs::read_to_string(place.path().join(format!("logs/{id}.{at}.log"))).unwrap();
    let node = log.split(" begins on ").nth(1).unwrap().split(',').next().unwrap();
    (process, node.to_owned())
}

/// The result line of a front-end, without times.
fn verdict(answer: &Answer) -> String {
    let line = answer.stdout.lines().last().unwrap_or_default();
    let counts = line.split(" tried again").next().unwrap();
    counts.to_owned()
}

/// What every front-end does with tasks that end in some way. `again` is called until the front-end ends.
fn tasks_end_in_every_way(cluster: &mut Cluster, mut again: impl FnMut(&mut Cluster)) {
    let place = Place::empty();
    let make = "mkdir -p made && printf '%s\\n' \"$1\" > made/$2.$$ && ln made/$2.$$ made/$2 && rm made/$2.$$";
    let odd = "it's \"$HOME\" {count} {index}, $(date) `date` \\\\ *";
    let merge = "cat $(seq -f made/%g 0 11) > made/all";
    let groups = [
        group("a", 12, &[], &["sh", "-c", make, "make", odd, "{index}"]),
        group("a.merge", 1, &["a"], &["sh", "-c", merge]),
    ];
    // The last task is beyond MaxArraySize.
    let mut plan = plan_of(&place, &groups);
    stop_at(&place, &mut plan, "a", 11, "interrupt");
    let engine = Engine::start(&place, cluster, &plan, &[]);
    let answer = engine.finish(&place, || again(cluster)).done();
    assert_eq!(
        verdict(&answer),
        "re4-engine: 13 of 13 tasks done, 0 failed, 0 not run, 1"
    );
    assert!(answer.stdout.contains("a 11/12 ran 2 times, on "), "{}", answer.stdout);
    let expected: Vec<String> = (0..12)
        .map(|index| odd.replace("{count}", "12").replace("{index}", &index.to_string()))
        .collect();
    let made = fs::read_to_string(place.path().join("made/all")).unwrap();
    assert_eq!(made.lines().collect::<Vec<_>>(), expected);

    // Only some tasks; one of them fails, so that the groups after it do not run.
    let fail = "echo so it is broken >&2; exit 9";
    let mut groups = [
        group(
            "b",
            12,
            &[],
            &[
                "sh",
                "-c",
                "test $0 != 7 || { echo so it is broken >&2; exit 9; }",
                "{index}",
            ],
        ),
        group("b.merge", 1, &["b"], &["sh", "-c", fail]),
        group("c", 2, &["b.merge"], &["sh", "-c", fail]),
        group("d", 2, &[], &["true"]),
    ];
    groups[0]["indices"] = json!([3, 7, 10]);
    let engine = Engine::start(&place, cluster, &plan_of(&place, &groups), &[]);
    let answer = engine.finish(&place, || again(cluster));
    assert_eq!(answer.code, Some(1), "{}{}", answer.stdout, answer.stderr);
    assert_eq!(
        verdict(&answer),
        "re4-engine: 4 of 8 tasks done, 1 failed, 3 not run, 0"
    );
    assert!(answer.stdout.contains("b 7/12 failed with 9 on "), "{}", answer.stdout);
    assert!(
        answer
            .stdout
            .contains("see [folder]/logs/b.7.log\n    so it is broken\n"),
        "{}",
        answer.stdout
    );
}

#[test]
fn tasks_on_this_machine() {
    let mut cluster = Cluster::local();
    tasks_end_in_every_way(&mut cluster, |_| ());
    // A task that is killed is tried again, but not for ever.
    let place = Place::empty();
    for (retries, code, counts) in [
        ("1", 0, "1 of 1 tasks done, 0 failed"),
        ("0", 1, "0 of 1 tasks done, 1 failed"),
    ] {
        let _ = fs::remove_file(place.path().join("0.first"));
        let mut plan = plan_of(&place, &[group("a", 1, &[], &["true"])]);
        stop_at(&place, &mut plan, "a", 0, "die");
        let engine = Engine::start(&place, &cluster, &plan, &["--retries", retries]);
        let answer = engine.finish(&place, || ());
        assert_eq!(answer.code, Some(code), "{}{}", answer.stdout, answer.stderr);
        assert!(answer.stdout.contains(counts), "{}", answer.stdout);
    }
    // SIGTERM ends the tasks too.
    let mut plan = plan_of(&place, &[group("a", 9, &[], &["true"])]);
    stop_at(&place, &mut plan, "a", 1, "gate");
    let engine = Engine::start(&place, &cluster, &plan, &[]);
    let (task, _) = stopped(&place, "a", 1);
    crate::support::signal(engine.0.as_ref().unwrap(), "TERM");
    let answer = engine.finish(&place, || ());
    assert_eq!(answer.code, Some(75), "{}{}", answer.stdout, answer.stderr);
    assert!(answer.stdout.contains("re4-engine: interrupted, "), "{}", answer.stdout);
    assert!(!task.is_running());
}

#[test]
fn plans_that_cannot_run() {
    let place = Place::empty();
    let cluster = Cluster::local();
    let refused = |plan: &Value, more: &[&str], expected: &str| {
        let answer = Engine::start(&place, &cluster, plan, more).finish(&place, || ());
        assert!(answer.refused().contains(expected));
    };
    refused(&json!([]), &[], "plan.json is not a plan");
    refused(
        &json!({"format": 2, "groups": []}),
        &[],
        "plan.json has format 2, not 1",
    );
    refused(
        &plan_of(&place, &[]),
        &["--missing"],
        "--missing has no effect on a finished plan",
    );
    let answer = Engine::start(&place, &cluster, &plan_of(&place, &[]), &[]).finish(&place, || ());
    assert!(answer.done().stdout.contains("nothing to do"));
}

/// Names of the parts of the rollouts that are made.
fn parts(place: &Place) -> Vec<String> {
    folders_in(&place.artifacts().join("rollouts"))
        .iter()
        .flat_map(|artifact| folders_in(&artifact.join("parts")))
        .map(|part| part.file_name().unwrap().to_str().unwrap().to_owned())
        .collect()
}

/// The plan of [`SIX_PARTS`] with three shards: the first try of shard 1 stops when one of its two parts is made, that of shard 2
/// before its first.
fn stopping_plan(place: &Place) -> Value {
    let mut plan = plan(place, &["--shards", "3"]);
    stop_at(place, &mut plan, "rollout", 2, "gate");
    stop_at(place, &mut plan, "rollout", 1, "2/6");
    plan
}

/// Asserts that these tasks ran twice, first on these nodes, and that nothing else was tried again or failed.
#[track_caller]
fn assert_tried_again(answer: &Answer, tasks: &[(&str, &str)]) {
    println!("{}", answer.stdout);
    for (task, node) in tasks {
        let line = format!("{task} ran 2 times, on {node}, ");
        assert!(answer.stdout.contains(&line), "{}", answer.stdout);
    }
    let counts = format!(" 0 failed, 0 not run, {}", tasks.len());
    assert!(verdict(answer).ends_with(&counts), "{}", answer.stdout);
}

/// A node is lost while it makes the second part of its shard of a suite. It cannot be `head`. `again` is called until the front-end ends.
fn a_suite_loses_a_node(
    cluster: &mut Cluster,
    head: &str,
    kill: impl FnOnce(&mut Cluster, &str),
    mut again: impl FnMut(&mut Cluster),
) {
    let place = Place::new();
    place.write("suite.toml", SUITE);
    let mut plan = planned(&place, &["suite.toml", "--shards", "2"]);
    stop_at(&place, &mut plan, "compare", 0, "0/4");
    stop_at(&place, &mut plan, "compare", 1, "2/4");
    let engine = Engine::start(&place, cluster, &plan, &[]);
    let mut running = [0, 1].map(|index| (index, stopped(&place, "compare", index)));
    if running[0].1.1 == head {
        running.reverse();
    }
    let [(lost, (process, node)), (other, _)] = running;
    let made = parts(&place);
    assert_eq!(made.len(), 2, "{made:?}");
    kill(cluster, &node);
    process.wait();
    place.write(&format!("{other}.open"), "");
    let answer = engine.finish(&place, || again(cluster)).done();
    assert_tried_again(&answer, &[(&format!("compare {lost}/2"), &node)]);
    let whole = Place::new();
    whole.write("suite.toml", SUITE);
    whole.run("compare suite.toml").done();
    assert_eq!(folders_in(&place.artifacts().join("comparison")).len(), 1);
    assert_same_bytes(&made_in(&place), &made_in(&whole));
}

#[test]
fn three_slurm_nodes() {
    let base = Place::empty();
    let Some(mut cluster) = Cluster::slurm(&base) else {
        return;
    };
    // Slurm lets a requeued task wait for two minutes.
    tasks_end_in_every_way(&mut cluster, |cluster| {
        cluster.ask("release");
    });
    let mut killed = String::new();
    let kill = |cluster: &mut Cluster, node: &str| {
        cluster.ask(&format!("kill {node}"));
        killed = format!("start {node}");
    };
    a_suite_loses_a_node(&mut cluster, "", kill, |cluster| {
        cluster.ask("release");
    });
    cluster.ask(&killed);

    let place = Place::new();
    let plan = stopping_plan(&place);
    let engine = Engine::start(&place, &cluster, &plan, &[]);
    let (killed, node) = stopped(&place, "rollout", 1);
    let (orphan, lost) = stopped(&place, "rollout", 2);
    let made = parts(&place);
    assert!(made.iter().any(|part| part == "000002"), "{made:?}");
    assert!(!made.iter().any(|part| part > &"000002".to_owned()), "{made:?}");
    // One node is gone with its task. Another one is lost for Slurm, but its task goes on.
    cluster.ask(&format!("kill {node}"));
    killed.wait();
    assert_eq!(cluster.ask(&format!("orphan {lost}")), json!(["slurmd"]));
    assert!(orphan.is_running());
    let again = place.path().join("2.again");
    let answer = engine
        .finish(&place, || {
            cluster.ask("release");
            // The lost task and its second try write the same parts.
            if again.exists() && !place.path().join("2.open").exists() {
                assert!(orphan.is_running());
                place.write("2.open", "");
            }
        })
        .done();
    orphan.wait();
    assert_tried_again(&answer, &[("rollout 1/3", &node), ("rollout 2/3", &lost)]);
    assert_same_bytes(&made_in(&place), &unsharded());
}

#[test]
fn three_ray_nodes() {
    let base = Place::empty();
    let Some(mut cluster) = Cluster::ray(&base) else { return };
    tasks_end_in_every_way(&mut cluster, |_| ());
    // The driver and the tables of the cluster are on the head, 127.0.0.2, which cannot be lost.
    let number = |node: &str| if node == "127.0.0.3" { 1 } else { 2 };
    let mut lost = 0;
    let kill = |cluster: &mut Cluster, node: &str| {
        lost = number(node);
        assert_eq!(cluster.ask(&format!("kill {lost}")), json!(["raylet"]));
    };
    a_suite_loses_a_node(&mut cluster, "127.0.0.2", kill, |_| ());
    cluster.ask(&format!("start {lost}"));

    let place = Place::new();
    let plan = stopping_plan(&place);
    let engine = Engine::start(&place, &cluster, &plan, &[]);
    let (killed, node) = stopped(&place, "rollout", 1);
    let (_, other) = stopped(&place, "rollout", 2);
    let (index, node) = if node == "127.0.0.2" { (2, other) } else { (1, node) };
    assert_eq!(cluster.ask(&format!("kill {}", number(&node))), json!(["raylet"]));
    place.write(if index == 1 { "2.open" } else { "1.open" }, "");
    let answer = engine.finish(&place, || ()).done();
    if index == 1 {
        killed.wait();
    }
    assert_tried_again(&answer, &[(&format!("rollout {index}/3"), &node)]);
    assert_same_bytes(&made_in(&place), &unsharded());
}

#[test]
fn shards_in_any_number_and_order_give_the_same_bytes() {
    let expected = unsharded();
    for (count, order) in [
        (2, vec![1, 0]),
        (7, vec![3, 6, 0, 2, 1, 5, 4]),
        (13, (0..13).rev().collect()),
    ] {
        let place = Place::new();
        place.run_each(&[&["index"], &SIX_PARTS[..]].concat()).done();
        for index in order {
            let shard = format!("{index}/{count}");
            place
                .run_each(&[&["rollout"], &SIX_PARTS[..], &["--shard", &shard]].concat())
                .done();
        }
        place.run_each(&[&["merge", "rollout"], &SIX_PARTS[..]].concat()).done();
        assert_same_bytes(&made_in(&place), &expected);
    }
}

#[test]
fn a_missing_part_is_named_and_made() {
    let place = Place::new();
    let cluster = Cluster::local();
    let mut incomplete = plan(&place, &["--shards", "6"]);
    for group in incomplete["groups"].as_array_mut().unwrap() {
        if group["id"] == "rollout" {
            group["indices"] = json!([0, 1, 2, 3, 5]);
        }
    }
    let answer = Engine::start(&place, &cluster, &incomplete, &[]).finish(&place, || ());
    assert_eq!(answer.code, Some(1), "{}{}", answer.stdout, answer.stderr);
    assert!(
        answer.stdout.contains("rollout.merge 0/1 failed with 3 on "),
        "{}",
        answer.stdout
    );
    let merge = place.run_each(&[&["merge", "rollout"], &SIX_PARTS[..]].concat());
    assert_eq!(merge.code, Some(3), "{}", merge.stderr);
    assert!(
        merge.stderr.contains("000004") || merge.stderr.contains(" 4"),
        "{}",
        merge.stderr
    );

    let missing = plan(&place, &["--shards", "6", "--missing"]);
    let groups = missing["groups"].as_array().unwrap();
    let ids: Vec<&str> = groups.iter().map(|group| group["id"].as_str().unwrap()).collect();
    assert_eq!(ids, ["rollout", "rollout.merge"]);
    assert_eq!(groups[0]["indices"], json!([4]));
    Engine::start(&place, &cluster, &missing, &[])
        .finish(&place, || ())
        .done();
    assert_same_bytes(&made_in(&place), &unsharded());
    assert_eq!(plan(&place, &["--shards", "6", "--missing"])["groups"], json!([]));
}

#[test]
fn two_writers_of_the_same_parts_give_the_same_bytes() {
    let place = Place::new();
    place.run_each(&[&["index"], &SIX_PARTS[..]].concat()).done();
    let start = || {
        let mut command = place.command();
        command
            .arg("rollout")
            .args(SIX_PARTS)
            .args(["--shard", "0/2"])
            .stdout(Stdio::null());
        command.spawn().unwrap()
    };
    for mut writer in [start(), start(), start()] {
        assert!(writer.wait().unwrap().success());
    }
    place.run_each(&[&["rollout"], &SIX_PARTS[..]].concat()).done();
    assert_same_bytes(&made_in(&place), &unsharded());
}

/// The front-end makes the plan itself when it is given a pipeline.
#[test]
fn a_pipeline_is_planned_and_run_by_one_command() {
    let place = Place::new();
    let output = Command::new(file("scripts/engines/local"))
        .args(SIX_PARTS)
        .args(["--shards", "4", "--jobs", "2"])
        .current_dir(place.path())
        .env("RE4_DATA", place.path().join("data"))
        .env("RE4_PIPE", crate::support::PROGRAM)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .unwrap();
    let answer = Answer::new(&output, place.path()).done();
    assert!(
        answer.stdout.contains("rollout          4 of 4 tasks done"),
        "{}",
        answer.stdout
    );
    assert_same_bytes(&made_in(&place), &unsharded());
}
