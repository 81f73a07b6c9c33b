//! Selection of the demonstrations of a dataset.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use thiserror::Error;

use crate::name::{Pick, SourceName};

/// Maximum number of names in a message; of more, only the first and the last are listed.
const NAMES_SHOWN: usize = 8;

/// The demonstrations to read, by their names or numbers in the source. Demonstrations of Push-T are its episodes, counted from
/// zero. Demonstrations of an HDF5 file are groups, numbered by the digits at the end of their names: `demo_3` has the number 3.
/// They are ordered by number; those without a number come last. With `ingest.filter`, only demonstrations that the filter key
/// lists can be selected.
///
/// In TOML it is one of `"all"`, `{ first = 50 }`, `{ last = 10 }`, `{ episodes = [0, 3, "demo_5"] }` (numbers or names) and
/// `{ range = "10..20" }` (half-open, by number). Any other key is refused.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Selection {
    /// Every demonstration.
    #[default]
    All,
    /// The first N demonstrations.
    First(u32),
    /// The last N demonstrations.
    Last(u32),
    /// These demonstrations, each listed once, in any order.
    #[serde(rename = "episodes")]
    List(Vec<Pick>),
    /// Demonstrations with numbers in a half-open range; numbers in it that no demonstration has are ignored.
    Range(EpisodeRange),
}

/// A half-open range of demonstration numbers, written `10..20`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EpisodeRange {
    /// First number.
    pub start: u64,
    /// The number after the last.
    pub end: u64,
}

/// Why a selection does not fit a dataset, and how to fix it.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SelectionError {
    /// Nothing is selected.
    #[error(
        "the selection {selection} selects no demonstrations; select at least one of the {demonstrations} demonstrations"
    )]
    Empty {
        /// The selection in its TOML form.
        selection: String,
        /// Demonstrations to select from.
        demonstrations: usize,
    },
    /// No demonstration has a requested number or name.
    #[error("the selection {selection} asks for {wanted}, {absent}; select from {there}")]
    Missing {
        /// The selection in its TOML form.
        selection: String,
        /// The requested demonstration, such as `demonstration 2`.
        wanted: String,
        /// Why it is missing, as the rest of the sentence: `but there is no demo_2`.
        absent: String,
        /// The available demonstrations.
        there: String,
    },
    /// Several demonstrations have a requested number.
    #[error(
        "the selection {selection} asks for demonstration {number}, but {candidates} all have that number; select one by name, as in episodes = [\"{first}\"]"
    )]
    Ambiguous {
        /// The selection in its TOML form.
        selection: String,
        /// The number.
        number: u64,
        /// Names of the demonstrations that have it.
        candidates: String,
        /// Name of the first of them.
        first: String,
    },
    /// More demonstrations than there are.
    #[error(
        "the selection {selection} asks for {wanted} demonstrations, but there are {demonstrations}; request at most that many"
    )]
    TooMany {
        /// The selection in its TOML form.
        selection: String,
        /// Demonstrations asked for.
        wanted: u32,
        /// Demonstrations to select from.
        demonstrations: usize,
    },
    /// A demonstration listed twice.
    #[error("the selection {selection} lists {demonstration} more than once; list it once")]
    Duplicate {
        /// The selection in its TOML form.
        selection: String,
        /// Name of the first demonstration listed twice.
        demonstration: String,
    },
    /// Text that is not a range.
    #[error("\"{text}\" is not a range of episodes; write it as \"10..20\" (episode 10 to episode 19)")]
    NotARange {
        /// The text.
        text: String,
    },
}

/// Joins names for a message; of many, it lists the first few and the last.
fn listed<'a>(names: impl Iterator<Item = &'a SourceName> + Clone) -> String {
    let count = names.clone().count();
    let shown = if count > NAMES_SHOWN + 2 { NAMES_SHOWN } else { count };
    let mut text = names
        .clone()
        .take(shown)
        .map(SourceName::as_str)
        .collect::<Vec<_>>()
        .join(", ");
    if let (true, Some(last)) = (shown < count, names.last()) {
        text = format!("{text}, ..., {last} ({count} in all)");
    }
    text
}

/// The demonstrations of a source, in order, and which of them can be selected.
struct Among<'a> {
    all: &'a [SourceName],
    eligible: &'a dyn Fn(usize) -> bool,
}

impl<'a> Among<'a> {
    fn iter(&self) -> impl Iterator<Item = (usize, &'a SourceName)> + Clone {
        let (all, eligible) = (self.all, self.eligible);
        all.iter().enumerate().filter(move |(place, _)| eligible(*place))
    }

    fn names(&self) -> impl Iterator<Item = &'a SourceName> + Clone {
        self.iter().map(|(_, name)| name)
    }
}

impl Selection {
    /// Returns the indices in `source` of the selected demonstrations, ascending. `source` must be in the order of
    /// [`SourceName`].
    ///
    /// # Errors
    /// The selection is empty, refers to a missing or an ambiguous demonstration, or lists a demonstration twice.
    pub fn resolve(&self, source: &[SourceName]) -> Result<Vec<usize>, SelectionError> {
        self.resolve_among(source, &|_| true)
    }

    /// Returns the numbers of the selected Push-T episodes, ascending, for a dataset of `episodes` episodes.
    ///
    /// # Errors
    /// Same as [`Selection::resolve`].
    pub fn resolve_episodes(&self, episodes: usize) -> Result<Vec<u32>, SelectionError> {
        let episodes = u32::try_from(episodes).unwrap_or(u32::MAX);
        let names: Vec<SourceName> = (0..episodes).map(SourceName::episode).collect();
        let places = self.resolve(&names)?;
        Ok(places
            .into_iter()
            .filter_map(|place| u32::try_from(place).ok())
            .collect())
    }

    /// Like [`Selection::resolve`], but restricted to the indices for which `eligible` returns true, such as those that a filter
    /// lists.
    ///
    /// # Errors
    /// Same as [`Selection::resolve`].
    pub fn resolve_among(
        &self,
        source: &[SourceName],
        eligible: &dyn Fn(usize) -> bool,
    ) -> Result<Vec<usize>, SelectionError> {
        let among = Among { all: source, eligible };
        let places: Vec<usize> = among.iter().map(|(place, _)| place).collect();
        let empty = || SelectionError::Empty {
            selection: self.to_string(),
            demonstrations: places.len(),
        };
        if places.is_empty() {
            return Err(empty());
        }
        let first = |count: u32| {
            let taken = usize::try_from(count).ok().filter(|count| *count <= places.len());
            taken.ok_or_else(|| SelectionError::TooMany {
                selection: self.to_string(),
                wanted: count,
                demonstrations: places.len(),
            })
        };
        let chosen = match self {
            Self::All => places.clone(),
            Self::First(count) => places[..first(*count)?].to_vec(),
            Self::Last(count) => places[places.len() - first(*count)?..].to_vec(),
            Self::List(list) => self.listed(list, &among)?,
            Self::Range(range) => self.ranged(*range, &among)?,
        };
        if chosen.is_empty() { Err(empty()) } else { Ok(chosen) }
    }

    fn listed(&self, list: &[Pick], among: &Among<'_>) -> Result<Vec<usize>, SelectionError> {
        let mut chosen = BTreeSet::new();
        for pick in list {
            let mut found = among.iter().filter(|(_, name)| pick.means(name));
            let (place, name) = found.next().ok_or_else(|| self.missing(pick, among))?;
            if let (Pick::Number(number), Some((_, second))) = (pick, found.next()) {
                let candidates = [name, second].into_iter().chain(found.map(|(_, name)| name));
                return Err(SelectionError::Ambiguous {
                    selection: self.to_string(),
                    number: *number,
                    candidates: listed(candidates.collect::<Vec<_>>().into_iter()),
                    first: name.to_string(),
                });
            }
            if !chosen.insert(place) {
                return Err(SelectionError::Duplicate {
                    selection: self.to_string(),
                    demonstration: name.to_string(),
                });
            }
        }
        Ok(chosen.into_iter().collect())
    }

    fn ranged(&self, range: EpisodeRange, among: &Among<'_>) -> Result<Vec<usize>, SelectionError> {
        if range.start >= range.end {
            return Ok(Vec::new());
        }
        let numbers = || among.all.iter().filter_map(SourceName::number);
        // A range that extends past the last number is refused: it is a mistake, or demonstrations are missing. Gaps inside it
        // are allowed.
        let beyond = numbers().max().map_or(0, |last| last.saturating_add(1));
        if range.end > beyond {
            return Err(self.missing(&Pick::Number(range.start.max(beyond)), among));
        }
        let inside = |name: &SourceName| {
            name.number()
                .is_some_and(|number| (range.start..range.end).contains(&number))
        };
        let chosen: Vec<usize> = among
            .iter()
            .filter(|(_, name)| inside(name))
            .map(|(place, _)| place)
            .collect();
        if chosen.is_empty() {
            return Err(self.missing(&Pick::Number(range.start), among));
        }
        Ok(chosen)
    }

    fn missing(&self, pick: &Pick, among: &Among<'_>) -> SelectionError {
        let unlisted = among.all.iter().find(|name| pick.means(name));
        let numbered = || among.all.iter().filter(|name| name.digits().is_some());
        let (wanted, absent) = match pick {
            Pick::Number(number) => {
                let first = numbered().next();
                let alike = first.filter(|first| numbered().all(|name| name.stem() == first.stem()));
                let absent = match (unlisted, alike) {
                    (Some(name), _) => format!("but the filter key does not list {name}"),
                    // If all names have the same stem, the name with the missing number is known.
                    (None, Some(first)) => format!("but there is no {}", first.with_number(*number)),
                    (None, None) => "but no demonstration has that number".to_owned(),
                };
                (format!("demonstration {number}"), absent)
            }
            Pick::Name(_) if unlisted.is_some() => (pick.to_string(), "which the filter key does not list".to_owned()),
            Pick::Name(_) => (pick.to_string(), "which does not exist".to_owned()),
        };
        SelectionError::Missing {
            selection: self.to_string(),
            wanted,
            absent,
            there: listed(among.names()),
        }
    }
}

// The TOML form.
impl fmt::Display for Selection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::First(count) => write!(f, "first = {count}"),
            Self::Last(count) => write!(f, "last = {count}"),
            Self::List(list) => {
                let list: Vec<String> = list.iter().map(Pick::to_string).collect();
                write!(f, "episodes = [{}]", list.join(", "))
            }
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
            "description": "A half-open range of demonstrations' own numbers, such as 10..20."
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbered(count: u32) -> Vec<SourceName> {
        (0..count).map(SourceName::episode).collect()
    }

    fn named(names: &[&str]) -> Vec<SourceName> {
        let mut names: Vec<SourceName> = names.iter().map(|name| SourceName::new(*name)).collect();
        names.sort();
        names
    }

    fn resolve(selection: &Selection) -> Result<Vec<usize>, String> {
        selection.resolve(&numbered(6)).map_err(|error| error.to_string())
    }

    fn range(start: u64, end: u64) -> Selection {
        Selection::Range(EpisodeRange { start, end })
    }

    fn list<const N: usize>(picks: [u64; N]) -> Selection {
        Selection::List(picks.map(Pick::from).to_vec())
    }

    /// Names of the demonstrations that a selection takes.
    fn taken<'a>(selection: &Selection, source: &'a [SourceName]) -> Result<Vec<&'a str>, String> {
        let places = selection.resolve(source).map_err(|error| error.to_string())?;
        Ok(places.into_iter().map(|place| source[place].as_str()).collect())
    }

    #[test]
    fn selections_resolve_in_dataset_order() {
        assert_eq!(resolve(&Selection::All), Ok(vec![0, 1, 2, 3, 4, 5]));
        assert_eq!(resolve(&Selection::First(2)), Ok(vec![0, 1]));
        assert_eq!(resolve(&Selection::Last(2)), Ok(vec![4, 5]));
        assert_eq!(resolve(&list([5, 0, 3])), Ok(vec![0, 3, 5]));
        assert_eq!(resolve(&range(2, 4)), Ok(vec![2, 3]));
        assert_eq!(resolve(&range(0, 6)), Ok(vec![0, 1, 2, 3, 4, 5]));
    }

    #[test]
    fn numbers_are_those_of_the_source() {
        let gaps = named(&["demo_0", "demo_1", "demo_3", "demo_4", "demo_6"]);
        assert_eq!(taken(&list([3]), &gaps), Ok(vec!["demo_3"]));
        assert_eq!(taken(&list([6, 0]), &gaps), Ok(vec!["demo_0", "demo_6"]));
        assert_eq!(taken(&range(1, 6), &gaps), Ok(vec!["demo_1", "demo_3", "demo_4"]));
        assert_eq!(taken(&range(0, 7), &gaps).map(|all| all.len()), Ok(5));
        assert_eq!(
            taken(&Selection::First(3), &gaps),
            Ok(vec!["demo_0", "demo_1", "demo_3"])
        );
        let mixed = Selection::List(vec![Pick::from("demo_4"), Pick::from(1)]);
        assert_eq!(taken(&mixed, &gaps), Ok(vec!["demo_1", "demo_4"]));
        let others = named(&["demo1", "demo10", "demo2", "take_99999999999999999999", "extra", "007"]);
        assert_eq!(taken(&list([10]), &others), Ok(vec!["demo10"]));
        assert_eq!(taken(&list([7]), &others), Ok(vec!["007"]));
        let by_name = Selection::List(vec!["take_99999999999999999999".into(), "extra".into()]);
        assert_eq!(taken(&by_name, &others).map(|all| all.len()), Ok(2));
        assert_eq!(
            taken(&range(0, 11), &others),
            Ok(vec!["demo1", "demo2", "007", "demo10"])
        );
        let pusht = Selection::List(vec!["episode 3".into()]);
        assert_eq!(taken(&pusht, &numbered(6)), Ok(vec!["episode 3"]));
    }

    #[test]
    fn a_filter_does_not_change_numbers() {
        let source = named(&["demo_0", "demo_1", "demo_2", "demo_3", "demo_4"]);
        let odd = |place: usize| place % 2 == 1;
        let resolve = |selection: &Selection| {
            selection
                .resolve_among(&source, &odd)
                .map_err(|error| error.to_string())
        };
        assert_eq!(resolve(&Selection::All), Ok(vec![1, 3]));
        assert_eq!(resolve(&Selection::Last(1)), Ok(vec![3]));
        assert_eq!(resolve(&list([3])), Ok(vec![3]));
        assert_eq!(resolve(&range(0, 5)), Ok(vec![1, 3]));
        let refused = [
            list([2]),
            Selection::List(vec!["demo_2".into()]),
            Selection::First(3),
            range(4, 5),
        ];
        let sentences: Vec<String> = refused
            .iter()
            .map(|selection| resolve(selection).unwrap_err())
            .collect();
        insta::assert_snapshot!(sentences.join("\n"));
    }

    #[test]
    fn mismatches_are_reported() {
        let sentences: Vec<String> = [
            Selection::First(7),
            Selection::Last(7),
            Selection::First(0),
            Selection::List(vec![]),
            list([1, 6]),
            list([3, 1, 3]),
            range(4, 4),
            range(5, 2),
            range(4, 7),
            range(9, 12),
        ]
        .iter()
        .map(|selection| resolve(selection).unwrap_err())
        .collect();
        insta::assert_snapshot!(sentences.join("\n"));
        assert!(matches!(Selection::All.resolve(&[]), Err(SelectionError::Empty { .. })));
        assert!(matches!(list([0]).resolve(&[]), Err(SelectionError::Empty { .. })));
    }

    #[test]
    fn missing_demonstrations_are_reported() {
        let gaps = named(&["demo_0", "demo_1", "demo_3"]);
        let many: Vec<String> = (0..200).map(|number| format!("demo_{number:03}")).collect();
        let many = named(&many.iter().map(String::as_str).collect::<Vec<_>>());
        let twins = named(&["a_1", "b_1", "a_2", "words"]);
        let of = |selection: Selection, source: &[SourceName]| taken(&selection, source).unwrap_err();
        let sentences = [
            of(list([2]), &gaps),
            of(Selection::List(vec!["demo_2".into()]), &gaps),
            of(Selection::List(vec![3.into(), "demo_3".into()]), &gaps),
            of(range(2, 3), &gaps),
            of(range(2, 5), &gaps),
            of(list([200]), &many),
            of(list([1]), &twins),
            of(list([3]), &twins),
            of(list([3]), &named(&["first", "second"])),
            of(range(0, 3), &named(&["first", "second"])),
        ];
        insta::assert_snapshot!(sentences.join("\n"));
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
            ("select.episodes = [0, 3, 5]", list([0, 3, 5])),
            (
                "select.episodes = [\"demo_3\", 5]",
                Selection::List(vec!["demo_3".into(), 5.into()]),
            ),
            ("select.range = \"10..20\"", range(10, 20)),
        ] {
            let holder: Holder = toml::from_str(text).unwrap();
            assert_eq!(holder.select, selection);
            assert_eq!(
                toml::from_str::<Holder>(&toml::to_string(&holder).unwrap()).unwrap(),
                holder
            );
            let json = serde_json::to_string(&holder).unwrap();
            assert_eq!(serde_json::from_str::<Holder>(&json).unwrap(), holder);
        }
        for text in [
            "select.frist = 50",
            "select.range = \"10-20\"",
            "select.first = -1",
            "select.episodes = [-1]",
            "select.episodes = [1.5]",
            "select.episodes = [true]",
            "select = { first = 1, last = 1 }",
        ] {
            assert!(toml::from_str::<Holder>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn serialized_selections_are_stable() {
        // This text is part of the keys of artifacts.
        let written = |selection: &Selection| serde_json::to_string(selection).unwrap();
        assert_eq!(written(&Selection::All), r#""all""#);
        assert_eq!(written(&Selection::First(50)), r#"{"first":50}"#);
        assert_eq!(written(&list([0, 3, 5])), r#"{"episodes":[0,3,5]}"#);
        assert_eq!(written(&range(10, 20)), r#"{"range":"10..20"}"#);
    }
}
