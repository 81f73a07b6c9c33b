//! An artifact is either complete or absent, whatever happens to its writer.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail by panicking"
)]

mod common;

use std::fs;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use common::{EVERY_KIND, artifact_names, columns, files, publish_sample, recipe, sample_rows};
use re4_artifact::{ArtifactSummary, Key, Stage, Store, Writer, verify};
use re4_fault::Remedy as _;
use serde_json::json;

/// Timeout for events that must happen; long, because the machine may be busy.
const LONGEST: Duration = Duration::from_mins(5);

const ROOT: &str = "RE4_TEST_ROOT";
const TASK: &str = "RE4_TEST_TASK";

/// Prepares a child process that runs the test [`child`] of this binary with a task.
fn spawn(task: &str, root: &Path) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args(["--exact", "child", "--nocapture"])
        .env(ROOT, root)
        .env(TASK, task)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// The entry point of child processes. Without a task, as in a normal test run, it does nothing.
#[test]
fn child() {
    let (Ok(task), Ok(root)) = (std::env::var(TASK), std::env::var(ROOT)) else {
        return;
    };
    let root = PathBuf::from(root);
    match task.as_str() {
        "publish forever" => {
            let store = Store::open(&root).unwrap();
            for number in 0.. {
                publish_sample(&store, number, 2_000);
                store
                    .record_run(Stage::Segment, &recipe(number).key(), &json!({"wall_s": 0.5}))
                    .unwrap();
            }
        }
        "publish one" => {
            let artifact = publish_sample(&Store::open(&root).unwrap(), 1, 20_000);
            println!("published {}", artifact.manifest().manifest_blake3);
        }
        "begin without permission" => {
            let store = Store::open(&root).unwrap();
            println!("refused: {}", store.begin(&recipe(1)).unwrap_err().sentence());
        }
        other => panic!("no such task: {other}"),
    }
}

fn half_written(store: &Store) -> Writer {
    let writer = store.begin(&recipe(1)).unwrap();
    let mut table = writer.table_in_groups(&EVERY_KIND, 10).unwrap();
    table.write_columns(columns(&sample_rows(100))).unwrap();
    drop(table);
    writer
}

#[test]
fn a_dropped_writer_leaves_no_files() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let writer = half_written(&store);
    assert_eq!(artifact_names(root.path()).len(), 1);
    drop(writer);
    assert_eq!(artifact_names(root.path()), Vec::<String>::new());
    assert!(store.lookup(Stage::Segment, &recipe(1).key()).unwrap().is_none());
}

#[test]
fn unfinished_and_repeated_tables_are_not_published() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let writer = half_written(&store);
    let twice = writer.table(&EVERY_KIND).err().unwrap().sentence();
    assert!(twice.ends_with("table every_kind was started twice"), "{twice}");
    let refused = writer.publish(ArtifactSummary::default()).unwrap_err().sentence();
    let folder = store.folder(Stage::Segment, &recipe(1).key());
    assert_eq!(
        refused,
        format!("cannot publish {}: table every_kind was not finished", folder.display())
    );
    assert_eq!(artifact_names(root.path()), Vec::<String>::new());
}

#[test]
fn opening_a_store_removes_leftovers_but_not_the_files_of_a_running_writer() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let writer = half_written(&store);
    let [own] = <[String; 1]>::try_from(artifact_names(root.path())).unwrap();
    assert!(own.starts_with(&format!(".tmp-{}-", recipe(1).key().short())), "{own}");
    // The same process at another time, and so one that no longer runs.
    let (before, random) = own.rsplit_once('-').unwrap();
    let dead = root.path().join(format!("{before}0-{random}"));
    fs::create_dir(&dead).unwrap();
    fs::write(dead.join("modes.parquet"), "half").unwrap();
    fs::write(root.path().join(format!("{before}1-{random}")), "{").unwrap();
    // A writer on another machine.
    let mut parts: Vec<&str> = own.split('-').collect();
    parts[2] = "node17";
    let elsewhere = parts.join("-");
    fs::create_dir(root.path().join(&elsewhere)).unwrap();
    Store::open(root.path()).unwrap();
    let mut expected = [own, elsewhere.clone()];
    expected.sort();
    assert_eq!(artifact_names(root.path()), expected);
    drop(writer);
    assert_eq!(artifact_names(root.path()), std::slice::from_ref(&elsewhere));
}

#[test]
fn a_published_artifact_is_found() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(&root.path().join("new/folder")).unwrap();
    let artifact = publish_sample(&store, 1, 100);
    let found = Store::open(store.root())
        .unwrap()
        .lookup(Stage::Segment, &recipe(1).key())
        .unwrap()
        .unwrap();
    assert_eq!(found.manifest(), artifact.manifest());
    assert_eq!(found.path(), store.root().join("modes").join(recipe(1).key().short()));
    let inside: Vec<_> = files(found.path()).into_keys().collect();
    assert_eq!(
        inside,
        [PathBuf::from("every_kind.parquet"), PathBuf::from("manifest.json")]
    );
    let run = store
        .record_run(Stage::Segment, found.key(), &json!({"wall_s": 1.5, "host": "h"}))
        .unwrap();
    assert_eq!(
        run,
        store.root().join(format!("runs/segment-{}.json", found.key().short()))
    );
    assert_eq!(
        fs::read_to_string(run).unwrap(),
        "{\n  \"host\": \"h\",\n  \"wall_s\": 1.5\n}\n"
    );
    verify(found.path(), &|_, _| None).unwrap();
}

/// Whether a process has started to write an artifact and has not yet published it.
fn is_writing(root: &Path) -> bool {
    let Ok(entries) = fs::read_dir(root) else {
        return false;
    };
    entries
        .filter_map(Result::ok)
        .any(|entry| entry.file_name().to_string_lossy().starts_with(".tmp-"))
}

#[test]
fn files_of_killed_processes_are_never_taken_for_artifacts() {
    let root = tempfile::tempdir().unwrap();
    let mut interrupted = 0;
    for moment in 0..25u64 {
        let mut process: Child = spawn("publish forever", root.path()).spawn().unwrap();
        // Wait for its first artifact, which can take long on a busy machine.
        let start = Instant::now();
        while !is_writing(root.path()) {
            assert!(start.elapsed() < LONGEST, "the process writes nothing");
            thread::sleep(Duration::from_millis(1));
        }
        thread::sleep(Duration::from_millis(moment * 3));
        process.kill().unwrap();
        process.wait().unwrap();
        let left = artifact_names(root.path());
        interrupted += usize::from(left.iter().any(|name| name.starts_with(".tmp-")));
        let store = Store::open(root.path()).unwrap();
        for name in artifact_names(root.path()) {
            assert!(!name.starts_with(".tmp-"), "{name} was left");
            let report = verify(&root.path().join("modes").join(&name), &|_, _| None).unwrap();
            assert_eq!(report.files[1].rows, Some(2_000));
        }
        // After all interruptions the store still works, and gives the same bytes as an empty store.
        if moment == 24 {
            let after = publish_sample(&store, 1_000_000, 2_000);
            let elsewhere = tempfile::tempdir().unwrap();
            let undisturbed = publish_sample(&Store::open(elsewhere.path()).unwrap(), 1_000_000, 2_000);
            assert_eq!(files(after.path()), files(undisturbed.path()));
        }
    }
    assert!(interrupted > 0, "no process was killed while it was writing");
}

#[test]
fn processes_that_publish_the_same_key_at_once_all_succeed() {
    let root = tempfile::tempdir().unwrap();
    let processes: Vec<Child> = (0..4)
        .map(|_| spawn("publish one", root.path()).spawn().unwrap())
        .collect();
    let mut hashes: Vec<String> = processes
        .into_iter()
        .map(|process| {
            let output = process.wait_with_output().unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            let stdout = String::from_utf8(output.stdout).unwrap();
            let line = stdout.lines().find_map(|line| line.split("published ").nth(1));
            line.unwrap_or_else(|| panic!("{stdout}")).to_owned()
        })
        .collect();
    hashes.dedup();
    assert_eq!(hashes.len(), 1);
    assert_eq!(artifact_names(root.path()), [recipe(1).key().short()]);
    verify(&root.path().join("modes").join(recipe(1).key().short()), &|_, _| None).unwrap();
}

#[test]
fn threads_that_publish_the_same_key_at_once_all_succeed() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let keys: Vec<Key> = thread::scope(|scope| {
        let workers: Vec<_> = (0..6)
            .map(|_| scope.spawn(|| *publish_sample(&store, 1, 5_000).key()))
            .collect();
        workers.into_iter().map(|worker| worker.join().unwrap()).collect()
    });
    assert_eq!(keys, [recipe(1).key(); 6]);
    assert_eq!(artifact_names(root.path()), [recipe(1).key().short()]);
}

#[test]
fn equal_keys_with_different_bytes_are_refused() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let writer = store.begin(&recipe(1)).unwrap();
    let mut table = writer.table_in_groups(&EVERY_KIND, 64).unwrap();
    table.write_columns(columns(&sample_rows(31))).unwrap();
    table.finish().unwrap();
    let theirs = publish_sample(&store, 1, 30);
    let refused = writer.publish(ArtifactSummary::default()).unwrap_err().sentence();
    let folder = theirs.path().display();
    assert_eq!(
        refused,
        format!(
            "cannot publish {folder}: another run published the same key with different bytes in table every_kind; delete the \
             folder {folder}, run again, and report a bug, because equal keys must give equal bytes"
        )
    );
    assert_eq!(artifact_names(root.path()).len(), 1);
}

/// A tmpfs that is mounted on a temporary folder; `None` if the test may not mount file systems.
struct Mounted(tempfile::TempDir);

impl Mounted {
    fn new(options: &str) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", options, "tmpfs"])
            .arg(folder.path())
            .output()
            .is_ok_and(|output| output.status.success());
        if !mounted {
            println!("skipped: this process may not mount a file system");
        }
        mounted.then(|| Self(folder))
    }

    fn remount(&self, options: &str) {
        let status = Command::new("mount")
            .args(["-o", options])
            .arg(self.0.path())
            .status()
            .unwrap();
        assert!(status.success());
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0.path()).status();
    }
}

#[test]
fn a_full_disk_is_reported_and_no_files_are_left() {
    let Some(disk) = Mounted::new("size=256k") else { return };
    let store = Store::open(disk.0.path()).unwrap();
    let writer = store.begin(&recipe(1)).unwrap();
    let mut table = writer.table_in_groups(&EVERY_KIND, 100).unwrap();
    let rows = sample_rows(1_000);
    let mut error = None;
    for _ in 0..1_000 {
        if let Err(refused) = table.write_columns(columns(&rows)) {
            error = Some(refused.sentence());
            break;
        }
    }
    let error = error.unwrap();
    assert!(
        error.starts_with("cannot write ") && error.contains("every_kind.parquet"),
        "{error}"
    );
    assert!(
        error.ends_with("the disk is full; free space there or choose another artifacts folder"),
        "{error}"
    );
    drop(table);
    drop(writer);
    assert!(artifact_names(disk.0.path()).is_empty());
    // A child process of another test that has been forked but not yet executed keeps the deleted files open, so that their space
    // is freed later.
    let probe = disk.0.path().join("probe");
    let start = Instant::now();
    while fs::write(&probe, vec![1; 128 << 10]).is_err() {
        assert!(start.elapsed() < LONGEST, "the space of the deleted files is not freed");
        thread::sleep(Duration::from_millis(10));
    }
    fs::remove_file(&probe).unwrap();
    publish_sample(&store, 1, 10);
}

#[test]
fn a_read_only_file_system_is_reported_and_can_be_read() {
    let Some(disk) = Mounted::new("size=1m") else { return };
    let artifact = publish_sample(&Store::open(disk.0.path()).unwrap(), 1, 10);
    disk.remount("remount,ro");
    let store = Store::open(disk.0.path()).unwrap();
    let found = store.lookup(Stage::Segment, artifact.key()).unwrap().unwrap();
    assert_eq!(found.manifest(), artifact.manifest());
    let refused = store.begin(&recipe(2)).unwrap_err().sentence();
    assert!(
        refused.ends_with("the file system is read-only; choose an artifacts folder that can be written"),
        "{refused}"
    );
    let new = Store::open(&disk.0.path().join("new")).unwrap_err().sentence();
    assert!(new.starts_with("cannot create the artifacts folder "), "{new}");
    disk.remount("remount,rw");
}

#[test]
fn missing_permission_is_reported() {
    use std::os::unix::fs::PermissionsExt;
    let root = tempfile::tempdir().unwrap();
    fs::set_permissions(root.path(), fs::Permissions::from_mode(0o555)).unwrap();
    let mut command = spawn("begin without permission", root.path());
    if fs::write(root.path().join("probe"), "").is_ok() {
        // Permissions do not apply to root, so the child runs as an unprivileged user.
        fs::remove_file(root.path().join("probe")).unwrap();
        command.uid(65_534);
    }
    let output = match command.output() {
        Ok(output) => output,
        Err(error) => {
            println!("skipped: cannot start an unprivileged process: {error}");
            return;
        }
    };
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.status.success(),
        "{stdout}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let sentence = format!(
        "refused: cannot create a temporary folder in {}: permission denied; give yourself write permission there or choose another artifacts folder",
        root.path().display()
    );
    assert!(stdout.contains(&sentence), "{stdout}");
    assert!(fs::read_dir(root.path()).unwrap().next().is_none());
}
