//! Helpers of the end-to-end tests: they run the program in a temporary folder with a small dataset and a pipeline file.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use arrow_array::{ArrayRef, RecordBatch};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use re4_artifact::{Artifact, Row as _, Stage};
use re4_policy::kinds::{PlaneRe4Row, SpaceRe4Row};
use re4_rollout::{PlaneDecisionRow, PlaneResultRow, PlaneStepRow, SpaceDecisionRow, SpaceResultRow, SpaceStepRow};
use serde_json::Value;
use tempfile::TempDir;

pub(crate) mod dataset;
#[cfg(feature = "object-store")]
pub(crate) mod moto;
pub(crate) mod synthetic_audit;

/// Maximum time to wait for any event. It is generous because the tests check that the event happens, not how fast it does on a
/// busy machine.
pub(crate) const LONGEST: Duration = Duration::from_mins(5);

/// Path of the program under test.
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_re4-pipe");

/// The top folder of the repository.
pub(crate) fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .canonicalize()
        .unwrap()
}

/// A temporary folder with `data/small.zarr` (12 scripted pushes with images) and `small.toml`. Commands run inside it.
pub(crate) struct Place {
    folder: TempDir,
}

impl Place {
    /// A folder with the dataset and the pipeline file.
    pub(crate) fn new() -> Self {
        let place = Self::empty();
        dataset::write(&place.dataset(), 12, true);
        place
    }

    /// A folder with the pipeline file and an empty data folder.
    pub(crate) fn empty() -> Self {
        let folder = TempDir::with_prefix("re4-").unwrap();
        fs::create_dir(folder.path().join("data")).unwrap();
        fs::write(folder.path().join("small.toml"), PIPELINE).unwrap();
        Self { folder }
    }

    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn dataset(&self) -> PathBuf {
        self.path().join("data/small.zarr")
    }

    pub(crate) fn artifacts(&self) -> PathBuf {
        self.path().join("artifacts")
    }

    pub(crate) fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path().join(name), content).unwrap();
    }

    /// Writes `sparse.toml`: `small.toml` with rollouts from 12 scenes far from the demonstrations instead of seeds.
    pub(crate) fn write_sparse(&self) {
        let small = fs::read_to_string(self.path().join("small.toml")).unwrap();
        self.write("sparse.toml", small.replace("seeds = \"500..506\"\n", "") + SCENES);
    }

    /// Writes `data/states.zarr`, which has two episodes without images, and `image.toml`: `small.toml` on rendered images of
    /// them.
    pub(crate) fn write_image(&self) {
        dataset::write(&self.path().join("data/states.zarr"), 2, false);
        let small = fs::read_to_string(self.path().join("small.toml")).unwrap();
        let image = small
            .replace("variant = \"state\"", "variant = \"image\"")
            .replace(
                "source = \"small.zarr\"",
                "source = \"states.zarr\"\nrender = [\"image\"]",
            )
            .replace("source = \"recorded\"", "source = \"log_polar\"");
        self.write("image.toml", image);
    }

    /// A command that runs the program in this folder, with its data.
    pub(crate) fn command(&self) -> Command {
        let mut command = Command::new(PROGRAM);
        command
            .current_dir(self.path())
            .env("RE4_DATA", self.path().join("data"))
            .env_remove("NO_COLOR")
            .env_remove("RUST_LOG")
            .env_remove("CLICOLOR_FORCE")
            .env("COLUMNS", "100");
        command
    }

    /// Runs the program to its end. Arguments are separated by spaces.
    pub(crate) fn run(&self, arguments: &str) -> Answer {
        self.run_each(&arguments.split_whitespace().collect::<Vec<_>>())
    }

    /// Runs the program to its end, for arguments that contain spaces.
    pub(crate) fn run_each(&self, arguments: &[&str]) -> Answer {
        let output = self.command().args(arguments).output().unwrap();
        Answer::new(&output, self.path())
    }

    /// Starts the program and returns while it is running.
    pub(crate) fn start(&self, arguments: &str) -> Child {
        self.command()
            .args(arguments.split_whitespace())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    }

    /// The artifact of a stage. Fails unless there is exactly one.
    pub(crate) fn artifact(&self, stage: Stage) -> Artifact {
        let folders = folders_in(&self.artifacts().join(stage.artifact()));
        assert_eq!(folders.len(), 1, "{stage} has {folders:?}");
        Artifact::open(&folders[0]).unwrap()
    }

    /// Bytes of every file of every artifact, by path below the artifacts folder. Records of single runs are left out.
    pub(crate) fn bytes(&self) -> BTreeMap<String, Vec<u8>> {
        artifact_bytes(&self.artifacts())
    }

    /// Temporary files and folders in the artifacts folder and beside it.
    pub(crate) fn temporaries(&self) -> Vec<PathBuf> {
        let mut found = Vec::new();
        let mut folders = vec![self.path().to_path_buf()];
        while let Some(folder) = folders.pop() {
            for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
                let name = path.file_name().unwrap().to_str().unwrap();
                if [".tmp-", ".re4-record-", ".re4-export-"]
                    .iter()
                    .any(|prefix| name.starts_with(prefix))
                {
                    found.push(path);
                } else if path.is_dir() {
                    folders.push(path);
                }
            }
        }
        found
    }
}

/// Waits until `happened` returns a value. Fails with `what` if that takes too long.
#[track_caller]
pub(crate) fn wait_for<T>(what: &str, mut happened: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(value) = happened() {
            return value;
        }
        assert!(start.elapsed() < LONGEST, "{what}: not within {LONGEST:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Sends a signal to a child process that has not been waited for yet.
#[track_caller]
pub(crate) fn signal(child: &Child, name: &str) {
    assert!(kill(child.id(), name), "SIG{name} could not be sent");
}

/// Sends a signal. Returns whether the process exists.
fn kill(process: u32, name: &str) -> bool {
    let output = Command::new("sh")
        .args(["-c", &format!("kill -{name} {process}")])
        .output()
        .unwrap();
    output.status.success()
}

/// A process that is not a child of this one. The start time distinguishes it from a later process with the same id.
pub(crate) struct Process {
    id: u32,
    /// Start time, in ticks since the machine was started.
    started: String,
}

impl Process {
    /// The process with this id.
    pub(crate) fn of(id: u32) -> Option<Self> {
        let (_, started) = Self::state(id)?;
        Some(Self { id, started })
    }

    pub(crate) fn id(&self) -> u32 {
        self.id
    }

    /// State and start time of a process. In `/proc/ID/stat` they come after the name, which may contain spaces and parentheses.
    fn state(id: u32) -> Option<(String, String)> {
        let line = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
        let mut words = line.rsplit_once(')')?.1.split_whitespace().map(str::to_owned);
        Some((words.next()?, words.nth(18)?))
    }

    /// Whether it is still running. An ended process that its parent has not waited for is a zombie, which does not count.
    pub(crate) fn is_running(&self) -> bool {
        Self::state(self.id).is_some_and(|(state, started)| started == self.started && state != "Z" && state != "X")
    }

    /// Sends a signal repeatedly until the process has ended. Rust's runtime handles the first SIGSEGV or SIGBUS that no memory
    /// access has caused by removing its handler, so only the next one ends the process.
    pub(crate) fn end_by(&self, name: &str) {
        let start = Instant::now();
        while self.is_running() {
            assert!(start.elapsed() < LONGEST, "SIG{name} does not end it");
            kill(self.id, name);
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until the process has ended.
    #[track_caller]
    pub(crate) fn wait(&self) {
        wait_for("the end of the process", || (!self.is_running()).then_some(()));
    }
}

/// A point at which the worker process that reads HDF5 waits, so that tests can act in the middle of its work.
pub(crate) struct Gate(PathBuf);

impl Gate {
    /// Sets a gate for a program that has not been started: its worker waits once this many demonstrations or images are done.
    pub(crate) fn before(command: &mut Command, place: &Place, done: usize) -> Self {
        let gate = Self(place.path().join("gate"));
        let _ = fs::remove_file(&gate.0);
        command
            .env("RE4_HDF5", "library")
            .env("RE4_WORKER_GATE", format!("{done} {}", gate.0.display()));
        gate
    }

    /// The worker that waits at the gate; `None` if it has not arrived yet.
    pub(crate) fn worker(&self) -> Option<Process> {
        let text = fs::read_to_string(&self.0).ok()?;
        Process::of(text.strip_suffix('\n')?.parse().ok()?)
    }

    /// Lets the waiting worker continue.
    pub(crate) fn open(&self) {
        fs::remove_file(&self.0).unwrap();
    }

    /// Waits until the program's worker has arrived at the gate.
    #[track_caller]
    pub(crate) fn wait(&self, program: &mut Child) -> Process {
        wait_for("a worker at the gate", || {
            let worker = self.worker();
            assert!(
                worker.is_some() || program.try_wait().unwrap().is_none(),
                "the program ended before its worker arrived at the gate"
            );
            worker
        })
    }
}

/// Exit code and output of the program, with the folder of the test written as `[folder]`.
pub(crate) struct Answer {
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Answer {
    pub(crate) fn new(output: &Output, folder: &Path) -> Self {
        let text = |bytes: &[u8]| {
            let text = String::from_utf8(bytes.to_vec()).unwrap();
            text.replace(folder.to_str().unwrap(), "[folder]")
        };
        Self {
            code: output.status.code(),
            stdout: text(&output.stdout),
            stderr: text(&output.stderr),
        }
    }

    /// Asserts success, and returns itself.
    #[track_caller]
    pub(crate) fn done(self) -> Self {
        assert_eq!(self.code, Some(0), "stdout {}\nstderr {}", self.stdout, self.stderr);
        self
    }

    /// Asserts an error: exit code 2, and one sentence as the last line of standard error, which is returned. Standard output is
    /// empty or, with `--json`, contains the same error with its remedy in a separate field.
    #[track_caller]
    pub(crate) fn refused(self) -> String {
        self.ended_with(2)
    }

    /// As [`Self::refused_at_once`], of a command that was interrupted: exit code 75.
    #[track_caller]
    pub(crate) fn interrupted_at_once(self) -> String {
        assert_eq!(self.stderr.lines().count(), 1, "{}", self.stderr);
        self.ended_with(75)
    }

    #[track_caller]
    fn ended_with(self, code: i32) -> String {
        assert_eq!(self.code, Some(code), "stdout {}\nstderr {}", self.stdout, self.stderr);
        let mut lines = self.stderr.lines().rev();
        let last = lines.next().unwrap_or_default();
        assert!(last.starts_with("error: "), "{}", self.stderr);
        assert!(
            lines.all(|line| !line.contains("error") && !line.contains("panicked")),
            "more than one sentence: {}",
            self.stderr
        );
        assert!(!last.contains(". "), "more than one sentence: {last}");
        if !self.stdout.is_empty() {
            let json = self.json();
            let part = |name: &str| json[name].as_str().map(str::to_owned);
            let parts: Vec<String> = ["error", "remedy"].into_iter().filter_map(part).collect();
            assert_eq!(format!("error: {}", parts.join("; ")), last);
        }
        last.to_owned()
    }

    /// As [`Self::refused`], and asserts that standard error contains nothing else.
    #[track_caller]
    pub(crate) fn refused_at_once(self) -> String {
        assert_eq!(self.stderr.lines().count(), 1, "{}", self.stderr);
        self.refused()
    }

    /// Standard output as one JSON object.
    #[track_caller]
    pub(crate) fn json(&self) -> serde_json::Value {
        assert_eq!(self.stdout.lines().count(), 1, "{}", self.stdout);
        let value: serde_json::Value = serde_json::from_str(&self.stdout).unwrap();
        assert!(value.is_object(), "{value}");
        value
    }
}

/// Folders directly in a folder, sorted; empty if the folder does not exist.
pub(crate) fn folders_in(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut folders: Vec<PathBuf> = entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_dir())
        .collect();
    folders.sort();
    folders
}

/// Bytes of every file of every artifact below an artifacts folder.
pub(crate) fn artifact_bytes(artifacts: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut names = Vec::new();
    list(artifacts, "", &mut names);
    names
        .into_iter()
        .filter(|name| !name.starts_with("runs/"))
        .map(|name| {
            let bytes = fs::read(artifacts.join(&name)).unwrap();
            (name, bytes)
        })
        .collect()
}

/// Collects all files below a folder by relative path, sorted.
fn list(folder: &Path, prefix: &str, names: &mut Vec<String>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let mut entries: Vec<_> = entries.map(Result::unwrap).collect();
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        let name = format!("{prefix}{}", entry.file_name().to_str().unwrap());
        if entry.file_type().unwrap().is_dir() {
            list(&entry.path(), &format!("{name}/"), names);
        } else {
            names.push(name);
        }
    }
}

/// Asserts that two sets of artifact bytes are equal. Names the files that differ, without printing their contents.
#[track_caller]
pub(crate) fn assert_same_bytes(left: &BTreeMap<String, Vec<u8>>, right: &BTreeMap<String, Vec<u8>>) {
    assert!(!left.is_empty());
    assert_eq!(
        left.keys().collect::<Vec<_>>(),
        right.keys().collect::<Vec<_>>(),
        "different files"
    );
    for (name, bytes) in left {
        assert!(bytes == &right[name], "{name} differs");
    }
}

/// Snapshot filters for text that differs between machines: keys, other hashes and times.
pub(crate) fn filters() -> Vec<(&'static str, &'static str)> {
    vec![
        ("the kinds are [a-z0-9_, -]+", "the kinds are [kinds]"),
        (r"\.tmp-[\w.-]+", "[temporary]"),
        (r"\.re4-record-\w+", "[temporary]"),
        (r"\b[0-9a-f]{64}\b", "[hash]"),
        (r"\b[0-9a-f]{16}\b", "[key]"),
        (r"\b\d+\.\d\d s\b", "[time] s"),
        (r"\b\d+\.\d ms\b", "[time] ms"),
        (r#""wall_s":[0-9.e-]+"#, r#""wall_s":"[time]""#),
    ]
}

/// The folder of real datasets, if it contains the human demonstrations; otherwise prints that the test is skipped.
pub(crate) fn real_data() -> Option<PathBuf> {
    let beside = || repository().join("../shared/data");
    let data = std::env::var_os("RE4_DATA").map_or_else(beside, PathBuf::from);
    let there = data.join("pusht/pusht_cchi_v7_replay.zarr").is_dir();
    if !there {
        println!(
            "skipped: no pusht/pusht_cchi_v7_replay.zarr below {}; set RE4_DATA to the folder of the datasets",
            data.display()
        );
    }
    there.then_some(data)
}

const SCENES: &str = r#"
[scenes]
kind = "sparse_observations"
poses = 6
pushers = 2
grid = 20
"#;

const PIPELINE: &str = r#"task = "pusht"
variant = "state"

[ingest]
source = "small.zarr"

[segment]
rule = "always_transit"

[pose]
source = "recorded"

[index]
longest_chunk = 128

[rollout]
policy = "re4"
seeds = "500..506"
max_steps = 60
"#;

/// Compares the columns of all tables in a folder's artifacts with the committed schemas. Returns the names of the tables.
pub(crate) fn compare_with_schemas(place: &Place) -> BTreeSet<String> {
    let mut compared = BTreeSet::new();
    for kind in folders_in(&place.artifacts()) {
        for artifact in folders_in(&kind)
            .into_iter()
            .filter(|folder| folder.join("manifest.json").exists())
        {
            let mut folders = vec![artifact.clone()];
            if artifact.join("parts").is_dir() {
                folders.extend(folders_in(&artifact.join("parts")));
            }
            let files = folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap());
            for file in files.map(|entry| entry.unwrap().path()) {
                if file.extension().is_none_or(|extension| extension != "parquet") {
                    continue;
                }
                let name = file.file_stem().unwrap().to_str().unwrap();
                let reader = ParquetRecordBatchReaderBuilder::try_new(fs::File::open(&file).unwrap()).unwrap();
                // If both domains have a table of this name, the domain in the file's metadata decides.
                let domain = reader.schema().metadata().get("re4.domain").cloned();
                let title = domain.map_or(name.to_owned(), |domain| format!("{name}-{domain}"));
                let path = repository().join(format!("schemas/{title}.json"));
                let described: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
                assert_eq!(described["file"], format!("{name}.parquet"));
                let found: Vec<[String; 5]> = reader
                    .schema()
                    .fields()
                    .iter()
                    .map(|field| {
                        let metadata = |key| field.metadata().get(key).cloned().unwrap_or_default();
                        let kind = field.data_type().to_string();
                        [
                            field.name().clone(),
                            kind,
                            field.is_nullable().to_string(),
                            metadata("unit"),
                            metadata("frame"),
                        ]
                    })
                    .collect();
                let columns: Vec<[String; 5]> = described["columns"]
                    .as_array()
                    .unwrap()
                    .iter()
                    .map(|column| {
                        let text = |key: &str| column[key].as_str().unwrap().to_owned();
                        let nullable = column["nullable"].as_bool().unwrap().to_string();
                        [text("name"), text("arrow_type"), nullable, text("unit"), text("frame")]
                    })
                    .collect();
                assert_eq!(found, columns, "{title}");
                compared.insert(title);
            }
        }
    }
    compared
}

/// The datasets of scripted demonstrations, if they exist; otherwise prints that the test is skipped.
pub(crate) fn scripted() -> Option<PathBuf> {
    let beside = || repository().join("../shared/data");
    let data = std::env::var_os("RE4_DATA").map_or_else(beside, PathBuf::from);
    let data = data.join("robomimic-scripted");
    if !data.is_dir() {
        println!(
            "skipped: no {}; set RE4_DATA to the folder of the datasets",
            data.display()
        );
        return None;
    }
    Some(data.canonicalize().unwrap())
}

/// The datasets of scripted demonstrations and the simulators, if both exist; otherwise prints that the test is skipped.
pub(crate) fn scripted_and_simulators() -> Option<(PathBuf, PathBuf)> {
    let named = |variable: &str, beside: &str| {
        std::env::var_os(variable).map_or_else(|| repository().join(beside), PathBuf::from)
    };
    let data = named("RE4_DATA", "../shared/data").join("robomimic-scripted");
    let simulators = named("RE4_SIMULATORS", "data/simulators");
    for (path, hint) in [
        (&data, "set RE4_DATA to the folder of the datasets"),
        (
            &simulators.join("mujoco-2.3.7/libmujoco.so"),
            "run scripts/setup-simulators.sh",
        ),
    ] {
        if !path.exists() {
            println!("skipped: no {}; {hint}", path.display());
            return None;
        }
    }
    Some((data, simulators.canonicalize().unwrap()))
}

/// Whether these are rollouts of a robosuite task.
fn is_spatial(rollouts: &Artifact) -> bool {
    rollouts.table_named("results").unwrap().domain().as_deref() == Some("space")
}

/// Table `results` of rollouts.
pub(crate) fn results(rollouts: &Artifact) -> RecordBatch {
    let space = is_spatial(rollouts);
    let spec = if space {
        SpaceResultRow::table()
    } else {
        PlaneResultRow::table()
    };
    rollouts.table(spec).unwrap().read_all().unwrap()
}

/// Table `steps` of rollouts.
pub(crate) fn steps(rollouts: &Artifact) -> RecordBatch {
    let space = is_spatial(rollouts);
    let spec = if space {
        SpaceStepRow::table()
    } else {
        PlaneStepRow::table()
    };
    rollouts.table(spec).unwrap().read_all().unwrap()
}

/// Table `decisions` of rollouts, which all policies have.
pub(crate) fn decisions_of(rollouts: &Artifact) -> RecordBatch {
    let space = is_spatial(rollouts);
    let spec = if space {
        SpaceDecisionRow::table()
    } else {
        PlaneDecisionRow::table()
    };
    rollouts.table(spec).unwrap().read_all().unwrap()
}

/// Table `decisions` of rollouts, joined with the columns of table `decisions_re4`, which has the same rows.
pub(crate) fn decisions(rollouts: &Artifact) -> RecordBatch {
    let (core, details) = if is_spatial(rollouts) {
        (SpaceDecisionRow::table(), SpaceRe4Row::table())
    } else {
        (PlaneDecisionRow::table(), PlaneRe4Row::table())
    };
    let [core, details] = [core, details].map(|spec| rollouts.table(spec).unwrap().read_all().unwrap());
    let names: Vec<String> = core
        .schema()
        .fields()
        .iter()
        .map(|field| field.name().clone())
        .collect();
    let mut columns: Vec<(String, ArrayRef, bool)> = Vec::new();
    for batch in [&core, &details] {
        for (field, column) in batch.schema().fields().iter().zip(batch.columns()) {
            if columns.iter().all(|(name, ..)| name != field.name()) {
                columns.push((field.name().clone(), column.clone(), true));
            } else {
                assert!(names.contains(field.name()));
                assert_eq!(core.column_by_name(field.name()).unwrap(), column, "{}", field.name());
            }
        }
    }
    RecordBatch::try_from_iter_with_nullable(columns).unwrap()
}
