//! The key `ingest.source`: the path of a dataset, or those of its files.

use std::fmt;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::de::{Error as _, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// Where a dataset is: one path, or a list of HDF5 files whose demonstrations are one dataset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum SourcePaths {
    /// A file or a folder.
    One(PathBuf),
    /// HDF5 files, in order.
    Several(Vec<PathBuf>),
}

impl SourcePaths {
    /// The paths as they are written in the pipeline file.
    pub fn paths(&self) -> &[PathBuf] {
        match self {
            Self::One(path) => std::slice::from_ref(path),
            Self::Several(paths) => paths,
        }
    }
}

impl From<PathBuf> for SourcePaths {
    fn from(path: PathBuf) -> Self {
        Self::One(path)
    }
}

impl fmt::Display for SourcePaths {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&label(self.paths()))
    }
}

/// A dataset of these files in messages.
pub(crate) fn label(paths: &[impl AsRef<Path>]) -> String {
    match paths {
        [] => String::new(),
        [only] => only.as_ref().display().to_string(),
        [first, others @ ..] => {
            let files = if others.len() == 1 { "file" } else { "files" };
            format!("{} and {} other {files}", first.as_ref().display(), others.len())
        }
    }
}

impl<'de> Deserialize<'de> for SourcePaths {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Paths;
        impl<'de> Visitor<'de> for Paths {
            type Value = SourcePaths;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a path or a list of paths")
            }

            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Self::Value, E> {
                Ok(SourcePaths::One(text.into()))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
                let mut paths: Vec<PathBuf> = Vec::new();
                while let Some(path) = list.next_element()? {
                    paths.push(path);
                }
                if paths.is_empty() {
                    return Err(A::Error::custom("the list of sources is empty; give at least one path"));
                }
                Ok(SourcePaths::Several(paths))
            }
        }
        deserializer.deserialize_any(Paths)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_is_a_path_or_a_list() {
        let read = |text: &str| serde_json::from_str::<SourcePaths>(text).map_err(|error| error.to_string());
        assert_eq!(read("\"a.hdf5\""), Ok(SourcePaths::One("a.hdf5".into())));
        let two = read("[\"a.hdf5\", \"b.hdf5\"]").unwrap();
        assert_eq!(two.to_string(), "a.hdf5 and 1 other file");
        assert_eq!(serde_json::to_string(&two).unwrap(), "[\"a.hdf5\",\"b.hdf5\"]");
        assert!(read("[]").unwrap_err().contains("the list of sources is empty"));
        assert!(read("3").unwrap_err().contains("expected a path or a list of paths"));
    }
}
