//! Where the store lies: a folder, or a zip file unpacked to a temporary folder.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tempfile::TempDir;
use zip::ZipArchive;
use zip::result::ZipError;

use crate::error::Fault;

/// How many folders above the store a zip file may have.
const ZIP_DEPTH: usize = 2;

/// An opened store: the folder that holds `.zgroup`.
#[derive(Debug)]
pub(crate) struct Store {
    folder: PathBuf,
    /// Keeps an unpacked zip alive; dropping it removes the files.
    _unpacked: Option<TempDir>,
}

impl Store {
    /// Opens a folder store, or unpacks a zip file and opens the store in it.
    pub(crate) fn open(path: &Path) -> Result<Self, Fault> {
        let metadata = match fs::metadata(path) {
            Ok(metadata) => metadata,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(Fault::MissingPath),
            Err(error) => return Err(Fault::io("read", path, error)),
        };
        if metadata.is_dir() {
            check_folder(path)?;
            return Ok(Self {
                folder: path.to_owned(),
                _unpacked: None,
            });
        }
        let unpacked = tempfile::Builder::new()
            .prefix("re4-ingest-")
            .tempdir()
            // The kind alone: tempfile's own words repeat the path.
            .map_err(|error| Fault::io("create a folder in", std::env::temp_dir(), error.kind().into()))?;
        unpack(path, unpacked.path())?;
        let mut stores = Vec::new();
        find_stores(unpacked.path(), ZIP_DEPTH, &mut stores)?;
        let relative = |store: &PathBuf| {
            let inside = store
                .strip_prefix(unpacked.path())
                .unwrap_or(store)
                .display()
                .to_string();
            if inside.is_empty() {
                "its root".to_owned()
            } else {
                inside
            }
        };
        match stores.as_slice() {
            [] => Err(Fault::ZipWithoutStore),
            [folder] => {
                check_folder(folder)?;
                Ok(Self {
                    folder: folder.clone(),
                    _unpacked: Some(unpacked),
                })
            }
            [first, second, ..] => Err(Fault::SeveralStoresInZip {
                count: stores.len(),
                first: relative(first),
                second: relative(second),
            }),
        }
    }

    /// The folder that holds `.zgroup`.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// BLAKE3 over the store's files in the byte order of their paths: for each, the length of its path and the path
    /// (with `/`), the length of the file, and the BLAKE3 of its bytes. Lengths are u64, little-endian.
    ///
    /// Files are hashed in parallel through a fixed buffer or a memory map, so memory does not grow with the store.
    pub(crate) fn hash(&self) -> Result<[u8; 32], Fault> {
        let mut files = Vec::new();
        list_files(&self.folder, "", &mut files)?;
        files.sort_unstable();
        let hashes: Vec<(u64, blake3::Hash)> = files
            .par_iter()
            .map(|name| {
                let path = self.folder.join(name);
                let mut hasher = blake3::Hasher::new();
                hasher
                    .update_mmap(&path)
                    .map_err(|error| Fault::io("read", path, error))?;
                Ok((hasher.count(), hasher.finalize()))
            })
            // In order, so that the first of several errors is told for any number of threads.
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<_, Fault>>()?;
        let mut whole = blake3::Hasher::new();
        for (name, (length, hash)) in files.iter().zip(hashes) {
            whole.update(&(name.len() as u64).to_le_bytes());
            whole.update(name.as_bytes());
            whole.update(&length.to_le_bytes());
            whole.update(hash.as_bytes());
        }
        Ok(*whole.finalize().as_bytes())
    }
}

/// Says what a folder is if it is not a Zarr v2 group.
fn check_folder(folder: &Path) -> Result<(), Fault> {
    let has = |name: &str| folder.join(name).is_file();
    if has(".zgroup") {
        return Ok(());
    }
    if has("zarr.json") {
        return Err(Fault::ZarrV3);
    }
    if has(".zarray") {
        return Err(Fault::SingleArray);
    }
    let mut entries = sorted_entries(folder)?;
    if entries.is_empty() {
        return Err(Fault::EmptyFolder);
    }
    entries.retain(|entry| entry.join(".zgroup").is_file());
    let hint = match entries.first().and_then(|entry| entry.file_name()) {
        Some(name) if name == "data" || name == "meta" => {
            "restore that file: its content is {\"zarr_format\": 2}".to_owned()
        }
        Some(name) => format!("it holds the store {}: give that path", name.display()),
        None => "give the folder that holds .zgroup, data/ and meta/".to_owned(),
    };
    Err(Fault::NotAStore { hint })
}

fn sorted_entries(folder: &Path) -> Result<Vec<PathBuf>, Fault> {
    let mut entries = fs::read_dir(folder)
        .and_then(|entries| {
            entries
                .map(|entry| entry.map(|entry| entry.path()))
                .collect::<io::Result<Vec<_>>>()
        })
        .map_err(|error| Fault::io("list", folder, error))?;
    entries.sort_unstable();
    Ok(entries)
}

/// Collects the topmost folders that are stores of any version.
fn find_stores(folder: &Path, depth: usize, stores: &mut Vec<PathBuf>) -> Result<(), Fault> {
    if [".zgroup", "zarr.json", ".zarray"]
        .iter()
        .any(|name| folder.join(name).is_file())
    {
        stores.push(folder.to_owned());
    } else if depth > 0 {
        for entry in sorted_entries(folder)?.iter().filter(|entry| entry.is_dir()) {
            find_stores(entry, depth - 1, stores)?;
        }
    }
    Ok(())
}

/// Collects the paths of all files below a folder, relative to it and with `/`.
fn list_files(folder: &Path, prefix: &str, files: &mut Vec<String>) -> Result<(), Fault> {
    for entry in sorted_entries(folder)? {
        let Some(name) = entry.file_name() else { continue };
        let name = format!("{prefix}{}", name.to_string_lossy());
        if entry.is_dir() {
            // A link to a folder that it lies in would be followed for ever, or as often as the system allows.
            if entry.is_symlink() && leads_up(&entry).map_err(|error| Fault::io("read", &entry, error))? {
                return Err(Fault::CircularLink { link: name });
            }
            list_files(&entry, &format!("{name}/"), files)?;
        } else {
            files.push(name);
        }
    }
    Ok(())
}

/// Whether a link leads to a folder that it lies in.
fn leads_up(link: &Path) -> io::Result<bool> {
    let target = link.canonicalize()?;
    let folder = link.parent().unwrap_or(link).canonicalize()?;
    Ok(folder.starts_with(target))
}

/// Unpacks a zip file. Nothing is written outside of `target`, and no links are made.
fn unpack(path: &Path, target: &Path) -> Result<(), Fault> {
    let file = File::open(path).map_err(|error| Fault::io("open", path, error))?;
    let mut archive = ZipArchive::new(io::BufReader::new(file)).map_err(|error| match error {
        ZipError::Io(error) if error.kind() == io::ErrorKind::PermissionDenied => Fault::io("read", path, error),
        error => Fault::UnreadableZip { why: error.to_string() },
    })?;
    for index in 0..archive.len() {
        let entry_name = match archive.name_for_index(index) {
            Some(Ok(name)) => name.into_owned(),
            _ => format!("number {index}"),
        };
        let unreadable = |why: String| Fault::UnreadableZipEntry {
            entry: entry_name.clone(),
            why,
        };
        let mut entry = archive.by_index(index).map_err(|error| unreadable(error.to_string()))?;
        let inside = match entry.enclosed_name() {
            Some(inside) if !entry.is_symlink() => target.join(inside),
            _ => return Err(Fault::UnsafeZipEntry { entry: entry_name }),
        };
        if entry.is_dir() {
            fs::create_dir_all(&inside).map_err(|error| Fault::io("create", inside, error))?;
            continue;
        }
        if let Some(parent) = inside.parent() {
            fs::create_dir_all(parent).map_err(|error| Fault::io("create", parent, error))?;
        }
        let mut output = File::create(&inside).map_err(|error| Fault::io("write", &inside, error))?;
        let expected = entry.size();
        let written = io::copy(&mut (&mut entry).take(expected.saturating_add(1)), &mut output).map_err(|error| {
            match error.kind() {
                // The disk's faults; everything else comes from the archive.
                io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::ReadOnlyFilesystem => {
                    Fault::io("write", &inside, error)
                }
                _ => unreadable(error.to_string()),
            }
        })?;
        if written != expected {
            return Err(unreadable(format!("{written} bytes instead of {expected}")));
        }
    }
    Ok(())
}
