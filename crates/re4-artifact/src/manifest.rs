//! The manifest: what an artifact is, how it was made, and the hashes of its files.

use std::collections::BTreeMap;
use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::canonical::{canonical_compact, canonical_json, canonical_text};
use crate::error::{ArtifactError, Damage};
use crate::key::{Key, Recipe, key_of};
use crate::writer::ArtifactSummary;

/// The newest manifest format that this build reads. Artifacts in parts have it, others have [`FORMAT_OF_ONE_PART`].
pub const MANIFEST_FORMAT: u32 = 2;

/// The format of manifests of artifacts that are not in parts.
const FORMAT_OF_ONE_PART: u32 = 1;

/// Name of the manifest in the folder of an artifact.
pub const MANIFEST_NAME: &str = "manifest.json";

/// Name of the manifest in the folder of a part.
pub const PART_MANIFEST_NAME: &str = "part.json";

/// Folder of the parts in the folder of an artifact.
pub(crate) const PARTS: &str = "parts";

const HASH_FIELD: &str = "manifest_blake3";

/// The manifest of an artifact, `manifest.json`. Its bytes depend only on the recipe and on the content: keys are sorted, and
/// it contains no time, host name or absolute path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Manifest {
    /// Format of the manifest itself.
    pub format: u32,
    /// Stage that wrote the artifact.
    pub stage: String,
    /// Kind of artifact: `episodes`, `modes`, ...
    pub artifact: String,
    /// BLAKE3 over stage, code version, configuration, inputs and source hash; 64 hexadecimal digits.
    #[schemars(with = "String")]
    pub key: Key,
    /// Version of the stage's code.
    pub code_version: u32,
    /// Version of the program that wrote the artifact.
    pub tool_version: String,
    /// Configuration of the stage.
    pub config: Value,
    /// Keys of the artifacts that the stage read, by name.
    #[schemars(with = "BTreeMap<String, String>")]
    pub inputs: BTreeMap<String, Key>,
    /// BLAKE3 of the raw data that the stage read; null if it read none.
    #[schemars(with = "Option<String>")]
    pub source_blake3: Option<Key>,
    /// Description of the raw data (format, sizes, names); null if the stage read none.
    pub source: Value,
    /// Folder of the part that this manifest describes, such as `000012`; omitted in the manifest of a whole artifact.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<String>,
    /// Number of parts; omitted if the artifact is not in parts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parts: Option<u32>,
    /// The tables, by name.
    pub tables: BTreeMap<String, TableSummary>,
    /// Files that are not tables, such as weights, by name; omitted if there are none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub files: BTreeMap<String, FileSummary>,
    /// Figures that summarize the content.
    pub summary: Value,
    /// Structured warnings of the stage.
    pub warnings: Vec<Value>,
    /// BLAKE3 of this manifest in compact canonical JSON without this field; 64 hexadecimal digits.
    #[schemars(with = "String")]
    pub manifest_blake3: Key,
}

/// The manifest's entry for a table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TableSummary {
    /// File, relative to the folder of the artifact or, if the artifact is in parts, of each part.
    pub file: String,
    /// Version of the table's schema.
    pub schema_version: u32,
    /// Number of rows.
    pub rows: u64,
    /// Number of rows in each row group except the last, which may have fewer.
    pub row_group_rows: u64,
    /// Length of the file, or of all files, in bytes.
    pub bytes: u64,
    /// BLAKE3 of the file or, if there are several, of their hashes; 64 hexadecimal digits.
    #[schemars(with = "String")]
    pub blake3: Key,
    /// The files in the order of their rows, if the artifact is in parts; else omitted. Parts without rows of the table have no file.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<TablePart>,
}

/// The file of a table in one part of an artifact.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TablePart {
    /// Folder of the part in the folder `parts`, such as `000012`, or `dataset` for the tables that describe all parts.
    pub part: String,
    /// Number of rows.
    pub rows: u64,
    /// Length of the file in bytes.
    pub bytes: u64,
    /// BLAKE3 of the file; 64 hexadecimal digits.
    #[schemars(with = "String")]
    pub blake3: Key,
}

/// A file of a table, as its manifest lists it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct TableFile {
    /// Path relative to the folder of the artifact.
    pub(crate) file: String,
    /// Number of rows.
    pub(crate) rows: u64,
    /// Length in bytes.
    pub(crate) bytes: u64,
    /// Hash.
    pub(crate) blake3: Key,
}

impl TableSummary {
    /// The files of the table in the order of their rows.
    pub(crate) fn files(&self) -> Vec<TableFile> {
        if self.parts.is_empty() {
            return vec![TableFile {
                file: self.file.clone(),
                rows: self.rows,
                bytes: self.bytes,
                blake3: self.blake3,
            }];
        }
        let file = |part: &TablePart| TableFile {
            file: format!("{PARTS}/{}/{}", part.part, self.file),
            rows: part.rows,
            bytes: part.bytes,
            blake3: part.blake3,
        };
        self.parts.iter().map(file).collect()
    }
}

/// The manifest's entry for a file that is not a table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FileSummary {
    /// Length of the file in bytes.
    pub bytes: u64,
    /// BLAKE3 of the file; 64 hexadecimal digits.
    #[schemars(with = "String")]
    pub blake3: Key,
}

/// How a manifest relates to parts.
#[derive(Debug, Clone)]
pub(crate) enum Division {
    /// The artifact is not in parts.
    None,
    /// The manifest describes the part in this folder.
    Part(String),
    /// The manifest describes an artifact of so many parts.
    Into(u32),
}

impl Manifest {
    /// Name of the file.
    pub(crate) fn name(&self) -> &'static str {
        if self.part.is_some() {
            PART_MANIFEST_NAME
        } else {
            MANIFEST_NAME
        }
    }

    pub(crate) fn new(
        recipe: &Recipe,
        tables: BTreeMap<String, TableSummary>,
        files: BTreeMap<String, FileSummary>,
        summary: ArtifactSummary,
        division: Division,
    ) -> Result<Self, ArtifactError> {
        let source = recipe.raw_source();
        let (part, parts) = match division {
            Division::None => (None, None),
            Division::Part(part) => (Some(part), None),
            Division::Into(parts) => (None, Some(parts)),
        };
        let mut manifest = Self {
            format: if parts.is_some() {
                MANIFEST_FORMAT
            } else {
                FORMAT_OF_ONE_PART
            },
            stage: recipe.stage().as_str().to_owned(),
            artifact: recipe.stage().artifact().to_owned(),
            key: recipe.key(),
            code_version: recipe.code_version(),
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            config: recipe.config_json().clone(),
            inputs: recipe.inputs().clone(),
            source_blake3: source.map(|source| source.hash),
            source: source.map_or(Value::Null, |source| source.summary.clone()),
            part,
            parts,
            tables,
            files,
            summary: summary.summary,
            warnings: summary.warnings,
            manifest_blake3: Key::from_bytes([0; 32]),
        };
        manifest.manifest_blake3 = hash_of(&canonical_json(&manifest)?);
        Ok(manifest)
    }

    /// Returns the text of `manifest.json`.
    pub(crate) fn to_text(&self) -> Result<String, ArtifactError> {
        Ok(canonical_text(&canonical_json(self)?))
    }

    /// Reads the manifest of the artifact in `folder` and checks everything that does not need the tables: its own hash, its
    /// format, its key and the names of its files.
    pub(crate) fn read(folder: &Path, name: &'static str) -> Result<Self, ArtifactError> {
        let path = folder.join(name);
        let damaged = |damage| ArtifactError::damaged(folder, damage);
        let broken = |reason: &str| {
            damaged(Damage::Manifest {
                reason: reason.to_owned(),
            })
        };
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(ArtifactError::NoManifest {
                    folder: folder.to_path_buf(),
                });
            }
            Err(error) => return Err(ArtifactError::io("read", &path)(error)),
        };
        let value: Value = serde_json::from_slice(&bytes).map_err(|_| broken("is not valid JSON"))?;
        // Compared as text, because a flipped bit can also change the case of a hexadecimal digit.
        let stored = value.get(HASH_FIELD).and_then(Value::as_str);
        // The hash is checked before the format, so that a damaged format number is not reported as a newer build. The bytes are
        // compared as well, because the hash is computed from the parsed value and does not cover white space.
        if stored != Some(hash_of(&value).to_string().as_str()) || canonical_text(&value).as_bytes() != bytes {
            return Err(broken("does not match its own hash"));
        }
        let format = value.get("format").and_then(Value::as_u64).unwrap_or(0);
        if format > u64::from(MANIFEST_FORMAT) {
            return Err(ArtifactError::NewerManifest {
                folder: folder.to_path_buf(),
                found: format,
                supported: MANIFEST_FORMAT,
            });
        }
        let manifest: Self = serde_json::from_value(value).map_err(|error| {
            damaged(Damage::Manifest {
                reason: format!("is incomplete or malformed: {error}"),
            })
        })?;
        if manifest.key != manifest.recomputed_key() {
            return Err(broken("has a key that does not match its recipe"));
        }
        // Names are joined to the path of the folder, so they must not contain separators.
        if let Some((name, _)) = manifest.tables.iter().find(|(name, summary)| {
            let outside = |text: &str| text.contains(['/', '\\', '.']);
            let parts = summary
                .parts
                .iter()
                .any(|part| part.part.is_empty() || outside(&part.part));
            summary.file != format!("{name}.parquet") || name.contains(['/', '\\']) || parts
        }) {
            return Err(damaged(Damage::Manifest {
                reason: format!("refers to a file outside the artifact for table {name}"),
            }));
        }
        let rows_of = |summary: &TableSummary| {
            summary
                .parts
                .iter()
                .try_fold(0_u64, |sum, part| sum.checked_add(part.rows))
        };
        let unequal = |summary: &TableSummary| !summary.parts.is_empty() && rows_of(summary) != Some(summary.rows);
        if let Some((name, _)) = manifest.tables.iter().find(|(_, summary)| unequal(summary)) {
            return Err(damaged(Damage::Manifest {
                reason: format!("lists parts of table {name} that do not have the rows of the table"),
            }));
        }
        if let Some(name) = manifest.files.keys().find(|name| name.contains(['/', '\\'])) {
            return Err(damaged(Damage::Manifest {
                reason: format!("refers to a file outside the artifact, {name}"),
            }));
        }
        Ok(manifest)
    }

    fn recomputed_key(&self) -> Key {
        key_of(
            &self.stage,
            self.code_version,
            &self.config,
            &self.inputs,
            self.source_blake3.as_ref(),
        )
    }
}

/// Computes the BLAKE3 hash of a manifest without the field of the hash itself. It must stay the same in every future format, so
/// that any build can distinguish damage from a newer format.
fn hash_of(manifest: &Value) -> Key {
    let mut rest = manifest.clone();
    if let Value::Object(map) = &mut rest {
        map.remove(HASH_FIELD);
    }
    blake3::hash(canonical_compact(&rest).as_bytes()).into()
}
