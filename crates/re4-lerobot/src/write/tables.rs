//! The Parquet files with the frames.

use std::fs::File;
use std::sync::Arc;

use arrow_array::{
    ArrayRef, BinaryArray, BooleanArray, FixedSizeListArray, Float32Array, Float64Array, Int64Array, RecordBatch,
    StringArray, StructArray,
};
use arrow_schema::{DataType, Field, Fields, Schema, SchemaRef};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{WriterProperties, WriterPropertiesBuilder};
use parquet::schema::types::ColumnPath;

use super::error::io_error;
use super::folder::Staging;
use super::{Data, Declaration, Declared, FeatureKind, NewEpisode, Number, WriteError};
use crate::info::{BOOKKEEPING, Version};

/// Named in the files, in place of the version of the Parquet library.
const CREATED_BY: &str = concat!("re4-pipe ", env!("CARGO_PKG_VERSION"));

/// A Parquet file that is being written.
pub(super) struct Table {
    name: String,
    writer: ArrowWriter<File>,
}

impl Table {
    pub(super) fn create(
        staging: &Staging,
        name: &str,
        schema: &SchemaRef,
        properties: WriterProperties,
    ) -> Result<Self, WriteError> {
        let file = staging.create_file(name)?;
        let writer = ArrowWriter::try_new(file, Arc::clone(schema), Some(properties))
            .map_err(|error| staging.failed("write", name, io_error(error)))?;
        Ok(Self {
            name: name.to_owned(),
            writer,
        })
    }

    /// Writes a row group.
    pub(super) fn write(&mut self, staging: &Staging, batch: &RecordBatch) -> Result<(), WriteError> {
        let written = self.writer.write(batch).and_then(|()| self.writer.flush());
        written.map_err(|error| staging.failed("write", &self.name, io_error(error)))
    }

    fn bytes(&self) -> u64 {
        self.writer.bytes_written() as u64
    }

    pub(super) fn close(self, staging: &Staging) -> Result<(), WriteError> {
        let failed = |error| staging.failed("write", &self.name, error);
        let file = self.writer.into_inner().map_err(|error| failed(io_error(error)))?;
        file.sync_all().map_err(failed)
    }
}

/// What all Parquet files have in common.
pub(super) fn properties(pandas: Option<String>) -> WriterPropertiesBuilder {
    let level = ZstdLevel::try_new(3).unwrap_or_default();
    WriterProperties::builder()
        .set_created_by(CREATED_BY.to_owned())
        .set_compression(Compression::ZSTD(level))
        .set_key_value_metadata(pandas.map(|text| vec![KeyValue::new("pandas".to_owned(), text)]))
}

/// The files with the frames.
pub(super) struct DataFiles {
    version: Version,
    schema: SchemaRef,
    properties: WriterProperties,
    /// Whether each feature is a column.
    columns: Vec<bool>,
    limit: u64,
    chunk: usize,
    open: Option<Table>,
    /// Number of the open file, or of the next one.
    number: usize,
}

impl DataFiles {
    pub(super) fn new(declared: &Declaration) -> Self {
        let own = declared.features.iter().filter(|feature| is_column(feature)).map(field);
        let more = BOOKKEEPING.map(|name| match name {
            "timestamp" => Field::new(name, DataType::Float32, false),
            _ => Field::new(name, DataType::Int64, false),
        });
        let mut properties = properties(None);
        for feature in &declared.features {
            if matches!(feature.kind, FeatureKind::Image(..)) {
                // The PNG files of artifacts are compressed for speed; the Parquet library halves them.
                let column = ColumnPath::new(vec![feature.name.clone(), "bytes".to_owned()]);
                properties = properties
                    .set_column_dictionary_enabled(column.clone(), false)
                    .set_column_statistics_enabled(column, parquet::file::properties::EnabledStatistics::None);
            }
        }
        Self {
            version: declared.version,
            schema: Arc::new(Schema::new(own.chain(more).collect::<Fields>())),
            properties: properties.build(),
            columns: declared.features.iter().map(is_column).collect(),
            limit: declared.limits.data_bytes,
            chunk: declared.limits.chunk.max(1),
            open: None,
            number: 0,
        }
    }

    /// Writes the rows of an episode; returns the numbers of chunk and file.
    pub(super) fn add(
        &mut self,
        staging: &Staging,
        index: usize,
        episode: &NewEpisode,
        bookkeeping: &[Data; 5],
    ) -> Result<[usize; 2], WriteError> {
        let own = episode.data.iter().zip(&self.columns).filter(|(_, column)| **column);
        let all = own.map(|(data, _)| data).chain(bookkeeping).zip(self.schema.fields());
        let arrays: Vec<ArrayRef> = all.map(|(data, field)| array(data, field)).collect();
        // The schema is made from the same declaration that the episode was checked against.
        let batch = RecordBatch::try_new(Arc::clone(&self.schema), arrays)
            .map_err(|error| staging.failed("write", "", std::io::Error::other(error.to_string())))?;
        let place = [self.number / self.chunk, self.number % self.chunk];
        let table = match &mut self.open {
            Some(table) => table,
            closed => {
                let name = match self.version {
                    Version::V3 => format!("data/chunk-{:03}/file-{:03}.parquet", place[0], place[1]),
                    Version::V2 => format!("data/chunk-{:03}/episode_{index:06}.parquet", index / self.chunk),
                };
                closed.insert(Table::create(staging, &name, &self.schema, self.properties.clone())?)
            }
        };
        table.write(staging, &batch)?;
        if self.version == Version::V2 || table.bytes() >= self.limit {
            self.close(staging)?;
        }
        Ok(place)
    }

    pub(super) fn close(&mut self, staging: &Staging) -> Result<(), WriteError> {
        if let Some(table) = self.open.take() {
            table.close(staging)?;
            self.number += 1;
        }
        Ok(())
    }
}

fn data_type(number: Number) -> DataType {
    match number {
        Number::Single => DataType::Float32,
        Number::Double => DataType::Float64,
        Number::Integer => DataType::Int64,
        Number::Truth => DataType::Boolean,
    }
}

/// Whether a feature is a column; videos are not.
fn is_column(feature: &Declared) -> bool {
    !matches!(feature.kind, FeatureKind::Video(..))
}

fn image_fields() -> Fields {
    Fields::from(vec![
        Field::new("bytes", DataType::Binary, true),
        Field::new("path", DataType::Utf8, true),
    ])
}

fn field(feature: &Declared) -> Field {
    let data_type = match &feature.kind {
        FeatureKind::Scalar(number) => data_type(*number),
        FeatureKind::Vector(number, names) => {
            let element = Arc::new(Field::new("element", data_type(*number), true));
            DataType::FixedSizeList(element, names.len() as i32)
        }
        FeatureKind::Image(..) | FeatureKind::Video(..) => DataType::Struct(image_fields()),
    };
    Field::new(&feature.name, data_type, true)
}

fn array(data: &Data, field: &Field) -> ArrayRef {
    let flat: ArrayRef = match data {
        Data::Single(values) => Arc::new(Float32Array::from(values.clone())),
        Data::Double(values) => Arc::new(Float64Array::from(values.clone())),
        Data::Integer(values) => Arc::new(Int64Array::from(values.clone())),
        Data::Truth(values) => Arc::new(BooleanArray::from(values.clone())),
        Data::Images(images) => {
            let names: StringArray = (0..images.len())
                .map(|frame| Some(format!("frame-{frame:06}.png")))
                .collect();
            let bytes: ArrayRef = Arc::new(BinaryArray::from_iter_values(images));
            Arc::new(StructArray::new(image_fields(), vec![bytes, Arc::new(names)], None))
        }
    };
    match field.data_type() {
        DataType::FixedSizeList(element, size) => {
            Arc::new(FixedSizeListArray::new(Arc::clone(element), *size, flat, None))
        }
        _ => flat,
    }
}
