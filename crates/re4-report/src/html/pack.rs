//! Rows of a table as the columns that a page's script reads: numbers packed as base64 of little-endian bytes, texts as they are.

use std::collections::BTreeSet;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use serde::Serialize;
use serde_json::{Map, Value, json};

/// Columns of rows, in the order in which they are added.
#[derive(Debug)]
pub struct Pack<'a, R> {
    rows: Vec<&'a R>,
    columns: Map<String, Value>,
}

impl<'a, R> Pack<'a, R> {
    /// Of these rows.
    pub(super) fn of(rows: impl IntoIterator<Item = &'a R>) -> Self {
        Self {
            rows: rows.into_iter().collect(),
            columns: Map::new(),
        }
    }

    /// Some 32-bit floats a row: a pixel to five decimals, a metre to a hundredth of a micrometre.
    pub(super) fn f32<const N: usize>(self, name: &str, value: impl Fn(&R) -> [f64; N]) -> Self {
        let column = f32s(self.rows.iter().flat_map(|row| value(row)));
        self.with(name, column)
    }

    /// Some 64-bit floats a row: the artifact's own numbers.
    pub(super) fn f64<const N: usize>(self, name: &str, value: impl Fn(&R) -> [f64; N]) -> Self {
        let bytes = self.rows.iter().flat_map(|row| value(row)).flat_map(f64::to_le_bytes);
        let column = packed("f64", &bytes.collect::<Vec<_>>());
        self.with(name, column)
    }

    /// A whole number a row.
    pub(super) fn u32(self, name: &str, value: impl Fn(&R) -> u32) -> Self {
        let column = u32s(self.rows.iter().map(|row| value(row)));
        self.with(name, column)
    }

    /// A byte a row.
    pub(super) fn u8(self, name: &str, value: impl Fn(&R) -> u8) -> Self {
        let column = packed("u8", &self.rows.iter().map(|row| value(row)).collect::<Vec<_>>());
        self.with(name, column)
    }

    /// A list of what is short enough to be read as it is.
    pub(super) fn list<T: Serialize>(self, name: &str, value: impl Fn(&'a R) -> T) -> Self {
        let column = json!(self.rows.iter().map(|row| value(row)).collect::<Vec<T>>());
        self.with(name, column)
    }

    /// Any number of 32-bit floats a row.
    pub(super) fn f32s<V: IntoIterator<Item = f64>>(self, name: &str, values: impl Fn(&'a R) -> V) -> Self {
        let column = f32s(self.rows.iter().flat_map(|row| values(row)));
        self.with(name, column)
    }

    /// A word a row, of few: a byte for each of them, and the words. The first is the empty one.
    pub(super) fn words(self, name: &str, list: &str, word: impl Fn(&'a R) -> &'a str) -> Self {
        let words: BTreeSet<&str> = self.rows.iter().map(|row| word(row)).chain([""]).collect();
        let place = |row: &'a R| words.iter().position(|known| *known == word(row)).unwrap_or(0) as u8;
        let codes: Vec<u8> = self.rows.iter().map(|row| place(row)).collect();
        self.with(name, packed("u8", &codes)).with(list, json!(words))
    }

    /// Further columns where there is anything in them.
    pub(super) fn where_any(self, holds: impl Fn(&R) -> bool, more: impl FnOnce(Self) -> Self) -> Self {
        if self.rows.iter().any(|row| holds(row)) {
            more(self)
        } else {
            self
        }
    }

    /// Another column.
    pub(super) fn with(mut self, name: &str, column: Value) -> Self {
        self.columns.insert(name.to_owned(), column);
        self
    }

    /// The columns by their names.
    pub(super) fn json(self) -> Value {
        Value::Object(self.columns)
    }
}

/// A column of 32-bit floats.
pub(super) fn f32s(values: impl Iterator<Item = f64>) -> Value {
    packed(
        "f32",
        &values.flat_map(|v| (v as f32).to_le_bytes()).collect::<Vec<_>>(),
    )
}

/// A column of whole numbers.
pub(super) fn u32s(values: impl Iterator<Item = u32>) -> Value {
    packed("u32", &values.flat_map(u32::to_le_bytes).collect::<Vec<_>>())
}

fn packed(kind: &str, bytes: &[u8]) -> Value {
    json!({ "type": kind, "data": BASE64_STANDARD.encode(bytes) })
}
