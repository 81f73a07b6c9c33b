//! Faults of an HDF5 file with demonstrations. Messages name objects by their full path in the file.

use thiserror::Error;

use crate::left_out::parts;

/// A fault of an HDF5 file. Its message names the object, and after the first `"; "` the remedy.
#[derive(Debug, Error)]
pub enum Hdf5Fault {
    /// The HDF5 library cannot open the file.
    #[error("it is not a readable HDF5 file ({why}); it may be truncated or damaged, so copy or download it again")]
    Unreadable {
        /// Message of the HDF5 library.
        why: String,
    },
    /// A program is writing to the file, or was killed while it did.
    #[error(
        "a program has the file open for writing, or was killed while writing; close that program, or, if there is none, run h5clear -s FILE on a copy of the file"
    )]
    InUse,
    /// The file needs the HDF5 library, but was opened without it.
    #[error("the HDF5 library is needed to read it; open it with the library")]
    NeedsLibrary,
    /// Several faults of one demonstration.
    #[error("{}", several(faults))]
    Several {
        /// Two or more faults.
        faults: Vec<Hdf5Fault>,
    },
    /// An object of the file cannot be read.
    #[error("{object}{} cannot be read ({why}); {}", and_others(*others), fix(why))]
    Damaged {
        /// Object within the file.
        object: String,
        /// Message of the HDF5 library or the operating system.
        why: String,
        /// Number of other objects of the demonstration with the same fault.
        others: usize,
    },
    /// An object is stored in another file.
    #[error(
        "{object} is stored in {place}, not in this file; copy it into this file, because all data must be in one file"
    )]
    Elsewhere {
        /// Object within the file.
        object: String,
        /// Where it is stored.
        place: String,
    },
    /// There are no demonstrations.
    #[error("it has no group /data with demonstrations; give an HDF5 file in robomimic's or robosuite's layout")]
    NoData,
    /// The group of a demonstration is empty.
    #[error("group /data/{demo} is empty; remove that group, or leave the demonstration out with a filter key")]
    EmptyDemo {
        /// The demonstration.
        demo: String,
    },
    /// A demonstration has no frames.
    #[error("dataset {object} has no rows; remove that demonstration, or leave it out with a filter key")]
    NoFrames {
        /// Dataset within the file.
        object: String,
    },
    /// A required dataset is missing.
    #[error("{} missing; {fix}", datasets(objects, "is", "are"))]
    Missing {
        /// Datasets within the file.
        objects: Vec<String>,
        /// The remedy.
        fix: &'static str,
    },
    /// A dataset has an unsupported element type.
    #[error("dataset {object} contains {found}, but {expected} is expected; convert it")]
    Dtype {
        /// Dataset within the file.
        object: String,
        /// The type in words.
        found: String,
        /// Supported types.
        expected: &'static str,
    },
    /// A dataset has a wrong shape.
    #[error("dataset {object} has shape {found:?}, but {expected} is expected; {fix}")]
    Shape {
        /// Dataset within the file.
        object: String,
        /// Its shape.
        found: Vec<usize>,
        /// Accepted shape in words.
        expected: String,
        /// The remedy.
        fix: &'static str,
    },
    /// Datasets have different lengths.
    #[error(
        "{} {found} rows, but {other} has {expected}; every dataset of a demonstration must have one row per frame, so restore or truncate the one that differs, or leave the demonstration out",
        datasets(objects, "has", "have")
    )]
    Length {
        /// Datasets within the file.
        objects: Vec<String>,
        /// Their rows.
        found: usize,
        /// Dataset with which they are compared.
        other: String,
        /// Number of rows of that dataset.
        expected: usize,
    },
    /// An attribute contains a wrong count.
    #[error(
        "attribute {attribute} of {object} is {found}, but there are {expected} {what}; correct the attribute, or restore the missing data"
    )]
    Count {
        /// Group within the file.
        object: String,
        /// Name of the attribute.
        attribute: &'static str,
        /// Its value.
        found: i64,
        /// The actual count.
        expected: usize,
        /// What was counted.
        what: String,
    },
    /// A value is NaN or infinite.
    #[error(
        "dataset {object} has {value} in row {row}, column {column}; repair that row, or leave the demonstration out with a filter key or ingest.select"
    )]
    NotFinite {
        /// Dataset within the file.
        object: String,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The value.
        value: f64,
    },
    /// A required attribute is missing or unusable.
    #[error("attribute {attribute} of {object} {why}; {fix}")]
    Attribute {
        /// Group within the file.
        object: String,
        /// Name of the attribute.
        attribute: &'static str,
        /// What is wrong with it.
        why: String,
        /// The remedy.
        fix: String,
    },
    /// The requested filter key does not exist.
    #[error("there is no filter key {filter:?} in /mask; {}", known_filters(known))]
    UnknownFilter {
        /// The requested filter key.
        filter: String,
        /// The existing filter keys.
        known: Vec<String>,
    },
    /// A filter key names a demonstration that does not exist.
    #[error(
        "filter key /mask/{filter} names {demo:?}, but there is no group /data/{demo}; correct the filter key, or use another one"
    )]
    FilterNames {
        /// The filter key.
        filter: String,
        /// The name.
        demo: String,
    },
    /// A filter key lists no demonstrations.
    #[error("filter key /mask/{filter} lists no demonstrations; use another filter key")]
    EmptyFilter {
        /// The filter key.
        filter: String,
    },
    /// The path is a folder.
    #[error("it is a folder, but robosuite's tasks are read from a single HDF5 file; give the path of that file")]
    Folder,
    /// Any other fault; the text is the complete message.
    #[error("{0}")]
    Other(String),
}

impl Hdf5Fault {
    /// The fault without the remedy.
    pub(crate) fn what(&self) -> String {
        parts(&self.to_string()).0.to_owned()
    }

    /// Combines all faults into one; `None` if there are none.
    pub(crate) fn all(mut faults: Vec<Self>) -> Option<Self> {
        if let Some(at) = faults.iter().position(|fault| matches!(fault, Self::NeedsLibrary)) {
            return Some(faults.swap_remove(at));
        }
        let mut merged: Vec<Self> = Vec::new();
        for fault in faults {
            // Objects that are damaged for the same reason share one message.
            let same = merged.iter_mut().find_map(|known| match (known, &fault) {
                (Self::Damaged { why, others, .. }, Self::Damaged { why: reason, .. }) if why == reason => Some(others),
                _ => None,
            });
            match same {
                Some(others) => *others += 1,
                None => merged.push(fault),
            }
        }
        if merged.len() < 2 {
            return merged.pop();
        }
        Some(Self::Several { faults: merged })
    }
}

fn and_others(others: usize) -> String {
    match others {
        0 => String::new(),
        1 => " and another one".to_owned(),
        others => format!(" and {others} others"),
    }
}

/// Names one or several datasets, with the verb in singular or plural.
fn datasets(names: &[String], one: &str, several: &str) -> String {
    match names {
        [only] => format!("dataset {only} {one}"),
        names => format!("datasets {} {several}", names.join(", ")),
    }
}

/// Joins the faults, then their distinct remedies.
fn several(faults: &[Hdf5Fault]) -> String {
    let sentences: Vec<String> = faults.iter().map(ToString::to_string).collect();
    let (mut whats, mut remedies) = (Vec::new(), Vec::new());
    for sentence in &sentences {
        let (what, remedy) = parts(sentence);
        whats.push(what);
        if !remedy.is_empty() && !remedies.contains(&remedy) {
            remedies.push(remedy);
        }
    }
    let mut text = whats.join(", and ");
    for remedy in remedies {
        text.push_str("; ");
        text.push_str(remedy);
    }
    text
}

/// The remedy for an error of the HDF5 library, chosen by words of its message.
fn fix(why: &str) -> &'static str {
    let mentions = |words: &[&str]| words.iter().any(|word| why.contains(word));
    if mentions(&["external file"]) {
        "it is stored in another file, so copy it into this one, because all data must be in one file"
    } else if mentions(&["doesn't exist", "not found", "too many links"]) {
        "restore it, or leave that demonstration or camera out"
    } else if mentions(&["not a dataset", "not a group"]) {
        "it is an object of another type, so correct the file's layout"
    } else if mentions(&["size of float datatype"]) {
        "convert it to float64 or float32"
    } else if mentions(&["plugin", "filter"]) {
        "it is compressed with a filter that the HDF5 library lacks, so rewrite it with gzip or without compression"
    } else {
        "the file is damaged or truncated, so copy or download it again"
    }
}

fn known_filters(known: &[String]) -> String {
    if known.is_empty() {
        "the file has no filter keys, so remove ingest.filter".to_owned()
    } else {
        format!("use one of {}", known.join(", "))
    }
}
