//! Kinds of wrong and of unusual datasets. Each is refused with the file and the column or key at fault, or read as what it means.

mod columns;
mod files;
mod metadata;
mod tables;

use std::sync::Arc;

use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float32Type, Float64Type, Int64Type};
use arrow_array::{Array, ArrayRef, BinaryArray, Float32Array, Float64Array, Int64Array, StringArray, StructArray};
use arrow_schema::Field;
use re4_fault::Remedy;

use super::support::{Contents, Copy, contents, samples};

pub(super) const AV1: &str = "pusht-v3.0-video-av1";
pub(super) const IMAGE: &str = "pusht-v3.0-image";
pub(super) const MULTI: &str = "pusht-v3.0-multifile";
pub(super) const OLD: &str = "pusht-v2.1-image";
pub(super) const OLD_VIDEO: &str = "pusht-v2.1-video-h264";

pub(super) const INFO: &str = "meta/info.json";
pub(super) const DATA: &str = "data/chunk-000/file-000.parquet";
pub(super) const EPISODES: &str = "meta/episodes/chunk-000/file-000.parquet";
pub(super) const TASKS: &str = "meta/tasks.parquet";
pub(super) const VIDEO: &str = "videos/observation.image/chunk-000/file-000.mp4";
pub(super) const OLD_MP4: [&str; 2] = [
    "videos/chunk-000/observation.image/episode_000000.mp4",
    "videos/chunk-000/observation.image/episode_000001.mp4",
];
pub(super) const OLD_DATA: [&str; 2] = [
    "data/chunk-000/episode_000000.parquet",
    "data/chunk-000/episode_000001.parquet",
];

/// What must come of a change.
pub(super) enum Then {
    /// It is read like the original.
    Same,
    /// A fault names this file, and this object if it is not empty.
    Refused(&'static str, &'static str),
}

pub(super) use Then::{Refused, Same};

/// A change of a sample: its name, the sample, the change and what must come of it.
pub(super) type Case = (&'static str, &'static str, fn(&Copy), Then);

pub(super) fn floats(array: &ArrayRef, change: impl Fn(usize, f64) -> f64) -> ArrayRef {
    let values = array.as_primitive::<Float64Type>();
    Arc::new(
        values
            .iter()
            .enumerate()
            .map(|(row, value)| value.map(|value| change(row, value)))
            .collect::<Float64Array>(),
    )
}

pub(super) fn singles(array: &ArrayRef, change: impl Fn(usize, f32) -> f32) -> ArrayRef {
    let values = array.as_primitive::<Float32Type>();
    Arc::new(
        values
            .iter()
            .enumerate()
            .map(|(row, value)| value.map(|value| change(row, value)))
            .collect::<Float32Array>(),
    )
}

pub(super) fn counts(array: &ArrayRef, change: impl Fn(usize, i64) -> i64) -> ArrayRef {
    let values = array.as_primitive::<Int64Type>();
    Arc::new(
        values
            .iter()
            .enumerate()
            .map(|(row, value)| value.map(|value| change(row, value)))
            .collect::<Int64Array>(),
    )
}

/// The pairs of a column of lists of two.
pub(super) fn pairs(array: &ArrayRef) -> Vec<[f32; 2]> {
    let list = array.as_list::<i32>();
    let values = |row: usize| list.value(row).as_primitive::<Float32Type>().values().to_vec();
    (0..list.len()).map(|row| values(row).try_into().unwrap()).collect()
}

/// The struct column of images with other bytes.
pub(super) fn images(array: &ArrayRef, change: impl Fn(usize, &[u8]) -> Option<Vec<u8>>) -> ArrayRef {
    let bytes = array.as_struct().column_by_name("bytes").unwrap().as_binary::<i32>();
    let bytes: BinaryArray = (0..bytes.len()).map(|row| change(row, bytes.value(row))).collect();
    let path: StringArray = (0..bytes.len()).map(|_| None::<&str>).collect();
    let field = |name: &str, array: &dyn Array| Arc::new(Field::new(name, array.data_type().clone(), true));
    Arc::new(StructArray::from(vec![
        (field("bytes", &bytes), Arc::new(bytes.clone()) as ArrayRef),
        (field("path", &path), Arc::new(path.clone()) as ArrayRef),
    ]))
}

pub(super) fn replace(bytes: &mut [u8], from: &[u8], to: &[u8]) {
    let at = bytes.windows(from.len()).position(|window| window == from).unwrap();
    bytes[at..at + to.len()].copy_from_slice(to);
}

pub(super) fn check(cases: &[Case]) {
    let Some(folder) = samples() else { return };
    let mut wrong = Vec::new();
    let mut originals: Vec<(&str, Contents)> = Vec::new();
    for (name, sample, change, then) in cases {
        if !originals.iter().any(|(known, _)| *known == *sample) {
            originals.push((*sample, contents(&folder.join(sample), true).unwrap()));
        }
        let original = &originals.iter().find(|(known, _)| *known == *sample).unwrap().1;
        let copy = Copy::of(&folder.join(sample));
        change(&copy);
        let found = contents(copy.root(), true);
        let sentences =
            |faults: &[re4_lerobot::Fault]| faults.iter().map(Remedy::sentence).collect::<Vec<_>>().join("\n    ");
        match (then, found) {
            (Same, Ok(found)) if found == *original => println!("{name}: read"),
            (Refused(file, object), Err(faults)) => {
                let names = |fault: &re4_lerobot::Fault| {
                    let of = fault.object.as_deref().unwrap_or_default();
                    fault.file == *file && (object.is_empty() || of == *object || of.ends_with(&format!(" {object}")))
                };
                println!("{name}: {}", sentences(&faults));
                let remedies = faults
                    .iter()
                    .all(|fault| !fault.fix.is_empty() && !fault.what.contains(';'));
                if !faults.iter().any(names) || !remedies {
                    wrong.push(format!(
                        "{name}: no fault names {file} {object}:\n    {}",
                        sentences(&faults)
                    ));
                }
            }
            (Same, Ok(_)) => wrong.push(format!("{name}: read with other contents")),
            (Same, Err(faults)) => wrong.push(format!("{name}: refused:\n    {}", sentences(&faults))),
            (Refused(..), Ok(found)) => {
                let how = if found == *original {
                    "like the original"
                } else {
                    "with other contents"
                };
                wrong.push(format!("{name}: read {how}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
