//! Access to a zarr store, which is a folder or a zip file unpacked to a temporary folder; lists the files that belong to the
//! dataset.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Write as _};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tempfile::TempDir;
use zip::ZipArchive;
use zip::result::ZipError;

use crate::error::Fault;
use crate::source::{Identity, SourceFile, Stop, irregular, is_unreachable, settle};

/// Maximum number of folders above the store in a zip file.
const ZIP_DEPTH: usize = 2;

/// The arrays that are read. Nothing else in the store is opened, and nothing else is part of its hash.
const ARRAYS: [&str; 6] = [
    "data/action",
    "data/img",
    "data/keypoint",
    "data/n_contacts",
    "data/state",
    "meta/episode_ends",
];

/// The groups that contain them.
const GROUPS: [&str; 3] = ["", "data/", "meta/"];

/// Metadata files of arrays and groups, of Zarr v2 and v3.
const METADATA: [&str; 4] = [".zarray", ".zattrs", ".zgroup", "zarr.json"];

/// Files that mark a folder as a store, or as an array of one, of either version.
const MARKERS: [&str; 3] = [".zgroup", "zarr.json", ".zarray"];

/// Bytes read at once, so that a request to stop takes effect soon.
const BLOCK: usize = 4 << 20;

/// An opened store: the folder that contains `.zgroup` or `zarr.json`, and the identities of its files when it was opened.
#[derive(Debug)]
pub(crate) struct Store {
    folder: PathBuf,
    /// The files of the dataset by their paths in the store, separated by `/`.
    files: BTreeMap<String, Identity>,
    /// The zip file, if the store was unpacked from one.
    archive: Option<SourceFile>,
    /// Keeps the unpacked zip; dropping it removes the files.
    _unpacked: Option<TempDir>,
}

impl Store {
    /// Opens a folder store, or unpacks a zip file and opens the store in it.
    pub(crate) fn open(path: &Path, stop: Stop<'_>) -> Result<Self, Fault> {
        let metadata = match fs::metadata(path) {
            Ok(metadata) => metadata,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(Fault::MissingPath),
            Err(error) => return Err(Fault::io("read", path, error)),
        };
        if metadata.is_dir() {
            return Self::of_folder(path.to_owned(), None, None, stop);
        }
        let archive = SourceFile::open_checked(path)?;
        check_kind(&archive)?;
        let unpacked = tempfile::Builder::new()
            .prefix("re4-ingest-")
            .tempdir()
            // Only the kind of the error: tempfile's own message repeats the path.
            .map_err(|error| Fault::io("create a folder in", std::env::temp_dir(), error.kind().into()))?;
        // A zip file that is still being written can be corrupt anywhere: report the change rather than the corruption.
        unpack(&archive, unpacked.path(), stop).map_err(|fault| changed_or(&archive, fault))?;
        archive.unchanged_checked()?;
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
            [folder] => Self::of_folder(folder.clone(), Some(archive), Some(unpacked), stop),
            [first, second, ..] => Err(Fault::SeveralStoresInZip {
                count: stores.len(),
                first: relative(first),
                second: relative(second),
            }),
        }
    }

    fn of_folder(
        folder: PathBuf,
        archive: Option<SourceFile>,
        unpacked: Option<TempDir>,
        stop: Stop<'_>,
    ) -> Result<Self, Fault> {
        check_folder(&folder)?;
        let mut files = list(&folder, stop)?;
        // A file that was just written might be written again without a change of its times.
        if settle(files.values()) {
            files = list(&folder, stop)?;
        }
        Ok(Self {
            folder,
            files,
            archive,
            _unpacked: unpacked,
        })
    }

    /// Whether its root is of Zarr format 3.
    pub(crate) fn is_format_3(&self) -> bool {
        self.files.contains_key("zarr.json")
    }

    /// Length of a file of the dataset; `None` if it did not exist when the store was opened.
    pub(crate) fn length(&self, name: &str) -> Option<u64> {
        self.files.get(name).map(Identity::length)
    }

    /// Names of the dataset's files below a folder of it, relative to that folder.
    pub(crate) fn names_below<'a>(&'a self, folder: &'a str) -> impl Iterator<Item = &'a str> {
        self.files
            .range::<str, _>((std::ops::Bound::Included(folder), std::ops::Bound::Unbounded))
            .map(|(name, _)| name.as_str())
            .take_while(move |name| name.starts_with(folder))
            .filter_map(move |name| name.strip_prefix(folder)?.strip_prefix('/'))
    }

    /// The bytes of a file of the dataset; `None` if it did not exist when the store was opened.
    ///
    /// # Errors
    /// The file changed or cannot be read, or `stop` returned true.
    pub(crate) fn read(&self, name: &str, stop: Stop<'_>) -> Result<Option<Vec<u8>>, Fault> {
        let Some(identity) = self.files.get(name) else {
            return Ok(None);
        };
        let file = self.open_file(name, identity)?;
        let mut bytes = vec![0; identity.length() as usize];
        for (number, block) in bytes.chunks_mut(BLOCK).enumerate() {
            if stop() {
                return Err(Fault::Stopped);
            }
            let read = file.file().read_exact_at(block, (number * BLOCK) as u64);
            read.map_err(|error| match error.kind() {
                io::ErrorKind::UnexpectedEof => changed(file.path()),
                _ => Fault::io("read", file.path(), error),
            })?;
        }
        Ok(Some(bytes))
    }

    /// Opens a file of the dataset, and checks that it has not changed.
    fn open_file(&self, name: &str, identity: &Identity) -> Result<SourceFile, Fault> {
        let path = self.folder.join(name);
        match SourceFile::open_checked(&path) {
            Ok(file) if file.identity() == *identity => Ok(file),
            Ok(_) | Err(Fault::MissingPath | Fault::NotAFile { .. }) => Err(changed(&path)),
            Err(fault) => Err(fault),
        }
    }

    /// BLAKE3 hash over the dataset's files in the byte order of their paths. For each file it covers the length of its path, the
    /// path (with `/`), the length of the file, and the BLAKE3 hash of its bytes. Lengths are u64, little-endian.
    ///
    /// Files are hashed in parallel, block by block.
    ///
    /// # Errors
    /// A file changed since the store was opened or cannot be read, or `stop` returned true.
    pub(crate) fn hash(&self, stop: Stop<'_>) -> Result<[u8; 32], Fault> {
        let files: Vec<(&String, &Identity)> = self.files.iter().collect();
        let hashes: Vec<[u8; 32]> = files
            .par_iter()
            .map(|(name, identity)| self.open_file(name, identity)?.hash_checked(stop))
            // Collected in order before the errors are examined, so that the reported error does not depend on the number of
            // threads.
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<_, Fault>>()?;
        let mut whole = blake3::Hasher::new();
        for ((name, identity), hash) in files.iter().zip(hashes) {
            whole.update(&(name.len() as u64).to_le_bytes());
            whole.update(name.as_bytes());
            whole.update(&identity.length().to_le_bytes());
            whole.update(&hash);
        }
        Ok(*whole.finalize().as_bytes())
    }

    /// Checks that no file of the dataset was changed, replaced, added or removed since the store was opened.
    ///
    /// # Errors
    /// [`Fault::Changed`], with the first file that differs.
    pub(crate) fn unchanged(&self) -> Result<(), Fault> {
        if let Some(archive) = &self.archive {
            // Only this process has access to the unpacked files.
            return archive.unchanged_checked();
        }
        let now = list(&self.folder, &|| false).map_err(|fault| match fault {
            Fault::Io { ref source, .. } if is_unreachable(source) => fault,
            Fault::Changed { path } | Fault::Io { path, .. } => Fault::Changed { path },
            Fault::NotAFileInside { file, .. } => changed(&self.folder.join(file)),
            _ => changed(&self.folder),
        })?;
        let different = |name: &&String| self.files.get(*name) != now.get(*name);
        match self.files.keys().chain(now.keys()).filter(different).min() {
            Some(name) => Err(changed(&self.folder.join(name))),
            None => Ok(()),
        }
    }

    /// Returns [`Fault::Changed`] if the store changed, else the fault itself: files that are being written can cause any fault.
    pub(crate) fn explain(&self, fault: Fault) -> Fault {
        match fault {
            Fault::Stopped | Fault::Changed { .. } => fault,
            fault => self.unchanged().err().unwrap_or(fault),
        }
    }

    /// Names of all arrays at the top, in `data` and in `meta`, for messages.
    pub(crate) fn arrays(&self) -> Vec<String> {
        let is_array = |folder: &Path| folder.join(".zarray").is_file() || is_array_v3(&folder.join("zarr.json"));
        GROUPS
            .iter()
            .flat_map(|group| {
                let entries = sorted_entries(&self.folder.join(group)).unwrap_or_default();
                entries
                    .into_iter()
                    .filter(|entry| is_array(entry))
                    .filter_map(move |entry| Some(format!("{group}{}", entry.file_name()?.to_string_lossy())))
            })
            .collect()
    }
}

fn changed(path: &Path) -> Fault {
    Fault::Changed { path: path.to_owned() }
}

fn changed_or(archive: &SourceFile, fault: Fault) -> Fault {
    match fault {
        Fault::Stopped => fault,
        fault => archive.unchanged_checked().err().unwrap_or(fault),
    }
}

/// Refuses a folder that is not a group of Zarr format 2 or 3, and suggests a remedy.
fn check_folder(folder: &Path) -> Result<(), Fault> {
    let has = |name: &str| folder.join(name).is_file();
    if has(".zarray") || has("zarr.json") && is_array_v3(&folder.join("zarr.json")) {
        return Err(Fault::SingleArray);
    }
    if has(".zgroup") || has("zarr.json") {
        return Ok(());
    }
    let mut entries = sorted_entries(folder)?;
    if entries.is_empty() {
        return Err(Fault::EmptyFolder);
    }
    entries.retain(|entry| MARKERS.iter().any(|name| entry.join(name).is_file()));
    let hint = match entries.first().and_then(|entry| entry.file_name().zip(Some(entry))) {
        Some((name, entry)) if name == "data" || name == "meta" => {
            if entry.join("zarr.json").is_file() {
                "restore zarr.json with the content {\"zarr_format\": 3, \"node_type\": \"group\"}".to_owned()
            } else {
                "restore .zgroup with the content {\"zarr_format\": 2}".to_owned()
            }
        }
        Some((name, _)) => format!("give the path of the store {} inside it", name.display()),
        None => "give the folder that contains .zgroup, data/ and meta/".to_owned(),
    };
    Err(Fault::NotAStore { hint })
}

/// Whether a `zarr.json` belongs to an array. An unreadable file returns false; opening the arrays then reports the error.
fn is_array_v3(path: &Path) -> bool {
    let mut text = String::new();
    let mut read = |path| File::open(path).and_then(|file| file.take(1 << 20).read_to_string(&mut text));
    path.is_file()
        && read(path).is_ok()
        && serde_json::from_str::<serde_json::Value>(&text)
            .is_ok_and(|json| json.get("node_type").and_then(|kind| kind.as_str()) == Some("array"))
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

/// Collects the topmost folders that are stores of either version.
fn find_stores(folder: &Path, depth: usize, stores: &mut Vec<PathBuf>) -> Result<(), Fault> {
    if MARKERS.iter().any(|name| folder.join(name).is_file()) {
        stores.push(folder.to_owned());
    } else if depth > 0 {
        for entry in sorted_entries(folder)?.iter().filter(|entry| entry.is_dir()) {
            find_stores(entry, depth - 1, stores)?;
        }
    }
    Ok(())
}

/// Lists the dataset's files by their paths in the store, with their present identities.
fn list(folder: &Path, stop: Stop<'_>) -> Result<BTreeMap<String, Identity>, Fault> {
    let mut files = BTreeMap::new();
    for group in GROUPS {
        for name in METADATA {
            let name = format!("{group}{name}");
            let path = folder.join(&name);
            if let Ok(metadata) = fs::metadata(&path) {
                add(&mut files, name, &metadata)?;
            }
        }
    }
    for array in ARRAYS {
        let path = folder.join(array);
        if path.is_dir() {
            list_array(&path, array, true, &mut files, stop)?;
        }
    }
    Ok(files)
}

fn add(files: &mut BTreeMap<String, Identity>, name: String, metadata: &fs::Metadata) -> Result<(), Fault> {
    if let Some(what) = irregular(metadata) {
        return Err(Fault::NotAFileInside { file: name, what });
    }
    files.insert(name, Identity::of(metadata));
    Ok(())
}

/// Whether an entry of an array's folder belongs to the array: metadata, chunks such as `3.0`, `c` and `c.3.0`, and `3` below
/// folders.
fn belongs(name: &str, at_top: bool) -> bool {
    let numbers = |name: &str| {
        name.split('.')
            .all(|part| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit()))
    };
    let chunk = name.strip_prefix("c.").unwrap_or(name);
    numbers(name) || at_top && (METADATA.contains(&name) || name == "c" || numbers(chunk))
}

/// Collects the files of an array.
fn list_array(
    folder: &Path,
    prefix: &str,
    at_top: bool,
    files: &mut BTreeMap<String, Identity>,
    stop: Stop<'_>,
) -> Result<(), Fault> {
    for entry in sorted_entries(folder)? {
        if stop() {
            return Err(Fault::Stopped);
        }
        let name = entry.file_name().and_then(|name| name.to_str());
        let Some(name) = name.filter(|name| belongs(name, at_top)) else {
            continue;
        };
        let inside = format!("{prefix}/{name}");
        let metadata = match fs::metadata(&entry) {
            Ok(metadata) => metadata,
            // It existed when the folder was listed.
            Err(error) if error.kind() == io::ErrorKind::NotFound && !entry.is_symlink() => {
                return Err(changed(&entry));
            }
            Err(error) => return Err(Fault::io("read", entry, error)),
        };
        if metadata.is_dir() {
            // Following a link to a parent folder would recurse until the system's limit on links.
            if entry.is_symlink() && points_to_parent(&entry).map_err(|error| Fault::io("read", &entry, error))? {
                return Err(Fault::CircularLink { link: inside });
            }
            list_array(&entry, &inside, false, files, stop)?;
        } else {
            add(files, inside, &metadata)?;
        }
    }
    Ok(())
}

/// Whether a link points to one of its own parent folders.
fn points_to_parent(link: &Path) -> io::Result<bool> {
    let target = link.canonicalize()?;
    let folder = link.parent().unwrap_or(link).canonicalize()?;
    Ok(folder.starts_with(target))
}

/// Identifies common files that are not zip files by their first bytes, and refuses them with a remedy.
fn check_kind(file: &SourceFile) -> Result<(), Fault> {
    let mut head = [0; 512];
    let length = head.len().min(file.length() as usize);
    let head = &mut head[..length];
    file.file()
        .read_exact_at(head, 0)
        .map_err(|error| Fault::io("read", file.path(), error))?;
    let starts = |magic: &[u8]| head.starts_with(magic);
    let (what, fix) = if head.is_empty() {
        ("the file is empty", "copy or download it again")
    } else if starts(b"\x89HDF\r\n\x1a\n") {
        (
            "it is an HDF5 file, but Push-T is read from a zarr store",
            "give a zarr store, or set task to the task of the file, such as \"can\"",
        )
    } else if starts(b"\x1f\x8b") {
        (
            "it is compressed with gzip",
            "unpack it (tar -xzf for a .tar.gz, otherwise gunzip) and give the folder of the store",
        )
    } else if starts(b"\x28\xb5\x2f\xfd") {
        (
            "it is compressed with zstd",
            "unpack it (tar --zstd -xf for a .tar.zst, otherwise unzstd) and give the folder of the store",
        )
    } else if starts(b"\xfd7zXZ\0") || starts(b"BZh") {
        (
            "it is compressed with xz or bzip2",
            "unpack it (tar -xf for an archive) and give the folder of the store",
        )
    } else if starts(b"7z\xbc\xaf\x27\x1c") || starts(b"Rar!") {
        (
            "it is a 7z or rar archive",
            "unpack it and give the folder of the store",
        )
    } else if head.get(257..262) == Some(b"ustar") {
        (
            "it is a tar archive",
            "unpack it (tar -xf) and give the folder of the store",
        )
    } else if starts(b"\x93NUMPY") || starts(b"PAR1") {
        (
            "it is a NumPy or Parquet file, but Push-T is read from a zarr store",
            "write its arrays to a zarr store",
        )
    } else {
        return Ok(());
    };
    Err(Fault::NotAStoreFile { what, fix })
}

/// Unpacks a zip file, read through its open handle. Nothing is written outside `target`, and no links are created.
fn unpack(file: &SourceFile, target: &Path, stop: Stop<'_>) -> Result<(), Fault> {
    let mut archive = ZipArchive::new(io::BufReader::new(file.file())).map_err(|error| match error {
        ZipError::Io(error) if error.kind() == io::ErrorKind::PermissionDenied => Fault::io("read", file.path(), error),
        error => Fault::UnreadableZip { why: error.to_string() },
    })?;
    for index in 0..archive.len() {
        if stop() {
            return Err(Fault::Stopped);
        }
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
        // At most one byte more than the entry declares is unpacked, so that a wrong size cannot fill the disk.
        let written = copy(&mut (&mut entry).take(expected.saturating_add(1)), &mut output, stop);
        let written = written.map_err(|error| match error {
            Copying::Stopped => Fault::Stopped,
            Copying::Read(error) => unreadable(error.to_string()),
            Copying::Write(error) => Fault::io("write", &inside, error),
        })?;
        if written != expected {
            return Err(unreadable(format!("{written} bytes instead of {expected}")));
        }
    }
    Ok(())
}

/// Why a copy ended early.
enum Copying {
    Stopped,
    Read(io::Error),
    Write(io::Error),
}

/// Copies everything from a reader to a file, block by block. Returns the number of bytes.
fn copy(from: &mut impl Read, to: &mut File, stop: Stop<'_>) -> Result<u64, Copying> {
    let mut block = vec![0; 1 << 16];
    let mut copied = 0;
    loop {
        if stop() {
            return Err(Copying::Stopped);
        }
        match from.read(&mut block) {
            Ok(0) => return Ok(copied),
            Ok(read) => {
                to.write_all(&block[..read]).map_err(Copying::Write)?;
                copied += read as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(Copying::Read(error)),
        }
    }
}
