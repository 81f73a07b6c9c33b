//! Reads the reference files of `tests/data/robosuite`: one line of JSON, then little-endian arrays, compressed by gzip.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::panic,
    reason = "every test uses only a part; only tests and examples read the files, and they may panic"
)]

use std::fs::File;
use std::io::Read;
use std::path::Path;

use flate2::read::GzDecoder;
use serde_json::Value;

pub(crate) struct Reference {
    pub(crate) header: Value,
    data: Vec<u8>,
}

/// An array: its shape, and its numbers row by row.
pub(crate) struct Array<T> {
    pub(crate) shape: Vec<usize>,
    pub(crate) numbers: Vec<T>,
}

impl<T> Array<T> {
    /// Row `index` of the first axis.
    pub(crate) fn row(&self, index: usize) -> &[T] {
        let length: usize = self.shape[1..].iter().product();
        &self.numbers[index * length..(index + 1) * length]
    }
}

/// The sorted names of the files of a kind, without prefix and extension: `lift_1.4.1_absolute` for `trace_`.
pub(crate) fn names(kind: &str) -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/robosuite");
    let files = std::fs::read_dir(folder).unwrap();
    let files = files.map(|file| file.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = files
        .filter_map(|file| Some(file.strip_prefix(kind)?.strip_suffix(".bin.gz")?.to_owned()))
        .collect();
    names.sort();
    assert!(!names.is_empty(), "no files {kind}*");
    names
}

impl Reference {
    pub(crate) fn read(name: &str) -> Self {
        Self::open(
            &Path::new(env!("CARGO_MANIFEST_DIR"))
                .join("tests/data/robosuite")
                .join(name),
        )
    }

    pub(crate) fn open(path: &Path) -> Self {
        let mut content = Vec::new();
        GzDecoder::new(File::open(path).unwrap())
            .read_to_end(&mut content)
            .unwrap();
        let end = content.iter().position(|&byte| byte == b'\n').unwrap();
        Self {
            header: serde_json::from_slice(&content[..end]).unwrap(),
            data: content.split_off(end + 1),
        }
    }

    pub(crate) fn text(&self, field: &str) -> &str {
        self.header[field].as_str().unwrap()
    }

    /// Whether there is an array of this name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.header["arrays"]
            .as_array()
            .unwrap()
            .iter()
            .any(|entry| entry["name"] == name)
    }

    pub(crate) fn f64s(&self, name: &str) -> Array<f64> {
        self.array(name, "f64", f64::from_le_bytes)
    }

    pub(crate) fn u32s(&self, name: &str) -> Array<u32> {
        self.array(name, "u32", u32::from_le_bytes)
    }

    pub(crate) fn u8s(&self, name: &str) -> Array<u8> {
        self.array(name, "u8", u8::from_le_bytes)
    }

    fn array<T, const N: usize>(&self, name: &str, kind: &str, convert: fn([u8; N]) -> T) -> Array<T> {
        let entry = self.header["arrays"]
            .as_array()
            .unwrap()
            .iter()
            .find(|entry| entry["name"] == name)
            .unwrap_or_else(|| panic!("no array {name}"));
        assert_eq!(entry["dtype"], kind, "{name}");
        let shape: Vec<usize> = serde_json::from_value(entry["shape"].clone()).unwrap();
        let offset = usize::try_from(entry["offset"].as_u64().unwrap()).unwrap();
        let bytes = shape.iter().product::<usize>() * N;
        let numbers = self.data[offset..offset + bytes]
            .chunks_exact(N)
            .map(|chunk| convert(chunk.try_into().unwrap()))
            .collect();
        Array { shape, numbers }
    }
}
