//! The folder in which a dataset is built: a temporary sibling that gets its name when it is complete.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use serde::Serialize as _;
use serde_json::Value;
use tempfile::TempDir;

use super::WriteError;

/// Beginning of the names of temporary folders.
const PREFIX: &str = ".re4-export-";

/// Name of the file in a temporary folder that a running writer has locked.
const LOCK: &str = ".lock";

/// A dataset that is being built. Dropping it removes the files.
pub(super) struct Staging {
    /// The path of the dataset.
    path: PathBuf,
    /// Removed on every way out.
    _temporary: TempDir,
    /// Locked while the process runs, also if it is killed.
    _lock: File,
    /// The folder of the files, inside the temporary one.
    building: PathBuf,
}

impl Staging {
    /// Creates the temporary folder.
    pub(super) fn create(path: &Path) -> Result<Self, WriteError> {
        let failed = |action, source| WriteError::Io {
            path: path.to_owned(),
            action,
            file: String::new(),
            source,
        };
        match fs::read_dir(path).map(|mut entries| entries.next().is_none()) {
            Ok(true) => {}
            Err(error) if error.kind() == io::ErrorKind::NotFound && fs::symlink_metadata(path).is_err() => {}
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => return Err(failed("list it", error)),
            _ => return Err(WriteError::Exists { path: path.to_owned() }),
        }
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        remove_leftovers(parent.unwrap_or(Path::new(".")));
        let temporary = tempfile::Builder::new()
            .prefix(PREFIX)
            .tempdir_in(parent.unwrap_or(Path::new(".")))
            // Only the kind of the error: tempfile's own message repeats the path and adds a random name.
            .map_err(|error| failed("create a folder beside it", error.kind().into()))?;
        let locked = || -> io::Result<File> {
            let lock = File::create_new(temporary.path().join(LOCK))?;
            lock.lock()?;
            Ok(lock)
        };
        let lock = locked().map_err(|error| failed("create a folder beside it", error))?;
        // The temporary folder is private to its owner, so the dataset is built in a subfolder with the usual permissions.
        let building = temporary.path().join("dataset");
        fs::create_dir(&building).map_err(|error| failed("create a folder beside it", error))?;
        Ok(Self {
            path: path.to_owned(),
            _temporary: temporary,
            _lock: lock,
            building,
        })
    }

    /// The path of the dataset when it is complete.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The folder that contains the files for now.
    pub(super) fn building(&self) -> &Path {
        &self.building
    }

    /// The error of an operation on a file of the dataset.
    pub(super) fn failed(&self, action: &'static str, file: &str, source: io::Error) -> WriteError {
        WriteError::Io {
            path: self.path.clone(),
            action,
            file: file.to_owned(),
            source,
        }
    }

    /// Creates a file, and the folders in which it is.
    pub(super) fn create_file(&self, name: &str) -> Result<File, WriteError> {
        let path = self.building.join(name);
        let created = || {
            if let Some(folder) = path.parent() {
                fs::create_dir_all(folder)?;
            }
            File::create_new(&path)
        };
        created().map_err(|error| self.failed("create", name, error))
    }

    /// Writes a whole file.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<(), WriteError> {
        let mut file = self.create_file(name)?;
        let written = file.write_all(bytes).and_then(|()| file.sync_all());
        written.map_err(|error| self.failed("write", name, error))
    }

    /// Writes JSON, indented by four spaces as the official writer does.
    pub(super) fn write_json(&self, name: &str, value: &Value) -> Result<(), WriteError> {
        let mut text = Vec::new();
        let formatter = serde_json::ser::PrettyFormatter::with_indent(b"    ");
        let written = value.serialize(&mut serde_json::Serializer::with_formatter(&mut text, formatter));
        written.map_err(|error| self.failed("write", name, error.into()))?;
        text.push(b'\n');
        self.write(name, &text)
    }

    /// Gives the dataset its name; returns the size of its files.
    pub(super) fn publish(self) -> Result<u64, WriteError> {
        let bytes = size(&self.building).map_err(|error| self.failed("list", "", error))?;
        fs::rename(&self.building, &self.path).map_err(|error| match error.kind() {
            io::ErrorKind::DirectoryNotEmpty | io::ErrorKind::AlreadyExists | io::ErrorKind::NotADirectory => {
                WriteError::Exists {
                    path: self.path.clone(),
                }
            }
            _ => self.failed(
                "rename the finished dataset to",
                &self.path.display().to_string(),
                error,
            ),
        })?;
        let parent = self.path.parent().filter(|parent| !parent.as_os_str().is_empty());
        // The dataset is complete. A folder that cannot be synced is no reason to remove it.
        let _ = File::open(parent.unwrap_or(Path::new("."))).and_then(|folder| folder.sync_all());
        Ok(bytes)
    }
}

/// Removes the temporary folders of writers that were killed. A folder without a lock file may be that of a writer that has just begun.
fn remove_leftovers(parent: &Path) {
    let Ok(entries) = fs::read_dir(parent) else {
        return;
    };
    for path in entries.flatten().map(|entry| entry.path()) {
        let temporary = path
            .file_name()
            .is_some_and(|name| name.to_string_lossy().starts_with(PREFIX));
        if temporary && File::open(path.join(LOCK)).is_ok_and(|lock| lock.try_lock().is_ok()) {
            // What cannot be removed disturbs nobody.
            let _ = fs::remove_dir_all(&path);
        }
    }
}

fn size(folder: &Path) -> io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let about = entry.metadata()?;
        bytes += if about.is_dir() {
            size(&entry.path())?
        } else {
            about.len()
        };
    }
    Ok(bytes)
}
