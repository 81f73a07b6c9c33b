//! The source files of demonstrations: the HDF5 file, and the model files beside it that its demonstrations refer to.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::error::{Fault, IngestError};
use crate::source::{Identity, SourceFile, Stop, check_unchanged};

/// Folder beside a raw file with its models, used if `model_file` is a file name.
pub(super) const MODELS_FOLDER: &str = "models";

/// Maximum size of a model in bytes.
const MAX_MODEL: u64 = 64 << 20;

/// The opened source files.
#[derive(Debug, Clone)]
pub struct Sources {
    file: Arc<SourceFile>,
    /// Models by name. They are opened only while they are read, since there can be more of them than a process may have open
    /// files.
    models: BTreeMap<String, Identity>,
}

/// Identities of the files, for detecting changes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SourcesIdentity {
    file: Identity,
    models: BTreeMap<String, Identity>,
}

impl Sources {
    /// Opens an HDF5 file. Models are added by [`Sources::with_models`].
    ///
    /// # Errors
    /// Same as [`SourceFile::open`].
    pub fn open(path: &Path) -> Result<Self, IngestError> {
        Ok(Self {
            file: Arc::new(SourceFile::open(path)?),
            models: BTreeMap::new(),
        })
    }

    /// Opens files that another process has opened, and checks that they are the same.
    ///
    /// # Errors
    /// Same as [`SourceFile::open`]; also if a file changed since.
    pub fn open_again(path: &Path, identity: &SourcesIdentity) -> Result<Self, IngestError> {
        let sources = Self {
            models: identity.models.clone(),
            ..Self::open(path)?
        };
        if sources.file.identity() == identity.file {
            sources.unchanged()?;
            Ok(sources)
        } else {
            Err(sources.changed())
        }
    }

    /// Checks that the file at a path is still the one with this identity, without opening it.
    pub(super) fn check(path: &Path, identity: &SourcesIdentity) -> Result<(), IngestError> {
        check_unchanged(path, &identity.file).map_err(|fault| fault.of(path))
    }

    /// Adds the models with these names, if they exist.
    #[must_use]
    pub fn with_models(mut self, names: impl IntoIterator<Item = String>) -> Self {
        for name in names {
            // A missing model is reported for each demonstration that refers to it.
            if let Ok(model) = SourceFile::open_checked(&self.model_path(&name)) {
                self.models.insert(name, model.identity());
            }
        }
        self
    }

    /// Names of the models, in byte order.
    pub fn model_names(&self) -> impl Iterator<Item = &str> {
        self.models.keys().map(String::as_str)
    }

    /// The error that reports a change of the files.
    pub fn changed(&self) -> IngestError {
        let path = self.path().to_owned();
        Fault::Changed { path }.of(self.path())
    }

    /// Whether there is a folder for models beside the file.
    pub fn has_models_folder(&self) -> bool {
        self.folder().join(MODELS_FOLDER).is_dir()
    }

    /// The HDF5 file.
    pub fn file(&self) -> &Arc<SourceFile> {
        &self.file
    }

    /// The path of the HDF5 file.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Identities of the files, for detecting changes.
    pub fn identity(&self) -> SourcesIdentity {
        SourcesIdentity {
            file: self.file.identity(),
            models: self.models.clone(),
        }
    }

    /// BLAKE3 hash of the HDF5 file. If demonstrations refer to models, it is the BLAKE3 hash over that hash and, for each model
    /// in the byte order of the names, the length of its name as little-endian u64, its name and the BLAKE3 hash of its bytes.
    ///
    /// # Errors
    /// A file cannot be read or changed, or `stop` returned true.
    pub fn hash(&self, stop: Stop<'_>) -> Result<[u8; 32], IngestError> {
        let own = self.file.hash(stop)?;
        if self.models.is_empty() {
            return Ok(own);
        }
        let mut hasher = blake3::Hasher::new();
        hasher.update(&own);
        for name in self.models.keys() {
            let hash = self.open_model(name).and_then(|model| model.hash_checked(stop));
            let hash = hash.map_err(|fault| fault.of(self.path()))?;
            hasher
                .update(&(name.len() as u64).to_le_bytes())
                .update(name.as_bytes())
                .update(&hash);
        }
        Ok(*hasher.finalize().as_bytes())
    }

    /// Checks that no file has changed since it was opened.
    ///
    /// # Errors
    /// Names the first file that changed.
    pub fn unchanged(&self) -> Result<(), IngestError> {
        self.file.unchanged()?;
        for (name, identity) in &self.models {
            check_unchanged(&self.model_path(name), identity).map_err(|fault| fault.of(self.path()))?;
        }
        Ok(())
    }

    /// The text of a model beside the file.
    pub(super) fn model(&self, name: &str) -> Result<String, Fault> {
        let model = self.open_model(name)?;
        let mut text = String::new();
        let read = model.file().take(MAX_MODEL).read_to_string(&mut text);
        read.map_err(|error| Fault::io("read", model.path(), error))?;
        Ok(text)
    }

    fn open_model(&self, name: &str) -> Result<SourceFile, Fault> {
        let path = self.model_path(name);
        let model = SourceFile::open_checked(&path)?;
        match self.models.get(name) {
            Some(identity) if *identity == model.identity() => Ok(model),
            // A model that did not exist before is a change, too.
            _ => Err(Fault::Changed { path }),
        }
    }

    fn folder(&self) -> &Path {
        self.path().parent().unwrap_or(Path::new("."))
    }

    fn model_path(&self, name: &str) -> PathBuf {
        self.folder().join(MODELS_FOLDER).join(name)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn only_referenced_models_are_hashed() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("demo.hdf5");
        fs::write(&path, "file").unwrap();
        let hash = |names: &[&str]| {
            let sources = Sources::open(&path).unwrap();
            let sources = sources.with_models(names.iter().map(|&name| name.to_owned()));
            sources.hash(&|| false).unwrap()
        };
        let alone = hash(&[]);
        assert_eq!(alone, *blake3::hash(b"file").as_bytes());
        let models = place.path().join(MODELS_FOLDER);
        fs::create_dir(&models).unwrap();
        fs::write(models.join("a.xml"), "a").unwrap();
        fs::write(models.join("epoch.pth"), "weights").unwrap();
        assert_eq!(hash(&[]), alone);
        assert_eq!(hash(&["missing.xml"]), alone);
        let with = hash(&["a.xml"]);
        assert_ne!(with, alone);
        fs::write(models.join("epoch.pth"), "other weights").unwrap();
        assert_eq!(hash(&["a.xml"]), with);
        fs::write(models.join("a.xml"), "b").unwrap();
        assert_ne!(hash(&["a.xml"]), with);
    }

    #[test]
    fn a_changed_model_is_detected() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("demo.hdf5");
        fs::write(&path, "file").unwrap();
        let models = place.path().join(MODELS_FOLDER);
        fs::create_dir(&models).unwrap();
        fs::write(models.join("a.xml"), "a").unwrap();
        let sources = Sources::open(&path).unwrap().with_models(["a.xml".to_owned()]);
        let again = Sources::open_again(&path, &sources.identity()).unwrap();
        assert_eq!(again.model("a.xml").unwrap(), "a");
        fs::write(models.join("a.xml"), "b").unwrap();
        for sources in [&sources, &again] {
            assert!(matches!(*sources.unchanged().unwrap_err().fault, Fault::Changed { .. }));
            assert!(matches!(sources.model("a.xml").unwrap_err(), Fault::Changed { .. }));
            assert!(sources.hash(&|| false).is_err());
        }
        assert!(Sources::open_again(&path, &sources.identity()).is_err());
    }
}
