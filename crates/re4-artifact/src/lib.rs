//! Content-addressed artifacts: Parquet tables, manifests, hashes, atomic publication and the stage cache.
//!
//! An artifact is a folder `<root>/<artifact>/<first 16 digits of its key>` that contains `manifest.json`, one
//! `<table>.parquet` per table and, for some stages, other files such as weights. Its [`Key`] is the hash of everything that
//! determines its bytes (see [`Recipe`]). It is written to a temporary folder and renamed, so that it is either complete or
//! absent.
//!
//! To add a table, declare its rows with [`table!`]. To read a subset of the columns of a table, declare a struct with
//! [`columns!`].
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use re4_artifact::{ArtifactSummary, Recipe, Stage, Store, table};
//!
//! table! {
//!     /// One row per dimension.
//!     #[table("scales", version = 1)]
//!     pub struct ScaleRow {
//!         /// Name of the dimension.
//!         pub dimension: String,
//!         /// Maximum value.
//!         pub maximum: f64,
//!     }
//! }
//!
//! # let folder = tempfile::tempdir()?;
//! # let root = folder.path();
//! let store = Store::open(root)?;
//! let recipe = Recipe::new(Stage::Index, 1).config(&serde_json::json!({"angle": "periodic"}))?;
//! let artifact = match store.lookup(Stage::Index, &recipe.key())? {
//!     Some(found) => found,
//!     None => {
//!         let writer = store.begin(&recipe)?;
//!         writer.write_rows([ScaleRow { dimension: "eef_x".to_owned(), maximum: 500.0 }])?;
//!         writer.publish(ArtifactSummary::default())?
//!     }
//! };
//! let scales: Vec<ScaleRow> = artifact.read()?;
//! assert_eq!(scales[0].maximum, 500.0);
//! # Ok(())
//! # }
//! ```

mod canonical;
mod columns;
mod contained;
mod disk;
pub mod episodes;
mod error;
mod key;
mod manifest;
mod owner;
mod parts;
mod reader;
mod remote;
mod rows;
mod spec;
mod store;
mod table;
mod text;
mod transfer;
mod verify;
mod writer;

#[doc(hidden)]
pub use arrow_array;
pub use canonical::{canonical_json, canonical_text};
pub use columns::{
    Columns, col_binary, col_bool, col_f64, col_f64_list, col_f64_or_null, col_i64, col_text, col_u32, col_u32_or_null,
    col_u64,
};
pub use error::{ArtifactError, Damage};
pub use key::{Key, Recipe, Source, Stage};
pub use manifest::{
    FileSummary, MANIFEST_FORMAT, MANIFEST_NAME, Manifest, PART_MANIFEST_NAME, TablePart, TableSummary,
};
pub use parts::{Part, Shard};
pub use reader::Artifact;
pub use remote::{Listed, Put, Remote, RemoteError, attach, attached, fetch, fetch_all, fetch_folder};
pub use rows::{
    ByEpisode, Cell, ColumnSource, Label, Place, QUATERNION_PARTS, Row, RowWriter, RowsOf, SixAxis, Word, either,
    trimmed,
};
pub use spec::{ColumnKind, ColumnSpec, TableSpec, json_description};
pub use store::Store;
pub use table::{Batches, Table};
pub use text::cell_text;
pub use transfer::{pull_folder, push_folder};
pub use verify::{Described, VerifiedFile, VerifyReport, verify};
pub use writer::{ArtifactSummary, DEFAULT_ROW_GROUP_ROWS, TableWriter, Writer};
