//! Making artifacts in parts: as one process, as one of several, or by merging what others have made.

use std::cell::OnceCell;
use std::path::{Path, PathBuf};

use anyhow::Result;
use re4_artifact::{Artifact, ArtifactSummary, Part, Recipe, Shard, Stage, Store, Writer};
use re4_fault::Remedy;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::interrupt::Interrupt;

/// Demonstrations per part of artifacts that are made from demonstrations. Part of the code version of the stages: other numbers give
/// other files.
pub(crate) const DEMOS_IN_PART: usize = 256;

/// Number of parts of `items`, `in_part` in each but the last.
pub(crate) fn parts_of(items: usize, in_part: usize) -> u32 {
    items.div_ceil(in_part).max(1) as u32
}

/// What a process makes of the artifact of a stage. Earlier stages are made whole.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Share {
    /// All parts that do not exist yet, and the manifest.
    #[default]
    Whole,
    /// Some of the parts of this stage's artifact, and no manifest.
    Parts(Stage, Shard),
    /// Only the manifest of this stage's artifact, from parts that exist.
    Merge(Stage),
    /// Nothing of this stage's artifact. It is only found out what exists of it.
    Look(Stage),
    /// Only manifests, of the artifacts of all stages, from parts that exist.
    Existing,
}

/// A [`Share`] for the worker process.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum ShareText {
    Whole,
    Parts(String, String),
    Merge(String),
    Look(String),
    Existing,
}

impl Serialize for Share {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let text = match self {
            Self::Whole => ShareText::Whole,
            Self::Parts(stage, shard) => ShareText::Parts(stage.to_string(), shard.to_string()),
            Self::Merge(stage) => ShareText::Merge(stage.to_string()),
            Self::Look(stage) => ShareText::Look(stage.to_string()),
            Self::Existing => ShareText::Existing,
        };
        text.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Share {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        use serde::de::Error as _;
        let stage = |name: &str| Stage::from_name(name).ok_or_else(|| D::Error::custom("unknown stage"));
        Ok(match ShareText::deserialize(deserializer)? {
            ShareText::Whole => Self::Whole,
            ShareText::Parts(name, shard) => Self::Parts(stage(&name)?, shard.parse().map_err(D::Error::custom)?),
            ShareText::Merge(name) => Self::Merge(stage(&name)?),
            ShareText::Look(name) => Self::Look(stage(&name)?),
            ShareText::Existing => Self::Existing,
        })
    }
}

/// Why a process ends before the artifact of its stage is complete, although nothing failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Partly {
    /// The process has made its shard of the parts.
    #[error("made {made} of the parts {first}..{end} of {}", artifact.display())]
    Made {
        /// Name of the stage.
        stage: String,
        /// Folder of the artifact.
        artifact: PathBuf,
        /// Number of parts of the artifact.
        parts: u32,
        /// First part of the share.
        first: u32,
        /// End of the share, exclusive.
        end: u32,
        /// Number of parts that this process made. The others existed.
        made: u32,
    },
    /// Parts are missing, or none is but the artifact was not to be merged.
    #[error("cannot merge {}: {} of its {parts} parts are missing: {}", artifact.display(), missing.len(), ranges(missing))]
    Missing {
        /// Name of the stage.
        stage: String,
        /// Folder of the artifact.
        artifact: PathBuf,
        /// Number of parts of the artifact.
        parts: u32,
        /// Numbers of the missing parts.
        missing: Vec<u32>,
        /// Number of demonstrations of the dataset, if they are to be ingested in one part.
        #[serde(default)]
        demos: Option<u64>,
    },
    /// The process has run its shard of a suite.
    #[error("{}", of_cells(suite, cells, *all, *parts, [*first, *end], failed))]
    Ran {
        /// The suite file.
        suite: PathBuf,
        /// Number of cells of the suite.
        all: u32,
        /// Number of parts of the rollouts of all cells.
        parts: u32,
        /// First part of the shard.
        first: u32,
        /// End of the shard, exclusive.
        end: u32,
        /// The cells of which the shard has parts.
        cells: Vec<String>,
        /// Those of them that cannot run.
        failed: Vec<String>,
    },
    /// Rollouts of cells are missing.
    #[error("cannot compare the cells of {}: the rollouts of {} of its {all} cells are missing: {}", suite.display(), cells.len(), cells.join(", "))]
    MissingCells {
        /// The suite file.
        suite: PathBuf,
        /// Number of cells of the suite.
        all: u32,
        /// The cells, each with the numbers of its missing parts if it has several.
        cells: Vec<String>,
    },
}

impl Partly {
    /// The same error, with the number of demonstrations that are to be ingested in one part. Parts of later artifacts depend on it.
    pub(crate) fn of_demos(error: anyhow::Error, number: usize) -> anyhow::Error {
        match error.downcast::<Self>() {
            Ok(mut partly) => {
                if let Self::Missing { demos, .. } = &mut partly {
                    *demos = Some(number as u64);
                }
                partly.into()
            }
            Err(error) => error,
        }
    }

    /// Whether this is an error: parts are missing. Otherwise the process has done its shard.
    pub fn is_missing(&self) -> bool {
        matches!(self, Self::Missing { .. } | Self::MissingCells { .. })
    }
}

fn of_cells(suite: &Path, cells: &[String], all: u32, parts: u32, own: [u32; 2], failed: &[String]) -> String {
    let [start, end] = own;
    let mut text = format!(
        "ran the parts {start}..{end} of {parts} of {}: {} of its {all} cells",
        suite.display(),
        cells.len()
    );
    for (before, names) in [(": ", cells), ("; cannot run: ", failed)] {
        if !names.is_empty() {
            text += before;
            text += &names.join(", ");
        }
    }
    text
}

impl Remedy for Partly {
    fn remedy(&self) -> Option<std::borrow::Cow<'_, str>> {
        match self {
            Self::Made { .. } | Self::Ran { .. } => None,
            Self::MissingCells { suite, .. } => Some(
                format!(
                    "run them with re4-pipe compare {0} and --shard, or run re4-pipe compare {0} to run all that is missing",
                    suite.display()
                )
                .into(),
            ),
            Self::Missing { stage, .. } => Some(
                format!(
                    "make them with re4-pipe {stage} and --shard, or run re4-pipe {stage} to make all that is missing"
                )
                .into(),
            ),
        }
    }
}

/// Numbers in ascending order as ranges with their last number, such as `3, 7-9`.
pub(crate) fn ranges(numbers: &[u32]) -> String {
    let mut texts: Vec<String> = Vec::new();
    for run in numbers.chunk_by(|a, b| a + 1 == *b) {
        texts.push(match run {
            [first, .., last] => format!("{first}-{last}"),
            [only] => only.to_string(),
            [] => continue,
        });
    }
    texts.join(", ")
}

impl Share {
    /// Whether no part of the artifact of a stage is made.
    pub(crate) fn makes_none(self, stage: Stage) -> bool {
        self == Self::Existing || self == Self::Merge(stage) || self == Self::Look(stage)
    }

    /// Whether a process with this shard builds the artifact of `stage` if it has only one part. If not, the error says so.
    pub(crate) fn builds_whole(self, store: &Store, recipe: &Recipe) -> Result<()> {
        let artifact = || store.folder(recipe.stage(), &recipe.key());
        let stage = recipe.stage();
        match self {
            Self::Parts(own, shard) if own == stage && shard.parts(1).is_empty() => Err(Partly::Made {
                stage: stage.to_string(),
                artifact: artifact(),
                parts: 1,
                first: 0,
                end: 0,
                made: 0,
            }
            .into()),
            share if share.makes_none(stage) => Err(Partly::Missing {
                stage: stage.to_string(),
                artifact: artifact(),
                parts: 1,
                missing: vec![0],
                demos: None,
            }
            .into()),
            _ => Ok(()),
        }
    }
}

/// A value that is computed when it is first needed.
pub(crate) struct Lazy<T>(OnceCell<T>);

impl<T> Lazy<T> {
    pub(crate) fn new() -> Self {
        Self(OnceCell::new())
    }

    /// The value, or the error of `make`, which is then called again the next time.
    pub(crate) fn get(&self, make: impl FnOnce() -> Result<T>) -> Result<&T> {
        if let Some(value) = self.0.get() {
            return Ok(value);
        }
        let value = make()?;
        Ok(self.0.get_or_init(|| value))
    }
}

/// An artifact that is made in parts.
pub(crate) struct Parting<'a> {
    pub(crate) store: &'a Store,
    pub(crate) recipe: &'a Recipe,
    /// Number of parts.
    pub(crate) parts: u32,
    pub(crate) share: Share,
    pub(crate) interrupt: &'a Interrupt,
}

impl Parting<'_> {
    /// Makes the parts of the share that do not exist with `make`, and unless it is a share, the manifest: `finish` gets all parts,
    /// writes the tables that describe all of them, and returns the summary.
    ///
    /// # Errors
    /// Those of `make` and `finish`; [`Partly`] if this process does not complete the artifact.
    pub(crate) fn make(
        &self,
        make: impl Fn(&Writer, u32) -> Result<ArtifactSummary>,
        finish: impl FnOnce(&mut Vec<Artifact>, &Writer) -> Result<ArtifactSummary>,
    ) -> Result<Artifact> {
        let each = |number| {
            let writer = self.store.begin_part(self.recipe, Part::Numbered(number))?;
            let summary = make(&writer, number)?;
            Ok(Some((writer, summary)))
        };
        self.make_each(each, finish)
    }

    /// As [`Parting::make`], for a `make` that begins its writer itself, and returns `None` for a part that is not to be published.
    pub(crate) fn make_each(
        &self,
        mut make: impl FnMut(u32) -> Result<Option<(Writer, ArtifactSummary)>>,
        finish: impl FnOnce(&mut Vec<Artifact>, &Writer) -> Result<ArtifactSummary>,
    ) -> Result<Artifact> {
        let stage = self.recipe.stage();
        let folder = self.store.folder(stage, &self.recipe.key());
        let own = match self.share {
            Share::Parts(of, shard) if of == stage => shard.parts(self.parts),
            share if share.makes_none(stage) => 0..0,
            _ => 0..self.parts,
        };
        let mut made = 0;
        for number in self.store.missing_parts(self.recipe, own.clone())? {
            self.interrupt.check(stage.as_str())?;
            // Another process may have made it in the meantime.
            if self.store.missing_parts(self.recipe, number..number + 1)? == [number]
                && let Some((writer, summary)) = make(number)?
            {
                self.interrupt.check(stage.as_str())?;
                writer.publish(summary)?;
                tracing::info!(
                    stage = stage.as_str(),
                    part = number,
                    parts = self.parts,
                    "part published"
                );
                made += 1;
            }
        }
        if matches!(self.share, Share::Parts(of, _) if of == stage) {
            return Err(Partly::Made {
                stage: stage.to_string(),
                artifact: folder,
                parts: self.parts,
                first: own.start,
                end: own.end,
                made,
            }
            .into());
        }
        let mut numbered = self.published(&folder)?;
        let writer = self.store.begin_part(self.recipe, Part::Dataset)?;
        let summary = finish(&mut numbered, &writer)?;
        self.interrupt.check(stage.as_str())?;
        let dataset = writer.has_tables().then(|| writer.publish(ArtifactSummary::default()));
        Ok(self
            .store
            .merge(self.recipe, &numbered, dataset.transpose()?.as_ref(), summary)?)
    }

    /// All parts.
    fn published(&self, folder: &Path) -> Result<Vec<Artifact>> {
        // All are looked for before the first one is downloaded from an object store.
        let missing = self.store.missing_parts(self.recipe, 0..self.parts)?;
        let part = |number| self.store.part(self.recipe, Part::Numbered(number)).transpose();
        if missing.is_empty() && self.share != Share::Look(self.recipe.stage()) {
            return Ok((0..self.parts).filter_map(part).collect::<Result<_, _>>()?);
        }
        Err(Partly::Missing {
            stage: self.recipe.stage().to_string(),
            artifact: folder.to_path_buf(),
            parts: self.parts,
            missing,
            demos: None,
        }
        .into())
    }
}

/// Adds up the whole numbers in the summaries of parts.
pub(crate) fn sum_of_summaries(parts: &[Artifact]) -> serde_json::Map<String, serde_json::Value> {
    let mut sum = serde_json::Map::new();
    for part in parts {
        for (name, value) in part.manifest().summary.as_object().into_iter().flatten() {
            let before = sum.get(name).and_then(serde_json::Value::as_u64).unwrap_or_default();
            sum.insert(name.clone(), (before + value.as_u64().unwrap_or_default()).into());
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_parts_are_named_as_ranges() {
        assert_eq!(ranges(&[3, 7, 8, 9, 12, 13]), "3, 7-9, 12-13");
        let missing = Partly::Missing {
            stage: "ingest".to_owned(),
            artifact: "artifacts/episodes/0123".into(),
            parts: 40,
            missing: vec![7, 8],
            demos: None,
        };
        assert_eq!(
            missing.sentence(),
            "cannot merge artifacts/episodes/0123: 2 of its 40 parts are missing: 7-8; make them with re4-pipe ingest and --shard, or \
             run re4-pipe ingest to make all that is missing"
        );
    }

    #[test]
    fn a_share_survives_the_way_to_the_worker() {
        let shares = [
            Share::Whole,
            Share::Parts(Stage::Ingest, "3/8".parse().unwrap()),
            Share::Merge(Stage::Segment),
            Share::Look(Stage::Index),
            Share::Existing,
        ];
        for share in shares {
            let text = serde_json::to_string(&share).unwrap();
            assert_eq!(serde_json::from_str::<Share>(&text).unwrap(), share);
        }
    }
}
