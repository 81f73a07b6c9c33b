//! Source files of a dataset: hashing them, and detecting changes since they were hashed.
//!
//! The key of an artifact contains the hash of its source, so the bytes that are read must be the bytes that were hashed. A file
//! is opened once, hashed and read through the same handle, and compared with the file at its path before anything is published.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io;
use std::os::unix::fs::{FileExt as _, FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

use crate::error::{Fault, IngestError};

/// Callback that long reads call between blocks. It returns true if reading should stop.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// Bytes hashed at once: large enough to occupy all threads, small enough that a request to stop takes effect soon.
const BLOCK: usize = 4 << 20;

/// Maximum time to wait for the clock of file times, which Linux advances once per timer tick, at most 10 ms apart. The limit is
/// needed because a file written by another machine can have a time that is far ahead of the local clock.
const LONGEST_TICK: Duration = Duration::from_millis(100);

/// `O_NONBLOCK` of Linux: opening a named pipe returns at once instead of waiting for a writer.
const NONBLOCK: i32 = 0o4000;

/// Metadata that identifies one version of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Identity {
    device: u64,
    inode: u64,
    length: u64,
    modified: (i64, i64),
    changed: (i64, i64),
}

impl Identity {
    /// The identity in a file's metadata.
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

    /// Whether the file was written within the current tick of the clock of file times, so that another write might not change
    /// its times.
    fn fresh(&self) -> bool {
        let Ok(now) = clock_gettime(ClockId::CLOCK_REALTIME_COARSE) else {
            return false;
        };
        (now.tv_sec(), now.tv_nsec()) <= self.modified.max(self.changed)
    }
}

/// Waits until any later write to files of these identities would change their times. Returns whether it had to wait.
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
    /// There is no file at the path, or it is not a regular file. Special files such as pipes are refused without blocking.
    pub fn open(path: &Path) -> Result<Self, IngestError> {
        Self::open_checked(path).map_err(|fault| fault.of(path))
    }

    pub(crate) fn open_checked(path: &Path) -> Result<Self, Fault> {
        let io = |error: io::Error| match error.kind() {
            io::ErrorKind::NotFound => Fault::MissingPath,
            _ => Fault::io("read", path, error),
        };
        // Checked before opening, because opening a device can have side effects.
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

    /// The path at which it was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The open handle. It reads the file that was opened, even if another file is at the path by now.
    pub fn file(&self) -> &File {
        &self.file
    }

    /// Its length in bytes.
    pub fn length(&self) -> u64 {
        self.identity.length
    }

    /// Its identity when it was opened.
    pub(crate) fn identity(&self) -> Identity {
        self.identity
    }

    /// BLAKE3 hash of its bytes, read through the handle block by block and hashed on all threads.
    ///
    /// # Errors
    /// The file cannot be read, it changed, or `stop` returned true.
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

    /// Checks that the file at the path is still the one that was opened, with the same size and times.
    ///
    /// # Errors
    /// [`Fault::Changed`] if it is not.
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

/// Checks that the file at a path still has this identity.
pub(crate) fn check_unchanged(path: &Path, identity: &Identity) -> Result<(), Fault> {
    match fs::metadata(path) {
        Ok(metadata) if Identity::of(&metadata) == *identity => Ok(()),
        Err(error) if is_unreachable(&error) => Err(Fault::io("read", path, error)),
        _ => Err(Fault::Changed { path: path.to_owned() }),
    }
}

/// Whether an error is about the connection to a network file system or about a disk, so that it says nothing about a change of the file.
pub(crate) fn is_unreachable(error: &io::Error) -> bool {
    // EIO has no kind.
    let disk = error.raw_os_error() == Some(5);
    let connection = matches!(
        error.kind(),
        io::ErrorKind::NotConnected
            | io::ErrorKind::ConnectionAborted
            | io::ErrorKind::ConnectionReset
            | io::ErrorKind::TimedOut
            | io::ErrorKind::HostUnreachable
            | io::ErrorKind::NetworkUnreachable
            | io::ErrorKind::NetworkDown
    );
    disk || connection
}

/// Refuses anything that is not a regular file.
fn check_regular(metadata: &Metadata) -> Result<(), Fault> {
    irregular(metadata).map_or(Ok(()), |what| Err(Fault::NotAFile { what }))
}

/// Describes a file that is not a regular file; `None` for a regular file.
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

/// The remedy for an error of the operating system.
pub(crate) fn io_fix(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::PermissionDenied => "change its permissions or run as a user with access",
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free some space there, or use a folder on a larger disk (zip files are unpacked to TMPDIR)"
        }
        io::ErrorKind::ReadOnlyFilesystem => "choose a folder that can be written to",
        io::ErrorKind::NotFound => "restore or create it",
        io::ErrorKind::NotConnected | io::ErrorKind::ConnectionAborted => "mount its file system again, then run again",
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
    fn every_change_is_detected() {
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
    fn a_file_truncated_during_hashing_is_an_error() {
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
    fn special_files_are_refused_at_once() {
        let place = tempfile::tempdir().unwrap();
        let fifo = place.path().join("fifo");
        let made = std::process::Command::new("mkfifo").arg(&fifo).status().unwrap();
        assert!(made.success());
        for (path, what) in [
            (place.path(), "a folder"),
            (&fifo, "a named pipe"),
            (Path::new("/dev/null"), "a device"),
        ] {
            let message = SourceFile::open(path).unwrap_err().to_string();
            assert!(message.contains(what), "{message}");
        }
    }

    #[test]
    fn a_lost_mount_is_no_change() {
        for error in [io::ErrorKind::NotConnected.into(), io::Error::from_raw_os_error(5)] {
            assert!(is_unreachable(&error));
        }
        for kind in [
            io::ErrorKind::NotFound,
            io::ErrorKind::NotADirectory,
            io::ErrorKind::StaleNetworkFileHandle,
        ] {
            assert!(!is_unreachable(&kind.into()));
        }
    }

    #[test]
    fn system_errors_name_the_path_and_the_remedy() {
        let sentences: Vec<String> = [
            io::ErrorKind::PermissionDenied,
            io::ErrorKind::StorageFull,
            io::ErrorKind::ReadOnlyFilesystem,
            io::ErrorKind::NotFound,
            io::ErrorKind::TimedOut,
            io::ErrorKind::NotConnected,
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
