//! Errors of a fetch, with remedies.

use re4_fault::Remedy;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// The error of a fetch: which dataset, from which URL, and what went wrong.
#[derive(Debug, Error, Remedy)]
#[error("cannot fetch {dataset} from {url}: {fault}")]
#[remedy(fault.remedy())]
pub struct FetchError {
    /// Name of the dataset.
    pub dataset: String,
    /// URL of the file.
    pub url: String,
    /// What went wrong.
    #[source]
    pub fault: Fault,
}

/// What went wrong in a fetch.
#[derive(Debug, Error, Remedy)]
pub enum Fault {
    /// The built-in catalogue is invalid.
    #[error("data/datasets.toml is not valid ({why})")]
    #[remedy("correct the file and build again")]
    Catalogue {
        /// Message of the parser.
        why: String,
    },
    /// The name is not in the catalogue.
    #[error("there is no such dataset")]
    #[remedy("use one of: {known}")]
    UnknownDataset {
        /// Names of the known datasets, separated by commas.
        known: String,
    },
    /// No connection to the server could be established.
    #[error("the server cannot be reached ({why})")]
    #[remedy("check the network, or run the command on another machine and copy the dataset")]
    Unreachable {
        /// Message of the network library.
        why: String,
    },
    /// The URL is not valid.
    #[error("the URL is not valid ({why})")]
    #[remedy("give a URL that starts with https://")]
    InvalidUrl {
        /// Message of the parser.
        why: String,
    },
    /// The server answered with an error status.
    #[error("the server answered {status}")]
    #[remedy("{}", status_remedy(*status))]
    Status {
        /// HTTP status.
        status: u16,
    },
    /// The server's answer does not match the request.
    #[error("the server's answer does not match the request ({why})")]
    #[remedy("try again later, or give another URL")]
    BadAnswer {
        /// The mismatch.
        why: String,
    },
    /// The connection was lost before the end of the file.
    #[error(
        "the connection was lost after {received} of {} bytes ({why})",
        total.map_or("an unknown number of".to_owned(), |total| total.to_string())
    )]
    #[remedy("run the command again to continue the download")]
    Interrupted {
        /// Number of bytes on disk.
        received: u64,
        /// Size of the file in bytes, if known.
        total: Option<u64>,
        /// Message of the network library.
        why: String,
    },
    /// The downloaded file has the wrong size.
    #[error("the file has {found} bytes and should have {expected}, so it was deleted")]
    #[remedy("run the command again; if the error persists, give another URL")]
    WrongSize {
        /// Size of the file.
        found: u64,
        /// Size in the catalogue.
        expected: u64,
    },
    /// The downloaded file has the wrong content.
    #[error("the file has SHA-256 {found} and should have {expected}, so it was deleted")]
    #[remedy("run the command again; if the error persists, give another URL")]
    WrongHash {
        /// Hash of the file.
        found: String,
        /// Hash in the catalogue.
        expected: String,
    },
    /// The downloaded file is not a zip file or is damaged.
    #[error("the file is not a readable zip file ({why}), so it was deleted")]
    #[remedy("run the command again; if the error persists, give another URL")]
    UnreadableZip {
        /// Message of the unpacker.
        why: String,
    },
    /// An entry of the zip file is a link, or its path is outside of the destination.
    #[error(
        "entry {entry} of the zip file is a link or its path is outside of the destination, so the file was deleted"
    )]
    #[remedy("give another URL")]
    UnsafeZipEntry {
        /// Name of the entry.
        entry: String,
    },
    /// The zip file does not contain the dataset.
    #[error("the zip file does not contain {expected}, so it was deleted")]
    #[remedy("give the URL of the right file")]
    Incomplete {
        /// Expected path in the zip file.
        expected: String,
    },
    /// Another fetch of the same dataset is running.
    #[error("another fetch is writing {}", part.display())]
    #[remedy("wait until it has finished")]
    Busy {
        /// The part file.
        part: PathBuf,
    },
    /// An operation on a file or folder failed.
    #[error("cannot {action} {}: {source}", path.display())]
    #[remedy("{}", io_remedy(source))]
    Io {
        /// The operation, such as "write".
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

impl Fault {
    /// Creates a [`Fault::Io`].
    pub(crate) fn io(action: &'static str, path: &Path, source: io::Error) -> Self {
        Self::Io {
            action,
            path: path.to_owned(),
            source,
        }
    }
}

fn status_remedy(status: u16) -> &'static str {
    match status {
        401 | 403 => "the file is not public, so give another URL",
        404 | 410 => "the file has moved, so give its new URL",
        429 | 500.. => "try again later",
        _ => "give another URL",
    }
}

fn io_remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free some space and run the command again to continue the download"
        }
        io::ErrorKind::ReadOnlyFilesystem => "choose a writable folder",
        io::ErrorKind::PermissionDenied => "change its permissions or choose another folder",
        io::ErrorKind::NotADirectory | io::ErrorKind::AlreadyExists => "give a folder as the destination",
        _ => "check the disk and run the command again",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn io_errors_name_the_path_and_the_remedy() {
        let kinds = [
            io::ErrorKind::StorageFull,
            io::ErrorKind::ReadOnlyFilesystem,
            io::ErrorKind::PermissionDenied,
            io::ErrorKind::NotADirectory,
            io::ErrorKind::Other,
        ];
        let sentences = kinds.map(|kind| Fault::io("write", Path::new("data/pusht.part"), kind.into()).sentence());
        insta::assert_snapshot!(sentences.join("\n"));
    }

    #[test]
    fn statuses_have_remedies() {
        insta::assert_snapshot!(
            [400, 403, 404, 429, 503]
                .map(|status| Fault::Status { status }.sentence())
                .join("\n")
        );
    }
}
