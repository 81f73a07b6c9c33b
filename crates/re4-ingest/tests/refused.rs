//! Every fault of a dataset is refused with one message that names it.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail like tests"
)]

mod common;

use std::fs;
use std::io::Read as _;

use common::{Copy, FRAMES, SIDE, files_of, fixture, image, refusal, zip_files};
use re4_ingest::Selection;
use re4_ingest::pusht::PushtReader;
use serde_json::json;
use tempfile::TempDir;

/// The fixture's values of an array, frame by frame, with one of them changed.
fn changed<const WIDTH: usize>(
    row: impl Fn(usize) -> [f64; WIDTH],
    frame: usize,
    column: usize,
    value: f64,
) -> Vec<f64> {
    let mut values: Vec<f64> = (0..FRAMES).flat_map(row).collect();
    values[frame * WIDTH + column] = value;
    values
}

fn state_with(frame: usize, column: usize, value: f64) -> String {
    Copy::of("original")
        .floats(
            "data/state",
            &[FRAMES, 5],
            &changed(common::state, frame, column, value),
        )
        .refusal()
}

fn action_with(frame: usize, column: usize, value: f64) -> String {
    Copy::of("original")
        .floats(
            "data/action",
            &[FRAMES, 2],
            &changed(common::action, frame, column, value),
        )
        .refusal()
}

fn contacts_with(frame: usize, value: f64) -> String {
    let values = changed(|t| [common::contacts(t)], frame, 0, value);
    Copy::of("original")
        .floats("data/n_contacts", &[FRAMES, 1], &values)
        .refusal()
}

fn keypoint_with(frame: usize, column: usize, value: f64) -> String {
    let values = changed(
        |t| std::array::from_fn::<f64, 18, _>(|i| common::keypoint(t)[i / 2][i % 2]),
        frame,
        column,
        value,
    );
    Copy::of("original")
        .floats("data/keypoint", &[FRAMES, 9, 2], &values)
        .refusal()
}

fn images() -> Vec<f64> {
    (0..FRAMES).flat_map(image).map(f64::from).collect()
}

fn images_with(edit: impl FnOnce(&mut Vec<f64>)) -> String {
    let mut values = images();
    edit(&mut values);
    Copy::of("original")
        .floats("data/img", &[FRAMES, SIDE, SIDE, 3], &values)
        .refusal()
}

#[test]
fn paths_that_are_not_stores() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let sentence = |name: &str| refusal(&at(name), folder.path());
    fs::create_dir(at("empty")).unwrap();
    fs::create_dir(at("other")).unwrap();
    fs::write(at("other/readme.txt"), "hello").unwrap();
    fs::create_dir(at("above")).unwrap();
    common::copy_folder(&fixture("minimal"), &at("above/pusht.zarr"));
    fs::create_dir(at("version3")).unwrap();
    fs::write(at("version3/zarr.json"), "{}").unwrap();
    common::copy_folder(&fixture("format3"), &at("above3/pusht.zarr"));
    common::copy_folder(&fixture("format3"), &at("headless3"));
    fs::remove_file(at("headless3/zarr.json")).unwrap();
    common::copy_folder(&fixture("format3").join("data/state"), &at("array3"));
    common::copy_folder(&fixture("original"), &at("renamed"));
    fs::rename(at("renamed/data/state"), at("renamed/data/agent_pos")).unwrap();
    let fifo = std::process::Command::new("mkfifo").arg(at("fifo")).status().unwrap();
    assert!(fifo.success());
    common::copy_folder(&fixture("minimal"), &at("piped"));
    fs::remove_file(at("piped/data/state/0/0")).unwrap();
    let fifo = std::process::Command::new("mkfifo")
        .arg(at("piped/data/state/0/0"))
        .status()
        .unwrap();
    assert!(fifo.success());
    common::copy_folder(&fixture("minimal"), &at("headless"));
    fs::remove_file(at("headless/.zgroup")).unwrap();
    common::copy_folder(&fixture("minimal").join("data/state"), &at("array"));
    insta::assert_snapshot!(
        [
            "nowhere",
            "empty",
            "other",
            "above",
            "version3",
            "headless",
            "array",
            "above3",
            "headless3",
            "array3",
            "renamed",
            "fifo",
            "piped"
        ]
        .map(sentence)
        .join("\n")
    );
}

#[test]
fn zip_files_without_a_store() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let file = |name: &str, content: &str| (name.to_owned(), content.as_bytes().to_vec());
    fs::write(at("text.zip"), "this is no zip file").unwrap();
    fs::write(at("void.zip"), "").unwrap();
    zip_files(&at("other.zip"), &[file("readme.txt", "hello")], true);
    let two = [files_of(&fixture("minimal"), "a/"), files_of(&fixture("minimal"), "b/")].concat();
    zip_files(&at("two.zip"), &two, false);
    zip_files(&at("slip.zip"), &[file("../escaped.txt", "x")], true);
    zip_files(&at("version3.zip"), &[file("x/zarr.json", "{}")], true);
    zip_files(&at("whole.zip"), &files_of(&fixture("original"), ""), false);
    let whole = fs::read(at("whole.zip")).unwrap();
    fs::write(at("cut.zip"), &whole[..whole.len() / 2]).unwrap();
    // One flipped bit in the content of the first entry, which its checksum detects.
    let mut flipped = fs::read(at("other.zip")).unwrap();
    let place = flipped.windows(5).position(|window| window == b"hello").unwrap();
    flipped[place] ^= 1;
    fs::write(at("flipped.zip"), flipped).unwrap();
    let mut link = zip::ZipWriter::new(fs::File::create(at("link.zip")).unwrap());
    link.add_symlink("store", "/etc", zip::write::SimpleFileOptions::default())
        .unwrap();
    link.finish().unwrap();
    let sentences: Vec<String> = [
        "text", "void", "other", "two", "slip", "version3", "cut", "flipped", "link",
    ]
    .iter()
    .map(|name| refusal(&at(&format!("{name}.zip")), folder.path()))
    .collect();
    insta::assert_snapshot!(sentences.join("\n"));
    assert!(!at("escaped.txt").exists());
    assert!(!folder.path().parent().unwrap().join("escaped.txt").exists());
}

#[test]
fn files_of_other_formats() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("dataset");
    let mut tar = vec![b'x'; 600];
    tar[257..262].copy_from_slice(b"ustar");
    let heads: [&[u8]; 9] = [
        b"",
        b"\x89HDF\r\n\x1a\nmore",
        b"\x1f\x8b\x08more",
        b"\x28\xb5\x2f\xfdmore",
        b"\xfd7zXZ\0more",
        b"7z\xbc\xaf\x27\x1cmore",
        b"\x93NUMPYmore",
        b"PAR1more",
        &tar,
    ];
    let sentences = heads.map(|head| {
        fs::write(&path, head).unwrap();
        refusal(&path, folder.path())
    });
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn missing_arrays_and_wrong_types() {
    let original = || Copy::of("original");
    let flat = |count: usize| vec![0.0; count];
    let sentences = [
        original().remove("data/state").refusal(),
        original().remove("data/action/.zarray").refusal(),
        original().remove("meta").refusal(),
        original()
            .replace("data/state", "<i4", &[FRAMES, 5], vec![0; FRAMES * 20])
            .refusal(),
        original()
            .replace("data/action", "|u1", &[FRAMES, 2], vec![0; FRAMES * 2])
            .refusal(),
        original()
            .replace("data/img", "<f2", &[FRAMES, 1, 1, 3], vec![0; FRAMES * 6])
            .refusal(),
        original()
            .replace("data/img", "|S3", &[FRAMES, 1, 1, 3], vec![0; FRAMES * 9])
            .refusal(),
        original()
            .replace("data/n_contacts", "|b1", &[FRAMES, 1], vec![0; FRAMES])
            .refusal(),
        original()
            .replace("data/keypoint", "<f2", &[FRAMES, 9, 2], vec![0; FRAMES * 36])
            .refusal(),
        original()
            .floats("meta/episode_ends", &[3], &[12.0, 17.5, 30.0])
            .refusal(),
        original()
            .floats("data/state", &[FRAMES, 4], &flat(FRAMES * 4))
            .refusal(),
        original()
            .floats("data/state", &[FRAMES * 5], &flat(FRAMES * 5))
            .refusal(),
        original()
            .floats("data/action", &[FRAMES, 3], &flat(FRAMES * 3))
            .refusal(),
        original()
            .floats("data/n_contacts", &[FRAMES, 2], &flat(FRAMES * 2))
            .refusal(),
        original()
            .floats("data/keypoint", &[FRAMES, 8, 2], &flat(FRAMES * 16))
            .refusal(),
        original()
            .floats("data/img", &[FRAMES, 3, 4, 4], &flat(FRAMES * 48))
            .refusal(),
        original().floats("data/img", &[FRAMES, 0, 4, 3], &[]).refusal(),
        original()
            .replace("meta/episode_ends", "<i8", &[3, 2], vec![0; 48])
            .refusal(),
        original()
            .floats("data/action", &[FRAMES - 1, 2], &flat(FRAMES * 2 - 2))
            .refusal(),
        original()
            .floats("data/img", &[FRAMES + 1, 2, 2, 3], &flat((FRAMES + 1) * 12))
            .refusal(),
    ];
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn invalid_episode_ends() {
    let ends = |ends: &[i64]| Copy::of("original").ends(ends).refusal();
    let sentences = [
        ends(&[]),
        ends(&[12, 17, 29]),
        ends(&[12, 17, 31]),
        ends(&[12, 12, 30]),
        ends(&[17, 12, 30]),
        ends(&[0, 30]),
        ends(&[-5, 12, 30]),
        ends(&[12, i64::MIN, 30]),
        ends(&[i64::MAX]),
        Copy::of("original")
            .replace("meta/episode_ends", "<u8", &[1], u64::MAX.to_le_bytes().to_vec())
            .refusal(),
        Copy::of("minimal")
            .floats("data/state", &[0, 5], &[])
            .floats("data/action", &[0, 2], &[])
            .ends(&[])
            .refusal(),
    ];
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn chunks_that_are_missing_or_broken() {
    let original = || Copy::of("original");
    let cut = |bytes: &mut Vec<u8>| bytes.truncate(bytes.len() / 2);
    let sentences = [
        original().remove("data/state/3.0").refusal(),
        original().remove("data/action/0.0").refusal(),
        original()
            .metadata("data/n_contacts", &[("fill_value", json!(null))])
            .remove("data/n_contacts/4.0")
            .refusal(),
        original()
            .metadata("data/n_contacts", &[("fill_value", json!(-1))])
            .remove("data/n_contacts/4.0")
            .refusal(),
        original().remove("data/state/3.0").remove("data/state/1.0").refusal(),
        Copy::of("format3").remove("data/state/c/3/0").refusal(),
        Copy::of("format3").edit("data/state/c/3/0", cut).refusal(),
        Copy::of("format3").remove("data/img/c/1").refusal(),
        Copy::of("sharded").edit("data/state/c/0/0", cut).refusal(),
        Copy::of("sharded")
            .edit("data/state/c/0/0", |bytes| bytes[40] ^= 1)
            .refusal(),
        Copy::of("sharded")
            .edit("data/n_contacts/c/0/0", |bytes| bytes.truncate(10))
            .refusal(),
        Copy::of("fortran").edit("data/state/1.0", cut).refusal(),
        original().remove("data/keypoint/1.0.0").refusal(),
        original().remove("data/img/2.0.0.0").refusal(),
        original().remove("meta/episode_ends/0").refusal(),
        Copy::of("mixed").remove("data/img/2.1.2.1").refusal(),
        Copy::of("minimal").remove("data/state/0/0").refusal(),
        original().edit("data/state/3.0", cut).refusal(),
        original().edit("data/img/2.0.0.0", cut).refusal(),
        original().edit("data/img/2.0.0.0", Vec::clear).refusal(),
        original()
            .edit("data/img/2.0.0.0", |bytes| bytes[20..40].fill(0xFF))
            .refusal(),
        original().edit("data/img/2.0.0.0", |bytes| bytes[4] ^= 0x40).refusal(),
        Copy::of("minimal").edit("data/state/0/0", cut).refusal(),
        Copy::of("mixed").edit("data/action/1.0", cut).refusal(),
        Copy::of("mixed").edit("data/state/1.1", cut).refusal(),
        Copy::of("modern").edit("data/img/1.0.0.0", cut).refusal(),
    ];
    insta::assert_snapshot!(sentences.join("\n"));
}

/// Following either link would recurse up to the system's limit, and following both would double the entries at each level.
#[cfg(unix)]
#[test]
fn circular_links() {
    let copy = Copy::of("minimal");
    for (name, target) in [("data/state/7", ".."), ("data/state/8", ".")] {
        std::os::unix::fs::symlink(target, copy.path().join(name)).unwrap();
    }
    let refused = || {
        PushtReader::open(&copy.path())
            .map(|_| ())
            .unwrap_err()
            .fault
            .to_string()
    };
    assert_eq!(
        refused(),
        "data/state/7 is a symbolic link to one of its own parent folders; remove the link"
    );
    fs::remove_file(copy.path().join("data/state/7")).unwrap();
    assert_eq!(
        refused(),
        "data/state/8 is a symbolic link to one of its own parent folders; remove the link"
    );
    fs::remove_file(copy.path().join("data/state/8")).unwrap();
    // A link to a folder elsewhere is equivalent to the folder.
    let hash = || PushtReader::open(&copy.path()).unwrap().source_hash(&|| false).unwrap();
    let whole = hash();
    fs::rename(copy.path().join("meta"), copy.path().with_extension("meta")).unwrap();
    std::os::unix::fs::symlink("../store.meta", copy.path().join("meta")).unwrap();
    assert_eq!(hash(), whole);
}

/// Small files that declare huge sizes.
#[test]
fn excessive_declared_sizes() {
    // A zstd frame that declares 2^62 bytes of content (RFC 8878, section 3.1.1.1).
    let mut claim = vec![0x28, 0xB5, 0x2F, 0xFD, 0xE0];
    claim.extend((1_u64 << 62).to_le_bytes());
    claim.extend([1, 0, 0]);
    let compressed = |id: &str, bytes: &[u8]| {
        Copy::of("original")
            .metadata("data/state", &[("compressor", json!({ "id": id, "level": 1 }))])
            .write("data/state/0.0", bytes)
    };
    let mut zlib = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::new(9));
    std::io::copy(&mut std::io::repeat(0).take(64 << 20), &mut zlib).unwrap();
    let long = |array: &str, width: &[u64]| {
        let shape: Vec<u64> = std::iter::once(1 << 62).chain(width.iter().copied()).collect();
        (array.to_owned(), json!(shape))
    };
    let arrays = [
        long("data/state", &[5]),
        long("data/action", &[2]),
        long("data/n_contacts", &[1]),
        long("data/keypoint", &[9, 2]),
        long("data/img", &[8, 8, 3]),
    ];
    let long = arrays.into_iter().fold(Copy::of("original"), |copy, (array, shape)| {
        copy.metadata(&array, &[("shape", shape)])
    });
    let sentences = [
        compressed("zstd", &claim).refusal(),
        compressed("zlib", &zlib.finish().unwrap()).refusal(),
        long.refusal(),
        Copy::of("original")
            .metadata(
                "meta/episode_ends",
                &[("shape", json!([100_000_000])), ("chunks", json!([10_000_000]))],
            )
            .refusal(),
    ];
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn metadata_that_cannot_be_used() {
    let with =
        |array: &str, entries: &[(&str, serde_json::Value)]| Copy::of("original").metadata(array, entries).refusal();
    let sentences = [
        Copy::of("original").write("data/state/.zarray", "{ not json").refusal(),
        Copy::of("original").write("data/state/.zarray", "[]").refusal(),
        with("data/state", &[("zarr_format", json!(3))]),
        with("data/state", &[("chunks", json!([0, 5]))]),
        with("data/state", &[("chunks", json!([7]))]),
        with("data/state", &[("shape", json!([])), ("chunks", json!([]))]),
        with("data/state", &[("order", json!("F"))]),
        with("data/state", &[("filters", json!([{ "id": "delta", "dtype": "<f4" }]))]),
        with("data/state", &[("compressor", json!({ "id": "lzma" }))]),
        with("data/state", &[("chunks", json!([1_000_000_000, 5]))]),
        with("data/state", &[("chunks", json!([u64::MAX, u64::MAX]))]),
        with("data/img", &[("chunks", json!([7, 4096, 4096, 3]))]),
        with("data/img", &[("shape", json!([FRAMES, 1_000_000, 1_000_000, 3]))]),
        with("data/state", &[("shape", json!([1_u64 << 62, 5]))]),
    ];
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn values_out_of_range() {
    let sentences = [
        state_with(17, 3, f64::NAN),
        state_with(29, 0, f64::INFINITY),
        state_with(12, 4, f64::NEG_INFINITY),
        state_with(5, 1, -100.5),
        state_with(5, 2, 701.0),
        state_with(5, 4, -270.0),
        state_with(5, 4, 100.0),
        action_with(0, 1, f64::NAN),
        action_with(11, 0, 5000.0),
        contacts_with(13, -1.0),
        contacts_with(13, 0.5),
        contacts_with(13, f64::NAN),
        keypoint_with(20, 5, f64::NAN),
        keypoint_with(20, 4, 900.0),
    ];
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn values_at_the_edge_are_accepted() {
    // The f32 nearest to 2π exceeds it.
    for angle in [0.0, f64::from(std::f32::consts::TAU), std::f64::consts::TAU - 1e-6] {
        let values = changed(common::state, 5, 4, angle);
        let store = Copy::of("original").floats("data/state", &[FRAMES, 5], &values);
        common::read_all(&store.path()).unwrap();
    }
}

#[test]
fn images_with_non_byte_values() {
    let at = 3 * (SIDE * SIDE * 3) + 2 * (SIDE * 3) + 5 * 3 + 1;
    let sentences = [
        images_with(|values| values[at] = 300.0),
        images_with(|values| values[at] = -1.0),
        images_with(|values| values[at] = 17.25),
        images_with(|values| values[at] = f64::NAN),
        images_with(|values| values.iter_mut().for_each(|value| *value /= 255.0)),
    ];
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn faults_outside_the_selection_are_ignored() {
    let store = Copy::of("original").floats("data/state", &[FRAMES, 5], &changed(common::state, 17, 3, f64::NAN));
    let reader = PushtReader::open(&store.path()).unwrap();
    assert!(reader.read_episodes(&Selection::First(2)).is_ok());
    assert!(reader.read_episodes(&Selection::Last(1)).is_err());
}

#[test]
fn missing_selections_and_images() {
    let store = Copy::of("minimal");
    let reader = PushtReader::open(&store.path()).unwrap();
    let place = store.path().parent().unwrap().to_str().unwrap().to_owned();
    let sentences = [
        reader.read_episodes(&Selection::First(4)).map(|_| ()).unwrap_err(),
        reader.image_blocks(&Selection::All).map(|_| ()).unwrap_err(),
    ]
    .map(|error| error.to_string().replace(&place, "[folder]"));
    insta::assert_snapshot!(sentences.join("\n"));
    let reader = PushtReader::open(&fixture("original")).unwrap();
    assert!(reader.image_blocks(&Selection::List(vec![3.into()])).is_err());
}

#[test]
fn an_iterator_of_images_ends_after_its_error() {
    let store = Copy::of("original").edit("data/img/1.0.0.0", |bytes| bytes.truncate(30));
    let reader = PushtReader::open(&store.path()).unwrap();
    let mut blocks = reader.image_blocks(&Selection::All).unwrap();
    assert_eq!(blocks.next().unwrap().unwrap().frames, 0..7);
    assert!(blocks.next().unwrap().is_err());
    assert!(blocks.next().is_none());
}

#[cfg(unix)]
#[test]
fn unreadable_files() {
    use std::os::unix::fs::PermissionsExt;
    let store = Copy::of("original");
    let file = store.path().join("data/action/1.0");
    fs::set_permissions(&file, fs::Permissions::from_mode(0o000)).unwrap();
    if fs::read(&file).is_ok() {
        println!("skipped: this user may read every file");
        return;
    }
    insta::assert_snapshot!(store.refusal(), @"cannot ingest [folder]/store.zarr: cannot read [folder]/store.zarr/data/action/1.0: Permission denied (os error 13); change its permissions or run as a user with access");
}
