//! Descriptions of tables. Schemas, checks and the reference documentation are derived from them.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use arrow_schema::{DataType, Field, Schema, SchemaRef};
use serde_json::{Value, json};

/// Description of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TableSpec {
    /// Name of the table. Its file is `<name>.parquet`.
    pub name: &'static str,
    /// Version of the schema. Raise it when a column is added or renamed, and set [`ColumnSpec::since`] of an added column to the
    /// new version.
    pub version: u32,
    /// Domain of the columns that are not common to all domains: `plane` (SE(2), Push-T) or `space` (SE(3), robosuite); "" if
    /// there are no such columns.
    pub domain: &'static str,
    /// Name of the table in earlier versions; "" if it was the same.
    pub formerly: &'static str,
    /// What one row is, and what the table is for.
    pub description: &'static str,
    /// The columns, in the order of the file.
    pub columns: &'static [ColumnSpec],
}

/// Description of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColumnSpec {
    /// Name.
    pub name: &'static str,
    /// Type of its values.
    pub kind: ColumnKind,
    /// Whether values may be null.
    pub nullable: bool,
    /// Unit of its values, "" for none: `px`, `rad`, `1/256 px`, ...
    pub unit: &'static str,
    /// Frame of reference of its values, "" for none: `world`, `object`, ...
    pub frame: &'static str,
    /// Meaning of its values.
    pub description: &'static str,
    /// First schema version of the table with this column. In tables of older versions the column is read as null, so a column
    /// that is added later must be nullable.
    pub since: u32,
    /// Name of the column in earlier versions; "" if it was the same.
    pub formerly: &'static str,
}

/// Type of the values of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ColumnKind {
    /// Unsigned 32-bit integers: ids, counts.
    U32,
    /// Unsigned 64-bit integers.
    U64,
    /// Signed 64-bit integers.
    I64,
    /// Double precision floats, stored bit for bit.
    F64,
    /// Booleans.
    Bool,
    /// UTF-8 text.
    Text,
    /// UTF-8 text with few distinct values, stored as a dictionary.
    Category,
    /// Bytes, for example of a PNG image; stored without further compression.
    Binary,
    /// A list of double precision floats.
    F64List,
    /// A list of single precision floats, stored bit for bit.
    F32List,
}

impl ColumnKind {
    /// Name of the type in descriptions and messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::U32 => "u32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F64 => "f64",
            Self::Bool => "bool",
            Self::Text => "text",
            Self::Category => "category",
            Self::Binary => "binary",
            Self::F64List => "list of f64",
            Self::F32List => "list of f32",
        }
    }

    /// The Arrow type of such a column.
    pub fn data_type(self) -> DataType {
        match self {
            Self::U32 => DataType::UInt32,
            Self::U64 => DataType::UInt64,
            Self::I64 => DataType::Int64,
            Self::F64 => DataType::Float64,
            Self::Bool => DataType::Boolean,
            Self::Text => DataType::Utf8,
            Self::Category => DataType::Dictionary(Box::new(DataType::Int32), Box::new(DataType::Utf8)),
            Self::Binary => DataType::Binary,
            Self::F64List => DataType::List(Arc::new(Field::new("element", DataType::Float64, false))),
            Self::F32List => DataType::List(Arc::new(Field::new("element", DataType::Float32, false))),
        }
    }
}

impl fmt::Display for ColumnKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl ColumnSpec {
    /// Creates a column without unit and frame of reference that is never null.
    pub const fn new(name: &'static str, kind: ColumnKind, description: &'static str) -> Self {
        Self {
            name,
            kind,
            nullable: false,
            unit: "",
            frame: "",
            description,
            since: 1,
            formerly: "",
        }
    }

    /// The same column, with values that may be null.
    #[must_use]
    pub const fn nullable(mut self) -> Self {
        self.nullable = true;
        self
    }

    /// The same column, with this unit.
    #[must_use]
    pub const fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    /// The same column, with this frame of reference.
    #[must_use]
    pub const fn frame(mut self, frame: &'static str) -> Self {
        self.frame = frame;
        self
    }

    /// The same column, first present in this version of the table.
    #[must_use]
    pub const fn since(mut self, version: u32) -> Self {
        self.since = version;
        self
    }

    fn field(&self) -> Field {
        let entries = [
            ("unit", self.unit),
            ("frame", self.frame),
            ("description", self.description),
        ];
        let metadata: BTreeMap<String, String> = entries
            .into_iter()
            .filter(|(_, text)| !text.is_empty())
            .map(|(name, text)| (name.to_owned(), text.to_owned()))
            .collect();
        Field::new(self.name, self.kind.data_type(), self.nullable).with_metadata(metadata)
    }
}

/// Name of the table in the metadata of a Parquet file and of the batches read from it.
pub(crate) const TABLE_KEY: &str = "re4.table";
const VERSION_KEY: &str = "re4.version";
pub(crate) const DOMAIN_KEY: &str = "re4.domain";
const DESCRIPTION_KEY: &str = "re4.description";
const COLUMNS_KEY: &str = "re4.columns";

impl TableSpec {
    /// Name of the table's file.
    pub fn file(&self) -> String {
        format!("{}.parquet", self.name)
    }

    /// Name of the table, followed by its domain if it has one: `modes-space`.
    pub fn title(&self) -> String {
        match self.domain {
            "" => self.name.to_owned(),
            domain => format!("{}-{domain}", self.name),
        }
    }

    /// Returns the column with this name.
    pub fn column(&self, name: &str) -> Option<&'static ColumnSpec> {
        self.columns.iter().find(|column| column.name == name)
    }

    /// Returns the columns of this schema version.
    pub fn columns_at(&self, version: u32) -> impl Iterator<Item = &'static ColumnSpec> {
        self.columns.iter().filter(move |column| column.since <= version)
    }

    /// Returns the name of a column in files of a schema version.
    pub fn name_at(&self, column: &ColumnSpec, version: u32) -> &'static str {
        if version < self.version && !column.formerly.is_empty() {
            column.formerly
        } else {
            column.name
        }
    }

    /// Returns the Arrow schema, with unit, frame of reference and description in the metadata of the fields.
    pub fn schema(&self) -> SchemaRef {
        let fields: Vec<Field> = self.columns.iter().map(ColumnSpec::field).collect();
        let metadata: BTreeMap<String, String> = self.key_values().into_iter().collect();
        Arc::new(Schema::new_with_metadata(fields, metadata))
    }

    /// Returns the key-value metadata of the Parquet file. It repeats the descriptions of the columns for readers that do not
    /// support the metadata of Arrow fields.
    pub(crate) fn key_values(&self) -> Vec<(String, String)> {
        let columns: Vec<Value> = self
            .columns
            .iter()
            .map(|c| json!({"description": c.description, "frame": c.frame, "name": c.name, "unit": c.unit}))
            .collect();
        let domain = (!self.domain.is_empty()).then(|| (DOMAIN_KEY.to_owned(), self.domain.to_owned()));
        let mut entries = vec![
            (COLUMNS_KEY.to_owned(), Value::Array(columns).to_string()),
            (DESCRIPTION_KEY.to_owned(), self.description.to_owned()),
            (TABLE_KEY.to_owned(), self.name.to_owned()),
            (VERSION_KEY.to_owned(), self.version.to_string()),
        ];
        entries.extend(domain);
        entries
    }
}

/// Returns the description of a table as JSON, for documentation and for programs that do not use this crate.
pub fn json_description(spec: &TableSpec) -> Value {
    let columns: Vec<Value> = spec
        .columns
        .iter()
        .map(|c| {
            json!({
                "name": c.name,
                "kind": c.kind.as_str(),
                "arrow_type": c.kind.data_type().to_string(),
                "nullable": c.nullable,
                "unit": c.unit,
                "frame": c.frame,
                "description": c.description,
                "since": c.since,
                "formerly": c.formerly,
            })
        })
        .collect();
    json!({
        "name": spec.name,
        "version": spec.version,
        "domain": spec.domain,
        "formerly": spec.formerly,
        "file": spec.file(),
        "description": spec.description,
        "columns": columns,
    })
}
