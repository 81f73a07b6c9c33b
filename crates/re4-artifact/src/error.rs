//! Errors of artifacts, with remedies.

use re4_fault::Remedy;
use std::borrow::Cow;
use std::error::Error;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use crate::remote::RemoteError;
use crate::spec::ColumnKind;

/// An error while writing, finding or reading an artifact.
#[derive(Debug, thiserror::Error, Remedy)]
#[non_exhaustive]
pub enum ArtifactError {
    /// An operation on a file or folder failed.
    #[error("cannot {operation} {path}: {}", explain(.source).0, path = .path.display())]
    #[remedy(explain(source).1.map(Cow::Borrowed))]
    Io {
        /// The operation, as a verb phrase.
        operation: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A Parquet file could not be encoded or decoded, and the reason is not an I/O error.
    #[error("cannot {operation} {path}: {source}", path = .path.display())]
    Parquet {
        /// The operation, as a verb phrase.
        operation: &'static str,
        /// The file.
        path: PathBuf,
        /// The error of the encoder or decoder.
        source: parquet::errors::ParquetError,
    },
    /// A value cannot be represented in JSON.
    #[error("cannot convert a value to JSON: {source}")]
    Json {
        /// The error of the serializer.
        source: serde_json::Error,
    },
    /// The files of an artifact differ from what was published.
    #[error("artifact {folder} is damaged: {damage}", folder = .folder.display())]
    #[remedy("delete the folder {folder} and run again", folder = folder.display())]
    Damaged {
        /// Folder of the artifact.
        folder: PathBuf,
        /// What is wrong with which file.
        damage: Damage,
    },
    /// The folder of the artifact does not exist.
    #[error("cannot read artifact {folder}: the folder does not exist", folder = .folder.display())]
    #[remedy("check the path, or run the stage that produces the artifact")]
    NoFolder {
        /// The requested folder.
        folder: PathBuf,
    },
    /// The folder has no manifest: either the path is wrong or the manifest was lost. The remedy does not suggest deleting the
    /// folder, because it may not be an artifact.
    #[error("cannot read artifact {folder}: it has no manifest.json", folder = .folder.display())]
    #[remedy("check the path, or, if it is the folder of an artifact, move it away and run again")]
    NoManifest {
        /// The requested folder.
        folder: PathBuf,
    },
    /// The manifest was written by a newer build.
    #[error(
        "cannot read artifact {folder}: its manifest has format {found}, but this build reads formats up to {supported}",
        folder = .folder.display()
    )]
    #[remedy("update re4-pipe")]
    NewerManifest {
        /// Folder of the artifact.
        folder: PathBuf,
        /// Format in the manifest.
        found: u64,
        /// Newest format that this build reads.
        supported: u32,
    },
    /// A table was written by a newer build.
    #[error(
        "cannot read artifact {folder}: table {table} has schema version {found}, but this build reads versions up to {supported}",
        folder = .folder.display()
    )]
    #[remedy("update re4-pipe")]
    NewerTable {
        /// Folder of the artifact.
        folder: PathBuf,
        /// Name of the table.
        table: String,
        /// Schema version in the manifest.
        found: u32,
        /// Newest version that this build reads.
        supported: u32,
    },
    /// The folder belongs to another key: two keys have the same first 16 digits, or a folder was renamed by hand.
    #[error("artifact {folder} belongs to key {found}, not to {expected}", folder = .folder.display())]
    #[remedy("move that folder away and run again")]
    OtherKey {
        /// Folder of the artifact.
        folder: PathBuf,
        /// The requested key.
        expected: String,
        /// Key in the manifest.
        found: String,
    },
    /// An artifact has no table with this name.
    #[error("artifact {folder} has no table {table}", folder = .folder.display())]
    #[remedy("use one of its tables: {known}")]
    NoTable {
        /// Folder of the artifact.
        folder: PathBuf,
        /// Name of the requested table.
        table: String,
        /// Names of the tables of the artifact, separated by commas.
        known: String,
    },
    /// The columns given to a table do not match its description.
    #[error("cannot write table {table}: {reason}")]
    Rows {
        /// Name of the table.
        table: String,
        /// The difference.
        reason: String,
    },
    /// Requested rows are outside the table.
    #[error("cannot read rows {first}..{end} of {path}: the table has {rows} rows", path = .path.display())]
    OutOfRange {
        /// File of the table.
        path: PathBuf,
        /// First requested row.
        first: u64,
        /// End of the requested rows, exclusive.
        end: u64,
        /// Number of rows of the table.
        rows: u64,
    },
    /// A table was not finished before publication, or was started twice.
    #[error("cannot publish {folder}: table {table} {reason}", folder = .folder.display())]
    Unfinished {
        /// The final folder of the artifact.
        folder: PathBuf,
        /// Name of the table.
        table: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Another run published the same key with other bytes: a stage is not deterministic.
    #[error(
        "cannot publish {folder}: another run published the same key with different bytes in {what}",
        folder = .folder.display()
    )]
    #[remedy(
        "delete the folder {folder}, run again, and report a bug, because equal keys must give equal bytes",
        folder = folder.display()
    )]
    NotReproducible {
        /// Folder of the artifact.
        folder: PathBuf,
        /// What differs.
        what: String,
    },
    /// A table or batch lacks a column.
    #[error("table {table} has no column {column}")]
    #[remedy("use one of its columns: {known}")]
    NoColumn {
        /// Name of the table, `?` if the batch does not contain it.
        table: String,
        /// Name of the requested column.
        column: String,
        /// Names of the columns of the table, separated by commas.
        known: String,
    },
    /// A column has another type than requested.
    #[error("column {column} of table {table} has type {found}, not {expected}")]
    ColumnKind {
        /// Name of the table, `?` if the batch does not contain it.
        table: String,
        /// Name of the column.
        column: String,
        /// The requested type.
        expected: ColumnKind,
        /// The Arrow type of the column.
        found: String,
    },
    /// A column that was requested without nulls has nulls.
    #[error("column {column} of table {table} is null in row {row}")]
    #[remedy("read it as a nullable column")]
    Null {
        /// Name of the table, `?` if the batch does not contain it.
        table: String,
        /// Name of the column.
        column: String,
        /// First row that is null, counted from the first row of the batch.
        row: usize,
    },
    /// A column has a word that its type does not define.
    #[error("column {column} of table {table} has the unknown value {word:?} (known are {known})")]
    #[remedy("build the artifact again")]
    UnknownWord {
        /// Name of the table, `?` if the batch does not contain it.
        table: String,
        /// Name of the column.
        column: String,
        /// The word.
        word: String,
        /// The words of the column's type, separated by commas.
        known: String,
    },
    /// An object store did not answer, or refused.
    #[error("cannot {operation} {object}: {source}")]
    #[remedy(source.remedy.map(Cow::Borrowed))]
    Remote {
        /// The operation, as a verb.
        operation: &'static str,
        /// Address of the object.
        object: String,
        /// The reason.
        source: RemoteError,
    },
    /// A table has the columns of another domain.
    #[error(
        "cannot read table {table} of {folder} as a table of the domain {expected}: it belongs to the domain {found}",
        folder = .folder.display()
    )]
    #[remedy("give an artifact of a task in the domain {expected}")]
    OtherDomain {
        /// Folder of the artifact.
        folder: PathBuf,
        /// Name of the table.
        table: String,
        /// The requested domain.
        expected: &'static str,
        /// Domain of the file.
        found: String,
    },
}

impl ArtifactError {
    pub(crate) fn io(operation: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io {
            operation,
            path,
            source,
        }
    }

    /// Converts an error of the encoder or decoder. If an error of the operating system caused it, which the user can often fix,
    /// the result is [`ArtifactError::Io`].
    pub(crate) fn parquet(operation: &'static str, path: &Path) -> impl FnOnce(parquet::errors::ParquetError) -> Self {
        let path = path.to_path_buf();
        move |source| {
            let mut cause: Option<&(dyn Error + 'static)> = Some(&source);
            while let Some(error) = cause {
                if let Some(io) = error.downcast_ref::<io::Error>() {
                    let source = io.raw_os_error().map_or_else(
                        || io::Error::new(io.kind(), io.to_string()),
                        io::Error::from_raw_os_error,
                    );
                    return Self::Io {
                        operation,
                        path,
                        source,
                    };
                }
                cause = error.source();
            }
            Self::Parquet {
                operation,
                path,
                source,
            }
        }
    }

    /// The same error about a manifest, for one that is at another place than it was read from.
    pub(crate) fn at(self, place: &Path) -> Self {
        let folder = place.to_path_buf();
        match self {
            Self::Damaged { damage, .. } => Self::Damaged { folder, damage },
            Self::NewerManifest { found, supported, .. } => Self::NewerManifest {
                folder,
                found,
                supported,
            },
            other => other,
        }
    }

    pub(crate) fn damaged(folder: &Path, damage: Damage) -> Self {
        Self::Damaged {
            folder: folder.to_path_buf(),
            damage,
        }
    }
}

/// Returns a description of an error of the operating system and, if there is one, its remedy.
fn explain(error: &io::Error) -> (String, Option<&'static str>) {
    let (what, remedy) = match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => (
            "the disk is full",
            "free space there or choose another artifacts folder",
        ),
        io::ErrorKind::ReadOnlyFilesystem => (
            "the file system is read-only",
            "choose an artifacts folder that can be written",
        ),
        io::ErrorKind::PermissionDenied => (
            "permission denied",
            "give yourself write permission there or choose another artifacts folder",
        ),
        io::ErrorKind::NotConnected | io::ErrorKind::ConnectionAborted => (
            "its file system is no longer mounted",
            "mount it again and run the same command",
        ),
        io::ErrorKind::NotFound => {
            return (
                error.to_string(),
                Some("check the path, or choose another artifacts folder"),
            );
        }
        _ => return (error.to_string(), None),
    };
    (what.to_owned(), Some(remedy))
}

/// How the files of an artifact differ from what was published. Paths are relative to its folder.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Damage {
    /// A file does not exist.
    Missing {
        /// The file.
        file: String,
    },
    /// A file has another length than published.
    Length {
        /// The file.
        file: String,
        /// Published length in bytes.
        expected: u64,
        /// Present length in bytes.
        found: u64,
    },
    /// A file has the published length, but other bytes.
    Content {
        /// The file.
        file: String,
    },
    /// The folder contains something that was not published.
    Stray {
        /// The file or folder.
        file: String,
    },
    /// The manifest is invalid.
    Manifest {
        /// The reason, as a verb phrase.
        reason: String,
    },
    /// The metadata of a table differ from the manifest or from the table's description.
    Table {
        /// The file.
        file: String,
        /// The difference, as a verb phrase.
        reason: String,
    },
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing { file } => write!(f, "{file} is missing"),
            Self::Length { file, expected, found } => {
                write!(f, "{file} has {found} bytes, but {expected} were published")
            }
            Self::Content { file } => write!(f, "the content of {file} does not match its published hash"),
            Self::Stray { file } => write!(f, "{file} is not part of it"),
            Self::Manifest { reason } => write!(f, "manifest.json {reason}"),
            Self::Table { file, reason } => write!(f, "{file} {reason}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::errors::ParquetError;

    #[test]
    fn errors_of_the_system_are_distinguished_from_those_of_an_encoder() {
        let full = io::Error::from(io::ErrorKind::StorageFull);
        let path = Path::new("a/frames.parquet");
        let message = ArtifactError::parquet("write", path)(ParquetError::External(Box::new(full))).sentence();
        assert_eq!(
            message,
            "cannot write a/frames.parquet: the disk is full; free space there or choose another artifacts folder"
        );
        let lost = io::Error::from(io::ErrorKind::NotConnected);
        let message = ArtifactError::io("read", path)(lost).sentence();
        assert_eq!(
            message,
            "cannot read a/frames.parquet: its file system is no longer mounted; mount it again and run the same command"
        );
        let broken = ArtifactError::parquet("read", path)(ParquetError::General("odd page".to_owned()));
        assert!(matches!(broken, ArtifactError::Parquet { .. }));
    }
}
