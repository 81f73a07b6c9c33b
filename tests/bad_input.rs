//! Damaged datasets, damaged artifacts and disk errors: the program exits with code 2 and prints one sentence with the error, its
//! place and a remedy; it leaves nothing half-written; and once the input is fixed, it writes the same bytes as without the
//! error.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::Command;

use crate::support::dataset::{self, LENGTH, replace, replace_ends, replace_state};
use crate::support::{PROGRAM, Place, artifact_bytes, assert_same_bytes, filters, folders_in};
use insta::{assert_snapshot, with_settings};
use re4_artifact::canonical_text;
use serde_json::Value;
use tempfile::TempDir;

const FRAMES: usize = 12 * LENGTH;

/// Bytes of the artifacts of an undisturbed run.
fn undisturbed() -> BTreeMap<String, Vec<u8>> {
    let place = Place::new();
    place.run("run small.toml").done();
    place.bytes()
}

#[test]
fn datasets_that_cannot_be_ingested() {
    type Damage = fn(&Path);
    let damages: [(&str, Damage); 20] = [
        ("missing path", |path| fs::remove_dir_all(path).unwrap()),
        ("empty folder", |path| {
            fs::remove_dir_all(path).unwrap();
            fs::create_dir(path).unwrap();
        }),
        ("not a zarr", |path| fs::remove_file(path.join(".zgroup")).unwrap()),
        ("not a zip file", |path| {
            fs::remove_dir_all(path).unwrap();
            fs::write(path, "pusht").unwrap();
        }),
        ("truncated chunk", |path| {
            let chunk = path.join("data/state/1.0");
            let bytes = fs::read(&chunk).unwrap();
            fs::write(chunk, &bytes[..bytes.len() / 2]).unwrap();
        }),
        ("truncated chunk of images", |path| {
            fs::write(path.join("data/img/3.0.0.0"), [0; 100]).unwrap();
        }),
        ("missing chunk", |path| {
            fs::remove_file(path.join("data/action/2.0")).unwrap();
        }),
        ("missing chunk of images", |path| {
            fs::remove_file(path.join("data/img/8.0.0.0")).unwrap();
        }),
        ("missing array", |path| {
            fs::remove_dir_all(path.join("data/action")).unwrap();
        }),
        ("broken metadata", |path| {
            fs::write(path.join("data/state/.zarray"), "{").unwrap();
        }),
        ("wrong dtype", |path| {
            replace(path, "data/state", "|b1", &[FRAMES, 5], &[1; FRAMES * 5]);
        }),
        ("wrong shape", |path| {
            replace(path, "data/state", "<f4", &[FRAMES, 4], &[0; FRAMES * 16]);
        }),
        ("wrong length", |path| {
            replace(path, "data/action", "<f4", &[FRAMES - 1, 2], &[0; (FRAMES - 1) * 8]);
        }),
        ("decreasing episode ends", |path| {
            replace_ends(path, &[70, 140, 139, FRAMES as i64]);
        }),
        ("repeated episode ends", |path| {
            replace_ends(path, &[70, 70, FRAMES as i64]);
        }),
        ("episode ends from zero", |path| {
            replace_ends(path, &[0, 70, FRAMES as i64]);
        }),
        ("episode ends below zero", |path| {
            replace_ends(path, &[-5, FRAMES as i64]);
        }),
        ("episode ends before the last frame", |path| {
            replace_ends(path, &[70, FRAMES as i64 - 1]);
        }),
        ("episode ends after the last frame", |path| {
            replace_ends(path, &[70, FRAMES as i64 + 1]);
        }),
        ("zero episodes", |path| replace_ends(path, &[])),
    ];
    let mut sentences = Vec::new();
    let mut refuse = |what: &str, damage: &dyn Fn(&Path)| {
        let place = Place::new();
        damage(&place.dataset());
        sentences.push(format!("{what}\n  {}", place.run("run small.toml").refused_at_once()));
        assert!(
            place.bytes().is_empty() && place.temporaries().is_empty(),
            "{what}: files were left"
        );
    };
    for (what, damage) in damages {
        refuse(what, &damage);
    }
    refuse("NaN in a state", &|path| replace_state(path, FRAMES, 75, 3, f32::NAN));
    refuse("an infinite state", &|path| {
        replace_state(path, FRAMES, 0, 0, f32::INFINITY);
    });
    refuse("a state far outside", &|path| {
        replace_state(path, FRAMES, 839, 2, 9999.0);
    });
    refuse("an angle in degrees", &|path| replace_state(path, FRAMES, 1, 4, 270.0));
    assert_snapshot!(sentences.join("\n"));
}

#[test]
fn zip_files_that_cannot_be_read() {
    let place = Place::empty();
    let error_of = |name: &str| {
        let arguments = format!("run small.toml --set ingest.source={name}");
        place.run(&arguments).refused_at_once()
    };
    place.write("data/text.zip", "this is not a zip file");
    place.write("data/empty.zip", "");
    // The end record of a zip file without entries.
    place.write("data/hollow.zip", [b"PK\x05\x06".as_slice(), &[0; 18]].concat());
    let sentences = ["text.zip", "empty.zip", "hollow.zip", "absent.zip"].map(error_of);
    assert_snapshot!(sentences.join("\n"));
    assert!(place.bytes().is_empty());
}

#[test]
fn a_repaired_dataset_gives_the_same_bytes() {
    let place = Place::new();
    let chunk = place.dataset().join("data/img/3.0.0.0");
    let sound = fs::read(&chunk).unwrap();
    fs::write(&chunk, &sound[..7]).unwrap();
    place.run("run small.toml").refused();
    fs::write(&chunk, sound).unwrap();
    place.run("run small.toml").done();
    assert_same_bytes(&place.bytes(), &undisturbed());
}

#[test]
fn a_selection_that_does_not_fit_the_dataset() {
    let place = Place::new();
    let error_of = |selection: &str| {
        let arguments = format!("run small.toml --set ingest.select.{selection}");
        place.run(&arguments).refused_at_once()
    };
    let sentences = [
        "first=0",
        "first=13",
        "last=13",
        "episodes=[]",
        "episodes=[3,12]",
        "episodes=[3,3]",
    ]
    .map(error_of);
    let ranges = ["range=3..3", "range=10..13"].map(error_of);
    assert_snapshot!(format!("{}\n{}", sentences.join("\n"), ranges.join("\n")));
}

#[test]
fn demonstrations_without_a_push() {
    let place = Place::new();
    replace_state(&place.dataset(), FRAMES, 0, 0, 100.0);
    let error_of = |arguments: &str| place.run(arguments).refused();
    assert_snapshot!(error_of("run small.toml --quiet"));
    assert!(place.temporaries().is_empty());
    assert!(folders_in(&place.artifacts().join("rollouts")).is_empty());
}

#[test]
fn all_damaged_artifacts_are_named() {
    let place = Place::new();
    place.run("run small.toml").done();
    for (name, bytes) in place.bytes() {
        if name.ends_with("modes.parquet") || name.ends_with("results.parquet") {
            fs::write(place.artifacts().join(name), &bytes[..bytes.len() - 1]).unwrap();
        }
    }
    let answer = place.run("verify");
    assert_eq!(answer.code, Some(2));
    assert_eq!(answer.stdout.lines().count(), 2, "the intact ones: {}", answer.stdout);
    assert_eq!(answer.stderr.lines().count(), 2, "{}", answer.stderr);
    for file in ["modes.parquet", "results.parquet"] {
        assert_eq!(answer.stderr.matches(file).count(), 1, "{}", answer.stderr);
    }
}

#[test]
fn a_flipped_byte_in_any_file_is_found() {
    let place = Place::new();
    place.run("run small.toml").done();
    place.run("replay small.toml").done();
    let sound = place.bytes();
    let mut sentences = Vec::new();
    for (name, bytes) in &sound {
        let file = place.artifacts().join(name);
        let folder = file
            .parent()
            .unwrap()
            .strip_prefix(place.path())
            .unwrap()
            .display()
            .to_string();
        for (position, bit) in [(0, 1), (bytes.len() / 3, 0x20), (bytes.len() - 1, 0x80)] {
            let mut flipped = bytes.clone();
            flipped[position] ^= bit;
            fs::write(&file, flipped).unwrap();
            let message = place.run(&format!("verify {folder}")).refused_at_once();
            let short = file.file_name().unwrap().to_str().unwrap();
            assert!(
                message.contains(short) && message.contains(&folder),
                "byte {position} of {name}: {message}"
            );
            if position != 0 && position != bytes.len() - 1 {
                let inspected = place.run(&format!("inspect {folder}")).refused_at_once();
                assert_eq!(inspected, message, "inspect reports the same error as verify");
                let command = if name.starts_with("replays") { "replay" } else { "run" };
                let run = place.run(&format!("{command} small.toml --quiet")).refused_at_once();
                assert_eq!(run, message, "stages report the same error as verify");
                sentences.push(message);
            }
        }
        fs::write(&file, bytes).unwrap();
    }
    place.run("verify").done();
    assert_same_bytes(&place.bytes(), &sound);
    // Which of the two errors of a manifest is reported depends on the position of the byte.
    let mut masks = filters();
    masks.push((
        "manifest.json (is not valid JSON|does not match its own hash)",
        "manifest.json [reason]",
    ));
    with_settings!({filters => masks}, { assert_snapshot!(sentences.join("\n")) });
}

#[test]
fn missing_longer_and_foreign_files_are_found_and_deleting_the_artifact_helps() {
    let place = Place::new();
    place.run("run small.toml").done();
    let intact = place.bytes();
    let folder = place.artifact(re4_artifact::Stage::Index).path().to_path_buf();
    let mut sentences = Vec::new();
    let mut check = |damage: &dyn Fn()| {
        damage();
        sentences.push(place.run("run small.toml --quiet").refused_at_once());
        let listed = place.run("verify");
        assert_eq!(listed.code, Some(2));
        assert_eq!(
            listed.stdout.lines().filter(|line| line.starts_with("intact")).count(),
            3
        );
        // Follows the remedy of the message.
        fs::remove_dir_all(&folder).unwrap();
        place.run("run small.toml").done();
        assert_same_bytes(&place.bytes(), &intact);
    };
    check(&|| fs::remove_file(folder.join("scales.parquet")).unwrap());
    check(&|| {
        let file = folder.join("index.parquet");
        fs::write(&file, [fs::read(&file).unwrap(), vec![0]].concat()).unwrap();
    });
    check(&|| fs::write(folder.join("notes.txt"), "mine").unwrap());
    check(&|| fs::write(folder.join("manifest.json"), "{}").unwrap());
    with_settings!({filters => filters()}, { assert_snapshot!(sentences.join("\n")) });
}

/// Changes a manifest as a newer version of the program would write it, with a matching hash.
fn rewrite(folder: &Path, change: impl FnOnce(&mut Value)) {
    let path = folder.join("manifest.json");
    let mut manifest: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut manifest);
    let mut rest = manifest.clone();
    rest.as_object_mut().unwrap().shift_remove("manifest_blake3");
    manifest["manifest_blake3"] = blake3::hash(rest.to_string().as_bytes()).to_string().into();
    fs::write(path, canonical_text(&manifest)).unwrap();
}

#[test]
fn an_artifact_from_a_newer_schema() {
    let place = Place::new();
    place.run("run small.toml").done();
    let folder = place.artifact(re4_artifact::Stage::Ingest).path().to_path_buf();
    let sound = fs::read(folder.join("manifest.json")).unwrap();
    let mut sentences = Vec::new();
    let mut refuse = |change: fn(&mut Value)| {
        rewrite(&folder, change);
        for command in ["verify", "run small.toml --quiet", "rollout small.toml --quiet"] {
            let message = place.run(command);
            assert_eq!(message.code, Some(2), "{command}");
            sentences.push(message.stderr.trim_end().to_owned());
        }
        fs::write(folder.join("manifest.json"), &sound).unwrap();
    };
    refuse(|manifest| manifest["tables"]["frames"]["schema_version"] = 99.into());
    refuse(|manifest| manifest["format"] = 99.into());
    with_settings!({filters => filters()}, { assert_snapshot!(sentences.join("\n")) });
    // Rewriting the manifest unchanged is accepted, so the error above was caused by the change.
    rewrite(&folder, |_| ());
    assert_eq!(fs::read(folder.join("manifest.json")).unwrap(), sound);
    place.run("run small.toml").done();
}

/// A separate file system, if this machine allows mounting one.
struct Disk(TempDir);

impl Disk {
    fn new(options: &str) -> Option<Self> {
        let folder = TempDir::with_prefix("re4-disk-").unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", options, "tmpfs"])
            .arg(folder.path())
            .output()
            .is_ok_and(|output| output.status.success());
        if !mounted {
            println!("skipped: this machine does not allow mounting a file system");
        }
        mounted.then(|| Self(folder))
    }

    fn remount(&self, options: &str) {
        let mut command = Command::new("mount");
        let status = command.args(["-o", options]).arg(self.0.path()).status().unwrap();
        assert!(status.success());
    }

    fn artifacts(&self) -> String {
        self.0.path().join("artifacts").display().to_string()
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0.path()).status();
    }
}

/// The message with the disk's folder written as `[disk]`.
fn on_disk(sentence: &str, disk: &Disk) -> String {
    sentence.replace(disk.0.path().to_str().unwrap(), "[disk]")
}

#[test]
fn a_full_disk() {
    let expected = undisturbed();
    let total: usize = expected.values().map(Vec::len).sum();
    let mut sentences = Vec::new();
    // From a disk that is full at once to one that has no space only for the last artifact.
    for tenths in 0..10 {
        let size = 4096 + total * tenths / 10;
        let Some(disk) = Disk::new(&format!("size={size}")) else {
            return;
        };
        let place = Place::new();
        let command = format!("run small.toml --quiet --artifacts {}", disk.artifacts());
        let message = on_disk(&place.run(&command).refused(), &disk);
        assert!(
            message.contains("the disk is full") && message.contains("; free space there"),
            "{tenths} tenths: {message}"
        );
        let left = artifact_bytes(Path::new(&disk.artifacts()));
        assert!(
            left.iter().all(|(name, bytes)| expected.get(name) == Some(bytes)),
            "{tenths} tenths: a part was left"
        );
        assert!(left.len() < expected.len());
        sentences.push(message);
        disk.remount(&format!("remount,size={}", 8 * total));
        place.run(&command).done();
        assert_same_bytes(&artifact_bytes(Path::new(&disk.artifacts())), &expected);
    }
    sentences.dedup();
    assert!(sentences.len() >= 3, "{sentences:?}");
    let disk = Disk::new("size=8m").unwrap();
    let place = Place::new();
    place
        .run(&format!("run small.toml --artifacts {}", disk.artifacts()))
        .done();
    // Fills the remaining space, to the last page.
    let mut filler = fs::File::create(disk.0.path().join("filler")).unwrap();
    while filler.write_all(&[1; 4096]).is_ok() {}
    let record = format!(
        "run small.toml --quiet --artifacts {} --record {}/out.zarr",
        disk.artifacts(),
        disk.0.path().display()
    );
    let message = on_disk(&place.run(&record).refused(), &disk);
    assert_eq!(
        folders_in(disk.0.path()).len(),
        1,
        "{message}: a part of the recording was left"
    );
    with_settings!({filters => filters()}, { assert_snapshot!(format!("{}\n{message}", sentences[0])) });
}

#[test]
fn a_read_only_file_system() {
    let Some(disk) = Disk::new("size=64m") else { return };
    let place = Place::new();
    let command = format!("run small.toml --quiet --artifacts {}", disk.artifacts());
    place.run(&command).done();
    disk.remount("remount,ro");
    let sound = artifact_bytes(Path::new(&disk.artifacts()));
    // Existing artifacts can still be used.
    place.run(&command).done();
    place.run(&format!("verify --artifacts {}", disk.artifacts())).done();
    let other = place.run(&format!("{command} --seeds 900..903")).refused();
    let new = place.run(&command.replace("/artifacts", "/elsewhere")).refused();
    let record = place
        .run(&format!("{command} --record {}/out.zarr", disk.0.path().display()))
        .refused();
    let schemas = place
        .run(&format!("schemas {}/schemas", disk.0.path().display()))
        .refused();
    assert_same_bytes(&artifact_bytes(Path::new(&disk.artifacts())), &sound);
    let message = on_disk(&[other, new, record, schemas].join("\n"), &disk);
    with_settings!({filters => filters()}, { assert_snapshot!(message) });
    disk.remount("remount,rw");
}

#[test]
fn a_folder_without_permission() {
    use std::os::unix::process::CommandExt as _;
    let place = Place::new();
    let closed = place.path().join("closed");
    fs::create_dir(&closed).unwrap();
    fs::set_permissions(&closed, fs::Permissions::from_mode(0o555)).unwrap();
    fs::set_permissions(place.path(), fs::Permissions::from_mode(0o755)).unwrap();
    let privileged = fs::write(closed.join("probe"), "").is_ok();
    let mut command = place.command();
    if privileged {
        // The superuser ignores permissions, so the program runs without privileges.
        fs::remove_file(closed.join("probe")).unwrap();
        command.uid(65_534).gid(65_534);
    }
    command.args(["run", "small.toml", "--quiet", "--artifacts", "closed"]);
    let output = match command.output() {
        Ok(output) => output,
        Err(error) => {
            println!("skipped: {PROGRAM} cannot be run without privileges: {error}");
            return;
        }
    };
    let message = crate::support::Answer::new(&output, place.path()).refused();
    assert!(fs::read_dir(&closed).unwrap().next().is_none(), "{message}");
    fs::set_permissions(&closed, fs::Permissions::from_mode(0o755)).unwrap();
    with_settings!({filters => filters()}, { assert_snapshot!(message) });
}

#[test]
fn an_artifacts_folder_that_is_a_file() {
    let place = Place::new();
    place.write("taken", "");
    let error_of = |command: &str| place.run(command).refused();
    let message = [
        error_of("run small.toml --artifacts taken"),
        error_of("run small.toml --artifacts taken/below"),
    ];
    assert_snapshot!(message.join("\n"));
}

#[test]
fn the_scripted_dataset_is_valid() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("x.zarr");
    dataset::write(&path, 2, true);
    let reader = re4_ingest::pusht::PushtReader::open(&path).unwrap();
    assert_eq!(reader.frame_count(), 2 * LENGTH);
}
