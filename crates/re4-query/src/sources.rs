//! The artifacts that a query reads.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactError, Key, MANIFEST_NAME, TableSpec};
use re4_fault::{OrFault as _, bail, ensure, fault};

use crate::about;

/// Column of every table: the artifact that the row comes from, as kind and first 16 digits of the key, such as
/// `rollouts/07bd4a2ea5c1ad8f`.
pub const ARTIFACT: &str = "artifact";

/// Column of every table: the `episodes` artifact that the row's artifact was made from, in the form of [`ARTIFACT`]; null if its
/// manifest names none.
pub const DATASET: &str = "dataset";

/// Artifacts, opened for queries.
#[derive(Debug)]
pub struct Sources {
    pub(crate) entries: Vec<Entry>,
    specs: Vec<&'static TableSpec>,
}

/// An artifact and its names in tables.
#[derive(Debug)]
pub(crate) struct Entry {
    pub(crate) artifact: Artifact,
    /// Value of [`ARTIFACT`].
    pub(crate) name: String,
    /// Value of [`DATASET`].
    pub(crate) dataset: Option<String>,
}

impl Entry {
    fn new(artifact: Artifact) -> Self {
        let manifest = artifact.manifest();
        let name = name_of(&manifest.artifact, &manifest.key);
        let dataset = match manifest.inputs.get("episodes") {
            Some(key) => Some(name_of("episodes", key)),
            None => (manifest.artifact == "episodes").then(|| name.clone()),
        };
        Self {
            artifact,
            name,
            dataset,
        }
    }
}

/// Kind and first 16 digits of the key, as in the path of an artifact.
fn name_of(kind: &str, key: &Key) -> String {
    format!("{kind}/{}", key.short())
}

impl Sources {
    /// Opens artifacts and checks their manifests. An argument is the folder of an artifact, a folder that contains artifacts directly
    /// or one level deeper, or a pattern with `*`, `?` or `[...]` for such folders. An artifact that several arguments match is opened
    /// once. Tables are described by `specs`; tables that are not described are ignored.
    ///
    /// # Errors
    /// If an argument matches no artifact, or an artifact cannot be opened.
    pub fn open(arguments: &[PathBuf], specs: Vec<&'static TableSpec>) -> Result<Self> {
        let mut folders = Vec::new();
        for argument in arguments {
            folders.extend(folders_of(argument)?);
        }
        let opened: Vec<Result<Artifact, ArtifactError>> =
            folders.par_iter().map(|folder| Artifact::open(folder)).collect();
        let mut keys = BTreeSet::new();
        let mut entries = Vec::new();
        for artifact in opened {
            let artifact = artifact?;
            if keys.insert(artifact.key().to_string()) {
                entries.push(Entry::new(artifact));
            }
        }
        Ok(Self { entries, specs })
    }

    /// Number of artifacts.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there are no artifacts.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The descriptions of the tables with a name, in the order of preference of a file that does not state its domain.
    pub(crate) fn specs_of(&self, table: &str) -> Vec<&'static TableSpec> {
        let mut found: Vec<_> = self.specs.iter().copied().filter(|spec| spec.name == table).collect();
        found.sort_by_key(|spec| spec.domain);
        found
    }

    /// Whether an artifact has a table with this name.
    pub(crate) fn has(&self, table: &str) -> bool {
        let specs = self.specs_of(table);
        let mut artifacts = self.entries.iter().map(|entry| &entry.artifact);
        artifacts.any(|artifact| specs.iter().any(|spec| artifact.has_table(spec)))
    }

    /// Names of the tables that the artifacts have, sorted.
    pub(crate) fn tables(&self) -> BTreeSet<&'static str> {
        let names: BTreeSet<&str> = self.specs.iter().map(|spec| spec.name).collect();
        names.into_iter().filter(|name| self.has(name)).collect()
    }

    /// The error for a table that no artifact has.
    pub(crate) fn no_table(&self, name: &str) -> anyhow::Error {
        let known: Vec<&str> = self.tables().into_iter().collect();
        let what = if self.len() == 1 {
            "the artifact"
        } else {
            "the artifacts"
        };
        fault!(
            "there is no table {name} in {what}";
            "use one of {}, or one of {} about the artifacts themselves, or give other artifacts",
            known.join(", "),
            about::TABLES.join(", ")
        )
        .into()
    }
}

/// The folders of artifacts that an argument means, sorted.
fn folders_of(argument: &Path) -> Result<Vec<PathBuf>> {
    if argument.is_dir() {
        let found = artifacts_in(argument)?;
        ensure!(
            !found.is_empty(),
            "there is no artifact in {}", argument.display();
            "give the folder of an artifact, or a folder of artifacts such as artifacts/rollouts"
        );
        return Ok(found);
    }
    if argument.exists() {
        bail!(
            "cannot query {}: it is not the folder of an artifact", argument.display();
            "give a folder such as artifacts/rollouts/KEY"
        );
    }
    let text = argument.to_string_lossy();
    if !text.contains(['*', '?', '[']) {
        return Err(ArtifactError::NoFolder {
            folder: argument.to_path_buf(),
        }
        .into());
    }
    let matches = glob::glob(&text).or_fault(|| fault!("{text} is not a valid pattern"; "use *, ? and [abc]"))?;
    let mut found = Vec::new();
    for path in matches {
        let path = path.or_fault(|| fault!("cannot list the folders that match {text}"; "check the permissions"))?;
        if path.is_dir() {
            found.extend(artifacts_in(&path)?);
        }
    }
    ensure!(
        !found.is_empty(),
        "no artifact matches {text}";
        "give a pattern of folders such as 'artifacts/rollouts/*', in quotes"
    );
    Ok(found)
}

/// The folder itself if it is an artifact, otherwise the artifacts in it and in its folders.
fn artifacts_in(folder: &Path) -> Result<Vec<PathBuf>> {
    if folder.join(MANIFEST_NAME).exists() {
        return Ok(vec![folder.to_path_buf()]);
    }
    let mut found = Vec::new();
    for child in folders_in(folder)? {
        if child.join(MANIFEST_NAME).exists() {
            found.push(child);
        } else {
            let below = folders_in(&child)?;
            found.extend(below.into_iter().filter(|path| path.join(MANIFEST_NAME).exists()));
        }
    }
    Ok(found)
}

/// The visible folders in a folder, sorted. Unfinished artifacts have names that start with a dot.
fn folders_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let unreadable = || fault!("cannot list the folder {}", folder.display(); "check its permissions");
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).or_fault(unreadable)? {
        let entry = entry.or_fault(unreadable)?;
        let hidden = entry.file_name().to_string_lossy().starts_with('.');
        let folder = match entry.file_type() {
            Ok(kind) if !kind.is_symlink() => kind.is_dir(),
            _ => entry.path().is_dir(),
        };
        if !hidden && folder {
            found.push(entry.path());
        }
    }
    found.sort();
    Ok(found)
}
