//! What is wrong with an HDF5 file of demonstrations. Objects are named by their full path in the file.

use thiserror::Error;

use crate::left_out::parts;

/// What is wrong with an HDF5 file, the object that it is about, and the fix.
#[derive(Debug, Error)]
pub enum Hdf5Fault {
    /// The library cannot open the file.
    #[error("it is no readable HDF5 file ({why}); it may be cut off or damaged, so copy or download it again")]
    Unreadable {
        /// The library's words.
        why: String,
    },
    /// A program writes to the file, or left it marked so.
    #[error(
        "a program has it open for writing, or was killed while it had; close that program, or if there is none, run h5clear -s FILE on a copy of it"
    )]
    InUse,
    /// Only the HDF5 library can read it, and the file was opened without it.
    #[error("the HDF5 library is needed to read it; open it with the library")]
    NeedsLibrary,
    /// Several faults of one demonstration.
    #[error("{}", several(faults))]
    Several {
        /// Two or more.
        faults: Vec<Hdf5Fault>,
    },
    /// An object of the file cannot be read.
    #[error("{object}{} cannot be read ({why}); {}", and_others(*others), fix(why))]
    Damaged {
        /// Object within the file.
        object: String,
        /// The library's or the system's words.
        why: String,
        /// How many objects more of the same demonstration cannot be read for the same reason.
        others: usize,
    },
    /// An object that lies in another file.
    #[error(
        "{object} lies in {place}, not in this file; copy it into this file, so that one file holds all there is to ingest"
    )]
    Elsewhere {
        /// Object within the file.
        object: String,
        /// Where it lies.
        place: String,
    },
    /// No demonstrations.
    #[error("it has no group /data with demonstrations; give an HDF5 file in robomimic's or robosuite's layout")]
    NoData,
    /// A group of a demonstration that holds nothing.
    #[error("group /data/{demo} is empty; remove that group, or leave the demonstration out by a filter key")]
    EmptyDemo {
        /// The demonstration.
        demo: String,
    },
    /// A demonstration without frames.
    #[error("dataset {object} has no rows; remove that demonstration, or leave it out by a filter key")]
    NoFrames {
        /// Dataset within the file.
        object: String,
    },
    /// A dataset that is needed is not there.
    #[error("{} missing; {fix}", datasets(objects, "is", "are"))]
    Missing {
        /// Datasets within the file.
        objects: Vec<String>,
        /// What to do.
        fix: &'static str,
    },
    /// A dataset of a type that is not read.
    #[error("dataset {object} holds {found}, but {expected} is expected; convert it")]
    Dtype {
        /// Dataset within the file.
        object: String,
        /// Type in words.
        found: String,
        /// Types that are read.
        expected: &'static str,
    },
    /// A dataset of another shape.
    #[error("dataset {object} has shape {found:?}, but {expected} is expected; {fix}")]
    Shape {
        /// Dataset within the file.
        object: String,
        /// Its shape.
        found: Vec<usize>,
        /// Shape in words.
        expected: String,
        /// What to do.
        fix: &'static str,
    },
    /// Datasets of different lengths.
    #[error(
        "{} {found} rows and {other} has {expected}; every dataset of a demonstration has one row a frame, so restore or cut the odd one, or leave the demonstration out",
        datasets(objects, "has", "have")
    )]
    Length {
        /// Datasets within the file.
        objects: Vec<String>,
        /// Their rows.
        found: usize,
        /// Dataset that it is compared with.
        other: String,
        /// Rows of that.
        expected: usize,
    },
    /// An attribute that counts wrongly.
    #[error(
        "attribute {attribute} of {object} is {found}, but there are {expected} {what}; correct the attribute, or restore the missing ones"
    )]
    Count {
        /// Group within the file.
        object: String,
        /// Name of the attribute.
        attribute: &'static str,
        /// Its value.
        found: i64,
        /// What was counted.
        expected: usize,
        /// Rows of what.
        what: String,
    },
    /// A NaN or an infinity.
    #[error(
        "dataset {object} has {value} in row {row}, column {column}; repair that row, or leave the demonstration out by a filter key or ingest.select"
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
    /// An attribute that is needed is not there, or is no text.
    #[error("attribute {attribute} of {object} {why}; {fix}")]
    Attribute {
        /// Group within the file.
        object: String,
        /// Name of the attribute.
        attribute: &'static str,
        /// What is wrong with it.
        why: String,
        /// What to do.
        fix: String,
    },
    /// A filter key that is not there.
    #[error("there is no filter key {filter:?} below /mask; {}", known_filters(known))]
    UnknownFilter {
        /// The filter key asked for.
        filter: String,
        /// Those there are.
        known: Vec<String>,
    },
    /// A filter key that names demonstrations which are not there.
    #[error(
        "filter key /mask/{filter} names {demo:?}, and there is no group /data/{demo}; correct the filter key, or use another one"
    )]
    FilterNames {
        /// The filter key.
        filter: String,
        /// The name.
        demo: String,
    },
    /// A filter key without names.
    #[error("filter key /mask/{filter} names no demonstration; use another one")]
    EmptyFilter {
        /// The filter key.
        filter: String,
    },
    /// A folder.
    #[error("it is a folder, and robosuite's tasks are read from one HDF5 file; give the path of that file")]
    Folder,
    /// Something that is refused in words of its own.
    #[error("{0}")]
    Other(String),
}

impl Hdf5Fault {
    /// What is wrong, without what to do about it.
    pub(crate) fn what(&self) -> String {
        parts(&self.to_string()).0.to_owned()
    }

    /// All faults as one; none of none.
    pub(crate) fn all(mut faults: Vec<Self>) -> Option<Self> {
        if let Some(at) = faults.iter().position(|fault| matches!(fault, Self::NeedsLibrary)) {
            return Some(faults.swap_remove(at));
        }
        let mut merged: Vec<Self> = Vec::new();
        for fault in faults {
            // What is wrong with many objects for one reason is told once.
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

/// One dataset or several, with the verb.
fn datasets(names: &[String], one: &str, several: &str) -> String {
    match names {
        [only] => format!("dataset {only} {one}"),
        names => format!("datasets {} {several}", names.join(", ")),
    }
}

/// What is wrong, one after the other, and then what to do about each.
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

/// What helps, by the library's words.
fn fix(why: &str) -> &'static str {
    let says = |words: &[&str]| words.iter().any(|word| why.contains(word));
    if says(&["external file"]) {
        "it lies in another file, so copy it into this one: one file has to hold all there is to ingest"
    } else if says(&["doesn't exist", "not found", "too many links"]) {
        "restore it, or leave that demonstration or camera out"
    } else if says(&["not a dataset", "not a group"]) {
        "something of another kind stands in its place, so correct the file's layout"
    } else if says(&["size of float datatype"]) {
        "convert it to float64 or float32"
    } else if says(&["plugin", "filter"]) {
        "it is compressed by a filter that the HDF5 library lacks, so rewrite it with gzip or without compression"
    } else {
        "the file is damaged or cut off, so copy or download it again"
    }
}

fn known_filters(known: &[String]) -> String {
    if known.is_empty() {
        "the file has none, so leave ingest.filter out".to_owned()
    } else {
        format!("use one of {}", known.join(", "))
    }
}
