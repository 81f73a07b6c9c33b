//! Answers as JSON, CSV and text.

use std::io::Write;

use anyhow::Result;
use polars::prelude::{AnyValue, DataFrame};
use serde_json::{Map, Number, Value, json};

use crate::answer::Answer;

/// Writes an answer as one JSON object on one line, `{"columns": [{"name": ..., "type": ...}], "rows": [{...}]}`. Bytes are written as
/// hexadecimal digits. Floats that JSON cannot represent (infinities, NaN) are null.
///
/// # Errors
/// Those of the query and of the writer.
pub fn write_json(answer: Answer, to: &mut dyn Write) -> Result<()> {
    let names: Vec<String> = answer.columns().iter().map(|column| column.name.clone()).collect();
    let columns: Vec<Value> = answer
        .columns()
        .iter()
        .map(|column| json!({ "name": column.name, "type": column.kind }))
        .collect();
    // Written with the first rows, so that a query that fails leaves nothing behind.
    let before = format!("{{\"columns\":{},\"rows\":[", Value::Array(columns));
    let mut first = true;
    answer.parts(|part| {
        for row in 0..part.height() {
            let values = cells(part, row)
                .zip(&names)
                .map(|(cell, name)| (name.clone(), as_json(&cell)));
            let object = Value::Object(values.collect::<Map<_, _>>());
            if first {
                write!(to, "{before}{object}")?;
                first = false;
            } else {
                write!(to, ",{object}")?;
            }
        }
        Ok(true)
    })?;
    writeln!(to, "{}]}}", if first { before.as_str() } else { "" })?;
    Ok(())
}

/// Writes an answer as CSV with a header: fields are separated by commas and quoted where necessary; null is an empty field; floats have
/// the minimum number of digits that identifies them; lists are JSON and bytes are hexadecimal digits.
///
/// # Errors
/// Those of the query and of the writer.
pub fn write_csv(answer: Answer, to: &mut dyn Write) -> Result<()> {
    let header: Vec<String> = answer.columns().iter().map(|column| quoted(&column.name)).collect();
    let mut before = header.join(",") + "\n";
    answer.parts(|part| {
        for row in 0..part.height() {
            let fields: Vec<String> = cells(part, row).map(|cell| field(&cell)).collect();
            writeln!(to, "{before}{}", fields.join(","))?;
            before.clear();
        }
        Ok(true)
    })?;
    write!(to, "{before}")?;
    Ok(())
}

/// The first rows of an answer as text.
#[derive(Debug)]
pub struct Preview {
    header: Vec<String>,
    numeric: Vec<bool>,
    rows: Vec<Vec<String>>,
    more: bool,
}

/// Maximum width of a value in a table, in characters.
const WIDEST_CELL: usize = 60;

impl Preview {
    /// Runs a query until it has given `count` rows.
    ///
    /// # Errors
    /// Those of the query.
    pub fn of(answer: Answer, count: usize) -> Result<Self> {
        let mut preview = Self {
            header: answer.columns().iter().map(|column| column.name.clone()).collect(),
            numeric: answer.columns().iter().map(|column| column.numeric).collect(),
            rows: Vec::new(),
            more: false,
        };
        answer.parts(|part| {
            let taken = part.height().min(count - preview.rows.len());
            preview
                .rows
                .extend((0..taken).map(|row| cells(part, row).map(|cell| text(&cell)).collect()));
            preview.more |= taken < part.height();
            Ok(!preview.more)
        })?;
        Ok(preview)
    }

    /// The rows below their header, and how many there are. Numbers are aligned to the right. Values are cut to 60 characters, and lines
    /// to `width` characters.
    pub fn text(&self, width: Option<usize>) -> String {
        let cut = |value: &str, most: usize| {
            if value.chars().count() <= most {
                value.to_owned()
            } else {
                value.chars().take(most.saturating_sub(1)).chain(['…']).collect()
            }
        };
        let lines: Vec<Vec<String>> = std::iter::once(&self.header)
            .chain(&self.rows)
            .map(|row| row.iter().map(|value| cut(value, WIDEST_CELL)).collect())
            .collect();
        let widths: Vec<usize> = (0..self.header.len())
            .map(|column| {
                lines
                    .iter()
                    .map(|line| line[column].chars().count())
                    .max()
                    .unwrap_or_default()
            })
            .collect();
        let mut text = String::new();
        for line in &lines {
            let cells = line.iter().zip(&widths).zip(&self.numeric);
            let cells: Vec<String> = cells
                .map(|((value, &width), numeric)| {
                    if *numeric {
                        format!("{value:>width$}")
                    } else {
                        format!("{value:<width$}")
                    }
                })
                .collect();
            let line = cells.join("  ");
            text += &cut(line.trim_end(), width.unwrap_or(usize::MAX));
            text.push('\n');
        }
        let count = self.rows.len();
        let rows = if count == 1 { "row" } else { "rows" };
        if self.more {
            text + &format!("the first {count} {rows}; --rows N prints more, --csv and --json print all")
        } else {
            text + &format!("{count} {rows}")
        }
    }
}

/// The values of a row.
fn cells(part: &DataFrame, row: usize) -> impl Iterator<Item = AnyValue<'_>> {
    part.columns()
        .iter()
        .map(move |column| column.get(row).unwrap_or(AnyValue::Null))
}

fn as_json(value: &AnyValue<'_>) -> Value {
    match value {
        AnyValue::Boolean(value) => Value::Bool(*value),
        AnyValue::String(text) => Value::String((*text).to_owned()),
        AnyValue::StringOwned(text) => Value::String(text.to_string()),
        AnyValue::UInt8(number) => json!(number),
        AnyValue::UInt16(number) => json!(number),
        AnyValue::UInt32(number) => json!(number),
        AnyValue::UInt64(number) => json!(number),
        AnyValue::Int8(number) => json!(number),
        AnyValue::Int16(number) => json!(number),
        AnyValue::Int32(number) => json!(number),
        AnyValue::Int64(number) => json!(number),
        // Via text, because conversion to f64 would add digits.
        AnyValue::Float32(number) => number
            .to_string()
            .parse()
            .ok()
            .and_then(Number::from_f64)
            .map_or(Value::Null, Value::Number),
        AnyValue::Float64(number) => Number::from_f64(*number).map_or(Value::Null, Value::Number),
        AnyValue::Binary(bytes) => Value::String(hexadecimal(bytes)),
        AnyValue::BinaryOwned(bytes) => Value::String(hexadecimal(bytes)),
        AnyValue::List(values) => values.iter().map(|value| as_json(&value)).collect(),
        // Columns of other types are converted to text before they reach an output.
        _ => Value::Null,
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    let digit = |value: u8| char::from(b"0123456789abcdef"[usize::from(value)]);
    bytes
        .iter()
        .flat_map(|byte| [digit(byte >> 4), digit(byte & 15)])
        .collect()
}

/// A value for people: of bytes only the number is given.
fn text(value: &AnyValue<'_>) -> String {
    match value {
        AnyValue::Null => "null".to_owned(),
        AnyValue::Binary(bytes) => format!("{} bytes", bytes.len()),
        AnyValue::BinaryOwned(bytes) => format!("{} bytes", bytes.len()),
        AnyValue::Float32(number) => number.to_string(),
        AnyValue::Float64(number) => number.to_string(),
        AnyValue::List(values) => {
            let values: Vec<String> = values.iter().map(|value| text(&value)).collect();
            format!("[{}]", values.join(", "))
        }
        other => match as_json(other) {
            Value::String(text) => text.replace(['\n', '\r', '\t'], " "),
            value => value.to_string(),
        },
    }
}

/// A value as a field of CSV.
fn field(value: &AnyValue<'_>) -> String {
    match value {
        AnyValue::Null => String::new(),
        AnyValue::Float32(number) => number.to_string(),
        AnyValue::Float64(number) => number.to_string(),
        other => match as_json(other) {
            Value::String(text) => quoted(&text),
            value => quoted(&value.to_string()),
        },
    }
}

/// A text as a field of CSV. Empty text is quoted, to be distinct from null.
fn quoted(text: &str) -> String {
    if text.is_empty() || text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use polars::prelude::{NamedFrom as _, Series};

    #[test]
    fn values_in_every_format() {
        let list = || AnyValue::List(Series::new("".into(), [0.5, f64::NAN]));
        for (value, json, csv, shown) in [
            (AnyValue::Null, "null", "", "null"),
            (AnyValue::Boolean(true), "true", "true", "true"),
            (AnyValue::Float64(0.1), "0.1", "0.1", "0.1"),
            (AnyValue::Float64(3.0), "3.0", "3", "3"),
            (AnyValue::Float64(f64::INFINITY), "null", "inf", "inf"),
            (AnyValue::Float32(0.1), "0.1", "0.1", "0.1"),
            (
                AnyValue::UInt64(u64::MAX),
                "18446744073709551615",
                "18446744073709551615",
                "18446744073709551615",
            ),
            (AnyValue::String("a\"b, c"), "\"a\\\"b, c\"", "\"a\"\"b, c\"", "a\"b, c"),
            (AnyValue::String(""), "\"\"", "\"\"", ""),
            (AnyValue::String("a\nb"), "\"a\\nb\"", "\"a\nb\"", "a b"),
            (AnyValue::Binary(&[0, 255]), "\"00ff\"", "00ff", "2 bytes"),
            (list(), "[0.5,null]", "\"[0.5,null]\"", "[0.5, NaN]"),
        ] {
            assert_eq!(as_json(&value).to_string(), json);
            assert_eq!(field(&value), csv);
            assert_eq!(text(&value), shown);
        }
    }
}
