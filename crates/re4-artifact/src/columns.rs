//! Conversion between record batches and plain vectors and slices, checked against the table's description.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{ArrowPrimitiveType, Float64Type, Int32Type, Int64Type, UInt32Type, UInt64Type};
use arrow_array::{
    Array, ArrayRef, BinaryArray, BooleanArray, DictionaryArray, Float32Array, Float64Array, Int32Array, Int64Array,
    ListArray, RecordBatch, StringArray, UInt32Array, UInt64Array,
};
use arrow_buffer::{NullBuffer, OffsetBuffer};
use arrow_schema::{DataType, Field, SchemaRef};

use crate::error::ArtifactError;
use crate::spec::{ColumnKind, TABLE_KEY, TableSpec};

/// Builder of a record batch from columns, in any order. [`Columns::finish`] checks them against the table's description.
#[derive(Debug)]
pub struct Columns {
    spec: &'static TableSpec,
    arrays: Vec<(String, ArrayRef)>,
}

impl Columns {
    /// Creates a builder without columns.
    pub fn new(spec: &'static TableSpec) -> Self {
        Self {
            spec,
            arrays: Vec::with_capacity(spec.columns.len()),
        }
    }

    /// Adds a column of unsigned 32-bit integers.
    #[must_use]
    pub fn u32(self, name: &str, values: Vec<u32>) -> Self {
        self.array(name, Arc::new(UInt32Array::from(values)))
    }

    /// Adds a nullable column of unsigned 32-bit integers.
    #[must_use]
    pub fn u32_or_null(self, name: &str, values: Vec<Option<u32>>) -> Self {
        self.array(name, Arc::new(UInt32Array::from(values)))
    }

    /// Adds a column of unsigned 64-bit integers.
    #[must_use]
    pub fn u64(self, name: &str, values: Vec<u64>) -> Self {
        self.array(name, Arc::new(UInt64Array::from(values)))
    }

    /// Adds a column of signed 64-bit integers.
    #[must_use]
    pub fn i64(self, name: &str, values: Vec<i64>) -> Self {
        self.array(name, Arc::new(Int64Array::from(values)))
    }

    /// Adds a column of floats.
    #[must_use]
    pub fn f64(self, name: &str, values: Vec<f64>) -> Self {
        self.array(name, Arc::new(Float64Array::from(values)))
    }

    /// Adds a nullable column of floats.
    #[must_use]
    pub fn f64_or_null(self, name: &str, values: Vec<Option<f64>>) -> Self {
        self.array(name, Arc::new(Float64Array::from(values)))
    }

    /// Adds a column of booleans.
    #[must_use]
    pub fn bool(self, name: &str, values: Vec<bool>) -> Self {
        self.array(name, Arc::new(BooleanArray::from(values)))
    }

    /// Adds a nullable column of booleans.
    #[must_use]
    pub fn bool_or_null(self, name: &str, values: Vec<Option<bool>>) -> Self {
        self.array(name, Arc::new(BooleanArray::from(values)))
    }

    /// Adds a column of text or of categories, depending on the description.
    #[must_use]
    pub fn text<T: AsRef<str>>(self, name: &str, values: impl IntoIterator<Item = T>) -> Self {
        self.text_or_null(name, values.into_iter().map(Some))
    }

    /// Adds a nullable column of text or of categories, depending on the description.
    #[must_use]
    pub fn text_or_null<T: AsRef<str>>(self, name: &str, values: impl IntoIterator<Item = Option<T>>) -> Self {
        let values: StringArray = values.into_iter().collect();
        let is_category = self.spec.column(name).is_some_and(|c| c.kind == ColumnKind::Category);
        if is_category {
            let dictionary: DictionaryArray<Int32Type> = values.iter().collect();
            self.array(name, Arc::new(dictionary))
        } else {
            self.array(name, Arc::new(values))
        }
    }

    /// Adds a column of byte strings, for example PNG images.
    #[must_use]
    pub fn binary<T: AsRef<[u8]>>(self, name: &str, values: impl IntoIterator<Item = T>) -> Self {
        let values = BinaryArray::from_iter_values(values);
        self.array(name, Arc::new(values))
    }

    /// Adds a column of lists of floats.
    #[must_use]
    pub fn f64_list<T: AsRef<[f64]>>(self, name: &str, values: impl IntoIterator<Item = T>) -> Self {
        let mut flat = Vec::new();
        let mut lengths = Vec::new();
        for list in values {
            lengths.push(list.as_ref().len());
            flat.extend_from_slice(list.as_ref());
        }
        let field = Arc::new(Field::new("element", DataType::Float64, false));
        let nulls: Option<NullBuffer> = None;
        let list = ListArray::new(
            field,
            OffsetBuffer::from_lengths(lengths),
            Arc::new(Float64Array::from(flat)),
            nulls,
        );
        self.array(name, Arc::new(list))
    }

    /// Adds a column of lists of `columns` floats each; `values` contains the lists one after the other. Values after the last
    /// complete list are ignored.
    #[must_use]
    pub fn f64_rows(self, name: &str, values: Vec<f64>, columns: usize) -> Self {
        let field = Arc::new(Field::new("element", DataType::Float64, false));
        let rows = values.len().checked_div(columns).unwrap_or(0);
        let offsets = OffsetBuffer::from_lengths(std::iter::repeat_n(columns, rows));
        let values = Float64Array::from(values).slice(0, rows * columns);
        self.array(name, Arc::new(ListArray::new(field, offsets, Arc::new(values), None)))
    }

    /// Adds a column of lists of `columns` single precision floats each; `values` contains the lists one after the other. Values
    /// after the last complete list are ignored.
    #[must_use]
    pub fn f32_rows(self, name: &str, values: Vec<f32>, columns: usize) -> Self {
        let field = Arc::new(Field::new("element", DataType::Float32, false));
        let rows = values.len().checked_div(columns).unwrap_or(0);
        let offsets = OffsetBuffer::from_lengths(std::iter::repeat_n(columns, rows));
        let values = Float32Array::from(values).slice(0, rows * columns);
        self.array(name, Arc::new(ListArray::new(field, offsets, Arc::new(values), None)))
    }

    /// Adds a column from an Arrow array.
    #[must_use]
    pub fn array(mut self, name: &str, values: ArrayRef) -> Self {
        self.arrays.push((name.to_owned(), values));
        self
    }

    /// Returns the columns as a record batch, in the order of the description.
    ///
    /// # Errors
    /// [`ArtifactError::Rows`] if a column is missing, unknown, given twice, of another type or length, or null although the
    /// description forbids it.
    pub fn finish(self) -> Result<RecordBatch, ArtifactError> {
        let spec = self.spec;
        let refuse = |reason: String| ArtifactError::Rows {
            table: spec.name.to_owned(),
            reason,
        };
        let mut given: Vec<Option<ArrayRef>> = vec![None; spec.columns.len()];
        for (name, array) in self.arrays {
            let place = spec
                .columns
                .iter()
                .position(|column| column.name == name)
                .and_then(|i| given.get_mut(i))
                .ok_or_else(|| refuse(format!("the table has no column {name}")))?;
            if place.replace(array).is_some() {
                return Err(refuse(format!("column {name} is given twice")));
            }
        }
        let mut arrays: Vec<ArrayRef> = Vec::with_capacity(given.len());
        for (column, array) in spec.columns.iter().zip(given) {
            let array = array.ok_or_else(|| refuse(format!("column {} is not given", column.name)))?;
            if array.data_type() != &column.kind.data_type() {
                return Err(refuse(format!(
                    "column {} has type {}, not {}",
                    column.name,
                    array.data_type(),
                    column.kind
                )));
            }
            if let Some(first) = arrays.first()
                && first.len() != array.len()
            {
                return Err(refuse(format!(
                    "column {} has {} values, but the first column has {}",
                    column.name,
                    array.len(),
                    first.len()
                )));
            }
            if !column.nullable
                && let Some(row) = first_null(array.as_ref())
            {
                return Err(refuse(format!("column {} is null in row {row}", column.name)));
            }
            arrays.push(array);
        }
        RecordBatch::try_new(spec.schema(), arrays).map_err(|error| refuse(error.to_string()))
    }
}

/// Returns the batch with the table's own schema after checking its columns. The schema of a batch from another source may lack
/// the metadata of the table.
pub(crate) fn check_rows(
    spec: &'static TableSpec,
    schema: &SchemaRef,
    batch: RecordBatch,
) -> Result<RecordBatch, ArtifactError> {
    if Arc::ptr_eq(schema, batch.schema_ref()) || schema == batch.schema_ref() {
        return Ok(batch);
    }
    let mut columns = Columns::new(spec);
    for (field, array) in batch.schema_ref().fields().iter().zip(batch.columns()) {
        columns = columns.array(field.name(), Arc::clone(array));
    }
    columns.finish()
}

pub(crate) fn first_null(array: &dyn Array) -> Option<usize> {
    let nulls = array.nulls()?;
    (0..nulls.len()).find(|&i| nulls.is_null(i))
}

pub(crate) fn table_name(batch: &RecordBatch) -> String {
    batch
        .schema_ref()
        .metadata
        .get(TABLE_KEY)
        .map_or("?", String::as_str)
        .to_owned()
}

/// Returns the column with this name, of any type.
pub(crate) fn column<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a ArrayRef, ArtifactError> {
    batch.column_by_name(name).ok_or_else(|| {
        let known: Vec<&str> = batch.schema_ref().fields().iter().map(|f| f.name().as_str()).collect();
        ArtifactError::NoColumn {
            table: table_name(batch),
            column: name.to_owned(),
            known: known.join(", "),
        }
    })
}

pub(crate) fn wrong_kind(batch: &RecordBatch, name: &str, array: &ArrayRef, expected: ColumnKind) -> ArtifactError {
    ArtifactError::ColumnKind {
        table: table_name(batch),
        column: name.to_owned(),
        expected,
        found: array.data_type().to_string(),
    }
}

pub(crate) fn complete(batch: &RecordBatch, name: &str, array: &dyn Array) -> Result<(), ArtifactError> {
    first_null(array).map_or(Ok(()), |row| {
        Err(ArtifactError::Null {
            table: table_name(batch),
            column: name.to_owned(),
            row,
        })
    })
}

fn primitive<'a, T: ArrowPrimitiveType>(
    batch: &'a RecordBatch,
    name: &str,
    kind: ColumnKind,
) -> Result<&'a arrow_array::PrimitiveArray<T>, ArtifactError> {
    let array = column(batch, name)?;
    array
        .as_primitive_opt::<T>()
        .ok_or_else(|| wrong_kind(batch, name, array, kind))
}

fn values<'a, T: ArrowPrimitiveType>(
    batch: &'a RecordBatch,
    name: &str,
    kind: ColumnKind,
) -> Result<&'a [T::Native], ArtifactError> {
    let array = primitive::<T>(batch, name, kind)?;
    complete(batch, name, array)?;
    Ok(array.values())
}

/// Returns the values of a column of unsigned 32-bit integers.
///
/// # Errors
/// As for all functions of this kind: [`ArtifactError::NoColumn`], [`ArtifactError::ColumnKind`], and, if the function does not
/// return options, [`ArtifactError::Null`].
pub fn col_u32<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a [u32], ArtifactError> {
    values::<UInt32Type>(batch, name, ColumnKind::U32)
}

/// Returns the values of a column of unsigned 64-bit integers.
///
/// # Errors
/// As [`col_u32`].
pub fn col_u64<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a [u64], ArtifactError> {
    values::<UInt64Type>(batch, name, ColumnKind::U64)
}

/// Returns the values of a column of signed 64-bit integers.
///
/// # Errors
/// As [`col_u32`].
pub fn col_i64<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a [i64], ArtifactError> {
    values::<Int64Type>(batch, name, ColumnKind::I64)
}

/// Returns the values of a column of floats.
///
/// # Errors
/// As [`col_u32`].
pub fn col_f64<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a [f64], ArtifactError> {
    values::<Float64Type>(batch, name, ColumnKind::F64)
}

/// Returns the values of a nullable column of floats.
///
/// # Errors
/// As [`col_u32`].
pub fn col_f64_or_null(batch: &RecordBatch, name: &str) -> Result<Vec<Option<f64>>, ArtifactError> {
    Ok(primitive::<Float64Type>(batch, name, ColumnKind::F64)?.iter().collect())
}

/// Returns the values of a nullable column of unsigned 32-bit integers.
///
/// # Errors
/// As [`col_u32`].
pub fn col_u32_or_null(batch: &RecordBatch, name: &str) -> Result<Vec<Option<u32>>, ArtifactError> {
    Ok(primitive::<UInt32Type>(batch, name, ColumnKind::U32)?.iter().collect())
}

/// Returns a column of booleans as an array, which may contain nulls.
///
/// # Errors
/// As [`col_u32`], except for [`ArtifactError::Null`].
pub fn col_bool<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a BooleanArray, ArtifactError> {
    let array = column(batch, name)?;
    array
        .as_boolean_opt()
        .ok_or_else(|| wrong_kind(batch, name, array, ColumnKind::Bool))
}

/// Returns the values of a column of text or of categories, `None` for null.
///
/// # Errors
/// As [`col_u32`].
pub fn col_text<'a>(batch: &'a RecordBatch, name: &str) -> Result<Vec<Option<&'a str>>, ArtifactError> {
    let array = column(batch, name)?;
    if let Some(text) = array.as_string_opt::<i32>() {
        return Ok(text.iter().collect());
    }
    let wrong = || wrong_kind(batch, name, array, ColumnKind::Text);
    let dictionary = array.as_dictionary_opt::<Int32Type>().ok_or_else(wrong)?;
    let words = dictionary.values().as_string_opt::<i32>().ok_or_else(wrong)?;
    let keys: &Int32Array = dictionary.keys();
    Ok(keys
        .iter()
        .map(|key| key.map(|key| words.value(key as usize)))
        .collect())
}

/// Returns a column of byte strings as an array, which may contain nulls.
///
/// # Errors
/// As [`col_u32`], except for [`ArtifactError::Null`].
pub fn col_binary<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a BinaryArray, ArtifactError> {
    let array = column(batch, name)?;
    array
        .as_binary_opt::<i32>()
        .ok_or_else(|| wrong_kind(batch, name, array, ColumnKind::Binary))
}

/// Returns the values of a column of lists of floats.
///
/// # Errors
/// As [`col_u32`].
pub fn col_f64_list(batch: &RecordBatch, name: &str) -> Result<Vec<Vec<f64>>, ArtifactError> {
    let array = column(batch, name)?;
    let lists = array
        .as_list_opt::<i32>()
        .ok_or_else(|| wrong_kind(batch, name, array, ColumnKind::F64List))?;
    complete(batch, name, lists)?;
    lists
        .iter()
        .flatten()
        .map(|list| {
            list.as_primitive_opt::<Float64Type>()
                .map(|list| list.values().to_vec())
                .ok_or_else(|| wrong_kind(batch, name, array, ColumnKind::F64List))
        })
        .collect()
}
