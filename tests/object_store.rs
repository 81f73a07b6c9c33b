//! Runs whose artifacts are in an object store. `cargo test --workspace --features re4-pipe/object-store --test it object_store::`
//! runs them; other builds refuse addresses.

use crate::support::Place;

#[cfg(not(feature = "object-store"))]
#[test]
fn a_build_without_object_stores_refuses_addresses_in_one_sentence() {
    let place = Place::empty();
    let expected = "error: cannot use s3://bucket/folder: this re4-pipe was built without object stores; build it with the cargo feature object-store (cargo build --release -p re4-pipe --features object-store), or name a folder";
    for command in ["run small.toml", "verify", "doctor"] {
        let error = place
            .run(&format!("{command} --artifacts s3://bucket/folder"))
            .refused_at_once();
        assert_eq!(error, expected, "{command}");
    }
    let error = place
        .run("inspect s3://bucket/folder/rollouts/0123456789abcdef")
        .refused_at_once();
    assert_eq!(error, expected);
    assert!(!place.path().join("s3:").exists());
}

#[cfg(feature = "object-store")]
mod with_object_stores {
    use std::collections::BTreeMap;
    use std::fs;
    use std::path::{Path, PathBuf};
    use std::process::Command;
    use std::time::Instant;

    use re4_artifact::{Remote as _, Stage};
    use re4_object::Objects;

    use super::Place;
    use crate::support::{Answer, artifact_bytes, assert_same_bytes, folders_in, wait_for};

    const COMMAND: &str = "run small.toml";

    /// A folder that follows the rules of an object store, and machines that use it.
    struct Site {
        place: Place,
        address: String,
    }

    impl Site {
        fn new() -> Self {
            Self::of(Place::new())
        }

        fn of(place: Place) -> Self {
            let address = format!("file://{}/objects", place.path().display());
            Self { place, address }
        }

        /// A command on a machine, whose cache is in a folder of this name.
        fn command(&self, machine: &str, arguments: &str) -> Command {
            let mut command = self.place.command();
            command
                .env("RE4_CACHE", self.place.path().join(machine))
                .args(arguments.split_whitespace())
                .args(["--artifacts", &self.address]);
            command
        }

        fn run(&self, machine: &str, arguments: &str) -> Answer {
            let output = self.command(machine, arguments).output().unwrap();
            Answer::new(&output, self.place.path())
        }

        /// A text as [`Answer`] shows it.
        fn shown(&self, text: &str) -> String {
            text.replace(self.place.path().to_str().unwrap(), "[folder]")
        }

        /// The cache of a machine.
        fn cache(&self, machine: &str) -> PathBuf {
            let caches = folders_in(&self.place.path().join(machine));
            assert_eq!(caches.len(), 1, "{caches:?}");
            caches[0].clone()
        }

        fn objects(&self) -> BTreeMap<String, Vec<u8>> {
            artifact_bytes(&self.place.path().join("objects"))
        }

        /// Address of the artifact of a stage. Fails unless there is exactly one.
        fn artifact(&self, stage: Stage) -> String {
            let objects = Objects::open(&self.address).unwrap().list(stage.artifact()).unwrap();
            let manifests: Vec<&str> = objects
                .iter()
                .filter_map(|(name, _)| name.strip_suffix("/manifest.json"))
                .collect();
            assert_eq!(manifests.len(), 1);
            format!("{}/{}", self.address, manifests[0])
        }
    }

    /// Bytes of an ordinary run.
    fn ordinary() -> BTreeMap<String, Vec<u8>> {
        let place = Place::new();
        place.run(COMMAND).done();
        place.bytes()
    }

    #[test]
    fn machines_share_the_artifacts_of_a_run() {
        let site = Site::new();
        let first = site.run("one", COMMAND).done();
        assert!(first.stderr.contains("store  file://"), "{}", first.stderr);
        let expected = ordinary();
        assert_same_bytes(&site.objects(), &expected);
        assert_same_bytes(&artifact_bytes(&site.cache("one")), &expected);
        // Another machine makes nothing, and downloads what it needs.
        let second = site.run("two", COMMAND).done();
        assert_eq!(
            second.stderr.matches("unchanged, skipped").count(),
            4,
            "{}",
            second.stderr
        );
        assert_same_bytes(&artifact_bytes(&site.cache("two")), &expected);
        assert_eq!(first.stdout, second.stdout);
        // With the records of the runs, such as their wall times.
        let records = |cache: &Path| fs::read_dir(cache.join("runs")).unwrap().count();
        assert_eq!(records(&site.cache("one")), records(&site.cache("two")));
    }

    #[test]
    fn commands_read_artifacts_by_address() {
        let site = Site::new();
        site.run("one", COMMAND).done();
        let rollouts = site.artifact(Stage::Rollout);
        let local = site.cache("one").join("rollouts");
        let here = folders_in(&local)[0].display().to_string();
        let by_path = site.run("one", &format!("inspect {here} --rows 2")).done().stdout;
        assert_eq!(
            site.run("two", &format!("inspect {rollouts} --rows 2")).done().stdout,
            by_path
        );
        // Only that artifact was downloaded.
        assert_eq!(folders_in(&site.cache("two")).len(), 2, "rollouts and runs");
        site.run("three", &format!("verify {rollouts}")).done();
        let all = site.run("three", "verify").done().stdout;
        assert_eq!(all.matches("intact").count(), 4, "{all}");
        let report = format!("report {rollouts} --output page.html");
        site.run("four", &report).done();
        let page = fs::read(site.place.path().join("page.html")).unwrap();
        site.run("one", &report).done();
        assert!(page == fs::read(site.place.path().join("page.html")).unwrap());
        let missing = format!("{}/rollouts/0123456789abcdef", site.address);
        let error = site.run("two", &format!("inspect {missing}")).refused();
        let expected = format!("cannot read artifact {missing}: there is no object manifest.json below it");
        assert!(error.contains(&site.shown(&expected)), "{error}");
        let error = site.run("two", "inspect s3://bucket/x").refused();
        assert!(
            error.contains("s3://bucket/x is not the address of an artifact"),
            "{error}"
        );
    }

    #[cfg(feature = "query")]
    #[test]
    fn a_query_reads_all_artifacts_of_the_store() {
        let site = Site::new();
        site.run("one", COMMAND).done();
        let query = |machine: &str, more: &[&str]| {
            let mut command = site.command(machine, "query --csv");
            let output = command
                .arg("select count(*) as steps from steps")
                .args(more)
                .output()
                .unwrap();
            Answer::new(&output, site.place.path()).done().stdout
        };
        let expected = query("one", &[]);
        assert!(expected.starts_with("steps\n"), "{expected}");
        assert_eq!(query("two", &[]), expected);
        assert_eq!(query("three", &[&site.artifact(Stage::Rollout)]), expected);
    }

    #[test]
    fn a_damaged_object_stops_the_run_and_is_named() {
        let site = Site::new();
        site.run("one", COMMAND).done();
        let episodes = site.artifact(Stage::Ingest);
        let file = PathBuf::from(episodes.strip_prefix("file://").unwrap()).join("frames.parquet");
        let mut bytes = fs::read(&file).unwrap();
        bytes[100] ^= 1;
        fs::write(&file, bytes).unwrap();
        let error = site.run("two", COMMAND).refused();
        let expected = format!(
            "error: artifact {episodes} is damaged: the content of frames.parquet does not match its published hash; delete the folder {episodes} and run again"
        );
        assert_eq!(error, site.shown(&expected));
        // A machine that has the artifact does not read the object again.
        site.run("one", COMMAND).done();
    }

    #[test]
    fn a_killed_run_is_continued_here_or_elsewhere() {
        let expected = ordinary();
        for (round, kind) in ["episodes", "modes", "index", "rollouts"].into_iter().enumerate() {
            let site = Site::new();
            let mut child = site.command("one", COMMAND).spawn().unwrap();
            let began = site.place.path().join("objects").join(kind);
            wait_for("an object of the artifact", || {
                (began.exists() || child.try_wait().unwrap().is_some()).then_some(())
            });
            child.kill().unwrap();
            child.wait().unwrap();
            let machine = ["one", "two"][round % 2];
            site.run(machine, COMMAND).done();
            // A client that was killed may have left a temporary file in the folder that plays the object store.
            let objects = site
                .objects()
                .into_iter()
                .filter(|(name, _)| !name.contains('#'))
                .collect();
            assert_same_bytes(&objects, &expected);
        }
    }

    #[test]
    fn two_machines_run_the_same_pipeline_at_the_same_time() {
        let site = Site::new();
        let start = |machine: &str| site.command(machine, COMMAND).arg("--quiet").spawn().unwrap();
        let children = ["one", "two"].map(start);
        for mut child in children {
            assert!(child.wait().unwrap().success());
        }
        assert_same_bytes(&site.objects(), &ordinary());
        assert_same_bytes(&artifact_bytes(&site.cache("one")), &artifact_bytes(&site.cache("two")));
    }

    /// The same through S3's protocol. Prints what it costs.
    /// Names of the parts of the artifacts of a stage in a cache.
    fn parts_in(cache: &Path, stage: Stage) -> Vec<String> {
        let artifacts = folders_in(&cache.join(stage.artifact()));
        let parts = artifacts
            .iter()
            .flat_map(|artifact| folders_in(&artifact.join("parts")));
        parts
            .map(|part| part.file_name().unwrap().to_string_lossy().into_owned())
            .collect()
    }

    #[test]
    fn a_shard_downloads_only_the_parts_that_it_reads() {
        let Some(place) = crate::parts::many() else { return };
        let site = Site::of(place);
        let folder = site.place.path().join("folder");
        let in_folder = site
            .place
            .command()
            .args(["index", "good.toml", "--artifacts"])
            .arg(&folder)
            .output();
        Answer::new(&in_folder.unwrap(), site.place.path()).done();
        for shard in ["2/3", "0/3", "1/3"] {
            site.run(
                &format!("ingest-{}", &shard[..1]),
                &format!("ingest good.toml --shard {shard}"),
            )
            .done();
        }
        // What is missing is found without a download.
        site.run("planner", "plan good.toml --shards 3 --missing --json").done();
        assert_eq!(parts_in(&site.cache("planner"), Stage::Ingest), Vec::<String>::new());
        site.run("merger", "merge ingest good.toml").done();
        site.run("two", "segment good.toml --shard 1/3").done();
        let own = parts_in(&site.cache("two"), Stage::Ingest);
        assert!(own.contains(&"000001".to_owned()), "{own:?}");
        assert!(own.iter().all(|part| part == "000001" || part == "dataset"), "{own:?}");
        assert_eq!(parts_in(&site.cache("two"), Stage::Segment), ["000001"]);
        // Another machine makes the rest, and reads all.
        site.run("rest", "index good.toml").done();
        assert_same_bytes(&site.objects(), &artifact_bytes(&folder));
        assert_same_bytes(&artifact_bytes(&site.cache("rest")), &artifact_bytes(&folder));
    }

    #[test]
    fn a_run_with_its_artifacts_in_s3() {
        let Some(moto) = crate::support::moto::Moto::start() else {
            return;
        };
        let mut site = Site::new();
        site.address = "s3://bucket/a/folder".to_owned();
        let run = |machine: &str| {
            let start = Instant::now();
            let output = moto.settings(&mut site.command(machine, COMMAND)).output().unwrap();
            (Answer::new(&output, site.place.path()).done(), start.elapsed())
        };
        let place = Place::new();
        let start = Instant::now();
        place.run(COMMAND).done();
        let ordinary = start.elapsed();
        let (first, made) = run("one");
        let (second, downloaded) = run("two");
        let (_, again) = run("two");
        println!("a folder {ordinary:?}; S3: made {made:?}, downloaded {downloaded:?}, again {again:?}");
        assert_eq!(first.stdout, second.stdout);
        assert_eq!(
            second.stderr.matches("unchanged, skipped").count(),
            4,
            "{}",
            second.stderr
        );
        assert_same_bytes(&artifact_bytes(&site.cache("one")), &place.bytes());
        assert_same_bytes(&artifact_bytes(&site.cache("two")), &place.bytes());
        // A key without permission, and a bucket that does not exist.
        site.address = "s3://nothing/folder".to_owned();
        let output = moto.settings(&mut site.command("three", COMMAND)).output().unwrap();
        let error = Answer::new(&output, site.place.path()).refused();
        assert!(error.contains("create the bucket, or check the address"), "{error}");
    }
}
