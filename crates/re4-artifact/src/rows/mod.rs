//! Typed rows: a table is declared once, as a struct, from which its schema, its writer and its readers follow.
//!
//! A field of a row is a [`Cell`]: one column (a number, a flag, a word), or several that belong together, such as a pose. Field
//! names give column names: `object: Pose2` is stored as `object_x`, `object_y` and `object_theta`. The documentation of struct
//! and fields describes table and columns in files and schemas.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use re4_artifact::{ArtifactSummary, Recipe, Row as _, Stage, Store, columns, table};
//! use re4_geometry::Pose2;
//!
//! table! {
//!     /// One row a frame of a demonstration.
//!     #[table("example", version = 2)]
//!     pub struct ExampleRow {
//!         /// Number of the demonstration, from 0.
//!         pub episode: u32,
//!         /// Pose of the object.
//!         #[frame = "world"]
//!         pub object: Pose2,
//!         /// Speed of the end effector; null where it was not recorded.
//!         #[unit = "px/s"]
//!         #[since = 2]
//!         pub speed: Option<f64>,
//!     }
//! }
//!
//! columns! {
//!     /// Columns that some reader needs, by the names that the table gives them.
//!     pub struct Where {
//!         /// Demonstration.
//!         pub episode: u32,
//!         /// Pose of the object.
//!         pub object: Pose2,
//!     }
//! }
//!
//! assert_eq!(ExampleRow::table().columns[3].name, "object_theta");
//! assert_eq!(ExampleRow::table().columns[3].unit, "rad");
//! # let folder = tempfile::tempdir()?;
//! # let store = Store::open(folder.path())?;
//! let writer = store.begin(&Recipe::new(Stage::Segment, 1).config(&serde_json::json!({}))?)?;
//! let mut rows = writer.rows::<ExampleRow>()?;
//! rows.push(&ExampleRow { episode: 0, object: Pose2::new(1.0, 2.0, 0.5), speed: None })?;
//! rows.finish()?;
//! let artifact = writer.publish(ArtifactSummary::default())?;
//! let places: Vec<Where> = artifact.table(ExampleRow::table())?.read()?;
//! assert_eq!(places[0].object.theta, 0.5);
//! let rows: Vec<ExampleRow> = artifact.read()?;
//! assert_eq!(rows[0].speed, None);
//! # Ok(())
//! # }
//! ```

mod cells;
mod poses;
mod read;
mod write;

use std::any::TypeId;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use arrow_array::{Array as _, ArrayRef, RecordBatch};

use crate::columns::{column, complete};
use crate::error::ArtifactError;
use crate::spec::{ColumnKind, ColumnSpec, TableSpec};

pub use cells::{Label, Word};
pub use poses::{QUATERNION_PARTS, SixAxis};
pub use read::RowsOf;
pub use write::RowWriter;

/// A value of one or more columns.
///
/// Implemented for numbers, flags, text, bytes, lists, [`Word`]s, [`Label`]s, poses and points; for `Option` of any of these,
/// which may be null; for arrays, whose columns are numbered; and for structs declared by [`columns!`](crate::columns!).
pub trait Cell: Sized + 'static {
    /// Values on their way to columns.
    type Buffers: Default;
    /// Columns of a batch.
    type View;

    /// Domain whose columns these are: `plane` or `space`; "" for those that all domains share.
    const DOMAIN: &'static str = "";

    /// Adds the descriptions of the columns.
    fn describe(at: &Place, columns: &mut Vec<ColumnSpec>);

    /// Adds a value, or nulls.
    fn push(value: Option<&Self>, buffers: &mut Self::Buffers);

    /// Moves what was pushed into columns, in the order of their descriptions.
    fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<ArrayRef>);

    /// Takes the columns from a batch.
    ///
    /// # Errors
    /// [`ArtifactError::NoColumn`], [`ArtifactError::ColumnKind`]; [`ArtifactError::Null`] where a value is `required` and
    /// absent; [`ArtifactError::UnknownWord`].
    fn view(source: &mut ColumnSource<'_>, required: bool) -> Result<Self::View, ArtifactError>;

    /// The value of a row; `None` where it is null.
    fn get(view: &Self::View, row: usize) -> Option<Self>;
}

/// The rows of a table.
pub trait Row: Cell {
    /// Name of the table.
    const NAME: &'static str;
    /// Version of its schema.
    const VERSION: u32;
    /// Name of the table before this version; "" where it always had its own.
    const FORMERLY: &'static str;

    /// What one row is.
    fn description() -> String;

    /// Description of the table.
    fn table() -> &'static TableSpec {
        static KNOWN: Known<&'static TableSpec> = Mutex::new(BTreeMap::new());
        once::<Self, _>(&KNOWN, || {
            // One description a type for the life of the process.
            Box::leak(Box::new(TableSpec {
                name: Self::NAME,
                version: Self::VERSION,
                domain: Self::DOMAIN,
                formerly: Self::FORMERLY,
                description: leak(Self::description()),
                columns: columns_of::<Self>(),
            }))
        })
    }
}

/// What is known of types. Row types are generic, and a static inside of a generic function is one for all of them.
type Known<T> = Mutex<BTreeMap<TypeId, T>>;

/// What is known of a type, made when it is asked for first: descriptions stay for the life of the process, one a type.
fn once<C: 'static, T: Copy>(known: &Known<T>, make: impl FnOnce() -> T) -> T {
    let id = TypeId::of::<C>();
    let found = known.lock().unwrap_or_else(PoisonError::into_inner).get(&id).copied();
    found.unwrap_or_else(|| {
        let made = make();
        *known
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .entry(id)
            .or_insert(made)
    })
}

/// Descriptions of the columns of a struct.
fn columns_of<C: Cell>() -> &'static [ColumnSpec] {
    static KNOWN: Known<&'static [ColumnSpec]> = Mutex::new(BTreeMap::new());
    once::<C, _>(&KNOWN, || {
        let mut columns = Vec::new();
        C::describe(&Place::default(), &mut columns);
        Vec::leak(columns)
    })
}

fn leak(text: String) -> &'static str {
    if text.is_empty() { "" } else { String::leak(text) }
}

/// Where a cell stands in a table, and what is said of it there.
#[derive(Debug, Clone, Default)]
pub struct Place {
    /// Name of the column, or what the names of its columns begin with; empty for those of the row itself.
    pub name: String,
    /// Sentences that describe it.
    pub description: String,
    /// Unit; "" where the type says it, or there is none.
    pub unit: &'static str,
    /// Frame of reference; "" for none.
    pub frame: &'static str,
    /// Whether it may be null.
    pub nullable: bool,
    /// Version of the table that first had it; 0 for the first.
    pub since: u32,
    /// The name that it had in versions before; empty where it is the same.
    pub formerly: String,
}

impl Place {
    /// A field below this place. Empty names are those of flattened structs.
    #[must_use]
    pub fn field(&self, name: &str, description: &str) -> Self {
        Self {
            name: below(&self.name, name),
            description: trimmed(description),
            formerly: if self.formerly.is_empty() {
                String::new()
            } else {
                below(&self.formerly, name)
            },
            ..self.clone()
        }
    }

    /// A part of a value: a column whose description goes on from that of the whole.
    #[must_use]
    pub fn part(&self, name: &str, words: &str) -> Self {
        let whole = self.description.strip_suffix('.').unwrap_or(&self.description);
        Self {
            description: format!("{whole}: {words}."),
            ..self.field(name, "")
        }
    }

    /// The column here.
    #[must_use]
    pub fn column(&self, kind: ColumnKind) -> ColumnSpec {
        ColumnSpec {
            name: leak(self.name.clone()),
            kind,
            nullable: self.nullable,
            unit: self.unit,
            frame: self.frame,
            description: leak(self.description.clone()),
            since: self.since.max(1),
            formerly: leak(self.formerly.clone()),
        }
    }
}

fn below(prefix: &str, name: &str) -> String {
    match (prefix, name) {
        (prefix, "") => prefix.to_owned(),
        ("", name) => name.to_owned(),
        (prefix, name) => format!("{prefix}_{name}"),
    }
}

/// The domain of columns that may be of one.
#[must_use]
pub const fn either(domain: &'static str, other: &'static str) -> &'static str {
    if domain.is_empty() { other } else { domain }
}

/// The text of documentation comments, one line after the other.
#[must_use]
pub fn trimmed(lines: &str) -> String {
    lines.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Columns of a batch, by the names that a struct gives them, one after the other.
pub struct ColumnSource<'a> {
    batch: &'a RecordBatch,
    columns: std::slice::Iter<'static, ColumnSpec>,
}

impl<'a> ColumnSource<'a> {
    /// Those of `C` in a batch.
    #[must_use]
    pub fn new<C: Cell>(batch: &'a RecordBatch) -> Self {
        Self {
            batch,
            columns: columns_of::<C>().iter(),
        }
    }

    /// The next column, as an array of type `A`.
    fn next<A: Clone + 'static>(&mut self, required: bool) -> Result<(A, ColumnSpec), ArtifactError> {
        let (array, spec) = self.any(required)?;
        let typed = array.as_any().downcast_ref::<A>().cloned();
        typed
            .map(|typed| (typed, spec))
            .ok_or_else(|| crate::columns::wrong_kind(self.batch, spec.name, array, spec.kind))
    }

    fn any(&mut self, required: bool) -> Result<(&'a ArrayRef, ColumnSpec), ArtifactError> {
        // A cell takes as many columns as it describes.
        let spec = self.columns.next().copied();
        let spec = spec.unwrap_or(ColumnSpec::new("", ColumnKind::F64, ""));
        let array = column(self.batch, spec.name)?;
        if required {
            complete(self.batch, spec.name, array.as_ref())?;
        }
        Ok((array, spec))
    }
}

/// Declares a struct whose fields are columns. Poses and points say whether the columns are those of the plane or of space; a
/// struct without any may say so by `#[domain = "plane"]` below its documentation. Between documentation and name, a field may have, in this order,
/// `#[unit = "m"]`, `#[frame = "world"]`, `#[since = 2]` (version of the table that first had it, whose older rows are null),
/// `#[formerly = "name"]` (its name in versions before), `#[prefix = "name"]` (what the names of its columns begin with in
/// place of its own; "" for a struct whose columns have their own names).
#[macro_export]
macro_rules! columns {
    (
        $(#[doc = $about:literal])*
        $(#[domain = $domain:literal])?
        $(#[derive($($derived:ident),*)])?
        pub struct $name:ident $(<$($generic:ident),+>)? {
            $(
                $(#[doc = $doc:literal])*
                $(#[unit = $unit:literal])?
                $(#[frame = $frame:literal])?
                $(#[since = $since:literal])?
                $(#[formerly = $formerly:literal])?
                $(#[prefix = $prefix:literal])?
                pub $field:ident : $type:ty
            ),* $(,)?
        }
    ) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, PartialEq $($(, $derived)*)?)]
        pub struct $name $(<$($generic),+>)? {
            $($(#[doc = $doc])* pub $field: $type,)*
        }

        const _: () = {
            #[doc(hidden)]
            #[allow(missing_docs)]
            pub struct Buffers $(<$($generic: $crate::Cell),+>)? {
                $($field: <$type as $crate::Cell>::Buffers,)*
            }

            impl $(<$($generic: $crate::Cell),+>)? Default for Buffers $(<$($generic),+>)? {
                fn default() -> Self {
                    Self { $($field: Default::default(),)* }
                }
            }

            #[doc(hidden)]
            #[allow(missing_docs)]
            pub struct View $(<$($generic: $crate::Cell),+>)? {
                $($field: <$type as $crate::Cell>::View,)*
            }

            impl $(<$($generic: $crate::Cell),+>)? $crate::Cell for $name $(<$($generic),+>)? {
                type Buffers = Buffers $(<$($generic),+>)?;
                type View = View $(<$($generic),+>)?;

                const DOMAIN: &'static str = {
                    #[allow(unused_mut)]
                    let mut domain = concat!("" $(, $domain)?);
                    $(domain = $crate::either(domain, <$type as $crate::Cell>::DOMAIN);)*
                    domain
                };

                fn describe(at: &$crate::Place, columns: &mut Vec<$crate::ColumnSpec>) {
                    $({
                        #[allow(unused_mut, unused_assignments)]
                        let mut name = stringify!($field);
                        $(name = $prefix;)?
                        #[allow(unused_mut)]
                        let mut field = at.field(name, concat!($($doc),*));
                        $(field.unit = $unit;)?
                        $(field.frame = $frame;)?
                        $(field.since = $since;)?
                        $(field.formerly = $formerly.to_owned();)?
                        <$type as $crate::Cell>::describe(&field, columns);
                    })*
                }

                fn push(value: Option<&Self>, buffers: &mut Self::Buffers) {
                    $(<$type as $crate::Cell>::push(value.map(|value| &value.$field), &mut buffers.$field);)*
                }

                fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<$crate::arrow_array::ArrayRef>) {
                    $(<$type as $crate::Cell>::finish(&mut buffers.$field, arrays);)*
                }

                fn view(source: &mut $crate::ColumnSource<'_>, required: bool) -> Result<Self::View, $crate::ArtifactError> {
                    Ok(View { $($field: <$type as $crate::Cell>::view(source, required)?,)* })
                }

                fn get(view: &Self::View, row: usize) -> Option<Self> {
                    Some(Self { $($field: <$type as $crate::Cell>::get(&view.$field, row)?,)* })
                }
            }
        };
    };
}

/// Declares a table: a struct as [`columns!`] does, after its documentation `#[table("name", version = 1)]`, with
/// `formerly = "name"` where the table of a domain had another name in versions before.
#[macro_export]
macro_rules! table {
    (
        $(#[doc = $about:literal])*
        #[table($table:literal, version = $version:literal $(, formerly = $formerly:literal)?)]
        $(#[domain = $domain:literal])?
        $(#[derive($($derived:ident),*)])?
        pub struct $name:ident $(<$($generic:ident),+>)? { $($fields:tt)* }
    ) => {
        $crate::columns! {
            $(#[doc = $about])*
            $(#[domain = $domain])?
            $(#[derive($($derived),*)])?
            pub struct $name $(<$($generic),+>)? { $($fields)* }
        }

        impl $(<$($generic: $crate::Cell),+>)? $crate::Row for $name $(<$($generic),+>)? {
            const NAME: &'static str = $table;
            const VERSION: u32 = $version;
            const FORMERLY: &'static str = concat!("" $(, $formerly)?);

            fn description() -> String {
                $crate::trimmed(concat!($($about),*))
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_type_is_described_once() {
        // Descriptions are never freed: each batch that is read may not make them again.
        assert!(std::ptr::eq(columns_of::<Vec<f64>>(), columns_of::<Vec<f64>>()));
        assert!(!std::ptr::eq(columns_of::<u32>(), columns_of::<bool>()));
    }
}
