//! Opening a file: which demonstrations it holds, in which order, and which of them are asked for.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;
use re4_robosuite::env_args::EnvArgs;

use super::demo::{Demo, FoundDemo, Wanted};
use super::fault::Hdf5Fault;
use super::file::File;
use crate::error::{Fault, IngestError};
use crate::selection::Selection;

/// Demonstrations that are found ahead of reading.
const AHEAD: usize = 16;

/// Folder beside a raw file that holds its models, where `model_file` is a name.
pub const MODELS_FOLDER: &str = "models";

/// Which demonstrations to read.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DemoChoice {
    /// Name of a filter key below `/mask`; only demonstrations that it lists are read.
    pub filter: Option<String>,
    /// Which of those, counted in their numeric order.
    pub select: Selection,
}

/// What the demonstrations of a file consist of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// robomimic's: with observations.
    Observed,
    /// Raw: states and actions.
    Raw,
}

/// An opened file. The demonstrations are known by name, and not yet read.
pub struct RobomimicReader {
    pub(super) path: PathBuf,
    pub(super) file: File,
    layout: Layout,
    demos: Vec<DemoName>,
    all: bool,
    sidecars: Mutex<BTreeMap<String, Arc<str>>>,
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

/// Names go into tables, pages and sentences.
const LONGEST_NAME: usize = 200;

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
        let names = file.members_or_none("data")?;
        if names.is_empty() {
            return Err(Hdf5Fault::NoData.into());
        }
        if let Some(name) = names
            .iter()
            .find(|name| name.len() > LONGEST_NAME || name.chars().any(char::is_control))
        {
            let start: String = name.chars().take(40).collect();
            return Err(Hdf5Fault::Other(format!(
                "a group below /data has the name {start:?}, {} bytes long; rename it to one of at most {LONGEST_NAME} bytes without control characters, such as demo_0",
                name.len()
            ))
            .into());
        }
        let mut demos = numbered(names);
        let found = demos.len();
        let keys = file.members_or_none("mask")?;
        for key in &keys {
            let listed = file.names(&format!("mask/{key}"))?;
            let asked_for = choice.filter.as_ref() == Some(key);
            if let Some(name) = listed
                .iter()
                .find(|name| asked_for && demos.iter().all(|demo| demo.name != **name))
            {
                return Err(Hdf5Fault::FilterNames {
                    filter: key.clone(),
                    demo: name.clone(),
                }
                .into());
            }
            for demo in demos.iter_mut().filter(|demo| listed.contains(&demo.name)) {
                demo.filter_keys.push(key.clone());
            }
        }
        if let Some(filter) = &choice.filter {
            if !keys.contains(filter) {
                return Err(Hdf5Fault::UnknownFilter {
                    filter: filter.clone(),
                    known: keys,
                }
                .into());
            }
            demos.retain(|demo| demo.filter_keys.contains(filter));
            if demos.is_empty() {
                return Err(Hdf5Fault::EmptyFilter { filter: filter.clone() }.into());
            }
        }
        let chosen = choice.select.resolve(demos.len())?;
        let demos: Vec<DemoName> = chosen
            .into_iter()
            .filter_map(|number| demos.get(number as usize).cloned())
            .collect();
        let mut layout = Layout::Raw;
        for demo in &demos {
            let members = file.members(&format!("data/{}", demo.name))?;
            if members.iter().any(|member| member == "obs") {
                layout = Layout::Observed;
            }
            // An empty group says nothing, and is refused when it is read.
            if !members.is_empty() {
                break;
            }
        }
        Ok(Self {
            path: path.to_owned(),
            file,
            layout,
            all: demos.len() == found,
            demos,
            sidecars: Mutex::default(),
        })
    }

    /// The demonstrations asked for, in order.
    pub fn demos(&self) -> &[DemoName] {
        &self.demos
    }

    /// What the demonstrations consist of.
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// What the file says of how it was recorded; `setting` stands for its attribute `env_args`.
    pub(super) fn environment(&self, setting: Option<&str>) -> Result<EnvArgs, Hdf5Fault> {
        let mend = |what: &str| {
            format!("{what}, or give the JSON text of a file that was recorded in the same way as ingest.env_args")
        };
        let refuse = |attribute: &'static str, error: re4_robosuite::env_args::EnvArgsError| {
            Hdf5Fault::Other(format!(
                "{error}; {}",
                mend(&format!("repair attribute {attribute} of /data"))
            ))
        };
        let own = self.file.text("data", "env_args")?;
        if let Some(text) = setting.or(own.as_deref()) {
            return EnvArgs::parse(text).map_err(|error| refuse("env_args", error));
        }
        let raw = ["env", "env_info", "repository_version"].map(|name| self.file.text("data", name));
        let [env, info, version] = raw;
        let (env, info, version) = (env?, info?, version?);
        if env.is_none() && info.is_none() {
            return Err(Hdf5Fault::Attribute {
                object: "/data".to_owned(),
                attribute: "env_args",
                why: "is missing, so the task, the controller and its scales are unknown".to_owned(),
                mend: mend("restore it"),
            });
        }
        EnvArgs::parse_raw(env.as_deref(), info.as_deref(), version.as_deref())
            .map_err(|error| refuse("env_info", error))
    }

    /// Finds a demonstration's datasets.
    fn find(&self, name: &str, wanted: Wanted) -> Result<FoundDemo, Hdf5Fault> {
        let mut found = FoundDemo::find(&self.file, name, wanted)?;
        if let Some(text) = &found.model
            && !text.trim_start().starts_with('<')
        {
            found.model = Some(self.sidecar(name, text)?);
        }
        Ok(found)
    }

    /// A model that lies beside the file.
    fn sidecar(&self, demo: &str, name: &str) -> Result<Arc<str>, Hdf5Fault> {
        let refuse = |why: String| Hdf5Fault::Attribute {
            object: format!("/data/{demo}"),
            attribute: "model_file",
            why,
            mend: "put the file there, as it came with the dataset".to_owned(),
        };
        if name.contains(['/', '\\']) || name.starts_with('.') || name.len() > 255 {
            let shown: String = name.chars().take(60).collect();
            return Err(refuse(format!("is neither a model nor the name of one: {shown:?}")));
        }
        let mut sidecars = self.sidecars.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(text) = sidecars.get(name) {
            return Ok(Arc::clone(text));
        }
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let text = std::fs::read_to_string(folder.join(MODELS_FOLDER).join(name))
            .map_err(|error| refuse(format!("names {MODELS_FOLDER}/{name} beside the file ({error})")))?;
        let text: Arc<str> = text.into();
        sidecars.insert(name.to_owned(), Arc::clone(&text));
        Ok(text)
    }

    fn wanted(&self) -> Wanted {
        match self.layout {
            Layout::Observed => Wanted::Observed,
            Layout::Raw => Wanted::Raw,
        }
    }

    /// Reads one demonstration, the hand's angular velocities with it.
    pub(super) fn read(&self, demo: &DemoName) -> Result<Demo, Hdf5Fault> {
        let wanted = match self.layout {
            Layout::Observed => Wanted::ObservedWithVelocities,
            Layout::Raw => Wanted::Raw,
        };
        self.find(&demo.name, wanted)?.read(&self.file)
    }

    /// The actions of the demonstration of this name; none where there is no such demonstration.
    pub(super) fn actions(&self, name: &str) -> Result<Option<Vec<[f64; 7]>>, Hdf5Fault> {
        if self.demos.iter().all(|demo| demo.name != name) {
            return Ok(None);
        }
        Ok(Some(self.find(name, Wanted::Actions)?.read(&self.file)?.actions))
    }

    /// Reads all demonstrations: they are found one after the other, worked on in parallel as they come, and handed on in
    /// order.
    ///
    /// # Errors
    /// The first demonstration that cannot be read, or whatever the two closures refuse.
    pub fn for_each<T: Send, E: From<IngestError> + Send>(
        &self,
        work: impl Fn(usize, Demo) -> Result<T, E> + Sync,
        mut take: impl FnMut(usize, T) -> Result<(), E>,
    ) -> Result<(), E> {
        let fault = |fault: Hdf5Fault| E::from(Fault::from(fault).of(&self.path));
        let mut frames = 0;
        std::thread::scope(|scope| -> Result<(), E> {
            let (sender, receiver) = sync_channel(AHEAD);
            scope.spawn(move || {
                for (episode, demo) in self.demos.iter().enumerate() {
                    let found = self.find(&demo.name, self.wanted());
                    let last = found.is_err();
                    if sender.send((episode, found)).is_err() || last {
                        break;
                    }
                }
            });
            while let Ok(first) = receiver.recv() {
                let batch: Vec<_> = std::iter::once(first).chain(receiver.try_iter().take(AHEAD)).collect();
                let done: Vec<Result<(usize, usize, T), E>> = batch
                    .into_par_iter()
                    .map(|(episode, found)| {
                        let demo = found.and_then(|found| found.read(&self.file)).map_err(fault)?;
                        Ok((episode, demo.frames, work(episode, demo)?))
                    })
                    .collect();
                for done in done {
                    let (episode, rows, result) = done?;
                    frames += rows;
                    take(episode, result)?;
                }
            }
            Ok(())
        })?;
        self.check_total(frames).map_err(fault)
    }

    /// The attribute `total` of `/data`, where all demonstrations were read.
    fn check_total(&self, frames: usize) -> Result<(), Hdf5Fault> {
        let total = self.file.count("data", "total")?;
        match total {
            Some(total) if self.all && usize::try_from(total) != Ok(frames) => Err(Hdf5Fault::Count {
                object: "/data".to_owned(),
                attribute: "total",
                found: total,
                expected: frames,
                what: "frames in all demonstrations".to_owned(),
            }),
            _ => Ok(()),
        }
    }

    /// Datasets of the first demonstration that are not ingested, groups with the number of their members.
    pub(super) fn skipped(&self, taken: impl Fn(&str) -> bool) -> Result<Vec<String>, Hdf5Fault> {
        let Some(demo) = self.demos.first() else {
            return Ok(Vec::new());
        };
        let group = format!("data/{}", demo.name);
        let mut skipped = Vec::new();
        for member in self.file.members(&group)? {
            match member.as_str() {
                "obs" => {
                    let observations = self.file.members(&format!("{group}/obs"))?;
                    skipped.extend(
                        observations
                            .into_iter()
                            .map(|name| format!("obs/{name}"))
                            .filter(|name| !taken(name)),
                    );
                }
                "next_obs" => {
                    let count = self.file.members(&format!("{group}/next_obs"))?.len();
                    skipped.push(format!("next_obs ({count} datasets)"));
                }
                name if taken(name) => {}
                _ => skipped.push(member),
            }
        }
        Ok(skipped)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn demonstrations_come_in_numeric_order() {
        let names = ["demo_0", "demo_1", "demo_10", "demo_2", "extra", "demo_03"].map(str::to_owned);
        let numbered = numbered(names.to_vec());
        let names: Vec<(&str, u32)> = numbered.iter().map(|demo| (demo.name.as_str(), demo.number)).collect();
        let expected = [
            ("demo_0", 0),
            ("demo_1", 1),
            ("demo_2", 2),
            ("demo_03", 3),
            ("demo_10", 10),
            ("extra", 5),
        ];
        assert_eq!(names, expected);
    }
}
