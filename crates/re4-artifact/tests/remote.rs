//! A store as the cache of an object store.
#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail by panicking")]

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use common::{artifact_names, files, publish_sample, recipe};
use re4_artifact::{
    Artifact, ArtifactError, ArtifactSummary, Listed, Part, Put, Remote, RemoteError, Stage, Store, attach, attached,
    fetch, fetch_all, fetch_folder, pull_folder, push_folder,
};
use re4_fault::Remedy as _;
use serde_json::json;

/// Objects in memory. It fails from a given number of requests on, as if the network was cut.
#[derive(Debug)]
struct Memory {
    objects: Mutex<BTreeMap<String, Vec<u8>>>,
    requests: AtomicUsize,
    cut_after: AtomicUsize,
    created: Mutex<Vec<String>>,
}

impl Memory {
    fn new() -> Arc<Self> {
        Arc::new(Self {
            objects: Mutex::default(),
            requests: AtomicUsize::new(0),
            cut_after: AtomicUsize::new(usize::MAX),
            created: Mutex::default(),
        })
    }

    fn request(&self) -> Result<(), RemoteError> {
        if self.requests.fetch_add(1, Ordering::SeqCst) >= self.cut_after.load(Ordering::SeqCst) {
            return Err(RemoteError {
                reason: "the network is cut".to_owned(),
                remedy: Some("run again"),
            });
        }
        Ok(())
    }

    /// Lets only so many more requests succeed.
    fn cut_after(&self, more: usize) {
        self.requests.store(0, Ordering::SeqCst);
        self.cut_after.store(more, Ordering::SeqCst);
    }

    fn names(&self) -> Vec<String> {
        self.objects.lock().unwrap().keys().cloned().collect()
    }

    fn change(&self, name: &str, change: impl FnOnce(&mut Vec<u8>)) {
        change(self.objects.lock().unwrap().get_mut(name).unwrap());
    }

    fn remove(&self, name: &str) -> Vec<u8> {
        self.objects.lock().unwrap().remove(name).unwrap()
    }
}

impl Remote for Memory {
    fn address(&self) -> &'static str {
        "memory://bucket/prefix"
    }

    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, RemoteError> {
        self.request()?;
        Ok(self.objects.lock().unwrap().get(name).cloned())
    }

    fn get_range(&self, name: &str, range: Range<u64>) -> Result<Option<Vec<u8>>, RemoteError> {
        self.request()?;
        let objects = self.objects.lock().unwrap();
        Ok(objects.get(name).map(|bytes| {
            let cut = |at: u64| (at as usize).min(bytes.len());
            bytes[cut(range.start)..cut(range.end)].to_vec()
        }))
    }

    fn put_new(&self, name: &str, content: Arc<Vec<u8>>) -> Result<Put, RemoteError> {
        self.request()?;
        let mut objects = self.objects.lock().unwrap();
        if objects.contains_key(name) {
            return Ok(Put::Taken);
        }
        objects.insert(name.to_owned(), content.to_vec());
        self.created.lock().unwrap().push(name.to_owned());
        Ok(Put::Created)
    }

    fn list(&self, folder: &str) -> Result<Vec<(String, u64)>, RemoteError> {
        self.request()?;
        let objects = self.objects.lock().unwrap();
        let inside = objects.iter().filter(|(name, _)| name.starts_with(folder));
        Ok(inside.map(|(name, bytes)| (name.clone(), bytes.len() as u64)).collect())
    }
}

/// A machine with a cache of the objects.
struct Machine {
    cache: tempfile::TempDir,
    store: Store,
}

impl Machine {
    fn new(remote: &Arc<Memory>) -> Self {
        let cache = tempfile::tempdir().unwrap();
        let store = connected(cache.path(), remote);
        Self { cache, store }
    }

    /// What a process that is started now finds.
    fn again(&mut self, remote: &Arc<Memory>) {
        self.store = connected(self.cache.path(), remote);
    }

    fn lookup(&self) -> Result<Option<Artifact>, ArtifactError> {
        self.store.lookup(Stage::Segment, &recipe(1).key())
    }
}

/// Damages the bytes of an object.
type Damage = fn(&mut Vec<u8>);

fn connected(cache: &Path, remote: &Arc<Memory>) -> Store {
    attach(cache, Arc::clone(remote) as Arc<dyn Remote>).unwrap();
    Store::open(cache).unwrap()
}

fn name(file: &str) -> String {
    format!("modes/{}/{file}", recipe(1).key().short())
}

#[test]
fn what_one_machine_publishes_another_finds() {
    let remote = Memory::new();
    let (one, other) = (Machine::new(&remote), Machine::new(&remote));
    assert!(one.lookup().unwrap().is_none());
    let published = publish_sample(&one.store, 1, 500);
    assert_eq!(remote.names(), [name("every_kind.parquet"), name("manifest.json")]);
    assert_eq!(*remote.created.lock().unwrap().last().unwrap(), name("manifest.json"));
    let found = other.lookup().unwrap().unwrap();
    assert_ne!(found.path(), published.path());
    assert_eq!(files(found.path()), files(published.path()));
    assert_eq!(artifact_names(other.cache.path()).len(), 1, "no temporary file is left");
    // And nothing is transferred the second time.
    remote.cut_after(0);
    assert!(other.lookup().unwrap().is_some());
}

#[test]
fn a_store_without_an_object_store_makes_no_requests() {
    let folder = tempfile::tempdir().unwrap();
    publish_sample(&Store::open(folder.path()).unwrap(), 1, 10);
    assert!(attached(folder.path()).is_none());
    fetch(folder.path(), Stage::Segment, &recipe(2).key()).unwrap();
    assert_eq!(fetch_all(folder.path()).unwrap(), 0);
    assert!(!fetch_folder(folder.path(), &folder.path().join("modes/0")).unwrap());
}

#[test]
fn an_artifact_without_manifest_is_not_there() {
    let remote = Memory::new();
    let (one, other) = (Machine::new(&remote), Machine::new(&remote));
    let published = publish_sample(&one.store, 1, 500);
    let expected = files(published.path());
    remote.remove(&name("manifest.json"));
    assert!(other.lookup().unwrap().is_none());
    // The files that were uploaded are equal, so they do not prevent the upload of the others.
    let made = publish_sample(&other.store, 1, 500);
    assert_eq!(files(made.path()), expected);
    assert_eq!(remote.names().len(), 2);
}

#[test]
fn a_damaged_object_is_refused_by_name() {
    let address = format!("memory://bucket/prefix/modes/{}", recipe(1).key().short());
    let damages: [(&str, Damage, &str); 6] = [
        (
            "every_kind.parquet",
            |bytes| bytes[40] ^= 1,
            "the content of every_kind.parquet does not match",
        ),
        (
            "every_kind.parquet",
            |bytes| bytes.truncate(40),
            "every_kind.parquet has 40 bytes, but ",
        ),
        ("every_kind.parquet", |bytes| bytes.push(0), "every_kind.parquet has "),
        ("every_kind.parquet", Vec::clear, "every_kind.parquet has 0 bytes, but "),
        ("manifest.json", |bytes| bytes[40] ^= 1, "manifest.json "),
        ("manifest.json", Vec::clear, "manifest.json is not valid JSON"),
    ];
    for (file, damage, reason) in damages {
        let remote = Memory::new();
        publish_sample(&Machine::new(&remote).store, 1, 500);
        remote.change(&name(file), damage);
        let other = Machine::new(&remote);
        let error = other.lookup().unwrap_err().sentence();
        assert!(
            error.starts_with(&format!("artifact {address} is damaged: {reason}")),
            "{error}"
        );
        assert!(
            error.ends_with(&format!("; delete the folder {address} and run again")),
            "{error}"
        );
        assert!(
            artifact_names(other.cache.path()).is_empty(),
            "nothing damaged gets into the cache"
        );
    }
    let remote = Memory::new();
    publish_sample(&Machine::new(&remote).store, 1, 500);
    remote.remove(&name("every_kind.parquet"));
    let error = Machine::new(&remote).lookup().unwrap_err().sentence();
    assert!(error.contains("every_kind.parquet is missing"), "{error}");
}

#[test]
fn an_upload_that_was_cut_off_anywhere_is_continued() {
    let whole = Memory::new();
    let expected = files(publish_sample(&Machine::new(&whole).store, 1, 500).path());
    for requests in 0.. {
        let remote = Memory::new();
        let mut one = Machine::new(&remote);
        remote.cut_after(requests);
        let writer = one.store.begin(&recipe(2)).unwrap();
        writer.file("weights", b"of any length").unwrap();
        let cut = writer.publish(ArtifactSummary::default()).is_err();
        remote.cut_after(usize::MAX);
        one.again(&remote);
        // The artifact is in the cache, and the next run uploads the rest.
        assert!(one.store.lookup(Stage::Segment, &recipe(2).key()).unwrap().is_some());
        assert_eq!(remote.names().len(), 2, "after {requests} requests");
        if !cut {
            break;
        }
    }
    // A download that was cut off leaves nothing.
    for requests in 0.. {
        let mut other = Machine::new(&whole);
        whole.cut_after(requests);
        let cut = other.lookup().is_err();
        assert!(!cut || requests > 2 || artifact_names(other.cache.path()).is_empty());
        whole.cut_after(usize::MAX);
        other.again(&whole);
        assert_eq!(files(other.lookup().unwrap().unwrap().path()), expected);
        if !cut {
            break;
        }
    }
}

#[test]
fn other_bytes_under_a_taken_name_are_an_error_that_names_both() {
    let remote = Memory::new();
    let one = Machine::new(&remote);
    publish_sample(&one.store, 1, 500);
    // Another machine that found nothing a moment ago publishes other bytes.
    let manifest = remote.remove(&name("manifest.json"));
    let other = Machine::new(&remote);
    let table = other.cache.path().join(name("every_kind.parquet"));
    let publish = |rows: u32| {
        let writer = other.store.begin(&recipe(1)).unwrap();
        let mut table = writer.table_in_groups(&common::EVERY_KIND, 64).unwrap();
        table
            .write_columns(common::columns(&common::sample_rows(rows)))
            .unwrap();
        table.finish().unwrap();
        writer.publish(ArtifactSummary::default())
    };
    let error = publish(400).unwrap_err();
    assert!(matches!(error, ArtifactError::NotReproducible { .. }));
    let text = error.to_string();
    assert!(text.contains("memory://bucket/prefix/modes/"), "{text}");
    assert!(
        text.contains(&format!("every_kind.parquet, compared with {}", table.display())),
        "{text}"
    );
    remote.objects.lock().unwrap().insert(name("manifest.json"), manifest);
    // The cache has other bytes than the object store from now on, which every later use notices.
    let error = other.lookup().unwrap_err().to_string();
    assert!(
        error.contains("different bytes in manifest.json, compared with "),
        "{error}"
    );
}

#[test]
fn of_many_writers_all_succeed_and_one_creates() {
    let remote = Memory::new();
    let machines: Vec<Machine> = (0..8).map(|_| Machine::new(&remote)).collect();
    std::thread::scope(|scope| {
        for machine in &machines {
            scope.spawn(|| publish_sample(&machine.store, 1, 300));
        }
    });
    assert_eq!(remote.created.lock().unwrap().len(), 2);
    let all: Vec<_> = machines
        .iter()
        .map(|machine| files(machine.lookup().unwrap().unwrap().path()))
        .collect();
    assert!(all.iter().all(|files| *files == all[0]));
}

#[test]
fn records_of_runs_follow_their_artifacts() {
    let remote = Memory::new();
    let (one, other) = (Machine::new(&remote), Machine::new(&remote));
    publish_sample(&one.store, 1, 10);
    let key = recipe(1).key();
    one.store
        .record_run(Stage::Segment, &key, &json!({ "wall_s": 1.5 }))
        .unwrap();
    other.lookup().unwrap().unwrap();
    let record = Store::run_record(other.cache.path(), Stage::Segment, &key).unwrap();
    assert_eq!(record, json!({ "wall_s": 1.5 }));
    // The record is that of the first run.
    other
        .store
        .record_run(Stage::Segment, &key, &json!({ "wall_s": 2.5 }))
        .unwrap();
    let third = Machine::new(&remote);
    fetch(third.cache.path(), Stage::Segment, &key).unwrap();
    third.lookup().unwrap().unwrap();
    let record = Store::run_record(third.cache.path(), Stage::Segment, &key).unwrap();
    assert_eq!(record, json!({ "wall_s": 1.5 }));
}

#[test]
fn all_artifacts_are_fetched() {
    let remote = Memory::new();
    let one = Machine::new(&remote);
    for number in 1..4 {
        publish_sample(&one.store, number, 10);
    }
    one.store
        .record_run(Stage::Segment, &recipe(1).key(), &json!({}))
        .unwrap();
    let other = Machine::new(&remote);
    assert_eq!(fetch_all(other.cache.path()).unwrap(), 3);
    assert_eq!(artifact_names(other.cache.path()), artifact_names(one.cache.path()));
    let folder = other.store.folder(Stage::Segment, &recipe(9).key());
    assert!(!fetch_folder(other.cache.path(), &folder).unwrap());
}

/// Publishes a part of ten rows.
fn publish_part(store: &Store, number: u32) {
    let writer = store.begin_part(&recipe(1), Part::Numbered(number)).unwrap();
    let mut table = writer.table_in_groups(&common::EVERY_KIND, 64).unwrap();
    table.write_columns(common::columns(&common::sample_rows(64))).unwrap();
    table.finish().unwrap();
    writer.publish(ArtifactSummary::default()).unwrap();
}

/// Publishes the manifest of an artifact of three parts.
fn merge(store: &Store) -> Artifact {
    let part = |number| store.part(&recipe(1), Part::Numbered(number)).unwrap().unwrap();
    let parts: Vec<Artifact> = (0..3).map(part).collect();
    store
        .merge(&recipe(1), &parts, None, ArtifactSummary::default())
        .unwrap()
}

#[test]
fn machines_make_parts_of_an_artifact_and_another_merges_them() {
    let alone = tempfile::tempdir().unwrap();
    let alone = Store::open(alone.path()).unwrap();
    (0..3).for_each(|number| publish_part(&alone, number));
    let expected = files(merge(&alone).path());

    let remote = Memory::new();
    let makers: Vec<Machine> = (0..3).map(|_| Machine::new(&remote)).collect();
    for (number, maker) in makers.iter().enumerate() {
        publish_part(&maker.store, number as u32);
        // Two machines that make the same part agree.
        publish_part(&makers[0].store, number as u32);
    }
    assert!(makers[0].lookup().unwrap().is_none());
    assert_eq!(remote.names().len(), 6);
    let merger = Machine::new(&remote);
    assert_eq!(files(merge(&merger.store).path()), expected);
    assert_eq!(*remote.created.lock().unwrap().last().unwrap(), name("manifest.json"));
    // One machine has a part of it already, the other has none.
    for reader in [&makers[1], &Machine::new(&remote)] {
        assert_eq!(files(reader.lookup().unwrap().unwrap().path()), expected);
    }
    // An object store that lost what it had gets all of it again.
    for object in remote.names() {
        remote.remove(&object);
    }
    let mut merger = merger;
    merger.again(&remote);
    merger.lookup().unwrap().unwrap();
    assert_eq!(remote.names().len(), 7);
    // A part that is missing is named.
    remote.remove(&name("parts/000002/part.json"));
    let error = Machine::new(&remote).lookup().unwrap_err().to_string();
    assert!(error.contains("parts/000002/part.json is missing"), "{error}");
}

#[test]
fn a_process_that_makes_some_parts_downloads_what_it_reads() {
    let remote = Memory::new();
    let maker = Machine::new(&remote);
    (0..3).for_each(|number| publish_part(&maker.store, number));
    let expected = files(merge(&maker.store).path());
    let reader = Machine::new(&remote);
    let store = reader.store.clone().verifying_by_part();
    let here = || files(reader.cache.path()).into_keys().collect::<Vec<_>>();
    let key = recipe(1).key();

    assert_eq!(store.missing_parts(&recipe(1), 0..5).unwrap(), [3, 4]);
    let artifact = store.lookup(Stage::Segment, &key).unwrap().unwrap();
    assert_eq!(artifact.parts(), 3);
    assert_eq!(here(), Vec::<String>::new());
    let part = artifact.part(1).unwrap();
    assert_eq!(
        part.table(&common::EVERY_KIND).unwrap().read_all().unwrap().num_rows(),
        64
    );
    let table = |number: u32| name(&format!("parts/{number:06}/every_kind.parquet"));
    let marker = |number: u32| name(&format!("parts/{number:06}/part.json"));
    assert_eq!(here(), [table(1), marker(1)]);
    // A damaged or missing part is named when it is read.
    remote.change(&table(2), |bytes| bytes[7] ^= 1);
    let error = artifact.part(2).unwrap_err().to_string();
    assert!(
        error.contains("parts/000002") && error.contains("every_kind.parquet"),
        "{error}"
    );
    remote.change(&table(2), |bytes| bytes[7] ^= 1);
    let lost = remote.remove(&marker(2));
    let error = artifact.part(2).unwrap_err().to_string();
    assert!(error.contains("parts/000002/every_kind.parquet is missing"), "{error}");
    remote.objects.lock().unwrap().insert(marker(2), lost);
    // All of it is read.
    artifact.verify_bytes().unwrap();
    assert_eq!(here().len(), 6);
    // A process that reads all of it completes the cache with the manifest.
    let whole = reader.lookup().unwrap().unwrap();
    assert_eq!(files(whole.path()), expected);
}

#[test]
fn large_and_empty_files_are_transferred() {
    let remote = Memory::new();
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("folder");
    fs::create_dir_all(folder.join("parts")).unwrap();
    let large: Vec<u8> = (0..(16 << 20) * 2 + 3)
        .map(|number: u32| (number % 251) as u8)
        .collect();
    // Lengths around the length up to which a file is one request.
    let contents: BTreeMap<&str, &[u8]> = BTreeMap::from([
        ("large", &large[..]),
        ("exact", &large[..16 << 20]),
        ("longer", &large[..=16 << 20]),
        ("twice", &large[..(16 << 20) * 2]),
        ("empty", &[]),
        ("last", b"marker"),
    ]);
    for (file, bytes) in &contents {
        fs::write(folder.join(file), bytes).unwrap();
    }
    let send = || push_folder(&*remote, &folder, "name", "last");
    send().unwrap();
    assert_eq!(*remote.created.lock().unwrap().last().unwrap(), "name/last");
    assert_eq!(remote.names().len(), contents.len());
    let listed = |file: &str, bytes: &[u8]| Listed {
        file: file.to_owned(),
        bytes: bytes.len() as u64,
        blake3: blake3::hash(bytes).into(),
    };
    let all: Vec<Listed> = contents.iter().map(|(file, bytes)| listed(file, bytes)).collect();
    let to = place.path().join("to");
    fs::create_dir(&to).unwrap();
    pull_folder(&*remote, "name", &to, &all).unwrap();
    assert_eq!(files(&to), files(&folder));
    // A large file that is there already is compared block by block.
    remote.remove("name/last");
    send().unwrap();
    for damage in [
        (|bytes: &mut Vec<u8>| *bytes.last_mut().unwrap() ^= 1) as fn(&mut Vec<u8>),
        |bytes| bytes.push(0),
        |bytes| bytes.truncate(16 << 20),
        |bytes| bytes.truncate(5),
    ] {
        remote.remove("name/last");
        remote.change("name/twice", damage);
        let error = send().unwrap_err().to_string();
        assert!(error.contains("different bytes in twice, compared with"), "{error}");
        let again = place.path().join("again");
        fs::create_dir(&again).unwrap();
        let twice = all.iter().find(|listed| listed.file == "twice").unwrap().clone();
        let error = pull_folder(&*remote, "name", &again, &[twice]).unwrap_err().to_string();
        assert!(
            error.contains("artifact memory://bucket/prefix/name is damaged: "),
            "{error}"
        );
        fs::remove_dir_all(&again).unwrap();
        remote.remove("name/twice");
        remote
            .objects
            .lock()
            .unwrap()
            .insert("name/twice".to_owned(), contents["twice"].to_vec());
        send().unwrap();
    }
}

#[test]
fn a_remote_that_does_not_answer_is_named() {
    let remote = Memory::new();
    remote.cut_after(0);
    let error = Machine::new(&remote).lookup().unwrap_err().sentence();
    let object = PathBuf::from("memory://bucket/prefix").join(name("manifest.json"));
    assert_eq!(
        error,
        format!("cannot read {}: the network is cut; run again", object.display())
    );
}
