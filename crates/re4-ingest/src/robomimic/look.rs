//! First inspection of a file: whether it is an HDF5 file, and if not, which common format it has.

use std::fs::TryLockError;
use std::os::unix::fs::FileExt as _;

use super::fault::Hdf5Fault;
use crate::error::Fault;
use crate::source::SourceFile;

/// First bytes of an HDF5 superblock, which is at byte 0, 512, 1024, 2048, ... of the file.
pub(super) const SIGNATURE: &[u8; 8] = b"\x89HDF\r\n\x1a\n";

/// Number of bytes at the start of a file that are used to identify its format.
const START: usize = 512;

/// Formats with their first bytes, description and remedy.
const FORMATS: [(&[u8], &str); 12] = [
    (b"\x1f\x8b", "compressed with gzip; unpack it with gunzip"),
    (b"BZh", "compressed with bzip2; unpack it with bunzip2"),
    (b"\xfd7zXZ\0", "compressed with xz; unpack it with unxz"),
    (b"\x28\xb5\x2f\xfd", "compressed with zstd; unpack it with unzstd"),
    (b"\x04\x22\x4d\x18", "compressed with lz4; unpack it with lz4 -d"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive; unpack it"),
    (
        b"PK\x03\x04",
        "a zip archive (or an .npz or .pt file, which are zip archives); unpack it and give the HDF5 file in it",
    ),
    (b"version https://git-lfs", "a Git LFS pointer; run git lfs pull"),
    (b"\x93NUMPY", "a NumPy array (.npy); give the HDF5 file of the dataset"),
    (b"PAR1", "a Parquet file; give the HDF5 file of the dataset"),
    (b"CDF", "a NetCDF file of the classic format; convert it to HDF5"),
    (b"\x0e\x03\x13\x01", "an HDF4 file; convert it with h4toh5"),
];

/// Inspects a file before the library opens it. Returns a fault if it is not an HDF5 file or is being written; `None` otherwise.
pub(super) fn inspect(source: &SourceFile) -> Result<Option<Hdf5Fault>, Fault> {
    if source.length() == 0 {
        return Ok(Some(Hdf5Fault::Other(
            "it is empty (0 bytes); copy or download it again".to_owned(),
        )));
    }
    let read = |at: u64, bytes: &mut [u8]| {
        let mut done = 0;
        while done < bytes.len() {
            match source.file().read_at(&mut bytes[done..], at + done as u64) {
                Ok(0) => break,
                Ok(read) => done += read,
                Err(error) => return Err(Fault::io("read", source.path(), error)),
            }
        }
        Ok(done)
    };
    let mut at = 0;
    loop {
        let mut block = [0; SIGNATURE.len()];
        read(at, &mut block)?;
        if block == *SIGNATURE {
            return Ok(in_use(source));
        }
        at = (at * 2).max(512);
        if at >= source.length() {
            break;
        }
    }
    let mut start = [0; START];
    let length = read(0, &mut start)?;
    Ok(Some(Hdf5Fault::Other(foreign(&start[..length]))))
}

/// The message for a file that is not an HDF5 file.
fn foreign(start: &[u8]) -> String {
    let known = FORMATS.iter().find(|(bytes, _)| start.starts_with(bytes));
    let text = String::from_utf8_lossy(start).trim_start().to_lowercase();
    if let Some((_, what)) = known {
        format!("it is not an HDF5 file but {what}")
    } else if start.get(257..262) == Some(b"ustar") {
        "it is not an HDF5 file but a tar archive; unpack it and give the HDF5 file in it".to_owned()
    } else if text.starts_with("<!doctype") || text.starts_with("<html") || text.starts_with("<?xml") {
        "it is not an HDF5 file but a web page, perhaps an error page of the server; download it again".to_owned()
    } else if start.iter().all(|byte| *byte == 0) {
        "it is not an HDF5 file: it begins with zeros, as an interrupted download does; download it again".to_owned()
    } else {
        "it is not an HDF5 file (it has no HDF5 signature), or its start is damaged; give the HDF5 file of the dataset, or copy or download it again".to_owned()
    }
}

/// Whether a program is writing the file. The HDF5 library holds a lock while it does.
fn in_use(source: &SourceFile) -> Option<Hdf5Fault> {
    match source.file().try_lock_shared() {
        Err(TryLockError::WouldBlock) => Some(Hdf5Fault::InUse),
        // The file system does not support locks, so writers cannot be detected.
        Err(TryLockError::Error(_)) => None,
        Ok(()) => {
            // The lock is only a test. A program that starts writing later is detected by the file's times.
            let _ = source.file().unlock();
            None
        }
    }
}

/// Converts the library's message when it cannot open a file.
pub(super) fn unreadable(why: &str) -> Hdf5Fault {
    let mentions = |words: &[&str]| words.iter().any(|word| why.contains(word));
    if mentions(&["lock file", "already open for write", "consistency flag"]) {
        Hdf5Fault::InUse
    } else {
        Hdf5Fault::Unreadable { why: why.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(bytes: &[u8]) -> Option<String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        let source = SourceFile::open(file.path()).unwrap();
        inspect(&source).unwrap().map(|fault| fault.to_string())
    }

    #[test]
    fn foreign_formats_are_identified() {
        for (bytes, word) in [
            (&b""[..], "0 bytes"),
            (b"\x1f\x8b\x08\0", "gunzip"),
            (b"PK\x03\x04....", "zip"),
            (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
            (b"\n<!DOCTYPE html><html>", "web page"),
            (&[0; 4000], "zeros"),
            (b"some text", "no HDF5 signature"),
            (b"\x89HD", "no HDF5 signature"),
        ] {
            let message = refusal(bytes).unwrap();
            assert!(message.contains(word) && message.contains("; "), "{message}");
        }
        let mut tar = [b'a'; 600];
        tar[257..262].copy_from_slice(b"ustar");
        assert!(refusal(&tar).unwrap().contains("tar archive"));
    }

    #[test]
    fn a_signature_may_follow_a_user_block() {
        for at in [0, 512, 1024, 4096] {
            let mut bytes = vec![7; 8192];
            bytes[at..at + 8].copy_from_slice(SIGNATURE);
            assert_eq!(refusal(&bytes), None, "{at}");
        }
    }

    #[test]
    fn a_file_locked_by_a_writer_is_in_use() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), SIGNATURE).unwrap();
        let source = SourceFile::open(file.path()).unwrap();
        let writer = std::fs::File::options().append(true).open(file.path()).unwrap();
        writer.lock().unwrap();
        assert!(matches!(inspect(&source).unwrap(), Some(Hdf5Fault::InUse)));
        drop(writer);
        assert!(inspect(&source).unwrap().is_none());
    }
}
