//! Why a fetch stops.

use re4_fault::Remedy;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// A dataset that cannot be fetched.
#[derive(Debug, Error, Remedy)]
#[error("cannot fetch {dataset} from {url}: {fault}")]
#[remedy(fault.remedy())]
pub struct FetchError {
    /// Name of the dataset.
    pub dataset: String,
    /// Where it was to come from.
    pub url: String,
    /// What went wrong.
    #[source]
    pub fault: Fault,
}

/// What went wrong with a fetch.
#[derive(Debug, Error, Remedy)]
pub enum Fault {
    /// The built-in catalogue is broken.
    #[error("data/datasets.toml is not valid ({why})")]
    #[remedy("repair it and build again")]
    Catalogue {
        /// The parser's words.
        why: String,
    },
    /// A name that is not in the catalogue.
    #[error("there is no such dataset")]
    #[remedy("known are: {known}")]
    UnknownDataset {
        /// Names of the known datasets.
        known: String,
    },
    /// No connection, or none that works.
    #[error("the server cannot be reached ({why})")]
    #[remedy("check the network, or run this on another machine and copy what it fetches")]
    Unreachable {
        /// The network's words.
        why: String,
    },
    /// An address that is none.
    #[error("that is no address of a file on the web ({why})")]
    #[remedy("give one that starts with https://")]
    BadAddress {
        /// The parser's words.
        why: String,
    },
    /// The server refused.
    #[error("the server answered {status}")]
    #[remedy("{}", status_fix(*status))]
    Status {
        /// HTTP status.
        status: u16,
    },
    /// An answer that does not fit the request.
    #[error("the server's answer does not fit the request ({why})")]
    #[remedy("try again later, or give another address")]
    BadAnswer {
        /// What does not fit.
        why: String,
    },
    /// The connection ended early.
    #[error(
        "the connection broke after {received} of {} bytes ({why})",
        total.map_or("an unknown number of".to_owned(), |total| total.to_string())
    )]
    #[remedy("run the command again, it continues from there")]
    Interrupted {
        /// Bytes on disk.
        received: u64,
        /// Size of the file, if known.
        total: Option<u64>,
        /// The network's words.
        why: String,
    },
    /// A complete file of the wrong size.
    #[error("the file has {found} bytes and should have {expected}, so it was deleted")]
    #[remedy("run the command again, and if it stays so, give another address")]
    WrongSize {
        /// Size of the file.
        found: u64,
        /// Size in the catalogue.
        expected: u64,
    },
    /// A complete file of the wrong content.
    #[error("the file has SHA-256 {found} and should have {expected}, so it was deleted")]
    #[remedy("run the command again, and if it stays so, give another address")]
    WrongHash {
        /// Hash of the file.
        found: String,
        /// Hash in the catalogue.
        expected: String,
    },
    /// A file that is no zip, or a damaged one.
    #[error("the file is not a readable zip file ({why}), so it was deleted")]
    #[remedy("run the command again, and if it stays so, give another address")]
    UnreadableZip {
        /// The unpacker's words.
        why: String,
    },
    /// An entry that would be unpacked outside of the destination.
    #[error("entry {entry} of the zip file is a link or leads outside of it, so the file was deleted")]
    #[remedy("give another address")]
    UnsafeZipEntry {
        /// Name of the entry.
        entry: String,
    },
    /// A zip without the dataset.
    #[error("the zip file holds no {expected}, so it was deleted")]
    #[remedy("give the address of the right file")]
    Incomplete {
        /// What should be in it.
        expected: String,
    },
    /// Another fetch of the same dataset is running.
    #[error("another fetch is writing {}", part.display())]
    #[remedy("wait for it to end")]
    Busy {
        /// The part file.
        part: PathBuf,
    },
    /// The operating system refused something.
    #[error("cannot {action} {}: {source}", path.display())]
    #[remedy("{}", io_fix(source))]
    Io {
        /// What was tried, such as "write".
        action: &'static str,
        /// On which path.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
}

impl Fault {
    /// An error of the operating system.
    pub(crate) fn io(action: &'static str, path: &Path, source: io::Error) -> Self {
        Self::Io {
            action,
            path: path.to_owned(),
            source,
        }
    }
}

fn status_fix(status: u16) -> &'static str {
    match status {
        401 | 403 => "the file is not public, so give another address",
        404 | 410 => "the file has moved, so give its new address",
        429 | 500.. => "try again later",
        _ => "give another address",
    }
}

fn io_fix(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free some space and run the command again, it continues"
        }
        io::ErrorKind::ReadOnlyFilesystem => "choose a folder that can be written to",
        io::ErrorKind::PermissionDenied => "change its permissions or choose another folder",
        io::ErrorKind::NotADirectory | io::ErrorKind::AlreadyExists => "choose a folder as destination",
        _ => "check the disk and run the command again",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_the_system_name_the_path_and_the_fix() {
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
    fn statuses_have_their_fixes() {
        insta::assert_snapshot!(
            [400, 403, 404, 429, 503]
                .map(|status| Fault::Status { status }.sentence())
                .join("\n")
        );
    }
}
