//! Random damage to a store results in an error message or in data, never in a panic or a hang.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail like tests"
)]

mod common;

use std::fs;

use common::{Copy, read_all};
use proptest::prelude::*;

const METADATA: [&str; 4] = [
    "data/state/.zarray",
    "data/img/.zarray",
    "data/n_contacts/.zarray",
    "meta/episode_ends/.zarray",
];
const ORIGINAL_CHUNKS: [&str; 4] = [
    "data/state/1.0",
    "data/img/0.0.0.0",
    "data/keypoint/4.0.0",
    "meta/episode_ends/0",
];
const MIXED_CHUNKS: [&str; 6] = [
    "data/action/0.0",
    "data/img/1.1.1.0",
    "data/keypoint/1.0.0",
    "data/n_contacts/0",
    "data/state/1.1",
    "meta/episode_ends/0",
];

/// Changes to a file: bytes overwritten, bytes removed, bytes added.
#[derive(Debug, Clone)]
enum Damage {
    Set(prop::sample::Index, u8),
    Cut(prop::sample::Index),
    Remove(prop::sample::Index),
    Insert(prop::sample::Index, u8),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = any::<prop::sample::Index>;
    // Digits, brackets and quotes keep JSON readable more often than other bytes.
    let byte = || {
        prop_oneof![
            any::<u8>(),
            prop::sample::select(b"0123456789[]{}\",.-eE<>|fiu".to_vec())
        ]
    };
    prop_oneof![
        6 => (at(), byte()).prop_map(|(at, byte)| Damage::Set(at, byte)),
        1 => at().prop_map(Damage::Cut),
        2 => at().prop_map(Damage::Remove),
        2 => (at(), byte()).prop_map(|(at, byte)| Damage::Insert(at, byte)),
    ]
}

fn apply(bytes: &mut Vec<u8>, damages: &[Damage]) {
    for damage in damages {
        if bytes.is_empty() {
            return;
        }
        match damage {
            Damage::Set(at, byte) => {
                let at = at.index(bytes.len());
                bytes[at] = *byte;
            }
            Damage::Cut(at) => bytes.truncate(at.index(bytes.len())),
            Damage::Remove(at) => {
                bytes.remove(at.index(bytes.len()));
            }
            Damage::Insert(at, byte) => bytes.insert(at.index(bytes.len()), *byte),
        }
    }
}

/// Damages one file of a store, reads everything, and restores the file.
fn read_damaged(store: &Copy, file: &str, damage: impl FnOnce(&mut Vec<u8>)) -> Result<(), TestCaseError> {
    let path = store.path().join(file);
    let whole = fs::read(&path).unwrap();
    let mut bytes = whole.clone();
    damage(&mut bytes);
    fs::write(&path, &bytes).unwrap();
    let result = read_all(&store.path());
    fs::write(&path, whole).unwrap();
    if let Err(sentence) = result {
        prop_assert!(sentence.starts_with("cannot ingest "), "{}", sentence);
    }
    Ok(())
}

thread_local! {
    // Every test runs in its own thread, so each has its own copies.
    static STORE: Copy = Copy::of("original");
    static MIXED: Copy = Copy::of("mixed");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_metadata(file in prop::sample::select(METADATA.to_vec()), damages in prop::collection::vec(damage(), 1..4)) {
        STORE.with(|store| read_damaged(store, file, |bytes| apply(bytes, &damages)))?;
    }

    #[test]
    fn damaged_blosc_chunks(file in prop::sample::select(ORIGINAL_CHUNKS.to_vec()), damages in prop::collection::vec(damage(), 1..4)) {
        STORE.with(|store| read_damaged(store, file, |bytes| apply(bytes, &damages)))?;
    }

    #[test]
    fn damaged_blosc_headers(file in prop::sample::select(ORIGINAL_CHUNKS.to_vec()), at in 0..24usize, byte in any::<u8>()) {
        STORE.with(|store| read_damaged(store, file, |bytes| bytes[at] = byte))?;
    }

    #[test]
    fn damaged_chunks_of_other_codecs(file in prop::sample::select(MIXED_CHUNKS.to_vec()), damages in prop::collection::vec(damage(), 1..4)) {
        MIXED.with(|store| read_damaged(store, file, |bytes| apply(bytes, &damages)))?;
    }

    #[test]
    fn damaged_zip_files(damages in prop::collection::vec(damage(), 1..4)) {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("store.zip");
        common::zip_files(&path, &common::files_of(&common::fixture("minimal"), ""), false);
        let mut bytes = fs::read(&path).unwrap();
        apply(&mut bytes, &damages);
        fs::write(&path, bytes).unwrap();
        if let Err(sentence) = read_all(&path) {
            prop_assert!(sentence.starts_with("cannot ingest "), "{}", sentence);
        }
    }
}
