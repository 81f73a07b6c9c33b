//! The files that a dataset is read from: what they were when they were hashed, and whether they still are.
//!
//! An artifact stands under the hash of its source, so what is read has to be what was hashed. A file is opened once, hashed
//! and read through the same handle, and compared with what stands at its path before anything is published.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io;
use std::os::unix::fs::{FileExt as _, FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

use crate::error::{Fault, IngestError};

/// Asked between blocks of a long read: whether to stop.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// Bytes that are hashed at once: enough for all threads, few enough to stop soon.
const BLOCK: usize = 4 << 20;

/// Longest wait for the clock of file times, which Linux moves once a timer tick, at most 10 ms apart. A file with a time of
/// another machine's clock may be ahead of ours for ever.
const LONGEST_TICK: Duration = Duration::from_millis(100);

/// `O_NONBLOCK` of Linux: what is no regular file answers at once instead of waiting for a writer.
const NONBLOCK: i32 = 0o4000;

/// What tells a version of a file from another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Identity {
    device: u64,
    inode: u64,
    length: u64,
    modified: (i64, i64),
    changed: (i64, i64),
}

impl Identity {
    /// Of a file's metadata.
    pub(crate) fn of(metadata: &Metadata) -> Self {
        Self {
            device: metadata.dev(),
            inode: metadata.ino(),
            length: metadata.len(),
            modified: (metadata.mtime(), metadata.mtime_nsec()),
            changed: (metadata.ctime(), metadata.ctime_nsec()),
        }
    }

    /// Length of the file in bytes.
    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// Whether the file was written within this tick of the clock of file times, so that another write might leave them as they
    /// are.
    fn fresh(&self) -> bool {
        let Ok(now) = clock_gettime(ClockId::CLOCK_REALTIME_COARSE) else {
            return false;
        };
        (now.tv_sec(), now.tv_nsec()) <= self.modified.max(self.changed)
    }
}

/// Waits until any later write to files of these identities would show in their times; whether it had to.
pub(crate) fn settle<'a>(identities: impl IntoIterator<Item = &'a Identity>) -> bool {
    let start = Instant::now();
    let mut waited = false;
    for identity in identities {
        while identity.fresh() && start.elapsed() < LONGEST_TICK {
            std::thread::sleep(Duration::from_millis(1));
            waited = true;
        }
    }
    waited
}

/// A regular file, opened for reading.
#[derive(Debug)]
pub struct SourceFile {
    path: PathBuf,
    file: File,
    identity: Identity,
}

impl SourceFile {
    /// Opens a file.
    ///
    /// # Errors
    /// No file there, or something else than a regular file; it is refused at once, whatever it is.
    pub fn open(path: &Path) -> Result<Self, IngestError> {
        Self::open_checked(path).map_err(|fault| fault.of(path))
    }

    pub(crate) fn open_checked(path: &Path) -> Result<Self, Fault> {
        let io = |error: io::Error| match error.kind() {
            io::ErrorKind::NotFound => Fault::MissingPath,
            _ => Fault::io("read", path, error),
        };
        // Before it is opened: opening a device can do anything.
        check_regular(&fs::metadata(path).map_err(io)?)?;
        let file = OpenOptions::new()
            .read(true)
            .custom_flags(NONBLOCK)
            .open(path)
            .map_err(io)?;
        let identity = |file: &File| file.metadata().map_err(io);
        let first = identity(&file)?;
        check_regular(&first)?;
        settle([&Identity::of(&first)]);
        Ok(Self {
            path: path.to_owned(),
            identity: Identity::of(&identity(&file)?),
            file,
        })
    }

    /// Where it was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The open handle. It reads the file that was opened, whatever stands at the path by now.
    pub fn file(&self) -> &File {
        &self.file
    }

    /// Its length in bytes.
    pub fn length(&self) -> u64 {
        self.identity.length
    }

    /// What it was when it was opened.
    pub(crate) fn identity(&self) -> Identity {
        self.identity
    }

    /// BLAKE3 of its bytes, read through the handle block by block and hashed on all threads.
    ///
    /// # Errors
    /// A file that cannot be read, or changed meanwhile; `stop` answered yes.
    pub fn hash(&self, stop: Stop<'_>) -> Result<[u8; 32], IngestError> {
        self.hash_checked(stop).map_err(|fault| fault.of(&self.path))
    }

    pub(crate) fn hash_checked(&self, stop: Stop<'_>) -> Result<[u8; 32], Fault> {
        let mut hasher = blake3::Hasher::new();
        let mut block = vec![0; BLOCK.min(usize::try_from(self.length()).unwrap_or(BLOCK)).max(1)];
        let mut at = 0;
        while at < self.length() {
            if stop() {
                return Err(Fault::Stopped);
            }
            let size = block.len().min((self.length() - at) as usize);
            let read = self.file.read_at(&mut block[..size], at);
            match read.map_err(|error| Fault::io("read", &self.path, error))? {
                0 => return Err(self.changed()),
                read => {
                    hasher.update_rayon(&block[..read]);
                    at += read as u64;
                }
            }
        }
        Ok(*hasher.finalize().as_bytes())
    }

    /// Whether the file at the path is still the one that was opened, of the same size and times.
    ///
    /// # Errors
    /// [`Fault::Changed`] where it is not.
    pub fn unchanged(&self) -> Result<(), IngestError> {
        self.unchanged_checked().map_err(|fault| fault.of(&self.path))
    }

    pub(crate) fn unchanged_checked(&self) -> Result<(), Fault> {
        check_unchanged(&self.path, &self.identity)
    }

    fn changed(&self) -> Fault {
        Fault::Changed {
            path: self.path.clone(),
        }
    }
}

/// Whether what stands at a path is still of this identity.
pub(crate) fn check_unchanged(path: &Path, identity: &Identity) -> Result<(), Fault> {
    match fs::metadata(path) {
        Ok(metadata) if Identity::of(&metadata) == *identity => Ok(()),
        _ => Err(Fault::Changed { path: path.to_owned() }),
    }
}

/// Refuses what is no regular file.
fn check_regular(metadata: &Metadata) -> Result<(), Fault> {
    irregular(metadata).map_or(Ok(()), |what| Err(Fault::NotAFile { what }))
}

/// What something is that is no regular file.
pub(crate) fn irregular(metadata: &Metadata) -> Option<&'static str> {
    let kind = metadata.file_type();
    Some(if kind.is_file() {
        return None;
    } else if kind.is_dir() {
        "a folder"
    } else if kind.is_fifo() {
        "a named pipe"
    } else if kind.is_socket() {
        "a socket"
    } else {
        "a device"
    })
}

/// What to do about an error of the operating system.
pub(crate) fn io_fix(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::PermissionDenied => "change its permissions or run as a user who may",
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free some space there, or use a folder on a larger disk (TMPDIR for unpacked zip files)"
        }
        io::ErrorKind::ReadOnlyFilesystem => "choose a folder that can be written to",
        io::ErrorKind::NotFound => "restore or create it",
        _ => "check the disk and try again",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(path: &Path, length: usize, seed: u8) {
        let bytes: Vec<u8> = (0..length).map(|i| (i % 251) as u8 ^ seed).collect();
        fs::write(path, bytes).unwrap();
    }

    #[test]
    fn the_hash_is_that_of_the_whole_file() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("file");
        for length in [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK + 77] {
            write(&path, length, 3);
            let file = SourceFile::open(&path).unwrap();
            let whole = blake3::hash(&fs::read(&path).unwrap());
            assert_eq!(&file.hash(&|| false).unwrap(), whole.as_bytes(), "{length} bytes");
            file.unchanged().unwrap();
        }
    }

    #[test]
    fn any_change_is_seen() {
        type Change = fn(&Path);
        let changes: [(&str, Change); 6] = [
            ("rewritten", |path| write(path, 1000, 9)),
            ("cut off", |path| write(path, 999, 3)),
            ("removed", |path| fs::remove_file(path).unwrap()),
            ("replaced by an equal one", |path| {
                let other = path.with_extension("other");
                fs::copy(path, &other).unwrap();
                fs::rename(other, path).unwrap();
            }),
            ("replaced, and put back", |path| {
                let other = path.with_extension("other");
                fs::rename(path, &other).unwrap();
                write(path, 1000, 9);
                fs::rename(other, path).unwrap();
            }),
            ("rewritten with its old time", |path| {
                let time = fs::metadata(path).unwrap().modified().unwrap();
                write(path, 1000, 9);
                File::options()
                    .append(true)
                    .open(path)
                    .unwrap()
                    .set_modified(time)
                    .unwrap();
            }),
        ];
        for (name, change) in changes {
            let place = tempfile::tempdir().unwrap();
            let path = place.path().join("file");
            write(&path, 1000, 3);
            let file = SourceFile::open(&path).unwrap();
            let before = file.hash(&|| false).unwrap();
            change(&path);
            let fault = file.unchanged().unwrap_err().fault;
            assert!(matches!(*fault, Fault::Changed { .. }), "{name}: {fault}");
            if name.starts_with("replaced") {
                assert_eq!(
                    file.hash(&|| false).unwrap(),
                    before,
                    "{name}: the handle reads another file"
                );
            }
        }
    }

    #[test]
    fn a_file_that_is_cut_off_while_it_is_hashed_is_an_error() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("file");
        write(&path, 3 * BLOCK, 3);
        let file = SourceFile::open(&path).unwrap();
        File::options()
            .write(true)
            .open(&path)
            .unwrap()
            .set_len(BLOCK as u64 + 5)
            .unwrap();
        assert!(matches!(
            *file.hash(&|| false).unwrap_err().fault,
            Fault::Changed { .. }
        ));
    }

    #[test]
    fn hashing_stops_when_asked() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("file");
        write(&path, 1000, 3);
        let file = SourceFile::open(&path).unwrap();
        assert!(matches!(*file.hash(&|| true).unwrap_err().fault, Fault::Stopped));
    }

    #[test]
    fn what_is_no_regular_file_is_refused_at_once() {
        let place = tempfile::tempdir().unwrap();
        let fifo = place.path().join("fifo");
        let made = std::process::Command::new("mkfifo").arg(&fifo).status().unwrap();
        assert!(made.success());
        for (path, what) in [
            (place.path(), "a folder"),
            (&fifo, "a named pipe"),
            (Path::new("/dev/null"), "a device"),
        ] {
            let said = SourceFile::open(path).unwrap_err().to_string();
            assert!(said.contains(what), "{said}");
        }
    }

    #[test]
    fn errors_of_the_system_name_the_path_and_the_fix() {
        let sentences: Vec<String> = [
            io::ErrorKind::PermissionDenied,
            io::ErrorKind::StorageFull,
            io::ErrorKind::ReadOnlyFilesystem,
            io::ErrorKind::NotFound,
            io::ErrorKind::TimedOut,
        ]
        .map(|kind| {
            Fault::io("read", "/data/x.zarr/data/img/3.0.0.0", kind.into())
                .of(Path::new("/data/x.zarr"))
                .to_string()
        })
        .into();
        insta::assert_snapshot!(sentences.join("\n"));
    }
}
