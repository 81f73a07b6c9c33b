//! Sets of scene seeds.

use std::borrow::Cow;
use std::str::FromStr;

use anyhow::Result;
use re4_fault::{Remedy as _, bail, fault};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::notes::fault_of;

/// Maximum number of seeds in a run.
const MAX_SEEDS: usize = 10_000_000;

/// Distinct seeds, in the order in which they are written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seeds {
    /// The shortest way to write them. Equal seeds have equal texts, and so equal keys of their rollouts.
    text: String,
    seeds: Vec<u32>,
}

impl Seeds {
    /// The seeds in their shortest form: `500..600`, or ranges and single seeds joined by commas.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The seeds.
    pub fn as_slice(&self) -> &[u32] {
        &self.seeds
    }
}

impl FromStr for Seeds {
    type Err = anyhow::Error;

    /// The parsers of arguments and of the pipeline file keep only the text of an error, so the text contains the remedy.
    fn from_str(text: &str) -> Result<Self> {
        Self::read(text).map_err(|error| anyhow::Error::msg(fault_of(&error).sentence()))
    }
}

impl Seeds {
    fn read(text: &str) -> Result<Self> {
        let mut seeds = Vec::new();
        for part in text.split(',').map(str::trim) {
            let number = |word: &str| {
                word.trim().parse::<u32>().map_err(|_| {
                    fault!(
                        "seeds {text:?}: {word:?} is not a number from 0 to {}", u32::MAX;
                        "write 500..600, or 1,2,3"
                    )
                })
            };
            match part.split_once("..") {
                Some((from, to)) => {
                    let (from, to) = (number(from)?, number(to)?);
                    if from >= to {
                        bail!(
                            "seeds {text:?}: the range {part} is empty";
                            "its end is exclusive, so write {from}..{}", from.saturating_add(1)
                        );
                    }
                    // Checked before memory is reserved, because a short text can ask for billions of seeds.
                    if (to - from) as usize > MAX_SEEDS.saturating_sub(seeds.len()) {
                        bail!("the seeds up to {part} are more than 10,000,000"; "split them over several runs");
                    }
                    seeds.extend(from..to);
                }
                None => seeds.push(number(part)?),
            }
        }
        let mut sorted = seeds.clone();
        sorted.sort_unstable();
        if let Some((seed, _)) = sorted.iter().zip(sorted.iter().skip(1)).find(|(one, next)| one == next) {
            bail!("seeds {text:?}: seed {seed} occurs twice"; "name each seed once");
        }
        Ok(Self {
            text: shortest(&seeds),
            seeds,
        })
    }
}

/// The shortest way to write seeds in this order: every run of consecutive seeds is a range.
fn shortest(seeds: &[u32]) -> String {
    let runs = seeds.chunk_by(|&one, &next| one.checked_add(1) == Some(next));
    let parts = runs.filter_map(|run| match run {
        [] => None,
        &[seed] => Some(seed.to_string()),
        // The end of a range is exclusive, so a range cannot contain the last number.
        &[first, .., u32::MAX] => Some(format!("{first}..{},{}", u32::MAX, u32::MAX)),
        &[first, .., last] => Some(format!("{first}..{}", last + 1)),
    });
    parts.collect::<Vec<_>>().join(",")
}

impl Serialize for Seeds {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.text)
    }
}

impl<'de> Deserialize<'de> for Seeds {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = match serde_json::Value::deserialize(deserializer)? {
            serde_json::Value::Array(numbers) => numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(","),
            serde_json::Value::String(text) => text,
            other => other.to_string(),
        };
        text.parse().map_err(serde::de::Error::custom)
    }
}

impl JsonSchema for Seeds {
    fn schema_name() -> Cow<'static, str> {
        "Seeds".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "A half-open range such as \"500..600\", several ranges or single seeds joined by commas, or a list of numbers.",
            "anyOf": [
                { "type": "string" },
                { "type": "integer", "minimum": 0 },
                { "type": "array", "items": { "type": "integer", "minimum": 0 } },
            ],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_lists_are_parsed() {
        assert_eq!("500..503".parse::<Seeds>().unwrap().as_slice(), &[500, 501, 502]);
        assert_eq!("7, 1..3".parse::<Seeds>().unwrap().as_slice(), &[7, 1, 2]);
        for bad in ["", "a", "3..3", "5..2", "1,1", "-1", "1..3,2", "1.5"] {
            assert!(bad.parse::<Seeds>().is_err(), "{bad}");
        }
    }

    #[test]
    fn equal_seeds_have_equal_texts() {
        let text = |text: &str| text.parse::<Seeds>().unwrap().text().to_owned();
        for same in ["500..524", "500..510, 510..524", "500,501..524", " 500 .. 524 "] {
            assert_eq!(text(same), "500..524");
        }
        assert_eq!(text("3,2,1"), "3,2,1");
        assert_eq!(text("7,8,9,1"), "7..10,1");
        assert_eq!(text("4294967295"), "4294967295");
        let last = "4294967293..4294967295,4294967295";
        assert_eq!(text(last), last);
    }

    #[test]
    fn the_text_names_the_same_seeds() {
        // All orders of all sets of up to four of these seeds.
        let all = [0_u32, 1, 2, 4, 5, u32::MAX - 1, u32::MAX];
        let mut lists = vec![Vec::new()];
        for _ in 0..4 {
            let longer = lists.iter().flat_map(|list: &Vec<u32>| {
                let next = all.iter().filter(|seed| !list.contains(seed));
                next.map(|&seed| [list.as_slice(), &[seed]].concat())
                    .collect::<Vec<_>>()
            });
            lists = longer.collect();
            for seeds in &lists {
                let written = seeds.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
                let parsed: Seeds = written.parse().unwrap();
                assert_eq!(parsed.as_slice(), seeds);
                assert_eq!(parsed.text().parse::<Seeds>().unwrap(), parsed);
            }
        }
    }

    #[test]
    fn the_total_number_of_seeds_is_bounded() {
        assert!("0..10000000".parse::<Seeds>().is_ok());
        let joined = (0..400).map(|i| format!("{}..{}", i * 10_000_000_u64, (i + 1) * 10_000_000_u64));
        let text = joined.collect::<Vec<_>>().join(",");
        let message = text.parse::<Seeds>().unwrap_err().to_string();
        assert!(
            message.contains("seeds up to 10000000..20000000 are more than 10,000,000"),
            "{message}"
        );
    }
}
