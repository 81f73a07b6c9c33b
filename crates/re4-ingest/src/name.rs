//! Names of demonstrations in their source, the order of names, and how a user selects one.

use std::borrow::Cow;
use std::cmp::Ordering;
use std::fmt;

use re4_episode::episode_name;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, de};

/// The name of a demonstration in its source.
///
/// Names are ordered by the number at their end, whatever precedes it, then by the whole name: `demo1`, `demo2`, `demo10`. Names
/// without a number at the end come last. Digits inside a name are compared as numbers, too, so that `take2b` precedes `take10b`.
/// Numbers may have any number of digits.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct SourceName {
    name: String,
    /// Byte index at which the digits at the end begin, without leading zeros; the length of the name if it does not end in a
    /// digit.
    digits: usize,
}

/// A demonstration as a selection refers to it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize)]
#[serde(untagged)]
pub enum Pick {
    /// Its number: the episode number of Push-T, counted from 0, or the number at the end of an HDF5 group's name.
    Number(u64),
    /// Its name: that of an HDF5 group, such as `demo_3`, or `episode N` for Push-T.
    Name(String),
}

impl SourceName {
    /// Creates a name from the text in the source.
    pub fn new(name: impl Into<String>) -> Self {
        let name = name.into();
        let before = name.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        let zeros = name[before..].len() - name[before..].trim_start_matches('0').len();
        // `000` consists of leading zeros only; its last digit is kept as the number 0.
        let digits = (before + zeros).min(name.len().saturating_sub(1)).max(before);
        Self { name, digits }
    }

    /// Name of a Push-T episode, by its number in the dataset.
    pub fn episode(number: u32) -> Self {
        Self::new(episode_name(number))
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.name
    }

    /// Its number as decimal digits without leading zeros; `None` if the name does not end in a digit.
    pub fn digits(&self) -> Option<&str> {
        self.name.get(self.digits..).filter(|digits| !digits.is_empty())
    }

    /// Its number; `None` if it has none or the number exceeds 64 bits.
    pub fn number(&self) -> Option<u64> {
        self.digits()?.parse().ok()
    }

    /// The part of the name before the digits at its end.
    pub(crate) fn stem(&self) -> &str {
        self.name.trim_end_matches(|c: char| c.is_ascii_digit())
    }

    /// The name with another number, zero-padded to the same width if this one is padded: `demo_7` for `demo_3`.
    pub(crate) fn with_number(&self, number: u64) -> String {
        let stem = self.stem();
        let width = self.name.len() - stem.len();
        let padded = self.name[stem.len()..].starts_with('0') && width > 1;
        if padded {
            format!("{stem}{number:0width$}")
        } else {
            format!("{stem}{number}")
        }
    }
}

impl fmt::Display for SourceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

impl Ord for SourceName {
    fn cmp(&self, other: &Self) -> Ordering {
        let numbers = match (self.digits(), other.digits()) {
            (Some(own), Some(others)) => compare_digits(own, others),
            (own, others) => own.is_none().cmp(&others.is_none()),
        };
        numbers
            .then_with(|| natural(&self.name, &other.name))
            .then_with(|| self.name.cmp(&other.name))
    }
}

impl PartialOrd for SourceName {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Compares numbers of any length, given without leading zeros.
fn compare_digits(a: &str, b: &str) -> Ordering {
    a.len().cmp(&b.len()).then_with(|| a.cmp(b))
}

/// Natural order: runs of digits are compared as numbers, all other bytes individually.
fn natural(a: &str, b: &str) -> Ordering {
    fn runs(text: &str) -> impl Iterator<Item = &[u8]> {
        text.as_bytes()
            .chunk_by(|x, y| x.is_ascii_digit() == y.is_ascii_digit())
    }
    let digits = |run: &[u8]| run.first().is_some_and(u8::is_ascii_digit);
    for (x, y) in runs(a).zip(runs(b)) {
        let order = if digits(x) && digits(y) {
            let significant = |run: &'_ [u8]| run.iter().copied().skip_while(|c| *c == b'0').collect::<Vec<u8>>();
            let (x, y) = (significant(x), significant(y));
            x.len().cmp(&y.len()).then_with(|| x.cmp(&y))
        } else {
            x.cmp(y)
        };
        if order.is_ne() {
            return order;
        }
    }
    runs(a).count().cmp(&runs(b).count())
}

impl Pick {
    /// Whether it refers to this demonstration.
    pub(crate) fn means(&self, name: &SourceName) -> bool {
        match self {
            Self::Number(number) => name.number() == Some(*number),
            Self::Name(text) => name.as_str() == text,
        }
    }
}

/// The TOML form.
impl fmt::Display for Pick {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Name(name) => write!(f, "{name:?}"),
        }
    }
}

impl From<u64> for Pick {
    fn from(number: u64) -> Self {
        Self::Number(number)
    }
}

impl From<&str> for Pick {
    fn from(name: &str) -> Self {
        Self::Name(name.to_owned())
    }
}

// Written by hand because the derived implementation for untagged enums does not name the offending value in its message.
impl<'de> Deserialize<'de> for Pick {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;

        impl de::Visitor<'_> for Visitor {
            type Value = Pick;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the number of a demonstration, or its name in quotes")
            }

            fn visit_u64<E: de::Error>(self, number: u64) -> Result<Pick, E> {
                Ok(Pick::Number(number))
            }

            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Pick, E> {
                u64::try_from(number)
                    .map(Pick::Number)
                    .map_err(|_| E::invalid_value(de::Unexpected::Signed(number), &self))
            }

            fn visit_str<E: de::Error>(self, name: &str) -> Result<Pick, E> {
                Ok(Pick::Name(name.to_owned()))
            }
        }

        deserializer.deserialize_any(Visitor)
    }
}

impl JsonSchema for Pick {
    fn schema_name() -> Cow<'static, str> {
        "Pick".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "A demonstration: its number (of a Push-T episode, counted from 0, or at the end of the name of an HDF5 group, 3 for demo_3), or its name.",
            "anyOf": [
                { "type": "integer", "minimum": 0 },
                { "type": "string" }
            ]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_ordered_by_the_number_at_their_end() {
        for sorted in [
            &["demo1", "demo2", "demo10", "demo11"][..],
            &["demo_0", "demo_2", "demo_03", "demo_10", "notes"],
            &["episode-7", "episode-12"],
            &["a_1", "b_1", "a_2", "b_10"],
            &["demo_7", "demo_18446744073709551616", "demo_99999999999999999999999"],
            &["run2_1", "run10_1", "other_2", "take2b", "take10b"],
            &["3", "20", "x"],
            &["demo_0", "demo_000", "demo_1"],
        ] {
            let mut names: Vec<SourceName> = sorted.iter().rev().map(|name| SourceName::new(*name)).collect();
            names.sort();
            let found: Vec<&str> = names.iter().map(SourceName::as_str).collect();
            assert_eq!(found, sorted);
        }
    }

    #[test]
    fn the_number_of_a_name_is_at_its_end() {
        for (name, digits) in [
            ("demo_3", Some("3")),
            ("demo3", Some("3")),
            ("demo_03", Some("3")),
            ("demo_000", Some("0")),
            ("12", Some("12")),
            ("traj-99999999999999999999999", Some("99999999999999999999999")),
            ("demo", None),
            ("demo_3b", None),
            ("", None),
            ("d\u{e9}mo_\u{663}", None),
        ] {
            assert_eq!(SourceName::new(name).digits(), digits, "{name}");
        }
        assert_eq!(SourceName::new("demo_18446744073709551616").number(), None);
        assert_eq!(SourceName::episode(12).number(), Some(12));
    }
}
