//! Patterns of file names in `info.json`: `data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet`.

use std::fmt::Write as _;

/// A pattern.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Template {
    parts: Vec<Part>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Part {
    Literal(String),
    /// A number with its minimum width, padded with zeros.
    Number(String, usize),
    /// The name of a video.
    VideoKey,
}

impl Template {
    /// Parses a pattern whose numbers have these names.
    ///
    /// # Errors
    /// Describes what is wrong with it.
    pub(crate) fn parse(text: &str, numbers: &[&str]) -> Result<Self, String> {
        let mut parts = Vec::new();
        let mut rest = text;
        while let Some((literal, field)) = rest.split_once('{') {
            let Some((field, after)) = field.split_once('}') else {
                return Err("a brace is not closed".to_owned());
            };
            parts.push(Part::Literal(literal.to_owned()));
            let (name, format) = field.split_once(':').unwrap_or((field, ""));
            let width = match format.strip_suffix('d').unwrap_or(format) {
                "" => Some(0),
                digits => digits.parse().ok().filter(|&width| width <= 20),
            };
            parts.push(match (name, width) {
                ("video_key", Some(0)) => Part::VideoKey,
                (_, Some(width)) if numbers.contains(&name) => Part::Number(name.to_owned(), width),
                _ => {
                    return Err(format!(
                        "{{{field}}} is not one of {{video_key}}, {{{}}}",
                        numbers.join("}, {")
                    ));
                }
            });
            rest = after;
        }
        parts.push(Part::Literal(rest.to_owned()));
        // A pattern that leads out of the dataset would let a downloaded file read any other.
        if text.starts_with('/') || text.contains('\\') || text.split('/').any(|part| part == ".." || part.is_empty()) {
            return Err("it does not stay inside the dataset".to_owned());
        }
        Ok(Self { parts })
    }

    /// The name of a file. A number that is not given is 0.
    pub(crate) fn fill(&self, numbers: &[(&str, u64)], video_key: &str) -> String {
        let mut name = String::new();
        for part in &self.parts {
            match part {
                Part::Literal(text) => name.push_str(text),
                Part::VideoKey => name.push_str(video_key),
                Part::Number(field, width) => {
                    let value = numbers
                        .iter()
                        .find(|(number, _)| number == field)
                        .map_or(0, |(_, value)| *value);
                    let _ = write!(name, "{value:0width$}");
                }
            }
        }
        name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_filled() {
        let numbers = ["episode_chunk", "episode_index"];
        let text = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4";
        let template = Template::parse(text, &numbers).unwrap();
        let name = template.fill(&[("episode_index", 1234), ("episode_chunk", 1)], "observation.image");
        assert_eq!(name, "videos/chunk-001/observation.image/episode_001234.mp4");
        let plain = Template::parse("{episode_index}.parquet", &numbers).unwrap();
        assert_eq!(plain.fill(&[("episode_index", 7)], ""), "7.parquet");
        for wrong in [
            "../{episode_index}",
            "/a",
            "a//b",
            "a/{episode_index",
            "{frame}",
            "{episode_index:x}",
            "a\\b",
        ] {
            assert!(Template::parse(wrong, &numbers).is_err(), "{wrong}");
        }
    }
}
