//! Typed rows: a table is declared once, as a struct. Its schema, its writer and its readers are derived from the declaration.
//!
//! The type of a field is a [`Cell`], which is stored as one column (a number, a flag, a word) or as several columns (a pose).
//! Names of columns are derived from names of fields: `object: Pose2` is stored as `object_x`, `object_y` and `object_theta`. The
//! doc comments of the struct and of its fields are the descriptions of the table and of its columns in files and schemas, so
//! they are written for users of the data.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use re4_artifact::{ArtifactSummary, Recipe, Row as _, Stage, Store, columns, table};
//! use re4_geometry::Pose2;
//!
//! table! {
//!     /// One row per frame of a demonstration.
//!     #[table("example", version = 2)]
//!     pub struct ExampleRow {
//!         /// Number of the demonstration, from 0.
//!         pub episode: u32,
//!         /// Pose of the object.
//!         #[frame = "world"]
//!         pub object: Pose2,
//!         /// Speed of the end effector; null if it was not recorded.
//!         #[unit = "px/s"]
//!         #[since = 2]
//!         pub speed: Option<f64>,
//!     }
//! }
//!
//! columns! {
//!     /// A subset of the columns, for a reader that does not need the others. Names and types are those of the table.
//!     pub struct ObjectPose {
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
//! let poses: Vec<ObjectPose> = artifact.table(ExampleRow::table())?.read()?;
//! assert_eq!(poses[0].object.theta, 0.5);
//! let rows: Vec<ExampleRow> = artifact.read()?;
//! assert_eq!(rows[0].speed, None);
//! # Ok(())
//! # }
//! ```

mod by_episode;
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

pub use by_episode::ByEpisode;
pub use cells::{Label, Word};
pub use poses::{QUATERNION_PARTS, SixAxis};
pub use read::RowsOf;
pub use write::RowWriter;

/// A value that is stored in one or more columns of a row.
///
/// Implemented for numbers, flags, text, bytes, lists, [`Word`]s, [`Label`]s, poses and points; for `Option` of any of these,
/// whose columns are nullable; for arrays, whose columns are numbered; and for structs declared with
/// [`columns!`](crate::columns!).
pub trait Cell: Sized + 'static {
    /// Builders of the columns.
    type Buffers: Default;
    /// The columns of a batch, converted for access by row.
    type View;

    /// Domain of the columns: `plane` (SE(2)) or `space` (SE(3)); "" if they are common to all domains.
    const DOMAIN: &'static str = "";

    /// Appends the descriptions of the columns. `at` is the position of the value in the table.
    fn describe(at: &Place, columns: &mut Vec<ColumnSpec>);

    /// Appends a value to the builders, or nulls for `None`.
    fn push(value: Option<&Self>, buffers: &mut Self::Buffers);

    /// Converts the builders to arrays, in the order of the descriptions, and empties them.
    fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<ArrayRef>);

    /// Takes the columns from a batch.
    ///
    /// # Errors
    /// [`ArtifactError::NoColumn`], [`ArtifactError::ColumnKind`], [`ArtifactError::UnknownWord`], and, if the value is
    /// `required` but null in some row, [`ArtifactError::Null`].
    fn view(source: &mut ColumnSource<'_>, required: bool) -> Result<Self::View, ArtifactError>;

    /// Returns the value of a row, `None` if it is null.
    fn get(view: &Self::View, row: usize) -> Option<Self>;
}

/// The row type of a table, declared with [`table!`](crate::table!).
pub trait Row: Cell {
    /// Name of the table.
    const NAME: &'static str;
    /// Version of its schema.
    const VERSION: u32;
    /// Name of the table in earlier versions; "" if it was the same.
    const FORMERLY: &'static str;

    /// Description of the table: the doc comment of the row type.
    fn description() -> String;

    /// Returns the description of the table and its columns.
    fn table() -> &'static TableSpec {
        static KNOWN: Known<&'static TableSpec> = Mutex::new(BTreeMap::new());
        once::<Self, _>(&KNOWN, || {
            // Leaked only once per row type, as `once` caches the result.
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

/// Cache of one value per type. A map is needed because a static inside a generic function is shared by all its instances.
type Known<T> = Mutex<BTreeMap<TypeId, T>>;

/// Returns the cached value of type `C`. The first call creates it, and it is kept until the process exits. If several threads
/// create it at the same time, all get the value of the first one.
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

/// Returns the descriptions of the columns of a type.
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

/// The position of a cell in a table: the name and description of its column, or the prefix of the names of its columns.
#[derive(Debug, Clone, Default)]
pub struct Place {
    /// Name of the column, or prefix of the names of the columns; empty for the row itself.
    pub name: String,
    /// Description of the value.
    pub description: String,
    /// Unit; "" if there is none or the type determines it.
    pub unit: &'static str,
    /// Frame of reference; "" for none.
    pub frame: &'static str,
    /// Whether the value may be null.
    pub nullable: bool,
    /// First version of the table with this value; 0 means 1.
    pub since: u32,
    /// Name or prefix in earlier versions; empty if it was the same.
    pub formerly: String,
}

impl Place {
    /// Returns the position of a field of the struct at this position. With an empty name, the columns of the field get no
    /// prefix.
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

    /// Returns the position of a part of the value at this position. The description is that of the whole value followed by
    /// `words`, as in "Pose of the object: quaternion w."
    #[must_use]
    pub fn part(&self, name: &str, words: &str) -> Self {
        let whole = self.description.strip_suffix('.').unwrap_or(&self.description);
        Self {
            description: format!("{whole}: {words}."),
            ..self.field(name, "")
        }
    }

    /// Returns the description of the column at this position.
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

/// Returns `domain`, or `other` if `domain` is empty. [`columns!`](crate::columns!) uses it to derive the domain of a struct from
/// its fields.
#[must_use]
pub const fn either(domain: &'static str, other: &'static str) -> &'static str {
    if domain.is_empty() { other } else { domain }
}

/// Joins the lines of a doc comment: white space is collapsed and removed at both ends.
#[must_use]
pub fn trimmed(lines: &str) -> String {
    lines.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Iterates over the columns of a batch in the order in which a type describes them.
pub struct ColumnSource<'a> {
    batch: &'a RecordBatch,
    columns: std::slice::Iter<'static, ColumnSpec>,
}

impl<'a> ColumnSource<'a> {
    /// Creates a source of the columns of `C`.
    #[must_use]
    pub fn new<C: Cell>(batch: &'a RecordBatch) -> Self {
        Self {
            batch,
            columns: columns_of::<C>().iter(),
        }
    }

    /// Returns the next column, as an array of type `A`.
    fn next<A: Clone + 'static>(&mut self, required: bool) -> Result<(A, ColumnSpec), ArtifactError> {
        let (array, spec) = self.any(required)?;
        let typed = array.as_any().downcast_ref::<A>().cloned();
        typed
            .map(|typed| (typed, spec))
            .ok_or_else(|| crate::columns::wrong_kind(self.batch, spec.name, array, spec.kind))
    }

    /// Returns the next column, as an array of any type.
    fn any(&mut self, required: bool) -> Result<(&'a ArrayRef, ColumnSpec), ArtifactError> {
        // A correct `Cell` takes as many columns as it describes. The fallback makes an incorrect one fail with a `NoColumn`
        // error.
        let spec = self.columns.next().copied();
        let spec = spec.unwrap_or(ColumnSpec::new("", ColumnKind::F64, ""));
        let array = column(self.batch, spec.name)?;
        if required {
            complete(self.batch, spec.name, array.as_ref())?;
        }
        Ok((array, spec))
    }
}

/// Declares a struct whose fields are columns of a table.
///
/// Use it for a group of columns that several tables share, and for a reader that needs a subset of the columns of a table. Every
/// field must be `pub` and its type must implement [`Cell`](crate::Cell).
///
/// Each field may have these attributes, in this order, between its doc comment and its name:
///
/// * `#[unit = "m"]`: unit. Poses and points have a default unit.
/// * `#[frame = "world"]`: frame of reference.
/// * `#[since = 2]`: first version of the table with this field. The type must be an `Option`; it is `None` in rows of older
///   versions.
/// * `#[formerly = "name"]`: name of the field in earlier versions of the table.
/// * `#[prefix = "name"]`: prefix of the names of its columns, instead of the name of the field. With `""` the columns of a
///   nested struct keep their own names.
///
/// The struct may have `#[domain = "plane"]` or `#[domain = "space"]` and then `#[derive(...)]` below its doc comment. A domain
/// is needed only if no field determines it; poses and points do. `Debug`, `Clone` and `PartialEq` are always derived.
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

/// Declares a table: a struct as for [`columns!`], with `#[table("name", version = 1)]` directly below its doc comment.
///
/// The struct implements [`Row`](crate::Row). Raise `version` when a field is added or renamed. `formerly = "name"` after the
/// version is the name of the table in earlier versions, if it was another one; for a row type of both domains it is that of the
/// table of the domain `space`.
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
    fn descriptions_are_cached_by_type() {
        // Descriptions are leaked, so reading another batch must not create them again.
        assert!(std::ptr::eq(columns_of::<Vec<f64>>(), columns_of::<Vec<f64>>()));
        assert!(!std::ptr::eq(columns_of::<u32>(), columns_of::<bool>()));
    }
}
