//! Array metadata of `.zarray` (format 2) and `zarr.json` (format 3), parsed to one common form.

use serde::Deserialize;
use serde_json::Value;

use super::Element;
use super::codecs::{Chain, Codec};
use crate::compression::Compressor;
use crate::error::Fault;

/// How an array is stored.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    /// Element type as written in the metadata.
    pub(super) dtype: String,
    /// The element type; `None` if it is not supported.
    pub(super) element: Option<Element>,
    /// Shape of the array.
    pub(super) shape: Vec<u64>,
    /// Shape of the content of one file, which is a chunk or a shard of several chunks.
    pub(super) chunk: Vec<u64>,
    /// Codecs that encode a chunk.
    pub(super) chain: Chain,
    /// How chunks are arranged in a file; `None` if a file contains one chunk.
    pub(super) shard: Option<Shard>,
    /// Fill value of chunks that are not stored, as JSON; null if there is none.
    pub(super) fill: Value,
    /// How chunk files are named.
    pub(super) keys: Keys,
}

/// A file that contains several chunks, located by an index of offsets and lengths.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shard {
    /// Shape of an inner chunk; it divides the shape of the shard.
    pub(super) chunk: Vec<u64>,
    /// Whether the index is at the end of the file.
    pub(super) index_at_end: bool,
    /// Codecs that encode the index.
    pub(super) index: Chain,
}

/// Names of chunk files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Keys {
    /// Prefix before the numbers: `c` in format 3.
    pub(super) prefix: Option<char>,
    /// Separator between the parts.
    pub(super) separator: char,
}

impl Keys {
    /// The name of a chunk's file below the folder of its array.
    pub(super) fn name(self, index: &[u64]) -> String {
        let parts: Vec<String> = self
            .prefix
            .iter()
            .map(char::to_string)
            .chain(index.iter().map(u64::to_string))
            .collect();
        parts.join(&self.separator.to_string())
    }
}

/// Why metadata cannot be used.
pub(super) enum Unusable {
    /// It is incomplete or contradicts itself.
    Broken(String),
    /// It uses a feature that this reader does not support.
    Unsupported(String),
}

impl Unusable {
    /// Converts it to a fault of this array.
    pub(super) fn of(self, array: &str, file: &str) -> Fault {
        match self {
            Self::Broken(why) => Fault::ArrayMetadata {
                array: array.to_owned(),
                file: file.to_owned(),
                why,
            },
            Self::Unsupported(why) => Fault::Encoding {
                array: array.to_owned(),
                why,
            },
        }
    }
}

impl From<serde_json::Error> for Unusable {
    fn from(error: serde_json::Error) -> Self {
        Self::Broken(error.to_string())
    }
}

fn broken<T>(why: impl Into<String>) -> Result<T, Unusable> {
    Err(Unusable::Broken(why.into()))
}

fn unsupported<T>(why: impl Into<String>) -> Result<T, Unusable> {
    Err(Unusable::Unsupported(why.into()))
}

#[derive(Deserialize)]
struct Format2 {
    zarr_format: Value,
    shape: Vec<u64>,
    chunks: Vec<u64>,
    dtype: Value,
    #[serde(default)]
    compressor: Option<Value>,
    #[serde(default)]
    fill_value: Value,
    #[serde(default)]
    order: Option<String>,
    #[serde(default)]
    filters: Option<Vec<Value>>,
    #[serde(default)]
    dimension_separator: Option<String>,
}

impl Layout {
    /// Parses a `.zarray`. `nested` returns whether chunk files are in nested folders; it is used if the metadata has no
    /// `dimension_separator`, as written by older versions of zarr-python.
    pub(super) fn of_format_2(text: &[u8], nested: impl FnOnce() -> bool) -> Result<Self, Unusable> {
        let value: Value = serde_json::from_slice(&as_json(text))?;
        if !value.is_object() {
            return broken("it is not a JSON object");
        }
        let metadata: Format2 = serde_json::from_value(value)?;
        if metadata.zarr_format != 2 {
            return broken(format!("its zarr_format is {} instead of 2", metadata.zarr_format));
        }
        check_shape(&metadata.shape, &metadata.chunks)?;
        if let Some(filter) = metadata.filters.as_ref().and_then(|filters| filters.first()) {
            return unsupported(format!("it uses the filter {}", name_of(filter, "id")));
        }
        let axes = match metadata.order.as_deref() {
            None | Some("C") => None,
            Some("F") => Some((0..metadata.shape.len()).rev().collect()),
            Some(other) => return broken(format!("its order is {other:?}, which is neither C nor F")),
        };
        let dtype = match &metadata.dtype {
            Value::String(dtype) => dtype.clone(),
            other => other.to_string(),
        };
        let codecs = match &metadata.compressor {
            None | Some(Value::Null) => Vec::new(),
            Some(compressor) => {
                let id = name_of(compressor, "id");
                match Compressor::of(&id) {
                    Some(compressor) => vec![Codec::Compressed(compressor)],
                    None => return unsupported(format!("it is compressed with {id}")),
                }
            }
        };
        let separator = match metadata.dimension_separator.as_deref() {
            Some("/") => '/',
            None if metadata.shape.len() > 1 && nested() => '/',
            Some(".") | None => '.',
            Some(other) => {
                return broken(format!(
                    "its dimension_separator is {other:?}, which is neither . nor /"
                ));
            }
        };
        Ok(Self {
            element: Element::from_dtype(&dtype),
            chain: Chain {
                axes,
                big_endian: dtype.starts_with('>'),
                codecs,
            },
            dtype,
            shape: metadata.shape,
            chunk: metadata.chunks,
            shard: None,
            fill: metadata.fill_value,
            keys: Keys {
                prefix: None,
                separator,
            },
        })
    }
}

#[derive(Deserialize)]
struct Format3 {
    zarr_format: Value,
    #[serde(default)]
    node_type: Value,
    shape: Vec<u64>,
    data_type: Value,
    chunk_grid: Value,
    chunk_key_encoding: Value,
    codecs: Vec<Value>,
    #[serde(default)]
    fill_value: Value,
    #[serde(default)]
    storage_transformers: Vec<Value>,
}

impl Layout {
    /// Parses a `zarr.json`; `None` if it belongs to a group.
    pub(super) fn of_format_3(text: &[u8]) -> Result<Option<Self>, Unusable> {
        let value: Value = serde_json::from_slice(&as_json(text))?;
        if !value.is_object() {
            return broken("it is not a JSON object");
        }
        if value.get("node_type").is_some_and(|kind| kind == "group") {
            return Ok(None);
        }
        let metadata: Format3 = serde_json::from_value(value)?;
        if metadata.zarr_format != 3 {
            return broken(format!("its zarr_format is {} instead of 3", metadata.zarr_format));
        }
        if metadata.node_type != "array" {
            return broken(format!("its node_type is {} instead of \"array\"", metadata.node_type));
        }
        if let Some(transformer) = metadata.storage_transformers.first() {
            return unsupported(format!(
                "it uses the storage transformer {}",
                name_of(transformer, "name")
            ));
        }
        let grid = name_of(&metadata.chunk_grid, "name");
        if grid != "regular" {
            return unsupported(format!("its chunk grid is {grid}"));
        }
        let chunk = lengths(&metadata.chunk_grid, "chunk_shape")?;
        check_shape(&metadata.shape, &chunk)?;
        let dtype = match &metadata.data_type {
            Value::String(dtype) => dtype.clone(),
            other => name_of(other, "name"),
        };
        let (chain, shard) = chain(&metadata.codecs, &chunk)?;
        Ok(Some(Self {
            element: Element::from_data_type(&dtype),
            dtype,
            shape: metadata.shape,
            chunk,
            chain,
            shard,
            fill: metadata.fill_value,
            keys: keys(&metadata.chunk_key_encoding)?,
        }))
    }
}

fn check_shape(shape: &[u64], chunk: &[u64]) -> Result<(), Unusable> {
    if shape.is_empty() {
        return broken("it has no dimensions");
    }
    if chunk.len() != shape.len() {
        return broken(format!(
            "it has {} chunk lengths for {} dimensions",
            chunk.len(),
            shape.len()
        ));
    }
    if chunk.contains(&0) {
        return broken("a chunk length is 0");
    }
    Ok(())
}

/// The name in a value that is either a string or an object with the name under `key`.
fn name_of(value: &Value, key: &str) -> String {
    match value {
        Value::String(name) => name.clone(),
        other => other
            .get(key)
            .and_then(Value::as_str)
            .map_or_else(|| other.to_string(), ToOwned::to_owned),
    }
}

fn setting<'a>(value: &'a Value, key: &str) -> Option<&'a Value> {
    value.get("configuration")?.get(key)
}

fn lengths(value: &Value, key: &str) -> Result<Vec<u64>, Unusable> {
    let found = setting(value, key).cloned().unwrap_or_default();
    serde_json::from_value(found).map_err(|error| Unusable::Broken(format!("{key}: {error}")))
}

fn keys(encoding: &Value) -> Result<Keys, Unusable> {
    let name = name_of(encoding, "name");
    let (prefix, usual) = match name.as_str() {
        "default" => (Some('c'), "/"),
        "v2" => (None, "."),
        _ => return unsupported(format!("its chunk key encoding is {name}")),
    };
    let separator = setting(encoding, "separator").and_then(Value::as_str).unwrap_or(usual);
    match separator {
        "/" => Ok(Keys { prefix, separator: '/' }),
        "." => Ok(Keys { prefix, separator: '.' }),
        other => broken(format!("its separator is {other:?}, which is neither . nor /")),
    }
}

/// Parses the codecs of a chunk, and the arrangement of chunks in a shard if the array is sharded.
fn chain(codecs: &[Value], chunk: &[u64]) -> Result<(Chain, Option<Shard>), Unusable> {
    let mut axes = None;
    let mut rest = codecs.iter();
    for codec in rest.by_ref() {
        match name_of(codec, "name").as_str() {
            "transpose" if axes.is_none() => axes = transposed(codec, chunk.len())?,
            "bytes" => {
                return Ok((
                    Chain {
                        axes,
                        big_endian: is_big_endian(codec)?,
                        codecs: rest.map(of_bytes).collect::<Result<_, _>>()?,
                    },
                    None,
                ));
            }
            "sharding_indexed" if axes.is_none() => {
                if let Some(codec) = rest.next() {
                    return unsupported(format!("its shards are encoded again by {}", name_of(codec, "name")));
                }
                return sharded(codec, chunk).map(|(chain, shard)| (chain, Some(shard)));
            }
            other => return unsupported(format!("it uses the codec {other}")),
        }
    }
    broken("none of its codecs converts numbers to bytes")
}

fn sharded(codec: &Value, outer: &[u64]) -> Result<(Chain, Shard), Unusable> {
    let list = |key: &str| match setting(codec, key) {
        Some(Value::Array(codecs)) => Ok(codecs.clone()),
        _ => broken(format!("its shards have no {key}")),
    };
    let inner = lengths(codec, "chunk_shape")?;
    check_shape(outer, &inner)?;
    if outer.iter().zip(&inner).any(|(outer, inner)| outer % inner != 0) {
        return broken("its chunk shape does not evenly divide its shard shape");
    }
    let (chain_of_chunks, nested) = chain(&list("codecs")?, &inner)?;
    if nested.is_some() {
        return unsupported("it has nested shards");
    }
    let (index, nested) = chain(&list("index_codecs")?, &[1])?;
    let only_checked = index.codecs.iter().all(|codec| *codec == Codec::Crc32c);
    if nested.is_some() || index.axes.is_some() || !only_checked {
        return unsupported("the index of its shards is compressed");
    }
    let index_at_end = match setting(codec, "index_location").and_then(Value::as_str) {
        None | Some("end") => true,
        Some("start") => false,
        Some(other) => {
            return broken(format!(
                "its index_location is {other:?}, which is neither start nor end"
            ));
        }
    };
    Ok((
        chain_of_chunks,
        Shard {
            chunk: inner,
            index_at_end,
            index,
        },
    ))
}

/// Parses the order of axes; `None` for the identity.
fn transposed(codec: &Value, dimensions: usize) -> Result<Option<Vec<usize>>, Unusable> {
    let order: Vec<usize> = match setting(codec, "order") {
        Some(Value::String(order)) if order == "C" => (0..dimensions).collect(),
        Some(Value::String(order)) if order == "F" => (0..dimensions).rev().collect(),
        Some(order) => serde_json::from_value(order.clone())?,
        None => return broken("its codec transpose has no order"),
    };
    let mut sorted = order.clone();
    sorted.sort_unstable();
    if !sorted.iter().copied().eq(0..dimensions) {
        return broken(format!("its order {order:?} does not name every axis exactly once"));
    }
    Ok((order != sorted).then_some(order))
}

fn is_big_endian(codec: &Value) -> Result<bool, Unusable> {
    match setting(codec, "endian") {
        None | Some(Value::Null) => Ok(false),
        Some(endian) if endian == "little" => Ok(false),
        Some(endian) if endian == "big" => Ok(true),
        Some(other) => broken(format!("its endian is {other}, which is neither little nor big")),
    }
}

fn of_bytes(codec: &Value) -> Result<Codec, Unusable> {
    let name = name_of(codec, "name");
    let known = name.strip_prefix("numcodecs.").unwrap_or(&name);
    match Compressor::of(known) {
        Some(compressor) => Ok(Codec::Compressed(compressor)),
        None if name == "crc32c" => Ok(Codec::Crc32c),
        None => unsupported(format!("it uses the codec {name}")),
    }
}

/// Converts JSON as Python writes it to valid JSON: `NaN`, `Infinity` and `-Infinity` become strings, as in the Zarr
/// specification.
pub(super) fn as_json(text: &[u8]) -> Vec<u8> {
    let mut json = Vec::with_capacity(text.len());
    let mut rest = text;
    let mut in_string = false;
    while let Some((&byte, after)) = rest.split_first() {
        let number = ["NaN", "Infinity", "-Infinity"]
            .iter()
            .find(|word| !in_string && rest.starts_with(word.as_bytes()));
        if let Some(word) = number {
            json.push(b'"');
            json.extend(word.as_bytes());
            json.push(b'"');
            rest = &rest[word.len()..];
            continue;
        }
        json.push(byte);
        rest = after;
        match byte {
            b'"' => in_string = !in_string,
            b'\\' if in_string => {
                if let Some((&escaped, after)) = rest.split_first() {
                    json.push(escaped);
                    rest = after;
                }
            }
            _ => {}
        }
    }
    json
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn json_as_python_writes_it_is_read() {
        let text = br#"{"a": NaN, "b": [Infinity, -Infinity, -1], "NaN": "NaN \"Infinity\" \\", "c": "x\\"}"#;
        let value: Value = serde_json::from_slice(&as_json(text)).unwrap();
        assert_eq!(
            value,
            json!({"a": "NaN", "b": ["Infinity", "-Infinity", -1], "NaN": "NaN \"Infinity\" \\", "c": "x\\"})
        );
        for broken in ["", "\"", "\"\\", "NaN", "{\"a\": nan}"] {
            let _ = serde_json::from_slice::<Value>(&as_json(broken.as_bytes()));
        }
    }

    #[test]
    fn chunk_files_are_named_by_their_format() {
        let name = |prefix, separator| Keys { prefix, separator }.name(&[3, 0, 12]);
        assert_eq!(name(None, '.'), "3.0.12");
        assert_eq!(name(None, '/'), "3/0/12");
        assert_eq!(name(Some('c'), '/'), "c/3/0/12");
        assert_eq!(name(Some('c'), '.'), "c.3.0.12");
    }

    fn format_3(change: impl FnOnce(&mut Value)) -> Result<Option<Layout>, String> {
        let mut metadata = json!({
            "zarr_format": 3, "node_type": "array", "shape": [30, 5], "data_type": "float32",
            "chunk_grid": { "name": "regular", "configuration": { "chunk_shape": [8, 5] } },
            "chunk_key_encoding": { "name": "default", "configuration": { "separator": "/" } },
            "fill_value": 0.0,
            "codecs": [{ "name": "bytes", "configuration": { "endian": "little" } }, { "name": "zstd", "configuration": {} }],
            "attributes": { "a": 1 }, "storage_transformers": [], "dimension_names": null,
        });
        change(&mut metadata);
        Layout::of_format_3(metadata.to_string().as_bytes()).map_err(|error| match error {
            Unusable::Broken(why) => format!("broken: {why}"),
            Unusable::Unsupported(why) => format!("unsupported: {why}"),
        })
    }

    #[test]
    fn metadata_of_a_format_3_group_is_not_an_array() {
        assert_eq!(format_3(|metadata| metadata["node_type"] = "group".into()), Ok(None));
    }

    #[test]
    fn metadata_of_format_3_that_cannot_be_used() {
        type Change<'a> = &'a dyn Fn(&mut Value);
        let shards = |chunk: Value, codecs: Value| {
            json!([{ "name": "sharding_indexed", "configuration": {
                "chunk_shape": chunk, "codecs": codecs, "index_codecs": ["bytes", "crc32c"] } }])
        };
        let changes: [Change; 15] = [
            &|metadata| metadata["zarr_format"] = 2.into(),
            &|metadata| metadata["node_type"] = Value::Null,
            &|metadata| metadata["shape"] = json!([]),
            &|metadata| metadata["chunk_grid"]["name"] = "rectangular".into(),
            &|metadata| metadata["chunk_grid"]["configuration"] = Value::Null,
            &|metadata| metadata["chunk_grid"]["configuration"]["chunk_shape"] = json!([8, 0]),
            &|metadata| metadata["chunk_key_encoding"]["name"] = "suffix".into(),
            &|metadata| metadata["codecs"] = json!([]),
            &|metadata| metadata["codecs"] = json!(["bytes", "numcodecs.lzma"]),
            &|metadata| {
                metadata["codecs"] = json!([{ "name": "transpose", "configuration": { "order": [1, 1] } }, "bytes"]);
            },
            &|metadata| metadata["codecs"] = shards(json!([3, 5]), json!(["bytes"])),
            &|metadata| metadata["codecs"] = shards(json!([4, 5]), shards(json!([2, 5]), json!(["bytes"]))),
            &|metadata| metadata["codecs"] = shards(json!([4]), json!(["bytes"])),
            &|metadata| metadata["codecs"][0]["configuration"]["endian"] = "middle".into(),
            &|metadata| metadata["storage_transformers"] = json!([{ "name": "cache" }]),
        ];
        let sentences: Vec<String> = changes
            .iter()
            .map(|change| format_3(|metadata| change(metadata)).unwrap_err())
            .collect();
        insta::assert_snapshot!(sentences.join("\n"));
    }
}
