//! The datasets and weights that are known by name.

use serde::Deserialize;

use crate::error::{Fault, FetchError};

/// What a downloaded file is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// A zip file, to be unpacked.
    #[default]
    Zip,
    /// What is wanted itself. Weights of PyTorch are zip files inside, and are used as they are.
    File,
}

/// A dataset that can be downloaded, or weights.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dataset {
    /// Name, as given on the command line.
    pub name: String,
    /// One sentence about it.
    pub description: String,
    /// Address of a file.
    pub url: String,
    /// Size of the file, where it is known.
    pub bytes: Option<u64>,
    /// SHA-256 of the file in hexadecimal, where it is known.
    pub sha256: Option<String>,
    /// Licence and holder of the rights.
    pub licence: String,
    /// What the file is.
    #[serde(default)]
    pub form: Form,
    /// Path below the destination at which the dataset will lie. In a zip file it is at this path or at its last part.
    pub provides: String,
}

impl Dataset {
    /// The same dataset from another address, such as a mirror.
    #[must_use]
    pub fn with_url(self, url: impl Into<String>) -> Self {
        Self {
            url: url.into(),
            ..self
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Catalogue {
    dataset: Vec<Dataset>,
}

/// All known datasets, in the order of `data/datasets.toml`, which is part of the program.
///
/// # Errors
/// None in a program whose tests pass: the catalogue is fixed when it is built.
pub fn catalogue() -> Result<Vec<Dataset>, FetchError> {
    toml::from_str::<Catalogue>(include_str!("../../../data/datasets.toml"))
        .map(|catalogue| catalogue.dataset)
        .map_err(|error| FetchError {
            dataset: "any dataset".to_owned(),
            url: "the catalogue".to_owned(),
            fault: Fault::Catalogue {
                why: error.message().to_owned(),
            },
        })
}

/// The known dataset of a name.
///
/// # Errors
/// A name that is not in the catalogue; the error lists those that are.
pub fn find(name: &str) -> Result<Dataset, FetchError> {
    let known = catalogue()?;
    let names: Vec<String> = known.iter().map(|dataset| dataset.name.clone()).collect();
    known
        .into_iter()
        .find(|dataset| dataset.name == name)
        .ok_or_else(|| FetchError {
            dataset: name.to_owned(),
            url: "the catalogue".to_owned(),
            fault: Fault::UnknownDataset {
                known: names.join(", "),
            },
        })
}

#[cfg(test)]
mod tests {
    use re4_fault::Remedy as _;

    use super::*;

    #[test]
    fn the_catalogue_is_sound() {
        let known = catalogue().unwrap();
        assert_eq!(
            known.iter().map(|dataset| &dataset.name).collect::<Vec<_>>(),
            ["pusht", "resnet18"]
        );
        for dataset in known {
            assert_eq!(find(&dataset.name).unwrap(), dataset);
            assert!(dataset.url.starts_with("https://"), "{}", dataset.url);
            assert!(!dataset.licence.is_empty() && !dataset.description.is_empty());
            let folder = match dataset.form {
                Form::Zip => dataset.name.as_str(),
                // Only its hash tells whether it is whole.
                Form::File => {
                    assert!(dataset.sha256.is_some() && dataset.bytes.is_some());
                    "weights"
                }
            };
            let inside = dataset.provides.strip_prefix(folder);
            assert!(inside.is_some_and(|path| path.starts_with('/')), "{}", dataset.provides);
            if let Some(sha256) = &dataset.sha256 {
                assert!(sha256.len() == 64 && sha256.chars().all(|c| matches!(c, '0'..='9' | 'a'..='f')));
            }
        }
    }

    #[test]
    fn unknown_names_get_the_known_ones() {
        let sentence = find("push-t").unwrap_err().sentence();
        assert_eq!(
            sentence,
            "cannot fetch push-t from the catalogue: there is no such dataset; known are: pusht, resnet18"
        );
    }
}
