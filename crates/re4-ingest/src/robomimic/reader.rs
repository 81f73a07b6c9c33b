//! Opening a file: which demonstrations it holds, in which order, and which of them are asked for.

use std::path::{Path, PathBuf};

use super::demo::{Demo, FoundDemo};
use super::fault::Hdf5Fault;
use super::file::File;
use crate::error::{Fault, IngestError};
use crate::selection::Selection;

/// Which demonstrations to read.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DemoChoice {
    /// Name of a filter key below `/mask`; only demonstrations that it lists are read.
    pub filter: Option<String>,
    /// Which of those, counted in their numeric order.
    pub select: Selection,
}

/// An opened file. The demonstrations are known by name, and not yet read.
pub struct RobomimicReader {
    path: PathBuf,
    file: File,
    demos: Vec<DemoName>,
    env_args: Option<String>,
}

/// A demonstration that is to be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DemoName {
    /// Its group below `/data`.
    pub name: String,
    /// Its number: that in its name, or its place where a name has none.
    pub number: u32,
    /// Filter keys that list it, in alphabetical order.
    pub filter_keys: Vec<String>,
}

impl RobomimicReader {
    /// Opens a file and finds its demonstrations, in the order of their numbers (`demo_2` before `demo_10`).
    ///
    /// # Errors
    /// What is no HDF5 file of demonstrations, a filter key that is not there or names what is not there, a selection that
    /// does not fit.
    pub fn open(path: &Path, choice: &DemoChoice) -> Result<Self, IngestError> {
        Self::open_checked(path, choice).map_err(|fault| fault.of(path))
    }

    fn open_checked(path: &Path, choice: &DemoChoice) -> Result<Self, Fault> {
        let file = File::open(path)?;
        let names = file
            .members("data")?
            .filter(|names| !names.is_empty())
            .ok_or(Hdf5Fault::NoData)?;
        let mut demos = numbered(names);
        for filter in file.members("mask")?.unwrap_or_default() {
            let listed = file.names(&format!("mask/{filter}"))?;
            for demo in &mut demos {
                if listed.contains(&demo.name) {
                    demo.filter_keys.push(filter.clone());
                }
            }
        }
        if let Some(filter) = &choice.filter {
            let known = file.members("mask")?.unwrap_or_default();
            if !known.contains(filter) {
                return Err(Hdf5Fault::UnknownFilter {
                    filter: filter.clone(),
                    known,
                }
                .into());
            }
            let listed = file.names(&format!("mask/{filter}"))?;
            if let Some(name) = listed.iter().find(|name| demos.iter().all(|demo| demo.name != **name)) {
                return Err(Hdf5Fault::FilterNames {
                    filter: filter.clone(),
                    demo: name.clone(),
                }
                .into());
            }
            demos.retain(|demo| demo.filter_keys.contains(filter));
            if demos.is_empty() {
                return Err(Hdf5Fault::EmptyFilter { filter: filter.clone() }.into());
            }
        }
        let chosen = choice.select.resolve(demos.len())?;
        let demos = chosen
            .into_iter()
            .filter_map(|number| demos.get(number as usize).cloned())
            .collect();
        let env_args = file.text_attribute("data", "env_args")?;
        Ok(Self {
            path: path.to_owned(),
            file,
            demos,
            env_args,
        })
    }

    /// The demonstrations asked for, in order.
    pub fn demos(&self) -> &[DemoName] {
        &self.demos
    }

    /// The attribute `env_args` of `/data`.
    pub fn env_args(&self) -> Option<&str> {
        self.env_args.as_deref()
    }

    /// Reads one of the demonstrations.
    ///
    /// # Errors
    /// Datasets that are missing, damaged, of another type or shape, or hold values that no recording can have.
    pub fn read(&self, demo: &DemoName) -> Result<Demo, IngestError> {
        let found = FoundDemo::find(&self.file, &demo.name);
        found
            .and_then(|found| found.read(&self.file))
            .map_err(|fault| Fault::from(fault).of(&self.path))
    }
}

/// Names in the order of the numbers that they end in; those without one come last, in alphabetical order.
fn numbered(names: Vec<String>) -> Vec<DemoName> {
    let number = |name: &str| name.rsplit('_').next().and_then(|digits| digits.parse::<u32>().ok());
    let mut names: Vec<(Option<u32>, String)> = names.into_iter().map(|name| (number(&name), name)).collect();
    names.sort_by(|a, b| (a.0.is_none(), a.0, &a.1).cmp(&(b.0.is_none(), b.0, &b.1)));
    (0..)
        .zip(names)
        .map(|(place, (number, name))| DemoName {
            name,
            number: number.unwrap_or(place),
            filter_keys: Vec::new(),
        })
        .collect()
}
