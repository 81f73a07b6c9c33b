//! The catalogue of datasets and weights that can be downloaded by name.

use serde::Deserialize;

use crate::error::{Fault, FetchError};

/// How a downloaded file is installed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// The file is a zip file that is unpacked.
    #[default]
    Zip,
    /// The file is used as it is. This includes weights of PyTorch, although their format is zip.
    File,
}

/// A dataset or a file of weights that can be downloaded.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dataset {
    /// Name, as given on the command line.
    pub name: String,
    /// One sentence about the dataset.
    pub description: String,
    /// URL of the file.
    pub url: String,
    /// Size of the file in bytes, if known.
    pub bytes: Option<u64>,
    /// SHA-256 of the file in hexadecimal, if known.
    pub sha256: Option<String>,
    /// Licence and copyright holder.
    pub licence: String,
    /// How the file is installed.
    #[serde(default)]
    pub form: Form,
    /// Path of the installed dataset, relative to the destination. In a zip file the dataset has this path or its last component.
    pub provides: String,
}

impl Dataset {
    /// Returns the same dataset with another URL, such as that of a mirror.
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

/// Returns all datasets in the order of `data/datasets.toml`, which is compiled into the program.
///
/// # Errors
/// [`Fault::Catalogue`] if the file is invalid. The catalogue is fixed at compile time, so the tests exclude this.
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

/// Returns the dataset with this name.
///
/// # Errors
/// [`Fault::UnknownDataset`], which lists the known names.
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
    fn the_catalogue_is_valid() {
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
                // Unlike a zip file, which contains checksums, it can only be checked by its hash.
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
    fn the_error_of_an_unknown_name_lists_the_known_names() {
        let sentence = find("push-t").unwrap_err().sentence();
        assert_eq!(
            sentence,
            "cannot fetch push-t from the catalogue: there is no such dataset; use one of: pusht, resnet18"
        );
    }
}
