//! Download of datasets and weights: resumable, size and hash checked, put in place whole or not at all.

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

/// What a fetch did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FetchReport {
    /// Name of the dataset.
    pub dataset: String,
    /// Where the dataset lies.
    pub path: PathBuf,
    /// What happened.
    pub outcome: Outcome,
}

/// How a dataset came to be where it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// It was there already; nothing was downloaded.
    AlreadyThere,
    /// It was downloaded and put in place.
    Fetched {
        /// Bytes of the downloaded file.
        bytes: u64,
        /// Bytes of it that an earlier, interrupted fetch had left.
        resumed_from: u64,
        /// SHA-256 of the downloaded file, in hexadecimal.
        sha256: String,
        /// Whether the catalogue holds a SHA-256, which then was equal.
        verified: bool,
    },
}

/// Downloads a dataset to `<destination>/<name>.part`, checks it, unpacks it if it is a zip file, and puts
/// it at `<destination>/<provides>`.
///
/// A part file of an interrupted fetch is continued if the server allows it and its file has not changed, else the
/// download starts again. A dataset that is there already is left as it is. `progress` is called with the bytes on disk
/// and the size of the file, if the server tells it.
///
/// # Errors
/// See [`Fault`]. The destination never holds half a dataset; what is left is at most a part file, which the next fetch
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
        Err(error) => return Err(Fault::io("look at", &path, error)),
    }
    fs::create_dir_all(destination).map_err(|error| Fault::io("create", destination, error))?;

    let download = Download::new(dataset, destination);
    let (resumed_from, _part) = match download.run(progress) {
        Ok(done) => done,
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
        // A file that is wrong must not be continued by the next fetch; a full disk says nothing about the file.
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
