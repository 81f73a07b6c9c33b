//! Reading artifacts: manifests, and verification of the files that they list.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use crate::disk::hash_file;
use crate::error::{ArtifactError, Damage};
use crate::key::Key;
use crate::manifest::{MANIFEST_NAME, Manifest, PARTS, TableFile, TableSummary};
use crate::remote::fetch_part_of;
use crate::spec::TableSpec;
use crate::table::Table;

/// An artifact that has been published.
#[derive(Debug, Clone)]
pub struct Artifact {
    path: PathBuf,
    manifest: Manifest,
}

impl Artifact {
    /// Opens the artifact in this folder and checks its manifest. The tables are not checked; use [`Artifact::verify_bytes`],
    /// [`crate::verify`] or [`crate::Store::lookup`] for that.
    ///
    /// # Errors
    /// [`ArtifactError::NoFolder`], [`ArtifactError::Damaged`], [`ArtifactError::NewerManifest`].
    pub fn open(path: &Path) -> Result<Self, ArtifactError> {
        if !path.is_dir() {
            return Err(ArtifactError::NoFolder {
                folder: path.to_path_buf(),
            });
        }
        Ok(Self {
            path: path.to_path_buf(),
            manifest: Manifest::read(path, MANIFEST_NAME)?,
        })
    }

    /// An artifact, or a part of one, with this manifest.
    pub(crate) fn with_manifest(path: PathBuf, manifest: Manifest) -> Self {
        Self { path, manifest }
    }

    /// Folder of the artifact.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The key: the hash of everything that determined the bytes of the artifact.
    pub fn key(&self) -> &Key {
        &self.manifest.key
    }

    /// Opens a table by its description in this build: columns that the file's version lacks are read as null.
    ///
    /// # Errors
    /// [`ArtifactError::NoTable`], [`ArtifactError::NewerTable`], [`ArtifactError::OtherDomain`], [`ArtifactError::Damaged`] if
    /// the file is missing or does not have the columns of its version, [`ArtifactError::Parquet`] if it cannot be decoded.
    pub fn table(&self, spec: &'static TableSpec) -> Result<Table, ArtifactError> {
        let summary = match self.under_former_name(spec) {
            Some(summary) => summary,
            None => self.summary(spec.name)?,
        };
        if summary.schema_version > spec.version {
            return Err(self.newer(spec.name, summary, spec.version));
        }
        Table::open(self, summary, Some(spec))
    }

    /// Returns whether the artifact has a table, under its present or its former name.
    pub fn has_table(&self, spec: &'static TableSpec) -> bool {
        self.manifest.tables.contains_key(spec.name) || self.under_former_name(spec).is_some()
    }

    /// The table under the name that it had in older versions.
    fn under_former_name(&self, spec: &'static TableSpec) -> Option<&TableSummary> {
        // A row type that several domains use declares the former name of the table of SE(3), such as `spatial_frames`. The tables of
        // the others always had their present names.
        let unchanged = matches!(spec.domain, "plane" | "arm") && spec.formerly.starts_with("spatial_");
        let summary = self.manifest.tables.get(spec.formerly).filter(|_| !unchanged)?;
        (summary.schema_version < spec.version).then_some(summary)
    }

    /// Opens a table by its name, with the columns of its file; for programs that display arbitrary artifacts.
    ///
    /// # Errors
    /// As [`Artifact::table`], except that any version and any domain is accepted.
    pub fn table_named(&self, name: &str) -> Result<Table, ArtifactError> {
        let summary = self.summary(name)?;
        Table::open(self, summary, None)
    }

    /// Checks every byte: each file of the manifest must exist with its published length and hash, and there must be no other
    /// file.
    ///
    /// # Errors
    /// [`ArtifactError::Damaged`], [`ArtifactError::Io`].
    pub fn verify_bytes(&self) -> Result<(), ArtifactError> {
        let mut expected: BTreeSet<String> = BTreeSet::from([self.manifest.name().to_owned()]);
        if self.in_parts() {
            self.verify_parts()?;
            expected.insert(PARTS.to_owned());
        } else {
            self.verify_files()?;
            expected.extend(self.manifest.tables.values().map(|summary| summary.file.clone()));
        }
        for (name, summary) in &self.manifest.files {
            self.verify_file(name, summary.bytes, &summary.blake3)?;
            expected.insert(name.clone());
        }
        let mut found = Vec::new();
        for entry in fs::read_dir(&self.path).map_err(ArtifactError::io("list", &self.path))? {
            let entry = entry.map_err(ArtifactError::io("list", &self.path))?;
            found.push(entry.file_name().to_string_lossy().into_owned());
        }
        found.sort();
        match found.into_iter().find(|name| !expected.contains(name)) {
            Some(file) => Err(ArtifactError::damaged(&self.path, Damage::Stray { file })),
            None => Ok(()),
        }
    }

    /// Checks every byte of one table, under its present or its former name.
    ///
    /// # Errors
    /// [`ArtifactError::NoTable`], [`ArtifactError::Damaged`], [`ArtifactError::Io`].
    pub fn verify_table(&self, spec: &'static TableSpec) -> Result<(), ArtifactError> {
        let summary = match self.under_former_name(spec) {
            Some(summary) => summary,
            None => self.summary(spec.name)?,
        };
        self.verify_files_of(summary)
    }

    /// Checks every byte of the files of all tables.
    pub(crate) fn verify_files(&self) -> Result<(), ArtifactError> {
        self.manifest
            .tables
            .values()
            .try_for_each(|summary| self.verify_files_of(summary))
    }

    fn verify_files_of(&self, summary: &TableSummary) -> Result<(), ArtifactError> {
        let verify = |file: TableFile| self.verify_file(&file.file, file.bytes, &file.blake3);
        summary.files().into_iter().try_for_each(verify)
    }

    fn verify_file(&self, file: &str, bytes: u64, blake3: &Key) -> Result<(), ArtifactError> {
        let path = self.path.join(file);
        if !path.exists() {
            fetch_part_of(&self.path, file)?;
        }
        let file = file.to_owned();
        let open = || File::open(&path).and_then(|file| file.metadata());
        let found = match fs::metadata(&path) {
            // That of the opened file, because network file systems look at a file anew when it is opened.
            Ok(metadata) if metadata.is_file() => open().map_err(ArtifactError::io("read", &path))?.len(),
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(ArtifactError::io("read", &path)(error));
            }
            _ => return Err(ArtifactError::damaged(&self.path, Damage::Missing { file })),
        };
        if found != bytes {
            let expected = bytes;
            let damage = Damage::Length { file, expected, found };
            return Err(ArtifactError::damaged(&self.path, damage));
        }
        if hash_file(&path).map_err(ArtifactError::io("read", &path))? != *blake3 {
            return Err(ArtifactError::damaged(&self.path, Damage::Content { file }));
        }
        Ok(())
    }

    fn summary(&self, table: &str) -> Result<&TableSummary, ArtifactError> {
        self.manifest.tables.get(table).ok_or_else(|| {
            let known: Vec<&str> = self.manifest.tables.keys().map(String::as_str).collect();
            ArtifactError::NoTable {
                folder: self.path.clone(),
                table: table.to_owned(),
                known: known.join(", "),
            }
        })
    }

    fn newer(&self, table: &str, summary: &TableSummary, supported: u32) -> ArtifactError {
        ArtifactError::NewerTable {
            folder: self.path.clone(),
            table: table.to_owned(),
            found: summary.schema_version,
            supported,
        }
    }
}
