//! Which episodes of a dataset to read.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use thiserror::Error;

/// Which episodes to read, by their numbers in the source dataset. Selected episodes keep the dataset's order.
///
/// In TOML it is one of `"all"`, `{ first = 50 }`, `{ last = 10 }`, `{ episodes = [0, 3, 5] }` and
/// `{ range = "10..20" }` (half-open); any other key is refused.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Selection {
    /// Every episode.
    #[default]
    All,
    /// The first so many episodes.
    First(u32),
    /// The last so many episodes.
    Last(u32),
    /// These episodes, each once, in any order.
    #[serde(rename = "episodes")]
    List(Vec<u32>),
    /// A half-open range of episodes.
    Range(EpisodeRange),
}

/// A half-open range of episode numbers, written `10..20`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EpisodeRange {
    /// First episode.
    pub start: u32,
    /// The episode after the last.
    pub end: u32,
}

/// Why a selection does not fit a dataset, and how to mend it.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SelectionError {
    /// Nothing is selected.
    #[error("the selection {selection} selects no episode; select at least one of the {episodes} episodes")]
    Empty {
        /// The selection in its TOML form.
        selection: String,
        /// Episodes in the dataset.
        episodes: usize,
    },
    /// An episode beyond the last one.
    #[error(
        "the selection {selection} asks for episode {episode}, but the dataset has {episodes} episodes, 0 to {}; select within them",
        .episodes - 1
    )]
    OutOfRange {
        /// The selection in its TOML form.
        selection: String,
        /// The first episode asked for that is not there.
        episode: u32,
        /// Episodes in the dataset, at least one.
        episodes: usize,
    },
    /// More episodes than there are.
    #[error(
        "the selection {selection} asks for {wanted} episodes, but the dataset has {episodes}; ask for no more than that"
    )]
    TooMany {
        /// The selection in its TOML form.
        selection: String,
        /// Episodes asked for.
        wanted: u32,
        /// Episodes in the dataset.
        episodes: usize,
    },
    /// An episode listed twice.
    #[error("the selection {selection} lists episode {episode} more than once; list it once")]
    Duplicate {
        /// The selection in its TOML form.
        selection: String,
        /// The first episode listed twice.
        episode: u32,
    },
    /// Text that is not a range.
    #[error("\"{text}\" is no range of episodes; write it as \"10..20\" (episode 10 to episode 19)")]
    NotARange {
        /// The text.
        text: String,
    },
}

impl Selection {
    /// The numbers of the selected episodes, ascending, for a dataset of `episodes` episodes.
    ///
    /// # Errors
    /// A selection that is empty, leaves the dataset or lists an episode twice.
    pub fn resolve(&self, episodes: usize) -> Result<Vec<u32>, SelectionError> {
        let selection = || self.to_string();
        let total = u32::try_from(episodes).unwrap_or(u32::MAX);
        let too_many = |wanted: u32| SelectionError::TooMany {
            selection: selection(),
            wanted,
            episodes,
        };
        let out_of_range = |episode: u32| SelectionError::OutOfRange {
            selection: selection(),
            episode,
            episodes,
        };
        let numbers: Vec<u32> = match self {
            Self::All => (0..total).collect(),
            Self::First(count) | Self::Last(count) if *count > total => return Err(too_many(*count)),
            Self::First(count) => (0..*count).collect(),
            Self::Last(count) => (total - *count..total).collect(),
            Self::List(list) => {
                let mut sorted = list.clone();
                sorted.sort_unstable();
                if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
                    return Err(SelectionError::Duplicate {
                        selection: selection(),
                        episode: pair[0],
                    });
                }
                sorted
            }
            Self::Range(range) if range.start < range.end && range.end > total => {
                return Err(out_of_range(range.start.max(total)));
            }
            Self::Range(range) => (range.start..range.end).collect(),
        };
        if numbers.is_empty() {
            return Err(SelectionError::Empty {
                selection: selection(),
                episodes,
            });
        }
        if let Some(&episode) = numbers.iter().find(|&&episode| episode >= total) {
            return Err(if total == 0 {
                SelectionError::Empty {
                    selection: selection(),
                    episodes,
                }
            } else {
                out_of_range(episode)
            });
        }
        Ok(numbers)
    }
}

/// The selection in its TOML form.
impl fmt::Display for Selection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::First(count) => write!(f, "first = {count}"),
            Self::Last(count) => write!(f, "last = {count}"),
            Self::List(list) => write!(f, "episodes = {list:?}"),
            Self::Range(range) => write!(f, "range = \"{range}\""),
        }
    }
}

impl fmt::Display for EpisodeRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}..{}", self.start, self.end)
    }
}

impl FromStr for EpisodeRange {
    type Err = SelectionError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        text.split_once("..")
            .and_then(|(start, end)| {
                Some(Self {
                    start: start.trim().parse().ok()?,
                    end: end.trim().parse().ok()?,
                })
            })
            .ok_or_else(|| SelectionError::NotARange { text: text.to_owned() })
    }
}

impl Serialize for EpisodeRange {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for EpisodeRange {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = Cow::<str>::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

impl JsonSchema for EpisodeRange {
    fn schema_name() -> Cow<'static, str> {
        "EpisodeRange".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "string",
            "pattern": r"^\s*[0-9]+\s*\.\.\s*[0-9]+\s*$",
            "description": "A half-open range of episode numbers, such as 10..20."
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(selection: &Selection) -> Result<Vec<u32>, String> {
        selection.resolve(6).map_err(|error| error.to_string())
    }

    fn range(start: u32, end: u32) -> Selection {
        Selection::Range(EpisodeRange { start, end })
    }

    #[test]
    fn selections_resolve_in_dataset_order() {
        assert_eq!(resolve(&Selection::All), Ok(vec![0, 1, 2, 3, 4, 5]));
        assert_eq!(resolve(&Selection::First(2)), Ok(vec![0, 1]));
        assert_eq!(resolve(&Selection::Last(2)), Ok(vec![4, 5]));
        assert_eq!(resolve(&Selection::List(vec![5, 0, 3])), Ok(vec![0, 3, 5]));
        assert_eq!(resolve(&range(2, 4)), Ok(vec![2, 3]));
        assert_eq!(resolve(&range(0, 6)), Ok(vec![0, 1, 2, 3, 4, 5]));
    }

    #[test]
    fn misfits_are_named() {
        let sentences: Vec<String> = [
            Selection::First(7),
            Selection::Last(7),
            Selection::First(0),
            Selection::List(vec![]),
            Selection::List(vec![1, 6]),
            Selection::List(vec![3, 1, 3]),
            range(4, 4),
            range(5, 2),
            range(4, 7),
            range(9, 12),
        ]
        .iter()
        .map(|selection| resolve(selection).unwrap_err())
        .collect();
        insta::assert_snapshot!(sentences.join("\n"));
        assert!(matches!(Selection::All.resolve(0), Err(SelectionError::Empty { .. })));
        assert!(matches!(
            Selection::List(vec![0]).resolve(0),
            Err(SelectionError::Empty { .. })
        ));
    }

    #[test]
    fn toml_forms_round_trip_and_unknown_keys_are_refused() {
        #[derive(Debug, PartialEq, Serialize, Deserialize)]
        struct Holder {
            select: Selection,
        }
        for (text, selection) in [
            ("select = \"all\"", Selection::All),
            ("select.first = 50", Selection::First(50)),
            ("select.last = 3", Selection::Last(3)),
            ("select.episodes = [0, 3, 5]", Selection::List(vec![0, 3, 5])),
            ("select.range = \"10..20\"", range(10, 20)),
        ] {
            let holder: Holder = toml::from_str(text).unwrap();
            assert_eq!(holder.select, selection);
            assert_eq!(
                toml::from_str::<Holder>(&toml::to_string(&holder).unwrap()).unwrap(),
                holder
            );
        }
        for text in [
            "select.frist = 50",
            "select.range = \"10-20\"",
            "select.first = -1",
            "select = { first = 1, last = 1 }",
        ] {
            assert!(toml::from_str::<Holder>(text).is_err(), "{text}");
        }
    }
}
