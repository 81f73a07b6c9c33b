//! Values of a column, whatever its numeric type and whether its rows are lists or plain values.

use std::ops::Range;

use arrow_array::cast::AsArray as _;
use arrow_array::types::{
    ArrowPrimitiveType, Float16Type, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type,
    UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef};
use arrow_schema::DataType;

use crate::fault::{Fault, Kind};

/// Values in the precision of the file. Single and half precision are exact in [`Values::Float`].
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Floating-point numbers.
    Float(Vec<f64>),
    /// Whole numbers.
    Integer(Vec<i64>),
    /// True or false.
    Bool(Vec<bool>),
    /// Text.
    Text(Vec<String>),
}

/// A column of an episode: `shape` values per frame, frame by frame, the last axis fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Name of the feature.
    pub name: String,
    /// The shape of a frame, as stated.
    pub shape: Vec<usize>,
    /// The values.
    pub values: Values,
}

/// The kinds of values, for the check of a type before anything is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Class {
    Float,
    Integer,
    Bool,
    Text,
}

impl Values {
    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::Float(values) => values.len(),
            Self::Integer(values) => values.len(),
            Self::Bool(values) => values.len(),
            Self::Text(values) => values.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A number as floating point; true is 1. `None` for text.
    pub fn number(&self, at: usize) -> Option<f64> {
        match self {
            Self::Float(values) => values.get(at).copied(),
            Self::Integer(values) => values.get(at).map(|&value| value as f64),
            Self::Bool(values) => values.get(at).map(|&value| f64::from(u8::from(value))),
            Self::Text(_) => None,
        }
    }

    /// A whole number, also if it is stored as floating point.
    pub fn integer(&self, at: usize) -> Option<i64> {
        match self {
            Self::Float(values) => {
                let value = *values.get(at)?;
                // 2^53: beyond it, floating-point numbers skip whole numbers.
                (value.fract() == 0.0 && value.abs() <= 9_007_199_254_740_992.0).then_some(value as i64)
            }
            Self::Integer(values) => values.get(at).copied(),
            Self::Bool(values) => values.get(at).map(|&value| i64::from(value)),
            Self::Text(_) => None,
        }
    }

    pub(crate) fn empty(class: Class) -> Self {
        match class {
            Class::Float => Self::Float(Vec::new()),
            Class::Integer => Self::Integer(Vec::new()),
            Class::Bool => Self::Bool(Vec::new()),
            Class::Text => Self::Text(Vec::new()),
        }
    }
}

/// The class of the values of a column; `None` for a type that is not accepted.
pub(crate) fn class(data_type: &DataType) -> Option<Class> {
    Some(match data_type {
        DataType::List(field) | DataType::LargeList(field) | DataType::FixedSizeList(field, _) => {
            return class(field.data_type());
        }
        DataType::Float16 | DataType::Float32 | DataType::Float64 => Class::Float,
        DataType::Boolean => Class::Bool,
        DataType::Utf8 | DataType::LargeUtf8 => Class::Text,
        whole if whole.is_integer() => Class::Integer,
        _ => return None,
    })
}

/// A type in the words of a user.
pub(crate) fn in_words(data_type: &DataType) -> String {
    match data_type {
        DataType::List(field) | DataType::LargeList(field) | DataType::FixedSizeList(field, _) => {
            format!("list of {}", in_words(field.data_type()))
        }
        DataType::Struct(fields) => {
            let fields: Vec<String> = fields
                .iter()
                .map(|field| format!("{}: {}", field.name(), in_words(field.data_type())))
                .collect();
            format!("struct of {}", fields.join(", "))
        }
        other => other.to_string().to_lowercase(),
    }
}

/// Number of values of a frame.
pub(crate) fn width(shape: &[usize]) -> usize {
    shape
        .iter()
        .fold(1, |product: usize, &side| product.saturating_mul(side))
}

/// Where a column is, for faults.
pub(crate) struct Place<'a> {
    pub(crate) file: &'a str,
    pub(crate) column: &'a str,
    /// The row of the file that is the first of the array.
    pub(crate) first: usize,
}

impl Place<'_> {
    pub(crate) fn fault(&self, kind: Kind, row: usize, what: impl std::fmt::Display, fix: &str) -> Fault {
        Fault::column(
            kind,
            self.file,
            self.column,
            format!("row {}: {what}", self.first + row),
            fix,
        )
    }

    fn missing(&self, row: usize) -> Fault {
        self.fault(
            Kind::Value,
            row,
            "a value is missing (null)",
            "write the value, or remove the episode",
        )
    }
}

/// The values of each row, below all lists: the array of values, and where each row begins in it.
pub(crate) fn leaves<'a>(
    array: &'a ArrayRef,
    shape: &[usize],
    place: &Place<'_>,
) -> Result<(&'a ArrayRef, Vec<usize>), Fault> {
    let mut starts: Vec<usize> = (0..=array.len()).collect();
    let mut array = array;
    let depth = {
        let (mut depth, mut inner) = (0, array.data_type());
        while let DataType::List(field) = inner {
            (depth, inner) = (depth + 1, field.data_type());
        }
        depth
    };
    for level in 0..depth {
        let list = array.as_list::<i32>();
        let offsets = list.value_offsets();
        let row_of = |item: usize| starts.partition_point(|&start| start <= item).saturating_sub(1);
        let used = starts.first().copied().unwrap_or(0)..starts.last().copied().unwrap_or(0);
        for item in used {
            if list.is_null(item) {
                return Err(place.missing(row_of(item)));
            }
            // Nested lists follow the shape axis by axis; a flat list is accepted for any shape.
            let length = (offsets[item + 1] - offsets[item]) as usize;
            if depth == shape.len() && length != shape[level] {
                let what = format!("it has {length} values along axis {level}, but the feature's shape is {shape:?}");
                return Err(place.fault(
                    Kind::Type,
                    row_of(item),
                    what,
                    "correct the shape in meta/info.json, or the column",
                ));
            }
        }
        for start in &mut starts {
            *start = offsets[*start] as usize;
        }
        array = list.values();
    }
    let width = width(shape);
    if let Some(row) = starts.windows(2).position(|pair| pair[1] - pair[0] != width) {
        let count = starts[row + 1] - starts[row];
        let what = format!("it has {count} values, but the feature's shape is {shape:?}");
        return Err(place.fault(
            Kind::Type,
            row,
            what,
            "correct the shape in meta/info.json, or the column",
        ));
    }
    if let (Some(&start), Some(&end)) = (starts.first(), starts.last())
        && let Some(null) = (start..end).find(|&item| array.is_null(item))
    {
        return Err(place.missing((null - start) / width.max(1)));
    }
    Ok((array, starts))
}

/// Appends numbers of one type.
fn extend<T: ArrowPrimitiveType, V>(
    into: &mut Vec<V>,
    array: &ArrayRef,
    range: Range<usize>,
    convert: impl Fn(T::Native) -> V,
) {
    into.extend(
        array.as_primitive::<T>().values()[range]
            .iter()
            .map(|&value| convert(value)),
    );
}

/// Appends the values of all rows of an array.
pub(crate) fn append(values: &mut Values, array: &ArrayRef, shape: &[usize], place: &Place<'_>) -> Result<(), Fault> {
    let (array, starts) = leaves(array, shape, place)?;
    let range: Range<usize> = starts.first().copied().unwrap_or(0)..starts.last().copied().unwrap_or(0);
    match (&mut *values, array.data_type()) {
        (Values::Float(into), DataType::Float64) => extend::<Float64Type, _>(into, array, range, |value| value),
        (Values::Float(into), DataType::Float32) => extend::<Float32Type, _>(into, array, range, f64::from),
        (Values::Float(into), DataType::Float16) => {
            extend::<Float16Type, _>(into, array, range, f64::from);
        }
        (Values::Integer(into), DataType::Int8) => extend::<Int8Type, _>(into, array, range, i64::from),
        (Values::Integer(into), DataType::Int16) => extend::<Int16Type, _>(into, array, range, i64::from),
        (Values::Integer(into), DataType::Int32) => extend::<Int32Type, _>(into, array, range, i64::from),
        (Values::Integer(into), DataType::Int64) => extend::<Int64Type, _>(into, array, range, |value| value),
        (Values::Integer(into), DataType::UInt8) => extend::<UInt8Type, _>(into, array, range, i64::from),
        (Values::Integer(into), DataType::UInt16) => extend::<UInt16Type, _>(into, array, range, i64::from),
        (Values::Integer(into), DataType::UInt32) => extend::<UInt32Type, _>(into, array, range, i64::from),
        (Values::Integer(into), DataType::UInt64) => {
            for (item, &value) in array.as_primitive::<UInt64Type>().values()[range].iter().enumerate() {
                let row = item / width(shape).max(1);
                let value = i64::try_from(value);
                into.push(value.map_err(|_| {
                    place.fault(Kind::Type, row, "the number exceeds 63 bits", "store smaller numbers")
                })?);
            }
        }
        (Values::Bool(into), DataType::Boolean) => into.extend(range.map(|item| array.as_boolean().value(item))),
        (Values::Text(into), DataType::Utf8) => {
            into.extend(range.map(|item| array.as_string::<i32>().value(item).to_owned()));
        }
        (Values::Text(into), DataType::LargeUtf8) => {
            into.extend(range.map(|item| array.as_string::<i64>().value(item).to_owned()));
        }
        (_, other) => {
            let what = format!("its type is {}", in_words(other));
            return Err(Fault::column(
                Kind::Type,
                place.file,
                place.column,
                what,
                "store numbers or text",
            ));
        }
    }
    Ok(())
}

/// One whole number per row.
pub(crate) fn integers(array: &ArrayRef, place: &Place<'_>) -> Result<Vec<i64>, Fault> {
    let values = single(array, place)?;
    let wrong = |row: usize| place.fault(Kind::Type, row, "it is not a whole number", "store whole numbers");
    (0..array.len())
        .map(|row| values.integer(row).ok_or_else(|| wrong(row)))
        .collect()
}

/// One number per row.
pub(crate) fn numbers(array: &ArrayRef, place: &Place<'_>) -> Result<Vec<f64>, Fault> {
    let values = single(array, place)?;
    let wrong = |row: usize| place.fault(Kind::Type, row, "it is not a finite number", "store numbers");
    let number = |row: usize| values.number(row).filter(|number| number.is_finite());
    (0..array.len())
        .map(|row| number(row).ok_or_else(|| wrong(row)))
        .collect()
}

/// One text per row.
pub(crate) fn texts(array: &ArrayRef, place: &Place<'_>) -> Result<Vec<String>, Fault> {
    match single(array, place)? {
        Values::Text(texts) => Ok(texts),
        _ => Err(place.fault(Kind::Type, 0, "it is not text", "store text")),
    }
}

/// Any number of texts per row; a single text is a list of one.
pub(crate) fn text_lists(array: &ArrayRef, place: &Place<'_>) -> Result<Vec<Vec<String>>, Fault> {
    let DataType::List(_) = array.data_type() else {
        return Ok(texts(array, place)?.into_iter().map(|text| vec![text]).collect());
    };
    let list = array.as_list::<i32>();
    let row = |row: usize| {
        if list.is_null(row) {
            return Ok(Vec::new());
        }
        let first = place.first + row;
        texts(&list.value(row), &Place { first, ..*place })
    };
    (0..list.len()).map(row).collect()
}

/// One value per row, also if it is stored as a list of one.
fn single(array: &ArrayRef, place: &Place<'_>) -> Result<Values, Fault> {
    let Some(class) = class(array.data_type()) else {
        let what = format!("its type is {}", in_words(array.data_type()));
        return Err(Fault::column(
            Kind::Type,
            place.file,
            place.column,
            what,
            "store plain values",
        ));
    };
    let mut values = Values::empty(class);
    append(&mut values, array, &[1], place)?;
    Ok(values)
}
