//! Converts rows to the columns that a page's script reads. Numbers are packed as base64 of little-endian bytes; texts are JSON
//! strings.

use std::collections::BTreeSet;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use serde::Serialize;
use serde_json::{Map, Value, json};

/// Columns of rows, in the order in which they were added.
#[derive(Debug)]
pub struct Pack<'a, R> {
    rows: Vec<&'a R>,
    columns: Map<String, Value>,
}

impl<'a, R> Pack<'a, R> {
    /// Starts without columns.
    pub(super) fn of(rows: impl IntoIterator<Item = &'a R>) -> Self {
        Self {
            rows: rows.into_iter().collect(),
            columns: Map::new(),
        }
    }

    /// Adds a column of `N` 32-bit floats per row. Their precision is about 1e-5 for lengths in px, and 1e-8 for lengths in m.
    pub(super) fn f32<const N: usize>(self, name: &str, value: impl Fn(&R) -> [f64; N]) -> Self {
        let column = f32s(self.rows.iter().flat_map(|row| value(row)));
        self.with(name, column)
    }

    /// Adds a column of `N` 64-bit floats per row, which are exactly the values of the artifact.
    pub(super) fn f64<const N: usize>(self, name: &str, value: impl Fn(&R) -> [f64; N]) -> Self {
        let bytes = self.rows.iter().flat_map(|row| value(row)).flat_map(f64::to_le_bytes);
        let column = packed("f64", &bytes.collect::<Vec<_>>());
        self.with(name, column)
    }

    /// Adds a column of one unsigned integer per row.
    pub(super) fn u32(self, name: &str, value: impl Fn(&R) -> u32) -> Self {
        let column = u32s(self.rows.iter().map(|row| value(row)));
        self.with(name, column)
    }

    /// Adds a column of one byte per row.
    pub(super) fn u8(self, name: &str, value: impl Fn(&R) -> u8) -> Self {
        let column = packed("u8", &self.rows.iter().map(|row| value(row)).collect::<Vec<_>>());
        self.with(name, column)
    }

    /// Adds a column as a plain JSON list. It is meant for columns that are too short to be worth packing.
    pub(super) fn list<T: Serialize>(self, name: &str, value: impl Fn(&'a R) -> T) -> Self {
        let column = json!(self.rows.iter().map(|row| value(row)).collect::<Vec<T>>());
        self.with(name, column)
    }

    /// Adds a column with a variable number of 32-bit floats per row.
    pub(super) fn f32s<V: IntoIterator<Item = f64>>(self, name: &str, values: impl Fn(&'a R) -> V) -> Self {
        let column = f32s(self.rows.iter().flat_map(|row| values(row)));
        self.with(name, column)
    }

    /// Adds a column of one word per row, for words from a small set: column `name` has an index per row, and `list` has the
    /// distinct words in sorted order. The first word is the empty one.
    pub(super) fn words(self, name: &str, list: &str, word: impl Fn(&'a R) -> &'a str) -> Self {
        let words: BTreeSet<&str> = self.rows.iter().map(|row| word(row)).chain([""]).collect();
        let index = |row: &'a R| words.iter().position(|known| *known == word(row)).unwrap_or(0) as u8;
        let codes: Vec<u8> = self.rows.iter().map(|row| index(row)).collect();
        self.with(name, packed("u8", &codes)).with(list, json!(words))
    }

    /// Adds the columns of `more` only if any row satisfies the condition, so that columns without values take no space.
    pub(super) fn where_any(self, condition: impl Fn(&R) -> bool, more: impl FnOnce(Self) -> Self) -> Self {
        if self.rows.iter().any(|row| condition(row)) {
            more(self)
        } else {
            self
        }
    }

    /// Adds a column that is already JSON.
    pub(super) fn with(mut self, name: &str, column: Value) -> Self {
        self.columns.insert(name.to_owned(), column);
        self
    }

    /// Returns the columns by name.
    pub(super) fn json(self) -> Value {
        Value::Object(self.columns)
    }
}

/// Packs a column of 32-bit floats.
pub(super) fn f32s(values: impl Iterator<Item = f64>) -> Value {
    packed(
        "f32",
        &values.flat_map(|v| (v as f32).to_le_bytes()).collect::<Vec<_>>(),
    )
}

/// Packs a column of unsigned integers.
pub(super) fn u32s(values: impl Iterator<Item = u32>) -> Value {
    packed("u32", &values.flat_map(u32::to_le_bytes).collect::<Vec<_>>())
}

fn packed(kind: &str, bytes: &[u8]) -> Value {
    json!({ "type": kind, "data": BASE64_STANDARD.encode(bytes) })
}
