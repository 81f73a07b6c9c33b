//! Complete verification of an artifact.

use std::path::{Path, PathBuf};

use crate::error::ArtifactError;
use crate::key::Key;
use crate::manifest::{MANIFEST_NAME, Manifest};
use crate::reader::Artifact;
use crate::spec::TableSpec;

/// The files that a successful verification checked.
#[derive(Debug, Clone, PartialEq)]
pub struct VerifyReport {
    /// Folder of the artifact.
    pub folder: PathBuf,
    /// Its manifest.
    pub manifest: Manifest,
    /// Its files, the manifest first.
    pub files: Vec<VerifiedFile>,
}

/// A file that matches its published hash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VerifiedFile {
    /// Name relative to the folder.
    pub file: String,
    /// Length in bytes.
    pub bytes: u64,
    /// Number of rows if the file is a table.
    pub rows: Option<u64>,
    /// BLAKE3 hash of the file; for the manifest, the hash in its field `manifest_blake3`.
    pub blake3: Key,
}

/// Looks up the description of an artifact's table by the name of the table; `None` if the table is unknown.
pub type Described<'a> = &'a dyn Fn(&Artifact, &str) -> Option<&'static TableSpec>;

/// Verifies an artifact completely.
///
/// Checks the hash, format and key of the manifest, the length and hash of every file, and that there are no other files. Decodes
/// every table and compares its rows and columns with the manifest and with the table's description.
///
/// # Errors
/// [`ArtifactError::NoFolder`], [`ArtifactError::Damaged`] naming the file, [`ArtifactError::NewerManifest`],
/// [`ArtifactError::NewerTable`], [`ArtifactError::Io`].
pub fn verify(path: &Path, described: Described<'_>) -> Result<VerifyReport, ArtifactError> {
    let artifact = Artifact::open(path)?;
    artifact.verify_bytes()?;
    let manifest = artifact.manifest();
    let manifest_path = path.join(MANIFEST_NAME);
    let manifest_bytes = std::fs::metadata(&manifest_path).map_err(ArtifactError::io("read", &manifest_path))?;
    let mut files = vec![VerifiedFile {
        file: MANIFEST_NAME.to_owned(),
        bytes: manifest_bytes.len(),
        rows: None,
        blake3: manifest.manifest_blake3,
    }];
    for (name, summary) in &manifest.tables {
        let table = match described(&artifact, name) {
            Some(spec) => artifact.table(spec)?,
            None => artifact.table_named(name)?,
        };
        for batch in table.batches()? {
            batch?;
        }
        files.extend(summary.files().into_iter().map(|file| VerifiedFile {
            file: file.file,
            bytes: file.bytes,
            rows: Some(file.rows),
            blake3: file.blake3,
        }));
    }
    for (name, summary) in &manifest.files {
        files.push(VerifiedFile {
            file: name.clone(),
            bytes: summary.bytes,
            rows: None,
            blake3: summary.blake3,
        });
    }
    Ok(VerifyReport {
        folder: path.to_path_buf(),
        manifest: manifest.clone(),
        files,
    })
}
