//! Download of datasets and weights. Downloads can be resumed, size and hash are checked, and files are installed atomically.

mod catalogue;
mod download;
mod error;
mod unpack;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

pub use catalogue::{Dataset, Form, catalogue, find};
pub use error::{Fault, FetchError};

use download::Download;

/// Result of a fetch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FetchReport {
    /// Name of the dataset.
    pub dataset: String,
    /// Path of the dataset.
    pub path: PathBuf,
    /// Whether it was downloaded.
    pub outcome: Outcome,
}

/// Whether a dataset was downloaded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// The dataset already existed; nothing was downloaded.
    AlreadyThere,
    /// The dataset was downloaded and installed.
    Fetched {
        /// Size of the downloaded file in bytes.
        bytes: u64,
        /// Number of bytes that an earlier, interrupted fetch had already downloaded.
        resumed_from: u64,
        /// SHA-256 of the downloaded file, in hexadecimal.
        sha256: String,
        /// Whether the SHA-256 was compared with one in the catalogue.
        verified: bool,
    },
}

/// Downloads a dataset to `<destination>/<name>.part`, checks it, unpacks it if it is a zip file, and moves it to
/// `<destination>/<provides>`.
///
/// The part file of an interrupted fetch is continued if the server supports it and the remote file has not changed; otherwise
/// the download starts again. An existing dataset is not changed. `progress` is called with the number of bytes on disk and the
/// size of the file, if the server reports it.
///
/// # Errors
/// See [`Fault`]. An incomplete dataset is never left at its final path. At most a part file is left, which the next fetch
/// continues.
pub fn fetch(
    dataset: &Dataset,
    destination: &Path,
    progress: &mut dyn FnMut(u64, Option<u64>),
) -> Result<FetchReport, FetchError> {
    fetch_checked(dataset, destination, progress).map_err(|fault| FetchError {
        dataset: dataset.name.clone(),
        url: dataset.url.clone(),
        fault,
    })
}

fn fetch_checked(
    dataset: &Dataset,
    destination: &Path,
    progress: &mut dyn FnMut(u64, Option<u64>),
) -> Result<FetchReport, Fault> {
    let path = destination.join(&dataset.provides);
    let report = |outcome| FetchReport {
        dataset: dataset.name.clone(),
        path: path.clone(),
        outcome,
    };
    match fs::symlink_metadata(&path) {
        Ok(_) => return Ok(report(Outcome::AlreadyThere)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(Fault::io("access", &path, error)),
    }
    fs::create_dir_all(destination).map_err(|error| Fault::io("create", destination, error))?;

    let download = Download::new(dataset, destination);
    // `_part` keeps the lock of the part file until the dataset is installed.
    let (resumed_from, _part) = match download.run(progress) {
        Ok(done) => done,
        // The part file belongs to the other fetch.
        Err(fault @ Fault::Busy { .. }) => return Err(fault),
        Err(fault) => {
            download.discard_if_empty()?;
            return Err(fault);
        }
    };
    let checked = download.check(dataset).and_then(|(bytes, sha256)| {
        match dataset.form {
            Form::Zip => unpack::unpack(&download.part, destination, Path::new(&dataset.provides))?,
            Form::File => unpack::put(&download.part, &path)?,
        }
        Ok(report(Outcome::Fetched {
            bytes,
            resumed_from,
            sha256,
            verified: dataset.sha256.is_some(),
        }))
    });
    match &checked {
        // The part file is deleted after success, and if its content is wrong, so that the next fetch does not continue it. After
        // other errors, such as a full disk, the content may be right and is kept.
        Ok(_)
        | Err(
            Fault::WrongSize { .. }
            | Fault::WrongHash { .. }
            | Fault::UnreadableZip { .. }
            | Fault::UnsafeZipEntry { .. }
            | Fault::Incomplete { .. },
        ) => {
            download.discard()?;
        }
        Err(_) => {}
    }
    checked
}
