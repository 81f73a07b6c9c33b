//! Opens a file: finds its demonstrations, orders them, and resolves which of them are requested.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;
use re4_robosuite::env_args::EnvArgs;
use serde::{Deserialize, Serialize};

use super::demo::{Demo, FoundDemo, Wanted};
use super::fault::Hdf5Fault;
use super::file::{Access, File, Kind};
use super::names::{chosen, demonstrations, mark_filter_keys, numbered, others_warning};
use super::relatives::{Cameras, FoundDatagen};
use super::sources::{MODELS_FOLDER, Sources};
use super::survey::{Survey, Surveyed};
use crate::demos::{DemoName, Info};
use crate::error::{Fault, IngestError};
use crate::selection::Selection;
use crate::tables::LeftOut;
use crate::warning::{Warning, WarningCode};

/// Number of demonstrations that are located ahead of reading.
const AHEAD: usize = 16;

/// Which demonstrations to read.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DemoChoice {
    /// Name of a filter key in `/mask`; only demonstrations that it lists are read.
    pub filter: Option<String>,
    /// Which of those, by number or name.
    pub select: Selection,
    /// Whether reading ends at the first fault instead of collecting all faults. The HDF5 library may crash after a fault.
    pub cautious: bool,
}

/// Layout of the demonstrations of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// robomimic's layout, with observations.
    Observed,
    /// Raw layout, with states and actions only.
    Raw,
}

/// An opened file. The demonstrations are known by name, but have not been read.
pub struct RobomimicReader {
    pub(super) path: PathBuf,
    pub(super) file: File,
    sources: Sources,
    /// What all requested demonstrations have.
    pub(super) surveyed: Surveyed,
    /// How the datasets of images are named.
    pub(super) image_names: Cameras,
    demos: Vec<DemoName>,
    /// Filter keys in `/mask` that list at least one demonstration.
    filter_keys: BTreeSet<String>,
    warnings: Vec<Warning>,
    sidecars: Mutex<BTreeMap<String, Arc<str>>>,
    /// What precedes the names of the demonstrations where several files are read.
    pub(super) prefix: String,
}

/// What is known of the demonstrations of a file by their names.
struct Found {
    file: File,
    /// The chosen demonstrations.
    demos: Vec<DemoName>,
    /// Number of all demonstrations.
    count: usize,
    /// Members of `/data` that are not demonstrations.
    others: Vec<String>,
    filter_keys: BTreeSet<String>,
    warnings: Vec<Warning>,
}

impl Found {
    fn of(sources: &Sources, choice: &DemoChoice, access: Access, known: Option<&Surveyed>) -> Result<Self, Fault> {
        let file = File::open(Arc::clone(sources.file()), access, !choice.cautious)?;
        let (names, others) = demonstrations(&file, known.map(|known| known.others.as_slice()))?;
        let mut warnings: Vec<Warning> = others_warning(&others).into_iter().collect();
        let mut demos = numbered(names);
        mark_filter_keys(&file, choice, &mut demos, &mut warnings)?;
        if let Some(filter) = &choice.filter
            && demos.iter().all(|demo| !demo.filter_keys.contains(filter))
        {
            return Err(Hdf5Fault::EmptyFilter { filter: filter.clone() }.into());
        }
        Ok(Self {
            filter_keys: demos.iter().flat_map(|demo| demo.filter_keys.iter().cloned()).collect(),
            count: demos.len(),
            demos: chosen(&demos, choice)?,
            others,
            file,
            warnings,
        })
    }
}

impl RobomimicReader {
    /// Opens a file and finds its demonstrations, in the order of the numbers at the end of their names (`demo_2` before
    /// `demo_10`), and the model files beside it that they refer to.
    ///
    /// With what is `known` of the file for this choice, no demonstration is looked at.
    ///
    /// # Errors
    /// The file is not an HDF5 file of demonstrations, the filter key does not exist or names a missing demonstration, or the
    /// selection does not match. With [`Access::Direct`] also [`Hdf5Fault::NeedsLibrary`].
    pub fn open(
        sources: &Sources,
        choice: &DemoChoice,
        access: Access,
        known: Option<&Surveyed>,
    ) -> Result<Self, IngestError> {
        Self::open_places(sources, choice, access, None, known)
    }

    /// Like [`Self::open`], only for those of the chosen demonstrations that have these indices, if some are given.
    pub(super) fn open_places(
        sources: &Sources,
        choice: &DemoChoice,
        access: Access,
        places: Option<&[usize]>,
        known: Option<&Surveyed>,
    ) -> Result<Self, IngestError> {
        let known = known.filter(|known| known.choice == *choice);
        Self::checked(sources, || {
            let mut found = Found::of(sources, choice, access, known)?;
            if let Some(places) = places {
                let demos = places.iter().filter_map(|place| found.demos.get(*place).cloned());
                found.demos = demos.collect();
            }
            Self::opened(sources.clone(), found, choice, known)
        })
    }

    /// Names of the chosen demonstrations of a file, and the number of all. Nothing else is read.
    pub(super) fn list(
        sources: &Sources,
        choice: &DemoChoice,
        access: Access,
    ) -> Result<(Vec<DemoName>, usize), IngestError> {
        Self::checked(sources, || {
            let found = Found::of(sources, choice, access, None)?;
            Ok((found.demos, found.count))
        })
    }

    fn checked<T>(sources: &Sources, open: impl FnOnce() -> Result<T, Fault>) -> Result<T, IngestError> {
        open().map_err(|fault| {
            let error = fault.of(sources.path());
            match sources.unchanged() {
                // A change of the file can cause any other fault, so only the change is reported.
                Err(changed) if !error.needs_library() => changed,
                _ => error,
            }
        })
    }

    fn opened(sources: Sources, found: Found, choice: &DemoChoice, known: Option<&Surveyed>) -> Result<Self, Fault> {
        let Found {
            file,
            demos,
            count,
            others,
            filter_keys,
            mut warnings,
        } = found;
        let surveyed = match known {
            Some(known) => known.clone(),
            None => Survey::of(&file, &demos)?.surveyed(choice, count, others, demos.len()),
        };
        warnings.extend(surveyed.warning.clone());
        let models = if sources.has_models_folder() {
            models_of(&file, &demos)?
        } else {
            BTreeSet::new()
        };
        let image_names = Cameras::of(file.text("data", Cameras::ATTRIBUTE)?.as_deref());
        Ok(Self {
            path: sources.path().to_owned(),
            surveyed,
            image_names,
            sources: sources.with_models(models),
            file,
            demos,
            filter_keys,
            warnings,
            sidecars: Mutex::default(),
            prefix: String::new(),
        })
    }

    /// The source files.
    pub fn sources(&self) -> &Sources {
        &self.sources
    }

    /// Warnings from opening the file.
    pub fn warnings(&self) -> &[Warning] {
        &self.warnings
    }

    /// The requested demonstrations, in order.
    pub fn demos(&self) -> &[DemoName] {
        &self.demos
    }

    /// Layout of the demonstrations.
    pub fn layout(&self) -> Layout {
        self.surveyed.layout
    }

    /// What a look at all requested demonstrations found, for opening the file again.
    pub fn surveyed(&self) -> &Surveyed {
        &self.surveyed
    }

    /// Metadata on how the file was recorded; `setting` replaces its attribute `env_args`.
    pub(super) fn environment(&self, setting: Option<&str>) -> Result<EnvArgs, Hdf5Fault> {
        let fix = |what: &str| {
            format!("{what}, or give the JSON text of a file that was recorded in the same way as ingest.env_args")
        };
        let refuse = |attribute: &'static str, error: re4_robosuite::env_args::EnvArgsError| {
            Hdf5Fault::Other(format!(
                "{error}; {}",
                fix(&format!("repair attribute {attribute} of /data"))
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
                fix: fix("restore it"),
            });
        }
        EnvArgs::parse_raw(env.as_deref(), info.as_deref(), version.as_deref())
            .map_err(|error| refuse("env_info", error))
    }

    /// A text attribute of `/data`.
    pub(super) fn data_text(&self, name: &str) -> Result<Option<String>, Hdf5Fault> {
        self.file.text("data", name)
    }

    /// Names of the objects with poses in `datagen_info` of the first demonstration.
    pub(super) fn datagen_objects(&self) -> Result<Vec<String>, Hdf5Fault> {
        self.of_first(|demo| FoundDatagen::objects(&self.file, demo))
    }

    /// Whether the first demonstration has the attribute `ep_meta`, which describes a scene that differs between demonstrations.
    pub(super) fn has_episode_metadata(&self) -> Result<bool, Hdf5Fault> {
        self.of_first(|demo| self.file.has_attribute(&format!("data/{demo}"), "ep_meta"))
    }

    /// Names, with their group, of the datasets in some groups of the first demonstration.
    pub(super) fn names_in_first(&self, groups: &[&str]) -> Result<Vec<String>, Hdf5Fault> {
        self.of_first(|demo| {
            let mut names = Vec::new();
            for group in groups {
                let path = format!("data/{demo}/{group}");
                // Also the path of a dataset in some files.
                if !self.file.exists(&path)? || self.file.kind(&path)? != Kind::Group {
                    continue;
                }
                names.extend(
                    self.file
                        .members(&path)?
                        .into_iter()
                        .map(|name| format!("{group}/{name}")),
                );
            }
            Ok(names)
        })
    }

    /// Asks something of the first demonstration. Its faults are reported when it is read.
    pub(super) fn of_first<T: Default>(&self, ask: impl Fn(&str) -> Result<T, Hdf5Fault>) -> Result<T, Hdf5Fault> {
        let Some(demo) = self.demos.first() else {
            return Ok(T::default());
        };
        match ask(&demo.name) {
            Err(fault) if !self.file.is_fatal(&fault) => Ok(T::default()),
            asked => asked,
        }
    }

    /// Locates a demonstration's datasets.
    fn find(&self, name: &str, wanted: Wanted) -> Result<FoundDemo, Hdf5Fault> {
        let mut found = FoundDemo::find(&self.file, name, wanted)?;
        if let Some(text) = &found.model
            && !is_model(text)
        {
            found.model = Some(self.sidecar(name, text)?);
        }
        Ok(found)
    }

    /// Reads a model file beside the HDF5 file.
    fn sidecar(&self, demo: &str, name: &str) -> Result<Arc<str>, Hdf5Fault> {
        let refuse = |why: String| Hdf5Fault::Attribute {
            object: format!("/data/{demo}"),
            attribute: "model_file",
            why,
            fix: "restore that file from the dataset".to_owned(),
        };
        if !is_model_name(name) {
            let shown: String = name.chars().take(60).collect();
            return Err(refuse(format!(
                "is neither a model nor the name of a model file: {shown:?}"
            )));
        }
        let mut sidecars = self.sidecars.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(text) = sidecars.get(name) {
            return Ok(Arc::clone(text));
        }
        let text = self.sources.model(name).map_err(|fault| match fault {
            Fault::Changed { .. } | Fault::MissingPath => refuse(format!(
                "names {MODELS_FOLDER}/{name} beside the file, which does not exist"
            )),
            fault => refuse(format!("names {MODELS_FOLDER}/{name} beside the file ({fault})")),
        })?;
        let text: Arc<str> = text.into();
        sidecars.insert(name.to_owned(), Arc::clone(&text));
        Ok(text)
    }

    fn wanted(&self) -> Wanted {
        match self.surveyed.layout {
            Layout::Observed => Wanted::Observed,
            Layout::Raw if self.image_names.are_libero() => Wanted::Late,
            Layout::Raw => Wanted::Raw,
        }
    }

    /// Reads one demonstration, including the angular velocities of the end effector.
    pub(super) fn read(&self, demo: &DemoName) -> Result<Demo, Hdf5Fault> {
        let wanted = match self.surveyed.layout {
            Layout::Observed => Wanted::ObservedWithVelocities,
            Layout::Raw => self.wanted(),
        };
        self.find(&demo.name, wanted)?.read(&self.file)
    }

    /// The actions of the demonstration of the file with this name; `None` if it does not exist.
    pub(super) fn actions(&self, name: &str) -> Result<Option<Vec<[f64; 7]>>, Hdf5Fault> {
        let is_demo = !self.surveyed.others.iter().any(|other| other == name);
        if !is_demo || !self.file.exists(&format!("data/{name}"))? {
            return Ok(None);
        }
        Ok(Some(self.find(name, Wanted::Actions)?.read(&self.file)?.actions))
    }

    /// Reads a range of the demonstrations. They are located one by one, read and processed in parallel, and passed to `take` in order.
    /// `work` receives the index of a demonstration among those requested, and the demonstration or the reason why it cannot be
    /// read.
    ///
    /// # Errors
    /// The file needs the HDF5 library but was opened without it, or one of the two closures returns an error.
    pub fn for_each<T: Send, E: From<IngestError> + Send>(
        &self,
        range: Range<usize>,
        work: impl Fn(usize, Result<Demo, LeftOut>) -> Result<T, E> + Sync,
        take: impl FnMut(usize, T) -> Result<(), E>,
    ) -> Result<(), E> {
        self.for_each_found(
            range,
            |demo| self.find(demo, self.wanted()),
            |place, found| {
                let read = found.and_then(|found| found.read(&self.file));
                work(place, self.left_out(&self.demos[place].name, read)?)
            },
            take,
        )
    }

    /// Like [`Self::for_each`], for demonstrations that `find` locates and `work` reads.
    ///
    /// # Errors
    /// As for [`Self::for_each`].
    pub(super) fn for_each_found<F: Send, T: Send, E: From<IngestError> + Send>(
        &self,
        range: Range<usize>,
        find: impl Fn(&str) -> Result<F, Hdf5Fault> + Send,
        work: impl Fn(usize, Result<F, Hdf5Fault>) -> Result<T, E> + Sync,
        mut take: impl FnMut(usize, T) -> Result<(), E>,
    ) -> Result<(), E> {
        std::thread::scope(|scope| -> Result<(), E> {
            let (sender, receiver) = sync_channel(AHEAD);
            scope.spawn(move || {
                for (episode, demo) in range.clone().zip(&self.demos[range]) {
                    let found = find(&demo.name);
                    let last = found.as_ref().is_err_and(|fault| self.file.is_fatal(fault));
                    if sender.send((episode, found)).is_err() || last {
                        break;
                    }
                }
            });
            while let Ok(first) = receiver.recv() {
                let batch: Vec<_> = std::iter::once(first).chain(receiver.try_iter().take(AHEAD)).collect();
                let done: Vec<Result<(usize, T), E>> = batch
                    .into_par_iter()
                    .map(|(episode, found)| Ok((episode, work(episode, found)?)))
                    .collect();
                for done in done {
                    let (episode, result) = done?;
                    take(episode, result)?;
                }
            }
            Ok(())
        })
    }

    /// Converts the fault of a demonstration that cannot be read to a [`LeftOut`], except for fatal faults of the file.
    pub(super) fn left_out<T>(
        &self,
        demo: &str,
        read: Result<T, Hdf5Fault>,
    ) -> Result<Result<T, LeftOut>, IngestError> {
        match read {
            Ok(read) => Ok(Ok(read)),
            Err(fault) if self.file.is_fatal(&fault) => Err(Fault::from(fault).of(&self.path)),
            Err(fault) => Ok(Err(LeftOut {
                demo: demo.to_owned(),
                why: fault.to_string(),
            })),
        }
    }

    /// Adds the properties of the file to `info`.
    ///
    /// # Errors
    /// The file needs the HDF5 library but was opened without it.
    pub(super) fn describe(&self, info: Info) -> Result<Info, IngestError> {
        let features = match self.skipped(|_| false) {
            Err(fault @ Hdf5Fault::NeedsLibrary) => return Err(Fault::from(fault).of(&self.path)),
            // Faults of a demonstration are reported when it is read.
            features => features.unwrap_or_default(),
        };
        Ok(Info {
            format: match self.surveyed.layout {
                Layout::Observed => "hdf5, robomimic",
                Layout::Raw => "hdf5, robosuite raw",
            }
            .to_owned(),
            features,
            demonstrations: self.surveyed.found,
            filter_keys: self.filter_keys.iter().cloned().collect(),
            ..info
        })
    }

    /// A warning if the attribute `total` of `/data` is not the number of frames of all demonstrations. The attribute is not
    /// used, and programs that remove demonstrations often do not update it.
    ///
    /// # Errors
    /// The file needs the HDF5 library but was opened without it.
    pub(super) fn total_warning(&self, frames: u64) -> Result<Option<Warning>, IngestError> {
        if self.demos.len() < self.surveyed.found {
            return Ok(None);
        }
        let total = match self.file.count("data", "total") {
            Err(fault @ Hdf5Fault::NeedsLibrary) => return Err(Fault::from(fault).of(&self.path)),
            Err(fault) => Err(fault.to_string()),
            Ok(total) => Ok(total),
        };
        let message = match total {
            Ok(Some(total)) if u64::try_from(total) != Ok(frames) => {
                format!(
                    "attribute total of /data is {total}, but the demonstrations have {frames} frames in total; the attribute is not used"
                )
            }
            Ok(_) => return Ok(None),
            Err(why) => format!("{why}; the attribute is not used"),
        };
        Ok(Some(Warning::new(WarningCode::StaleTotal, message, 1)))
    }

    /// Datasets of the first demonstration that are not ingested, and groups with their number of members.
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

/// Whether the text of `model_file` is a model; it may begin with a byte order mark.
fn is_model(text: &str) -> bool {
    text.trim_start_matches('\u{feff}').trim_start().starts_with('<')
}

/// Whether the text of `model_file` is the name of a file beside the source.
fn is_model_name(text: &str) -> bool {
    !text.contains(['/', '\\']) && !text.starts_with('.') && !is_model(text) && (1..=255).contains(&text.len())
}

/// Names of model files that demonstrations refer to instead of containing a model.
fn models_of(file: &File, demos: &[DemoName]) -> Result<BTreeSet<String>, Hdf5Fault> {
    let mut names = BTreeSet::new();
    for demo in demos {
        match file.text(&format!("data/{}", demo.name), "model_file") {
            Ok(Some(text)) if is_model_name(&text) => {
                names.insert(text);
            }
            Err(Hdf5Fault::NeedsLibrary) => return Err(Hdf5Fault::NeedsLibrary),
            // Faults are reported when the demonstration is read.
            _ => {}
        }
    }
    Ok(names)
}
