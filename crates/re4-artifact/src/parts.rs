//! Artifacts in parts, which several processes on several machines make.
//!
//! A stage cuts a large artifact into parts by a constant number of demonstrations or rollouts, whatever the number of processes. A part
//! is the folder `parts/NNNNNN` in the folder of the artifact, with a file of each of its tables and the manifest `part.json`. The
//! tables that describe all parts are in `parts/dataset`. The manifest of the artifact is published last and lists the files of all
//! parts; without it, the artifact does not exist yet.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::disk::sync_folder;
use crate::error::{ArtifactError, Damage};
use crate::key::{Key, Recipe};
use crate::manifest::{Division, MANIFEST_NAME, Manifest, PART_MANIFEST_NAME, PARTS, TablePart, TableSummary};
use crate::reader::Artifact;
use crate::store::Store;
use crate::writer::{ArtifactSummary, Publication, Writer, same_bytes};

/// The part of the tables that describe all parts.
const DATASET: &str = "dataset";

/// A process's shard of the parts of an artifact: number `index` of `count` shares.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: u32,
    count: u32,
}

impl Shard {
    /// The parts of this shard, of `parts` parts. The shards of all indices cover every part once.
    pub fn parts(self, parts: u32) -> Range<u32> {
        let bound = |index: u32| (u64::from(parts) * u64::from(index) / u64::from(self.count)) as u32;
        bound(self.index)..bound(self.index + 1)
    }

    /// Number of shares.
    pub fn count(self) -> u32 {
        self.count
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refuse =
            || format!("{text:?} is not a shard: write index/count with an index from 0 to count - 1, such as 3/8");
        let (index, count) = text.split_once('/').ok_or_else(refuse)?;
        let digits = |text: &str| {
            text.bytes()
                .all(|byte| byte.is_ascii_digit())
                .then(|| text.parse::<u32>().ok())
                .flatten()
        };
        let (index, count) = digits(index).zip(digits(count)).ok_or_else(refuse)?;
        // The largest index plus one must not overflow.
        if index >= count || count == u32::MAX {
            return Err(refuse());
        }
        Ok(Self { index, count })
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

/// A part of an artifact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// The part with this number, from 0.
    Numbered(u32),
    /// The part with this number, with the rows of [`Part::Numbered`] but other running numbers, because fewer demonstrations than
    /// expected are in the parts before it.
    Renumbered(u32),
    /// The tables that describe all parts.
    Dataset,
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Numbered(number) => write!(f, "{number:06}"),
            Self::Renumbered(number) => write!(f, "{number:06}-renumbered"),
            Self::Dataset => f.write_str(DATASET),
        }
    }
}

impl Store {
    /// The folder of a part, whether it exists or not.
    pub fn part_folder(&self, recipe: &Recipe, part: Part) -> PathBuf {
        self.folder(recipe.stage(), &recipe.key())
            .join(PARTS)
            .join(part.to_string())
    }

    /// Returns a part of the artifact of this recipe if it has been published, after checking its manifest. If the store is the cache of
    /// an object store, the part is downloaded or uploaded if one of them lacks it.
    ///
    /// # Errors
    /// [`ArtifactError::Damaged`] if the manifest is damaged or belongs to another part, [`ArtifactError::OtherKey`] if it belongs to
    /// another artifact.
    pub fn part(&self, recipe: &Recipe, part: Part) -> Result<Option<Artifact>, ArtifactError> {
        self.pull(&self.part_folder(recipe, part), PART_MANIFEST_NAME)?;
        let found = self.part_here(recipe, part)?;
        if let Some(part) = &found {
            self.push(part.path(), PART_MANIFEST_NAME)?;
        }
        Ok(found)
    }

    /// Those of the numbered parts of the artifact of this recipe that have not been published. If the store is the cache of an object
    /// store, parts are uploaded if that lacks them, but not downloaded.
    ///
    /// # Errors
    /// As [`Store::part`], for parts that are in the folder of the store.
    pub fn missing_parts(&self, recipe: &Recipe, numbers: Range<u32>) -> Result<Vec<u32>, ArtifactError> {
        let mut missing = Vec::new();
        for number in numbers {
            match self.part_here(recipe, Part::Numbered(number))? {
                Some(part) => self.push(part.path(), PART_MANIFEST_NAME)?,
                None => missing.push(number),
            }
        }
        let folder = |number| self.part_folder(recipe, Part::Numbered(number));
        self.not_remote(missing, folder, PART_MANIFEST_NAME)
    }

    /// [`Store::part`] in the folder of the store alone.
    pub(crate) fn part_here(&self, recipe: &Recipe, part: Part) -> Result<Option<Artifact>, ArtifactError> {
        let folder = self.part_folder(recipe, part);
        match fs::symlink_metadata(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(ArtifactError::io("access", &folder)(error)),
            Ok(_) => Artifact::open_part(&folder, &part.to_string(), &recipe.key()).map(Some),
        }
    }

    /// Starts writing a part.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] if the folder cannot be created.
    pub fn begin_part(&self, recipe: &Recipe, part: Part) -> Result<Writer, ArtifactError> {
        Writer::of_part(self, recipe, part)
    }

    /// Publishes the manifest of an artifact whose parts have been published: `numbered`, in order, and [`Part::Dataset`] if it exists.
    ///
    /// # Errors
    /// [`ArtifactError::Damaged`] if a part is missing or does not fit the others, [`ArtifactError::NotReproducible`] if another process
    /// published another manifest.
    pub fn merge(
        &self,
        recipe: &Recipe,
        numbered: &[Artifact],
        dataset: Option<&Artifact>,
        summary: ArtifactSummary,
    ) -> Result<Artifact, ArtifactError> {
        let folder = self.folder(recipe.stage(), &recipe.key());
        let mut tables: BTreeMap<String, TableSummary> = BTreeMap::new();
        for part in numbered.iter().chain(dataset) {
            for (name, of_part) in &part.manifest().tables {
                add(&mut tables, name, part, of_part)?;
            }
        }
        for table in tables.values_mut() {
            let mut hasher = blake3::Hasher::new();
            for part in &table.parts {
                hasher.update(part.blake3.as_bytes());
            }
            table.blake3 = hasher.finalize().into();
        }
        let manifest = Manifest::new(
            recipe,
            tables,
            BTreeMap::new(),
            summary,
            Division::Into(numbered.len() as u32),
        )?;
        let artifact = self.publish_manifest(&folder, &manifest)?;
        self.push(&folder, MANIFEST_NAME)?;
        Ok(artifact)
    }

    /// Publishes the manifest by a hard link, which does not replace an existing file.
    pub(crate) fn publish_manifest(&self, folder: &Path, manifest: &Manifest) -> Result<Artifact, ArtifactError> {
        let path = folder.join(MANIFEST_NAME);
        let write = |error| ArtifactError::io("write", &path)(error);
        let _publication = Publication::wait();
        let temporary = self.temporary("manifest").map_err(write)?;
        let file = temporary.path().join(MANIFEST_NAME);
        let text = manifest.to_text()?;
        File::create_new(&file)
            .and_then(|mut file| {
                file.write_all(text.as_bytes())?;
                file.sync_all()
            })
            .map_err(write)?;
        let published = match fs::hard_link(&file, &path) {
            // The file system has no hard links. Every writer of this name writes the same bytes, or the comparison below fails.
            Err(error) if !path.exists() && error.kind() != io::ErrorKind::NotFound => fs::rename(&file, &path),
            linked => linked,
        };
        drop(temporary);
        match published {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            published => published.map_err(write)?,
        }
        sync_folder(folder)?;
        same_bytes(Artifact::open(folder)?, manifest)
    }
}

/// Adds a part of a table to the entry of the whole table.
fn add(
    tables: &mut BTreeMap<String, TableSummary>,
    name: &str,
    part: &Artifact,
    of_part: &TableSummary,
) -> Result<(), ArtifactError> {
    let entry = tables.entry(name.to_owned()).or_insert_with(|| TableSummary {
        rows: 0,
        bytes: 0,
        parts: Vec::new(),
        ..of_part.clone()
    });
    if (entry.schema_version, entry.row_group_rows) != (of_part.schema_version, of_part.row_group_rows) {
        let reason = format!("has a table {name} that does not fit those of the other parts");
        return Err(ArtifactError::damaged(part.path(), Damage::Manifest { reason }));
    }
    entry.rows += of_part.rows;
    entry.bytes += of_part.bytes;
    entry.parts.push(TablePart {
        part: part.manifest().part.clone().unwrap_or_default(),
        rows: of_part.rows,
        bytes: of_part.bytes,
        blake3: of_part.blake3,
    });
    Ok(())
}

impl Artifact {
    /// Opens the part in this folder.
    fn open_part(folder: &Path, part: &str, key: &Key) -> Result<Self, ArtifactError> {
        let manifest = Manifest::read(folder, PART_MANIFEST_NAME)?;
        if manifest.part.as_deref() != Some(part) {
            let reason = "belongs to another part".to_owned();
            return Err(ArtifactError::damaged(folder, Damage::Manifest { reason }));
        }
        if manifest.key != *key {
            return Err(ArtifactError::OtherKey {
                folder: folder.to_path_buf(),
                expected: key.to_string(),
                found: manifest.key.to_string(),
            });
        }
        Ok(Self::with_manifest(folder.to_path_buf(), manifest))
    }

    /// Whether the artifact is in parts.
    pub fn in_parts(&self) -> bool {
        self.manifest().parts.is_some()
    }

    /// Number of parts; 1 if the artifact is not in parts.
    pub fn parts(&self) -> u32 {
        self.manifest().parts.unwrap_or(1)
    }

    /// The tables of one part and those that describe all parts, as an artifact. Running numbers, such as those of demonstrations, are
    /// those of the whole artifact. The files of the part are verified, those of other parts are not read. An artifact that is not in parts
    /// is returned as it is.
    ///
    /// # Errors
    /// [`ArtifactError::Damaged`] if a file differs from what was published.
    pub fn part(&self, number: u32) -> Result<Self, ArtifactError> {
        if !self.in_parts() {
            return Ok(self.clone());
        }
        let own = [Part::Numbered(number), Part::Renumbered(number), Part::Dataset].map(|part| part.to_string());
        let mut manifest = self.manifest().clone();
        manifest.tables.retain(|_, table| {
            table.parts.retain(|part| own.contains(&part.part));
            table.rows = table.parts.iter().map(|part| part.rows).sum();
            table.bytes = table.parts.iter().map(|part| part.bytes).sum();
            !table.parts.is_empty()
        });
        let part = Self::with_manifest(self.path().to_path_buf(), manifest);
        part.verify_files()?;
        Ok(part)
    }

    /// The part without some of its tables, for an artifact whose part [`Part::Dataset`] has them for all parts.
    #[must_use]
    pub fn without(self, tables: &[&str]) -> Self {
        let mut manifest = self.manifest().clone();
        manifest.tables.retain(|name, _| !tables.contains(&name.as_str()));
        Self::with_manifest(self.path().to_path_buf(), manifest)
    }

    /// Checks every byte of the files of an artifact in parts, and that the folders of its parts contain no other files. Folders of parts
    /// that the manifest does not list are left alone: a process that was late may have written them.
    pub(crate) fn verify_parts(&self) -> Result<(), ArtifactError> {
        self.verify_files()?;
        let of_tables = self.manifest().tables.values().flat_map(|table| &table.parts);
        let parts: BTreeSet<&str> = of_tables.map(|part| part.part.as_str()).collect();
        for part in parts {
            let folder = self.path().join(PARTS).join(part);
            // A part may have tables that the artifact does not list, because another part has them for all parts.
            let own = Self::open_part(&folder, part, self.key())?;
            let files: Vec<&str> = own.manifest().tables.values().map(|table| &*table.file).collect();
            for entry in fs::read_dir(&folder).map_err(ArtifactError::io("list", &folder))? {
                let name = entry.map_err(ArtifactError::io("list", &folder))?.file_name();
                let name = name.to_string_lossy();
                if name != PART_MANIFEST_NAME && !files.contains(&&*name) {
                    let file = format!("{PARTS}/{part}/{name}");
                    return Err(ArtifactError::damaged(self.path(), Damage::Stray { file }));
                }
            }
        }
        Ok(())
    }
}
