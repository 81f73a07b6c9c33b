//! Every kind of damage to a published artifact is detected and reported in one sentence.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail by panicking"
)]

mod common;

use std::fs;
use std::path::{Path, PathBuf};

use common::{EVERY_KIND, SCALES, files, publish_sample, recipe};
use re4_artifact::{Artifact, ArtifactError, ArtifactSummary, Stage, Store, canonical_json, canonical_text, verify};
use re4_fault::Remedy as _;
use serde_json::{Value, json};

struct Published {
    _root: tempfile::TempDir,
    store: Store,
    folder: PathBuf,
}

/// Appearance up the descriptions of the tables in this file.
fn known(_: &Artifact, name: &str) -> Option<&'static re4_artifact::TableSpec> {
    [&SCALES, &EVERY_KIND].into_iter().find(|spec| spec.name == name)
}

fn published() -> Published {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let folder = publish_sample(&store, 1, 30).path().to_path_buf();
    verify(&folder, &known).unwrap();
    Published {
        _root: root,
        store,
        folder,
    }
}

impl Published {
    fn lookup(&self) -> Result<Option<Artifact>, ArtifactError> {
        self.store.lookup(Stage::Segment, &recipe(1).key())
    }

    /// The error message of verification, which must equal that of lookup.
    fn complaint(&self) -> String {
        let verified = verify(&self.folder, &known).unwrap_err().sentence();
        assert_eq!(self.lookup().unwrap_err().sentence(), verified);
        assert!(!verified.contains('\n'));
        verified
    }

    fn damaged(&self, what: &str) -> String {
        let folder = self.folder.display();
        format!("artifact {folder} is damaged: {what}; delete the folder {folder} and run again")
    }

    /// Changes the manifest as a program would: with a matching hash.
    fn rewrite_manifest(&self, change: impl FnOnce(&mut Value)) {
        let path = self.folder.join("manifest.json");
        let mut manifest: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        change(&mut manifest);
        manifest.as_object_mut().unwrap().remove("manifest_blake3");
        let compact = canonical_json(&manifest).unwrap().to_string();
        manifest["manifest_blake3"] = json!(blake3::hash(compact.as_bytes()).to_string());
        fs::write(&path, canonical_text(&manifest)).unwrap();
    }
}

#[test]
fn every_flipped_byte_is_detected() {
    let artifact = published();
    let mut flips = 0;
    for (name, bytes) in files(&artifact.folder) {
        let path = artifact.folder.join(&name);
        // Every byte of the manifest; of the tables the first and last 64 bytes, and every seventh byte in between to save time.
        let whole = name.extension().is_some_and(|extension| extension == "json");
        let ends = |position| position < 64 || position + 64 >= bytes.len();
        for position in (0..bytes.len()).filter(|&position| whole || ends(position) || position % 7 == 0) {
            let mut flipped = bytes.clone();
            flipped[position] ^= 1 << (position % 8);
            fs::write(&path, &flipped).unwrap();
            let error = Artifact::open(&artifact.folder)
                .and_then(|a| a.verify_bytes())
                .unwrap_err();
            assert!(
                matches!(error, ArtifactError::Damaged { .. }) && error.to_string().contains(&*name.to_string_lossy()),
                "byte {position} of {}: {error}",
                name.display()
            );
            flips += 1;
        }
        fs::write(&path, &bytes).unwrap();
    }
    assert!(flips > 2_000, "only {flips} bytes were tried");
    verify(&artifact.folder, &known).unwrap();
}

#[test]
fn a_flipped_byte_is_reported() {
    let artifact = published();
    let path = artifact.folder.join("every_kind.parquet");
    let mut bytes = fs::read(&path).unwrap();
    bytes[100] ^= 4;
    fs::write(&path, bytes).unwrap();
    assert_eq!(
        artifact.complaint(),
        artifact.damaged("the content of every_kind.parquet does not match its published hash")
    );
}

#[test]
fn a_truncated_file_is_reported() {
    let artifact = published();
    let path = artifact.folder.join("every_kind.parquet");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..50]).unwrap();
    let what = format!("every_kind.parquet has 50 bytes, but {} were published", bytes.len());
    assert_eq!(artifact.complaint(), artifact.damaged(&what));
}

/// The reader computes the row group of a row from the length in the manifest, so that length must be checked against the file.
#[test]
fn row_groups_that_are_not_as_published_are_reported() {
    for (size, found) in [
        (0, "30 rows in row group 0, but the manifest implies 0"),
        (7, "30 rows in row group 0, but the manifest implies 7"),
        (29, "30 rows in row group 0, but the manifest implies 29"),
    ] {
        let artifact = published();
        artifact.rewrite_manifest(|manifest| manifest["tables"]["every_kind"]["row_group_rows"] = json!(size));
        let what = format!("every_kind.parquet has {found}");
        let message = verify(&artifact.folder, &known).unwrap_err().sentence();
        assert_eq!(message, artifact.damaged(&what));
        let open = Artifact::open(&artifact.folder).unwrap();
        assert_eq!(open.table(&EVERY_KIND).unwrap_err().sentence(), message);
    }
}

#[test]
fn a_missing_file_is_reported() {
    let artifact = published();
    let open = Artifact::open(&artifact.folder).unwrap();
    fs::remove_file(artifact.folder.join("every_kind.parquet")).unwrap();
    assert_eq!(artifact.complaint(), artifact.damaged("every_kind.parquet is missing"));
    let read = open.table(&EVERY_KIND).unwrap_err().sentence();
    assert_eq!(read, artifact.damaged("every_kind.parquet is missing"));
}

#[test]
fn a_missing_or_truncated_manifest_is_reported() {
    let artifact = published();
    let path = artifact.folder.join("manifest.json");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert_eq!(
        artifact.complaint(),
        artifact.damaged("manifest.json is not valid JSON")
    );
    fs::write(&path, "").unwrap();
    assert_eq!(
        artifact.complaint(),
        artifact.damaged("manifest.json is not valid JSON")
    );
    fs::write(&path, "{}").unwrap();
    assert_eq!(
        artifact.complaint(),
        artifact.damaged("manifest.json does not match its own hash")
    );
    fs::remove_file(&path).unwrap();
    let folder = artifact.folder.display();
    assert_eq!(
        artifact.complaint(),
        format!(
            "cannot read artifact {folder}: it has no manifest.json; check the path, or, if it is the folder of an artifact, move it away and run again"
        )
    );
}

#[test]
fn stray_files_and_folders_are_reported() {
    let artifact = published();
    fs::write(artifact.folder.join("notes.txt"), "hello").unwrap();
    assert_eq!(artifact.complaint(), artifact.damaged("notes.txt is not part of it"));
    fs::remove_file(artifact.folder.join("notes.txt")).unwrap();
    fs::create_dir(artifact.folder.join("more")).unwrap();
    assert_eq!(artifact.complaint(), artifact.damaged("more is not part of it"));
    fs::remove_dir(artifact.folder.join("more")).unwrap();
    artifact.lookup().unwrap().unwrap();
}

#[test]
fn a_newer_manifest_is_refused() {
    let artifact = published();
    artifact.rewrite_manifest(|manifest| {
        manifest["format"] = json!(3);
        manifest["something"] = json!("new");
    });
    assert_eq!(
        artifact.complaint(),
        format!(
            "cannot read artifact {}: its manifest has format 3, but this build reads formats up to 2; update re4-pipe",
            artifact.folder.display()
        )
    );
}

#[test]
fn a_newer_table_is_refused() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let writer = store.begin(&recipe(1)).unwrap();
    let table = writer.table(&SCALES).unwrap();
    table.finish().unwrap();
    let folder = writer.publish(ArtifactSummary::default()).unwrap().path().to_path_buf();
    let artifact = Published {
        _root: root,
        store,
        folder,
    };
    artifact.rewrite_manifest(|manifest| manifest["tables"]["scales"]["schema_version"] = json!(3));
    assert_eq!(
        verify(&artifact.folder, &known).unwrap_err().sentence(),
        format!(
            "cannot read artifact {}: table scales has schema version 3, but this build reads versions up to 1; update re4-pipe",
            artifact.folder.display()
        )
    );
    let open = Artifact::open(&artifact.folder).unwrap();
    assert!(matches!(open.table(&SCALES), Err(ArtifactError::NewerTable { .. })));
}

#[test]
fn a_forged_manifest_with_a_matching_hash_is_detected() {
    let artifact = published();
    artifact.rewrite_manifest(|manifest| manifest["config"]["epsilon"] = json!(0.2));
    assert_eq!(
        artifact.complaint(),
        artifact.damaged("manifest.json has a key that does not match its recipe")
    );

    let artifact = published();
    artifact.rewrite_manifest(|manifest| manifest["tables"]["every_kind"]["file"] = json!("../x.parquet"));
    assert_eq!(
        artifact.complaint(),
        artifact.damaged("manifest.json refers to a file outside the artifact for table every_kind")
    );

    let artifact = published();
    artifact.rewrite_manifest(|manifest| drop(manifest.as_object_mut().unwrap().remove("tool_version")));
    assert_eq!(
        artifact.complaint(),
        artifact.damaged("manifest.json is incomplete or malformed: missing field `tool_version`")
    );

    // The hashes match and the row count does not: only `verify`, which opens the tables, detects this.
    let artifact = published();
    artifact.rewrite_manifest(|manifest| manifest["tables"]["every_kind"]["rows"] = json!(31));
    assert_eq!(
        verify(&artifact.folder, &known).unwrap_err().sentence(),
        artifact.damaged("every_kind.parquet has 30 rows, but the manifest lists 31")
    );
}

#[test]
fn a_table_whose_columns_do_not_match_its_version_is_refused() {
    const OTHER: re4_artifact::TableSpec = re4_artifact::TableSpec {
        columns: &[re4_artifact::ColumnSpec::new(
            "episode",
            re4_artifact::ColumnKind::U32,
            "An id.",
        )],
        ..EVERY_KIND
    };
    let artifact = published();
    let open = Artifact::open(&artifact.folder).unwrap();
    assert_eq!(
        open.table(&OTHER).unwrap_err().sentence(),
        artifact.damaged("every_kind.parquet has 11 columns, but version 1 of the every_kind table has 1")
    );
}

#[test]
fn a_folder_of_another_key_is_refused() {
    let artifact = published();
    let other = artifact.store.folder(Stage::Segment, &recipe(2).key());
    fs::rename(&artifact.folder, &other).unwrap();
    let error = artifact
        .store
        .lookup(Stage::Segment, &recipe(2).key())
        .unwrap_err()
        .sentence();
    assert_eq!(
        error,
        format!(
            "artifact {} belongs to key {}, not to {}; move that folder away and run again",
            other.display(),
            recipe(1).key(),
            recipe(2).key()
        )
    );
}

#[test]
fn a_path_without_an_artifact_is_reported() {
    assert_eq!(
        verify(Path::new("/nowhere/at/all"), &known).unwrap_err().sentence(),
        "cannot read artifact /nowhere/at/all: the folder does not exist; check the path, or run the stage that produces the artifact"
    );
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    assert!(store.lookup(Stage::Segment, &recipe(1).key()).unwrap().is_none());
}

#[test]
fn the_verification_report_lists_every_file() {
    let artifact = published();
    let report = verify(&artifact.folder, &known).unwrap();
    let names: Vec<(&str, Option<u64>)> = report.files.iter().map(|f| (f.file.as_str(), f.rows)).collect();
    assert_eq!(names, [("manifest.json", None), ("every_kind.parquet", Some(30))]);
    let hash = blake3::hash(&fs::read(artifact.folder.join("every_kind.parquet")).unwrap());
    assert_eq!(report.files[1].blake3.to_string(), hash.to_string());
    assert_eq!(report.manifest.summary, json!({"rows": 30}));
    assert_eq!(report.manifest.warnings, [json!({"kind": "sample"})]);
    assert_eq!(report.manifest.source, json!({"format": "zarr"}));
}

/// A store that verifies an artifact once notices a later write, also one that keeps length and modification time.
#[test]
fn a_write_after_the_first_verification_is_noticed() {
    let place = published();
    let store = place.store.clone().verifying_once();
    let lookup = || store.lookup(Stage::Segment, &recipe(1).key());
    assert!(lookup().unwrap().is_some() && lookup().unwrap().is_some());
    let file = fs::read_dir(&place.folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.extension().is_some_and(|ending| ending == "parquet"))
        .unwrap();
    let modified = fs::metadata(&file).unwrap().modified().unwrap();
    let mut bytes = fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    // The clock of the file system has ticks, so the time of a change at once can equal the time of publication.
    std::thread::sleep(std::time::Duration::from_millis(50));
    fs::write(&file, &bytes).unwrap();
    fs::File::open(&file).unwrap().set_modified(modified).unwrap();
    assert!(matches!(lookup(), Err(ArtifactError::Damaged { .. })));
    bytes[middle] ^= 1;
    fs::write(&file, &bytes).unwrap();
    assert!(lookup().unwrap().is_some());
    fs::write(place.folder.join("stray"), "").unwrap();
    assert!(matches!(lookup(), Err(ArtifactError::Damaged { .. })));
}

#[test]
fn the_record_of_a_run_is_read_back() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let key = recipe(1).key();
    assert_eq!(Store::run_record(root.path(), Stage::Segment, &key), None);
    let path = store
        .record_run(Stage::Segment, &key, &json!({ "wall_s": 1.5 }))
        .unwrap();
    assert_eq!(
        Store::run_record(root.path(), Stage::Segment, &key),
        Some(json!({ "wall_s": 1.5 }))
    );
    fs::write(path, "{").unwrap();
    assert_eq!(Store::run_record(root.path(), Stage::Segment, &key), None);
}
