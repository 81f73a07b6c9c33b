//! Who writes a temporary folder, and whether that writer still runs.
//!
//! A store can be on a network file system that many machines share. Locks of files are not enough there: some file systems have
//! none, and others keep them on one machine, so that every other machine finds them free. The name of a temporary folder therefore
//! contains its writer. A process of this machine is looked up; the writers of other machines are judged by the age of their files.

use std::fs::{self, File, TryLockError};
use std::path::Path;
use std::time::{Duration, SystemTime};

/// Prefix of the name of temporary files and folders.
const PREFIX: &str = ".tmp";

/// Age from which the files of another machine's writer are leftovers. Longer than any stage runs without writing.
const ABANDONED: Duration = Duration::from_hours(7 * 24);

/// A process on a machine. A part that the system does not tell is empty, and equals nothing.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Owner {
    /// Name of the machine.
    host: String,
    /// Identifier of the machine's boot.
    boot: String,
    /// Namespace of the process id, which differs between containers.
    namespace: String,
    /// Process id.
    process: u32,
    /// When the process started, in clock ticks since the boot. Process ids are used again.
    started: u64,
}

/// The beginning of the name of a temporary file or folder of this process: `.tmp-WHAT-HOST-BOOT-NAMESPACE-PROCESS-START-`.
pub(crate) fn prefix(what: &str) -> String {
    let Owner {
        host,
        boot,
        namespace,
        process,
        started,
    } = Owner::current();
    format!("{PREFIX}-{what}-{host}-{boot}-{namespace}-{process}-{started}-")
}

/// Locks a temporary folder until the returned file is dropped or the process ends. `None` if the file system has no locks.
pub(crate) fn hold(temporary: &Path) -> Option<File> {
    let folder = File::open(temporary).ok()?;
    folder.try_lock().ok().map(|()| folder)
}

impl Owner {
    fn current() -> Self {
        // Only what cannot be confused with the separator, and not too much of it for the name of a file.
        let part = |text: &str, length: usize| -> String {
            let plain = text
                .chars()
                .filter(|letter| letter.is_ascii_alphanumeric() || *letter == '.');
            plain.take(length).collect()
        };
        let read = |path: &str| fs::read_to_string(path).unwrap_or_default();
        let namespace = fs::read_link("/proc/self/ns/pid").map(|link| link.to_string_lossy().into_owned());
        let process = std::process::id();
        Self {
            host: part(&read("/proc/sys/kernel/hostname"), 64),
            boot: part(&read("/proc/sys/kernel/random/boot_id"), 12),
            namespace: part(&namespace.unwrap_or_default(), 16),
            process,
            started: started(process).unwrap_or_default(),
        }
    }

    /// The writer of a temporary file or folder with this name; `None` if the name contains none.
    fn of(name: &str) -> Option<Self> {
        let parts: Vec<&str> = name.split('-').collect();
        let &[PREFIX, _, host, boot, namespace, process, started, _] = parts.as_slice() else {
            return None;
        };
        Some(Self {
            host: host.to_owned(),
            boot: boot.to_owned(),
            namespace: namespace.to_owned(),
            process: process.parse().ok()?,
            started: started.parse().ok()?,
        })
    }

    /// Whether the process has ended, as far as `observer` can tell; `None` if it cannot. `free` is whether the lock of the writer is
    /// free; `None` if there are no locks.
    fn has_ended(&self, observer: &Self, free: Option<bool>) -> Option<bool> {
        let same = |own: &str, other: &str| !own.is_empty() && own == other;
        if free == Some(false) {
            Some(false)
        } else if !same(&self.host, &observer.host) {
            None
        } else if !same(&self.boot, &observer.boot) {
            Some(true)
        } else if same(&self.namespace, &observer.namespace) {
            Some(started(self.process) != Some(self.started))
        } else {
            // Another container on this machine. Locks work between the processes of one kernel.
            free
        }
    }
}

/// Whether this is a temporary folder or file whose writer no longer runs. In doubt, it is kept until it is old.
pub(crate) fn is_leftover(temporary: &Path) -> bool {
    let name = temporary.file_name().map(|name| name.to_string_lossy().into_owned());
    // Whatever has another name is not temporary.
    let Some(owner) = name.and_then(|name| Owner::of(&name)) else {
        return false;
    };
    let free = File::open(temporary).ok().and_then(|file| match file.try_lock() {
        Ok(()) => Some(true),
        Err(TryLockError::WouldBlock) => Some(false),
        Err(TryLockError::Error(_)) => None,
    });
    let ended = owner.has_ended(&Owner::current(), free);
    ended.unwrap_or_else(|| is_abandoned(temporary))
}

/// Whether the last change of a temporary folder and of the files in it is long ago. The files of a folder that is young are not looked at:
/// a network file system could then show their length of this moment when they are published.
fn is_abandoned(temporary: &Path) -> bool {
    let old = |path: &Path| {
        let modified = fs::symlink_metadata(path).and_then(|metadata| metadata.modified()).ok();
        // A time in the future, by another machine's clock, is not old.
        let age = modified.and_then(|modified| SystemTime::now().duration_since(modified).ok());
        age.is_some_and(|age| age > ABANDONED)
    };
    let inside = || fs::read_dir(temporary).into_iter().flatten().filter_map(Result::ok);
    old(temporary) && inside().all(|entry| old(&entry.path()))
}

/// When a process of this machine started, in clock ticks since the boot; `None` if there is no such process.
fn started(process: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // The name of the program, in parentheses, can contain spaces and parentheses. The start is the 20th field after it.
    let (_, fields) = status.rsplit_once(')')?;
    fields.split_whitespace().nth(19)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn old(path: &Path, age: Duration) {
        let file = File::open(path).unwrap();
        file.set_modified(SystemTime::now() - age).unwrap();
    }

    #[test]
    fn a_running_process_has_not_ended() {
        let own = Owner::current();
        for free in [Some(true), Some(false), None] {
            assert_eq!(own.has_ended(&own, free), Some(false), "{free:?}");
        }
    }

    #[test]
    fn processes_of_this_machine_are_looked_up() {
        let here = Owner::current();
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let other = Owner {
            process: child.id(),
            started: started(child.id()).unwrap(),
            ..here.clone()
        };
        // Also if the lock looks free, as on a file system that keeps locks on one machine.
        assert_eq!(other.has_ended(&here, Some(true)), Some(false));
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(other.has_ended(&here, Some(true)), Some(true));
        assert_eq!(other.has_ended(&here, None), Some(true));
        // The id is used by another process.
        let reused = Owner {
            started: here.started + 1,
            ..here.clone()
        };
        assert_eq!(reused.has_ended(&here, None), Some(true));
        let before_the_boot = Owner {
            boot: "other".to_owned(),
            ..here.clone()
        };
        assert_eq!(before_the_boot.has_ended(&here, Some(true)), Some(true));
    }

    #[test]
    fn other_machines_and_containers_are_judged_by_locks_or_not_at_all() {
        let here = Owner::current();
        let elsewhere = Owner {
            host: "node17".to_owned(),
            ..here.clone()
        };
        for free in [Some(true), None] {
            assert_eq!(elsewhere.has_ended(&here, free), None);
        }
        assert_eq!(elsewhere.has_ended(&here, Some(false)), Some(false));
        let container = Owner {
            namespace: "pid:[1]".to_owned(),
            ..here.clone()
        };
        for free in [Some(true), Some(false), None] {
            assert_eq!(container.has_ended(&here, free), free);
        }
        let unknown = Owner {
            host: String::new(),
            ..here.clone()
        };
        assert_eq!(unknown.has_ended(&unknown, Some(true)), None);
    }

    #[test]
    fn the_files_of_another_machine_are_left_until_they_are_old() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join(".tmp-0123456789abcdef-node17-b-n-1-2-xyz");
        let other = root.path().join(".tmp-0123456789abcdef-xyz");
        for folder in [&folder, &other] {
            fs::create_dir(folder).unwrap();
            let table = folder.join("table.parquet");
            fs::write(&table, "half").unwrap();
            assert!(!is_leftover(folder));
            old(folder, ABANDONED + Duration::from_mins(1));
            // The table was written to a moment ago.
            assert!(!is_leftover(folder));
            old(&table, ABANDONED + Duration::from_mins(1));
        }
        assert!(is_leftover(&folder));
        // The clock of the machine is ahead.
        File::open(folder.join("table.parquet"))
            .unwrap()
            .set_modified(SystemTime::now() + ABANDONED)
            .unwrap();
        assert!(!is_leftover(&folder));
        // Not the name of a temporary folder.
        assert!(!is_leftover(&other));
    }

    #[test]
    fn names_contain_the_writer() {
        let name = format!("{}a1B2c3", prefix("0123456789abcdef"));
        assert_eq!(Owner::of(&name).unwrap(), Owner::current());
        assert!(name.len() < 255);
        for other in [
            "",
            ".tmp-x",
            ".tmp-a-b-c-d-e-f-g",
            "other-a-b-c-d-1-2-g",
            &format!("{name}-h"),
        ] {
            assert_eq!(Owner::of(other), None, "{other}");
        }
    }
}
