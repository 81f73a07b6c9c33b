//! What can go wrong with artifacts, and how each is fixed.

use re4_fault::Remedy;
use std::borrow::Cow;
use std::error::Error;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use crate::spec::ColumnKind;

/// Why an artifact could not be written, found or read.
#[derive(Debug, thiserror::Error, Remedy)]
#[non_exhaustive]
pub enum ArtifactError {
    /// The operating system refused an operation on a file or folder.
    #[error("cannot {operation} {path}: {}", explain(.source).0, path = .path.display())]
    #[remedy(explain(source).1.map(Cow::Borrowed))]
    Io {
        /// What was tried, as a verb phrase.
        operation: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The operating system's answer.
        source: io::Error,
    },
    /// A Parquet file could not be encoded or decoded though the operating system did its part.
    #[error("cannot {operation} {path}: {source}", path = .path.display())]
    Parquet {
        /// What was tried, as a verb phrase.
        operation: &'static str,
        /// The file.
        path: PathBuf,
        /// The encoder's or decoder's answer.
        source: parquet::errors::ParquetError,
    },
    /// A value has no JSON form.
    #[error("cannot describe a value as JSON: {source}")]
    Json {
        /// What the serializer said.
        source: serde_json::Error,
    },
    /// The bytes of a published artifact are not those that were published.
    #[error("artifact {folder} is damaged: {damage}", folder = .folder.display())]
    #[remedy("delete the folder {folder} and run again", folder = folder.display())]
    Damaged {
        /// Folder of the artifact.
        folder: PathBuf,
        /// What is wrong with which file.
        damage: Damage,
    },
    /// There is no folder to verify or open.
    #[error("cannot read artifact {folder}: there is no such folder", folder = .folder.display())]
    #[remedy("check the path, or run the stage that makes it")]
    NoFolder {
        /// The folder asked for.
        folder: PathBuf,
    },
    /// The folder has no manifest: another folder was named, or the manifest was lost. Nobody is told to delete it.
    #[error("cannot read artifact {folder}: it has no manifest.json", folder = .folder.display())]
    #[remedy("check the path, and where an artifact should be there, move the folder away and run again")]
    NoManifest {
        /// The folder asked for.
        folder: PathBuf,
    },
    /// The manifest was written by a newer build.
    #[error(
        "cannot read artifact {folder}: its manifest has format {found}, this build reads up to {supported}",
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
        "cannot read artifact {folder}: {table} table has schema version {found}, this build reads up to {supported}",
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
    /// Two keys share the first 16 digits, or a folder was renamed by hand.
    #[error("artifact {folder} belongs to key {found}, not to {expected}", folder = .folder.display())]
    #[remedy("move that folder away and run again")]
    OtherKey {
        /// Folder of the artifact.
        folder: PathBuf,
        /// Key looked for.
        expected: String,
        /// Key in the manifest.
        found: String,
    },
    /// An artifact holds no table of this name.
    #[error("artifact {folder} has no table {table}", folder = .folder.display())]
    #[remedy("it has {known}")]
    NoTable {
        /// Folder of the artifact.
        folder: PathBuf,
        /// The table asked for.
        table: String,
        /// The tables there are, separated by commas.
        known: String,
    },
    /// Rows offered to a table do not fit its description.
    #[error("cannot write table {table}: {reason}")]
    Rows {
        /// Name of the table.
        table: String,
        /// What does not fit.
        reason: String,
    },
    /// Rows asked for lie outside the table.
    #[error("cannot read rows {first}..{end} of {path}: the table has {rows} rows", path = .path.display())]
    OutOfRange {
        /// File of the table.
        path: PathBuf,
        /// First row asked for.
        first: u64,
        /// End of the rows asked for, exclusive.
        end: u64,
        /// Rows there are.
        rows: u64,
    },
    /// A table was begun and not finished, or begun twice, before publication.
    #[error("cannot publish {folder}: table {table} {reason}", folder = .folder.display())]
    Unfinished {
        /// The folder that was to be published.
        folder: PathBuf,
        /// Name of the table.
        table: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Another run published the same key with other bytes: some stage is not deterministic.
    #[error(
        "cannot publish {folder}: another run published the same key with different bytes in {what}",
        folder = .folder.display()
    )]
    #[remedy(
        "delete the folder {folder}, run again, and report it, for equal keys must give equal bytes",
        folder = folder.display()
    )]
    NotReproducible {
        /// Folder of the artifact.
        folder: PathBuf,
        /// What differs.
        what: String,
    },
    /// A batch lacks a column.
    #[error("table {table} has no column {column}")]
    #[remedy("it has {known}")]
    NoColumn {
        /// Name of the table, `?` when the rows do not say.
        table: String,
        /// The column asked for.
        column: String,
        /// The columns there are, separated by commas.
        known: String,
    },
    /// A column is of another kind than asked for.
    #[error("column {column} of table {table} holds {found}, not {expected}")]
    ColumnKind {
        /// Name of the table, `?` when the rows do not say.
        table: String,
        /// Name of the column.
        column: String,
        /// The kind asked for.
        expected: ColumnKind,
        /// The Arrow type found.
        found: String,
    },
    /// A column that was asked for as complete has nulls.
    #[error("column {column} of table {table} is null in row {row}")]
    #[remedy("read it as a column with nulls")]
    Null {
        /// Name of the table, `?` when the rows do not say.
        table: String,
        /// Name of the column.
        column: String,
        /// First row, of the rows at hand, that is null.
        row: usize,
    },
    /// A word of a column is none of those that it may have.
    #[error("column {column} of table {table} has the word {word:?}, which is none of {known}")]
    #[remedy("build the artifact again")]
    UnknownWord {
        /// Name of the table, `?` when the rows do not say.
        table: String,
        /// Name of the column.
        column: String,
        /// The word.
        word: String,
        /// Words that it may have, comma-separated.
        known: String,
    },
    /// A table holds the columns of another domain.
    #[error(
        "cannot read table {table} of {folder} as one of the domain {expected}: it is of the domain {found}",
        folder = .folder.display()
    )]
    #[remedy("name an artifact of a task in that domain")]
    OtherDomain {
        /// Folder of the artifact.
        folder: PathBuf,
        /// Name of the table.
        table: String,
        /// Domain asked for.
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

    /// Tells the operating system's refusals, which the user can fix, from the encoder's.
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

    pub(crate) fn damaged(folder: &Path, damage: Damage) -> Self {
        Self::Damaged {
            folder: folder.to_path_buf(),
            damage,
        }
    }
}

/// What an answer of the operating system means, and how to fix it.
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

/// What is wrong with the bytes of an artifact. Files are named relative to its folder.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Damage {
    /// A file is not there.
    Missing {
        /// The file.
        file: String,
    },
    /// A file has another length than published.
    Length {
        /// The file.
        file: String,
        /// Bytes published.
        expected: u64,
        /// Bytes found.
        found: u64,
    },
    /// A file has the right length and other bytes.
    Content {
        /// The file.
        file: String,
    },
    /// Something is there that was not published.
    Stray {
        /// The file or folder.
        file: String,
    },
    /// The manifest is no manifest.
    Manifest {
        /// What is wrong with it.
        reason: String,
    },
    /// A table says something else about itself than the manifest does.
    Table {
        /// The file.
        file: String,
        /// What disagrees.
        reason: String,
    },
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing { file } => write!(f, "{file} is missing"),
            Self::Length { file, expected, found } => {
                write!(f, "{file} has {found} bytes where {expected} were published")
            }
            Self::Content { file } => write!(f, "the content of {file} does not match its published hash"),
            Self::Stray { file } => write!(f, "{file} does not belong to it"),
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
    fn a_full_disk_is_told_from_a_broken_encoder() {
        let full = io::Error::from(io::ErrorKind::StorageFull);
        let path = Path::new("a/frames.parquet");
        let said = ArtifactError::parquet("write", path)(ParquetError::External(Box::new(full))).sentence();
        assert_eq!(
            said,
            "cannot write a/frames.parquet: the disk is full; free space there or choose another artifacts folder"
        );
        let broken = ArtifactError::parquet("read", path)(ParquetError::General("odd page".to_owned()));
        assert!(matches!(broken, ArtifactError::Parquet { .. }));
    }
}
