//! The files of a dataset of several HDF5 files: which they are, and how their demonstrations are named.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::fault::Hdf5Fault;
use super::source::RobomimicSource;
use super::sources::{Sources, SourcesIdentity};
use super::survey::Surveyed;
use crate::demos::DemoSource as _;
use crate::error::{Fault, IngestError};
use crate::left_out::parts;
use crate::source::Stop;

/// Maximum number of files that a message names individually.
const NAMED: usize = 20;

/// A file of a dataset of several files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Member {
    pub(super) path: PathBuf,
    /// What precedes the names of its demonstrations: `NAME/`.
    pub(super) prefix: String,
    pub(super) identity: SourcesIdentity,
    /// What is known of its demonstrations.
    pub(super) surveyed: Option<Surveyed>,
}

/// The files of a dataset of several HDF5 files, in order. None of them is kept open.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Members {
    /// The dataset in messages.
    label: PathBuf,
    files: Vec<Member>,
}

/// The HDF5 files directly in a folder, sorted by path.
///
/// # Errors
/// The folder cannot be read or has no such files.
pub fn files_of(folder: &Path) -> Result<Vec<PathBuf>, IngestError> {
    let unreadable = |error| Fault::io("read", folder, error).of(folder);
    let (mut files, mut folders, mut others) = (Vec::new(), Vec::new(), 0);
    for entry in fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.is_dir() {
            folders.push(path);
        } else if path.extension().is_some_and(|end| end == "hdf5" || end == "h5") {
            files.push(path);
        } else {
            others += 1;
        }
    }
    files.sort();
    folders.sort();
    if !files.is_empty() {
        return Ok(files);
    }
    let what = match folders.first() {
        None if others == 0 => {
            "the folder is empty; give a folder with HDF5 files (*.hdf5 or *.h5), or the path of one".to_owned()
        }
        None => "the folder has no HDF5 files (*.hdf5 or *.h5); give a folder with such files, or the path of one"
            .to_owned(),
        Some(first) => format!(
            "the folder has no HDF5 files (*.hdf5 or *.h5), only folders such as {}; give that folder, since folders in a folder are not searched",
            first.display()
        ),
    };
    Err(Fault::from(Hdf5Fault::Other(what)).of(folder))
}

impl Members {
    /// Finds the files at these paths. `label` is the dataset in messages.
    ///
    /// # Errors
    /// Names every file that does not exist, is not an HDF5 file, or is listed twice.
    pub fn find(label: PathBuf, paths: Vec<PathBuf>) -> Result<Self, IngestError> {
        let of = paths.len();
        let prefixes = prefixes(&paths);
        let (mut files, mut faults): (Vec<Member>, Vec<IngestError>) = (Vec::new(), Vec::new());
        let mut known: BTreeMap<PathBuf, PathBuf> = BTreeMap::new();
        for (path, prefix) in paths.into_iter().zip(prefixes) {
            let refuse = |what: String| Fault::from(Hdf5Fault::Other(what)).of(&path);
            let real = fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
            let before = known.insert(real, path.clone());
            if path.is_dir() {
                faults.push(refuse(
                    "it is a folder, but a list of sources has only HDF5 files; list the files, or give only the folder".to_owned(),
                ));
            } else if path.is_file() && !RobomimicSource::probe(&path) {
                faults.push(refuse(
                    "it is not an HDF5 file, but a dataset of several files has only HDF5 files; remove it".to_owned(),
                ));
            } else if let Some(before) = before {
                faults.push(refuse(format!(
                    "it is the same file as {}; list it once",
                    before.display()
                )));
            } else if prefix.chars().any(char::is_control) {
                faults.push(refuse(
                    "its name has control characters, and it is part of the names of its demonstrations; rename it"
                        .to_owned(),
                ));
            } else {
                match Sources::open(&path) {
                    Ok(sources) => files.push(Member {
                        identity: sources.identity(),
                        path,
                        prefix,
                        surveyed: None,
                    }),
                    Err(error) => faults.push(error),
                }
            }
        }
        if let Some(error) = combined(&label, of, faults) {
            return Err(error);
        }
        Ok(Self { label, files })
    }

    /// The dataset in messages.
    pub fn label(&self) -> &Path {
        &self.label
    }

    /// The files.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(|file| file.path.as_path())
    }

    /// Checks that no file has changed since it was found.
    ///
    /// # Errors
    /// Names the first file that has.
    pub fn unchanged(&self) -> Result<(), IngestError> {
        self.files.iter().try_for_each(Member::unchanged)
    }

    pub(super) fn files(&self) -> &[Member] {
        &self.files
    }

    /// Takes what is known of the demonstrations of the files from `known` where it has it.
    pub fn set_surveyed(&mut self, known: impl Fn(&Path) -> Option<Surveyed>) {
        for file in &mut self.files {
            file.surveyed = known(&file.path);
        }
    }

    /// BLAKE3 hash of the dataset: the number of files and, for each, the length of what precedes the names of its demonstrations,
    /// that text, and the hash of the file that `hash` returns. Numbers are little-endian u64.
    ///
    /// # Errors
    /// Those of `hash`.
    pub fn hash<E>(&self, mut hash: impl FnMut(&Member) -> Result<[u8; 32], E>) -> Result<[u8; 32], E> {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&(self.files.len() as u64).to_le_bytes());
        for file in &self.files {
            hasher
                .update(&(file.prefix.len() as u64).to_le_bytes())
                .update(file.prefix.as_bytes())
                .update(&hash(file)?);
        }
        Ok(*hasher.finalize().as_bytes())
    }
}

impl Member {
    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Checks that the file has not changed since it was found.
    ///
    /// # Errors
    /// If it has.
    pub(super) fn unchanged(&self) -> Result<(), IngestError> {
        Sources::check(&self.path, &self.identity)
    }

    /// BLAKE3 hash of the file.
    ///
    /// # Errors
    /// The file cannot be read or changed, or `stop` returned true.
    pub fn hash(&self, stop: Stop<'_>) -> Result<[u8; 32], IngestError> {
        Sources::open_again(&self.path, &self.identity)?.hash(stop)
    }
}

/// What precedes the names of the demonstrations of each file: the file's name without extension, with as many of its folders as
/// make it unique.
fn prefixes(paths: &[PathBuf]) -> Vec<String> {
    let parts: Vec<Vec<String>> = paths
        .iter()
        .map(|path| {
            let whole = path.with_extension("");
            let names = whole
                .components()
                .map(|part| part.as_os_str().to_string_lossy().into_owned());
            names.filter(|name| name != "/").collect()
        })
        .collect();
    let end = |parts: &[String], length: usize| parts[parts.len().saturating_sub(length)..].join("/");
    let mut found: Vec<Option<String>> = vec![None; paths.len()];
    let longest = parts.iter().map(Vec::len).max().unwrap_or(0);
    for length in 1..=longest {
        if found.iter().all(Option::is_some) {
            break;
        }
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        for parts in &parts {
            *counts.entry(end(parts, length)).or_default() += 1;
        }
        for (found, parts) in found.iter_mut().zip(&parts).filter(|(found, _)| found.is_none()) {
            let own = end(parts, length);
            if counts.get(&own) == Some(&1) {
                *found = Some(own);
            }
        }
    }
    // Files that differ only in their extension keep it.
    let whole = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let named = found
        .into_iter()
        .zip(paths)
        .map(|(found, path)| format!("{}/", found.or_else(|| whole(path)).unwrap_or_default()));
    named.collect()
}

/// One error for the faults of the files of a dataset; `None` if there are none. Faults whose dataset is `label` name their files
/// themselves.
pub(super) fn combined(label: &Path, of: usize, mut faults: Vec<IngestError>) -> Option<IngestError> {
    let first = |fault: &IngestError| fault.needs_library() || fault.fault.ends_reading();
    if let Some(place) = faults.iter().position(first) {
        return Some(faults.swap_remove(place));
    }
    if faults.len() < 2 {
        return faults.pop();
    }
    let (mut named, mut remedies): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    for fault in &faults {
        let sentence = fault.fault.to_string();
        let (what, remedy) = parts(&sentence);
        if !remedy.is_empty() && !remedies.iter().any(|known| known == remedy) {
            remedies.push(remedy.to_owned());
        }
        named.push(if fault.dataset == label {
            what.to_owned()
        } else {
            format!("{} ({what})", fault.dataset.display())
        });
    }
    let more = match named.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    named.truncate(NAMED);
    let text = format!(
        "{} faults in its {of} files: {}{more}; {}",
        faults.len(),
        named.join(", "),
        remedies.join("; ")
    );
    Some(Fault::from(Hdf5Fault::Other(text)).of(label))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prefixes_are_the_shortest_unique_ends() {
        let of = |paths: &[&str]| prefixes(&paths.iter().map(PathBuf::from).collect::<Vec<_>>());
        assert_eq!(of(&["/x/a.hdf5", "/x/b.hdf5"]), ["a/", "b/"]);
        assert_eq!(
            of(&["/x/one/demo.hdf5", "/x/two/demo.hdf5", "/x/two/other.h5"]),
            ["one/demo/", "two/demo/", "other/"]
        );
        // Another folder does not change the names.
        assert_eq!(
            of(&["/y/z/one/demo.hdf5", "/y/z/two/demo.hdf5"]),
            ["one/demo/", "two/demo/"]
        );
        assert_eq!(of(&["a.b.hdf5", "a.c.hdf5"]), ["a.b/", "a.c/"]);
        assert_eq!(of(&["x/a.hdf5", "x/a.h5"]), ["a.hdf5/", "a.h5/"]);
        assert_eq!(of(&["demo.hdf5", "x/demo.hdf5"]), ["demo/", "x/demo/"]);
    }

    #[test]
    fn a_folder_without_hdf5_files_is_refused() {
        let place = tempfile::tempdir().unwrap();
        let why = || files_of(place.path()).unwrap_err().fault.to_string();
        assert!(why().starts_with("the folder is empty; "), "{}", why());
        fs::write(place.path().join("notes.txt"), "").unwrap();
        assert!(why().starts_with("the folder has no HDF5 files"), "{}", why());
        fs::create_dir(place.path().join("sub")).unwrap();
        assert!(
            why().contains("only folders such as") && why().contains("/sub; "),
            "{}",
            why()
        );
        for name in ["b.hdf5", "a.h5", "c.txt"] {
            fs::write(place.path().join(name), "").unwrap();
        }
        let names: Vec<_> = files_of(place.path()).unwrap();
        assert_eq!(names, ["a.h5", "b.hdf5"].map(|name| place.path().join(name)));
    }

    #[test]
    fn all_faults_of_a_list_are_named() {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name);
        fs::write(at("a.hdf5"), "").unwrap();
        fs::write(at("b.zip"), "").unwrap();
        fs::create_dir(at("c")).unwrap();
        let paths = ["a.hdf5", "a.hdf5", "b.zip", "c", "d.hdf5"].map(at).to_vec();
        let error = Members::find("list".into(), paths).unwrap_err().to_string();
        for part in [
            "cannot ingest list: 4 faults in its 5 files",
            "a.hdf5 (it is the same file as",
            "b.zip (it is not an HDF5 file",
            "c (it is a folder",
            "d.hdf5 (there is no such file",
        ] {
            assert!(error.contains(part), "{part}: {error}");
        }
    }

    #[test]
    fn the_hash_has_order_and_names() {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name);
        for (name, text) in [("a.hdf5", "one"), ("b.hdf5", "two"), ("c.hdf5", "two")] {
            fs::write(at(name), text).unwrap();
        }
        let hash = |names: [&str; 2]| {
            let members = Members::find("x".into(), names.map(at).to_vec()).unwrap();
            members.hash(|file| file.hash(&|| false)).unwrap()
        };
        let hashes = [["a.hdf5", "b.hdf5"], ["b.hdf5", "a.hdf5"], ["a.hdf5", "c.hdf5"]].map(hash);
        assert!(hashes[0] != hashes[1] && hashes[0] != hashes[2]);
        assert_eq!(hash(["a.hdf5", "b.hdf5"]), hashes[0]);
    }
}
