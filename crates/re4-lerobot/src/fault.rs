//! Faults of a dataset: which file, which object inside it, what is wrong, and how to fix it.

use std::borrow::Cow;
use std::fmt;
use std::io;
use std::path::PathBuf;

use re4_fault::Remedy;

/// Number of faults that are kept in full. The rest are counted: a dataset with a wrong frame rate has one fault per episode.
const KEPT: usize = 50;

/// A dataset that cannot be read, with all faults that were found.
#[derive(Debug)]
pub struct LerobotError {
    /// The path that was given for the dataset.
    pub dataset: PathBuf,
    /// The faults, in the order of the files; never empty.
    pub faults: Faults,
}

/// The faults of a dataset or of an episode.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Faults {
    first: Vec<Fault>,
    more: usize,
}

/// The kind of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// The caller requested a stop.
    Stopped,
    /// The operating system reports an error.
    Io,
    /// There is no LeRobot dataset at the path, or one of an unknown version.
    Format,
    /// A file that the metadata names is missing.
    MissingFile,
    /// A file that the metadata does not name.
    StrayFile,
    /// A file is damaged.
    Damaged,
    /// A key or a column is missing.
    Missing,
    /// A column or a key that is not declared.
    Undeclared,
    /// A value or a column has a type or a shape that is not accepted.
    Type,
    /// Two counts that must be equal differ.
    Count,
    /// A value contradicts another one.
    Value,
    /// The encoding of a file is valid but not supported.
    Unsupported,
}

/// A fault of one object in one file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// Its kind.
    pub kind: Kind,
    /// The file, relative to the dataset, with `/` as separator; empty for the dataset itself.
    pub file: String,
    /// The object inside the file: a key, a column or a line.
    pub object: Option<String>,
    /// What is wrong with it.
    pub what: String,
    /// How to fix it, in the imperative.
    pub fix: String,
}

impl Fault {
    /// A fault of a whole file.
    pub(crate) fn of_file(kind: Kind, file: &str, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self {
            kind,
            file: file.to_owned(),
            object: None,
            // The first semicolon of a sentence separates what is wrong from the remedy. Messages of libraries may have others.
            what: what.into().replace(';', ","),
            fix: fix.into(),
        }
    }

    /// The fault with the object inside its file: "key fps", "column action".
    pub(crate) fn at(self, object: impl Into<String>) -> Self {
        Self {
            object: Some(object.into()),
            ..self
        }
    }

    /// A key of a JSON file.
    pub(crate) fn key(kind: Kind, file: &str, key: &str, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self::of_file(kind, file, what, fix).at(format!("key {key}"))
    }

    /// A column of a table.
    pub(crate) fn column(
        kind: Kind,
        file: &str,
        column: &str,
        what: impl Into<String>,
        fix: impl Into<String>,
    ) -> Self {
        Self::of_file(kind, file, what, fix).at(format!("column {column}"))
    }

    /// An error of the operating system.
    pub(crate) fn io(file: &str, action: &str, error: &io::Error) -> Self {
        let (kind, fix) = match error.kind() {
            io::ErrorKind::NotFound => (Kind::MissingFile, "restore it, or download the dataset again"),
            io::ErrorKind::PermissionDenied => (Kind::Io, "give yourself read permission"),
            _ => (Kind::Io, "check the disk, then run again"),
        };
        Self::of_file(kind, file, format!("it cannot be {action} ({error})"), fix)
    }

    /// The caller requested a stop.
    pub(crate) fn stopped() -> Self {
        Self::of_file(Kind::Stopped, "", "reading was stopped", "run again")
    }

    /// A file whose contents are damaged.
    pub(crate) fn damaged(file: &str, why: impl fmt::Display) -> Self {
        let fix = "download or write this file again";
        Self::of_file(Kind::Damaged, file, format!("it is damaged: {why}"), fix)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.file.is_empty(), &self.object) {
            (true, None) => write!(f, "{}", self.what),
            (true, Some(object)) => write!(f, "{object}: {}", self.what),
            (false, None) => write!(f, "{}: {}", self.file, self.what),
            (false, Some(object)) => write!(f, "{}, {object}: {}", self.file, self.what),
        }
    }
}

impl Remedy for Fault {
    fn remedy(&self) -> Option<Cow<'_, str>> {
        Some(Cow::Borrowed(&self.fix))
    }
}

impl From<Fault> for Faults {
    fn from(fault: Fault) -> Self {
        Self {
            first: vec![fault],
            more: 0,
        }
    }
}

impl Faults {
    /// The faults that are kept in full.
    pub fn iter(&self) -> impl Iterator<Item = &Fault> {
        self.first.iter()
    }

    /// Number of all faults, including those that are only counted.
    pub fn count(&self) -> usize {
        self.first.len() + self.more
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.first.is_empty()
    }

    /// Whether reading was stopped by the caller.
    pub fn stopped(&self) -> bool {
        self.first.iter().any(|fault| fault.kind == Kind::Stopped)
    }

    pub(crate) fn push(&mut self, fault: Fault) {
        if self.first.len() < KEPT {
            self.first.push(fault);
        } else {
            self.more += 1;
        }
    }

    pub(crate) fn extend(&mut self, other: Self) {
        self.more += other.more;
        for fault in other.first {
            self.push(fault);
        }
    }

    /// The value of a result; its fault is kept.
    pub(crate) fn keep<T>(&mut self, result: Result<T, Fault>) -> Option<T> {
        result.map_err(|fault| self.push(fault)).ok()
    }

    /// The value if there is no fault.
    pub(crate) fn or<T>(self, value: T) -> Result<T, Self> {
        if self.is_empty() { Ok(value) } else { Err(self) }
    }
}

/// One sentence per fault, with its remedy, on one line each.
impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, fault) in self.first.iter().enumerate() {
            let separator = if i > 0 { "\n" } else { "" };
            write!(f, "{separator}{}", fault.sentence())?;
        }
        if self.more > 0 {
            write!(f, "\n{} further faults are not listed", self.more)?;
        }
        Ok(())
    }
}

impl std::error::Error for Faults {}

impl fmt::Display for LerobotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cannot read {}: ", self.dataset.display())?;
        let mut faults = self.faults.iter();
        if let Some(first) = faults.next() {
            write!(f, "{first}")?;
        }
        match self.faults.count() {
            0 | 1 => Ok(()),
            more => write!(f, " (and {} more)", more - 1),
        }
    }
}

impl std::error::Error for LerobotError {}

impl Remedy for LerobotError {
    fn remedy(&self) -> Option<Cow<'_, str>> {
        self.faults.iter().next().and_then(Remedy::remedy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_beyond_the_limit_are_counted() {
        let mut faults = Faults::default();
        for i in 0..KEPT + 3 {
            faults.push(Fault::column(
                Kind::Value,
                "a.parquet",
                "index",
                format!("row {i}"),
                "fix it",
            ));
        }
        assert_eq!((faults.count(), faults.iter().count()), (KEPT + 3, KEPT));
        let text = faults.to_string();
        assert!(text.starts_with("a.parquet, column index: row 0; fix it\n"), "{text}");
        assert!(text.ends_with("\n3 further faults are not listed"), "{text}");
        let error = LerobotError {
            dataset: "set".into(),
            faults,
        };
        let sentence = "cannot read set: a.parquet, column index: row 0 (and 52 more); fix it";
        assert_eq!(error.sentence(), sentence);
    }
}
