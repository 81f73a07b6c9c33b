//! Artifacts in S3, simulated by moto's server. The tests are skipped if `RE4_MOTO` does not name that program.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    unreachable_pub,
    reason = "helpers of tests fail by panicking"
)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Barrier};
use std::thread;
use std::time::{Duration, Instant};

use re4_artifact::{Artifact, ArtifactSummary, Put, Recipe, Remote, Stage, Store, attach, table};
use re4_fault::Remedy as _;
use re4_object::Objects;
use serde_json::json;

use moto::Moto;

/// Maximum time to wait for any event. It is generous because the machine may be busy.
const LONGEST: Duration = Duration::from_mins(5);

table! {
    /// One row per number.
    #[table("numbers", version = 1)]
    pub struct NumberRow {
        /// A number.
        pub number: f64,
    }
}

#[path = "../../../tests/support/moto.rs"]
mod moto;

/// What the tests do with a server.
trait Server {
    fn objects(&self, address: &str) -> Objects;

    /// Replaces an object of the bucket, which [`Objects`] cannot.
    fn replace(&self, path: &str, content: &[u8]);

    /// A child process that runs [`child`] with a task.
    fn spawn(&self, task: &str, address: &str, cache: &Path) -> Child;
}

impl Server for Moto {
    fn objects(&self, address: &str) -> Objects {
        open(address, self.endpoint())
    }

    fn replace(&self, path: &str, content: &[u8]) {
        use object_store::ObjectStoreExt as _;
        let store = object_store::aws::AmazonS3Builder::new()
            .with_bucket_name("bucket")
            .with_endpoint(self.endpoint())
            .with_allow_http(true)
            .with_access_key_id("key")
            .with_secret_access_key("secret")
            .build()
            .unwrap();
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .enable_all()
            .build()
            .unwrap();
        let put = async { store.put(&path.into(), content.to_vec().into()).await };
        runtime.block_on(put).unwrap();
    }

    fn spawn(&self, task: &str, address: &str, cache: &Path) -> Child {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command
            .args(["--exact", "child", "--nocapture"])
            .env("RE4_TEST_TASK", task)
            .env("RE4_TEST_ADDRESS", address)
            .env("RE4_TEST_CACHE", cache)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        self.settings(&mut command).spawn().unwrap()
    }
}

fn open(address: &str, endpoint: &str) -> Objects {
    let settings = [
        ("AWS_ENDPOINT", endpoint),
        ("AWS_ALLOW_HTTP", "true"),
        ("AWS_ACCESS_KEY_ID", "key"),
        ("AWS_SECRET_ACCESS_KEY", "secret"),
        ("AWS_REGION", "us-east-1"),
    ];
    Objects::open_with(address, &settings).unwrap()
}

/// A cache of an address on a machine of its own.
fn machine(objects: Objects) -> (tempfile::TempDir, Store) {
    let cache = tempfile::tempdir().unwrap();
    attach(cache.path(), Arc::new(objects)).unwrap();
    let store = Store::open(cache.path()).unwrap();
    (cache, store)
}

fn recipe() -> Recipe {
    Recipe::new(Stage::Index, 1)
        .config(&json!({ "numbers": 1000 }))
        .unwrap()
}

/// Publishes an artifact of one table and so many other files.
fn publish(store: &Store, files: usize) -> Artifact {
    let writer = store.begin(&recipe()).unwrap();
    writer
        .write_rows((0..1000).map(|number| NumberRow {
            number: f64::from(number).sqrt(),
        }))
        .unwrap();
    for number in 0..files {
        let bytes: Vec<u8> = (0..50_000 + number).map(|at| (at * number % 251) as u8).collect();
        writer.file(&format!("file-{number:03}"), &bytes).unwrap();
    }
    writer.publish(ArtifactSummary::default()).unwrap()
}

/// The bytes of an artifact's files.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    paths
        .map(|path| (path.file_name().unwrap().into(), fs::read(&path).unwrap()))
        .collect()
}

/// The entry point of child processes. Without a task, as in a normal test run, it does nothing.
#[test]
fn child() {
    let Ok(task) = std::env::var("RE4_TEST_TASK") else {
        return;
    };
    let of = |name: &str| std::env::var(format!("RE4_TEST_{name}")).unwrap();
    let cache = PathBuf::from(of("CACHE"));
    attach(&cache, Arc::new(Objects::open(&of("ADDRESS")).unwrap())).unwrap();
    let store = Store::open(&cache).unwrap();
    let found = store.lookup(Stage::Index, &recipe().key()).unwrap();
    let artifact = found.unwrap_or_else(|| publish(&store, task.parse().unwrap()));
    println!("published {}", artifact.manifest().manifest_blake3);
}

/// The hash that a child process printed. Fails if the process failed.
fn published(child: Child) -> String {
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        output.status.success(),
        "{text}\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
    text.split("published ")
        .nth(1)
        .unwrap()
        .lines()
        .next()
        .unwrap()
        .to_owned()
}

#[test]
fn of_sixteen_writers_exactly_one_creates_an_object() {
    let Some(moto) = Moto::start() else { return };
    // Several clients, as on several machines.
    let clients: Vec<Objects> = (0..4).map(|_| moto.objects("s3://bucket/races")).collect();
    let start = Instant::now();
    for race in 0..200 {
        let name = format!("{race:03}/object");
        let together = Barrier::new(16);
        let outcomes: Vec<Put> = thread::scope(|scope| {
            let writers: Vec<_> = (0..16_u8)
                .map(|writer| {
                    let (client, name, together) = (&clients[usize::from(writer) % 4], &name, &together);
                    scope.spawn(move || {
                        together.wait();
                        client.put_new(name, Arc::new(vec![writer; 1000])).unwrap()
                    })
                })
                .collect();
            writers.into_iter().map(|writer| writer.join().unwrap()).collect()
        });
        let winners: Vec<usize> = (0..16).filter(|&writer| outcomes[writer] == Put::Created).collect();
        assert_eq!(winners.len(), 1, "race {race}: {winners:?}");
        let content = clients[0].get(&name).unwrap().unwrap();
        assert_eq!(content, vec![winners[0] as u8; 1000], "race {race}");
    }
    println!("200 races of 16 writers in {:?}", start.elapsed());
}

#[test]
fn what_one_machine_publishes_another_reads() {
    let Some(moto) = Moto::start() else { return };
    let address = "s3://bucket/a/prefix";
    let (one, store) = machine(moto.objects(address));
    assert!(store.lookup(Stage::Index, &recipe().key()).unwrap().is_none());
    let published = publish(&store, 20);
    let (_other, elsewhere) = machine(moto.objects(address));
    let found = elsewhere.lookup(Stage::Index, &recipe().key()).unwrap().unwrap();
    assert_eq!(files(found.path()), files(published.path()));
    let undisturbed = tempfile::tempdir().unwrap();
    let alone = publish(&Store::open(undisturbed.path()).unwrap(), 20);
    assert_eq!(files(found.path()), files(alone.path()));

    // The same objects by their names, and by ranges.
    let objects = moto.objects(address);
    let folder = format!("index/{}", recipe().key().short());
    let listed = objects.list("index").unwrap();
    assert_eq!(listed.len(), 22);
    for (name, bytes) in &listed {
        let file = one.path().join(name);
        assert_eq!(fs::metadata(&file).unwrap().len(), *bytes, "{name}");
        let whole = fs::read(&file).unwrap();
        let part = objects.get_range(name, 10..30).unwrap().unwrap();
        assert_eq!(part, whole[10..30], "{name}");
        let end = objects.get_range(name, bytes - 5..bytes + 10).unwrap().unwrap();
        assert_eq!(end, whole[whole.len() - 5..], "{name}");
        assert!(
            objects.get_range(name, *bytes..bytes + 1).unwrap().unwrap().is_empty(),
            "{name}"
        );
    }
    assert!(
        listed
            .iter()
            .any(|(name, _)| *name == format!("{folder}/manifest.json"))
    );
    // A prefix is a folder, not the beginning of a name.
    assert!(moto.objects("s3://bucket/a/pre").list("").unwrap().is_empty());
    assert!(
        moto.objects("s3://bucket/a/pre")
            .get(&format!("{folder}/manifest.json"))
            .unwrap()
            .is_none()
    );
}

#[test]
fn a_damaged_object_is_refused_and_half_an_artifact_is_not_there() {
    let Some(moto) = Moto::start() else { return };
    let (one, store) = machine(moto.objects("s3://bucket"));
    let folder = publish(&store, 3).path().strip_prefix(one.path()).unwrap().to_owned();
    let folder = folder.to_str().unwrap();
    moto.replace(&format!("{folder}/file-002"), b"other bytes");
    let (_other, elsewhere) = machine(moto.objects("s3://bucket"));
    let error = elsewhere.lookup(Stage::Index, &recipe().key()).unwrap_err().sentence();
    let expected = format!(
        "artifact s3://bucket/{folder} is damaged: file-002 has 11 bytes, but 50002 were published; delete the folder s3://bucket/{folder} and run again"
    );
    assert_eq!(error, expected);

    // Another writer with equal files meets the damaged one under the name that it needs.
    let prefix = moto.objects("s3://bucket/half");
    let half = fs::read(one.path().join(folder).join("file-000")).unwrap();
    assert_eq!(
        prefix.put_new(&format!("{folder}/file-000"), Arc::new(half)).unwrap(),
        Put::Created
    );
    let (_third, third) = machine(prefix);
    assert!(third.lookup(Stage::Index, &recipe().key()).unwrap().is_none());
    publish(&third, 3);
    assert_eq!(moto.objects("s3://bucket/half").list("").unwrap().len(), 5);
}

#[test]
fn processes_that_publish_the_same_artifact_agree() {
    let Some(moto) = Moto::start() else { return };
    let caches: Vec<_> = (0..4).map(|_| tempfile::tempdir().unwrap()).collect();
    let children: Vec<Child> = caches
        .iter()
        .map(|cache| moto.spawn("30", "s3://bucket/together", cache.path()))
        .collect();
    let hashes: Vec<String> = children.into_iter().map(published).collect();
    assert!(hashes.iter().all(|hash| *hash == hashes[0]), "{hashes:?}");
    assert_eq!(moto.objects("s3://bucket/together").list("").unwrap().len(), 32);
}

#[test]
fn a_process_that_was_killed_while_it_uploaded_is_continued() {
    let Some(moto) = Moto::start() else { return };
    let undisturbed = tempfile::tempdir().unwrap();
    let alone = publish(&Store::open(undisturbed.path()).unwrap(), 100);
    let mut killed_in_the_middle = 0;
    for round in 0..5 {
        let address = format!("s3://bucket/killed/{round}");
        let objects = moto.objects(&address);
        let cache = tempfile::tempdir().unwrap();
        let mut child = moto.spawn("100", &address, cache.path());
        let start = Instant::now();
        let count = || objects.list("").unwrap().len();
        while count() < 1 + round * 20 && child.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < LONGEST, "no object was created");
        }
        child.kill().unwrap();
        child.wait().unwrap();
        // The server may still create what was sent before the kill, but the manifest was not sent.
        if count() < 90 {
            killed_in_the_middle += 1;
            let (_other, elsewhere) = machine(moto.objects(&address));
            assert!(elsewhere.lookup(Stage::Index, &recipe().key()).unwrap().is_none());
        }
        // Once with what the killed process left in its cache, and once on another machine.
        let place = if round % 2 == 0 {
            cache
        } else {
            tempfile::tempdir().unwrap()
        };
        published(moto.spawn("100", &address, place.path()));
        assert_eq!(count(), 102);
        let (_other, elsewhere) = machine(moto.objects(&address));
        let found = elsewhere.lookup(Stage::Index, &recipe().key()).unwrap().unwrap();
        assert_eq!(files(found.path()), files(alone.path()), "round {round}");
    }
    assert!(killed_in_the_middle > 0, "every process ended before it was killed");
}

#[test]
fn a_missing_bucket_and_a_missing_server_are_named() {
    let Some(moto) = Moto::start() else { return };
    let (_cache, store) = machine(moto.objects("s3://nothing/a"));
    let error = store.lookup(Stage::Index, &recipe().key()).unwrap_err().sentence();
    assert!(error.starts_with("cannot read s3://nothing/a/index/"), "{error}");
    assert!(error.ends_with("; create the bucket, or check the address"), "{error}");
    let objects = moto.objects("s3://bucket/a");
    drop(moto);
    let error = objects.get("name").unwrap_err();
    assert!(error.remedy.unwrap().starts_with("check the network"), "{error}");
}
