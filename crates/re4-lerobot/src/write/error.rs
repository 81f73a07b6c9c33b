//! Errors of writing a dataset.

use std::borrow::Cow;
use std::io;
use std::path::PathBuf;

use parquet::errors::ParquetError;
use re4_fault::Remedy;
use thiserror::Error;

use crate::fault::LerobotError;

/// Why a dataset cannot be written. Nothing remains at the path of the dataset.
#[derive(Debug, Error)]
pub enum WriteError {
    /// Something exists at the path.
    #[error("cannot write the dataset {}: that path exists and is not an empty folder", path.display())]
    Exists {
        /// The path of the dataset.
        path: PathBuf,
    },
    /// An operation of the operating system failed.
    #[error("cannot write the dataset {}: cannot {action}{}: {}", path.display(), of_file(file), reason(source))]
    Io {
        /// The path of the dataset.
        path: PathBuf,
        /// The operation, such as "write".
        action: &'static str,
        /// The file relative to the dataset; empty for the dataset itself.
        file: String,
        /// The error.
        source: io::Error,
    },
    /// A value that a dataset cannot contain.
    #[error("cannot write the dataset {}: episode {episode}, {feature}: {what}", path.display())]
    Value {
        /// The path of the dataset.
        path: PathBuf,
        /// Number of the episode in the dataset, from 0.
        episode: usize,
        /// Name of the feature.
        feature: String,
        /// What is wrong.
        what: String,
        /// How to fix it.
        fix: &'static str,
    },
    /// The declaration of the features is wrong.
    #[error("cannot write the dataset {}: feature {feature}: {what}", path.display())]
    Feature {
        /// The path of the dataset.
        path: PathBuf,
        /// Name of the feature.
        feature: String,
        /// What is wrong.
        what: &'static str,
    },
    /// No episode was given.
    #[error("cannot write the dataset {}: there is no episode", path.display())]
    Empty {
        /// The path of the dataset.
        path: PathBuf,
    },
    /// The reader of this crate refuses the written files.
    #[error("cannot write the dataset {}: the written files cannot be read: {source}", path.display())]
    Unreadable {
        /// The path of the dataset.
        path: PathBuf,
        /// The faults.
        source: Box<LerobotError>,
    },
    /// The caller requested a stop.
    #[error("cannot write the dataset {}: the export was stopped", path.display())]
    Stopped {
        /// The path of the dataset.
        path: PathBuf,
    },
}

impl Remedy for WriteError {
    fn remedy(&self) -> Option<Cow<'_, str>> {
        let fixed = match self {
            Self::Exists { .. } => "remove it, or give another path",
            Self::Io { source, .. } => io_fix(source),
            Self::Value { fix, .. } => fix,
            Self::Feature { .. } => "give it another name",
            Self::Empty { .. } => "choose at least one episode",
            Self::Unreadable { .. } => "report this as a bug of re4-pipe",
            Self::Stopped { .. } => "run again",
        };
        Some(Cow::Borrowed(fixed))
    }
}

fn of_file(file: &str) -> String {
    if file.is_empty() {
        String::new()
    } else {
        format!(" {file}")
    }
}

/// The error without the path of a temporary folder, which means nothing to the user.
fn reason(error: &io::Error) -> String {
    error.raw_os_error().map_or_else(
        || error.to_string(),
        |code| io::Error::from_raw_os_error(code).to_string(),
    )
}

fn io_fix(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => "give a path that you may write to",
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "free some space, or give a path on a larger disk",
        io::ErrorKind::NotFound => "create the folder in which it is to be written, or give another path",
        io::ErrorKind::NotADirectory => "give a path inside a folder",
        _ => "check the disk, then run again",
    }
}

/// The error of the operating system inside one of the Parquet library.
pub(super) fn io_error(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(source) => match source.downcast::<io::Error>() {
            Ok(source) => *source,
            Err(source) => io::Error::other(source.to_string()),
        },
        // The library passes on only the text of most errors of files.
        other => io::Error::other(other.to_string()),
    }
}
