//! Opening a file: which demonstrations it holds, in which order, and which of them are asked for.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;
use re4_robosuite::env_args::EnvArgs;

use super::demo::{Demo, FoundDemo, Wanted};
use super::fault::Hdf5Fault;
use super::file::{Access, File, Kind};
use super::sources::{MODELS_FOLDER, Sources};
use super::survey::Survey;
use crate::error::{Fault, IngestError};
use crate::left_out::LeftOut;
use crate::selection::{Selection, SelectionError, SourceName};
use crate::warning::{Warning, WarningCode};

/// Demonstrations that are found ahead of reading.
const AHEAD: usize = 16;

/// Which demonstrations to read.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DemoChoice {
    /// Name of a filter key below `/mask`; only demonstrations that it lists are read.
    pub filter: Option<String>,
    /// Which of those, by their own numbers or names.
    pub select: Selection,
    /// Whether reading ends at the first fault, instead of going on to find all: behind one, the HDF5 library may fall over.
    pub cautious: bool,
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
    sources: Sources,
    layout: Layout,
    /// Whether the pose of the object has to come from the states.
    pub(super) object_from_states: bool,
    demos: Vec<DemoName>,
    all: bool,
    warnings: Vec<Warning>,
    sidecars: Mutex<BTreeMap<String, Arc<str>>>,
}

/// A demonstration that is to be read. What it is called in the file is what it is called everywhere.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DemoName {
    /// Its group below `/data`.
    pub name: String,
    /// The number that its name ends in; none where the name has none, it exceeds 32 bits, or another demonstration of the file
    /// has the same.
    pub number: Option<u32>,
    /// Filter keys that list it, in alphabetical order.
    pub filter_keys: Vec<String>,
}

/// Names go into tables, pages and sentences.
const LONGEST_NAME: usize = 200;

impl RobomimicReader {
    /// Opens a file and finds its demonstrations, in the order of the numbers that their names end in (`demo_2` before
    /// `demo_10`), and the models beside it that they name.
    ///
    /// # Errors
    /// What is no HDF5 file of demonstrations, a filter key that is not there or names what is not there, a selection that
    /// does not fit; with [`Access::Direct`], [`Hdf5Fault::NeedsLibrary`].
    pub fn open(sources: &Sources, choice: &DemoChoice, access: Access) -> Result<Self, IngestError> {
        let opened = Self::open_checked(sources.clone(), choice, access);
        opened.map_err(|fault| {
            let error = fault.of(sources.path());
            match sources.unchanged() {
                // Whatever is wrong with a file that changed is not what has to be fixed.
                Err(changed) if !error.needs_library() => changed,
                _ => error,
            }
        })
    }

    fn open_checked(sources: Sources, choice: &DemoChoice, access: Access) -> Result<Self, Fault> {
        let file = File::open(Arc::clone(sources.file()), access, !choice.cautious)?;
        let (names, mut warnings) = demonstrations(&file)?;
        let mut demos = numbered(names);
        let found = demos.len();
        mark_filter_keys(&file, choice, &mut demos, &mut warnings)?;
        if let Some(filter) = &choice.filter
            && demos.iter().all(|demo| !demo.filter_keys.contains(filter))
        {
            return Err(Hdf5Fault::EmptyFilter { filter: filter.clone() }.into());
        }
        let demos = chosen(&demos, choice)?;
        let survey = Survey::of(&file, &demos)?;
        warnings.extend(survey.warning());
        let models = if sources.has_models_folder() {
            models_of(&file, &demos)?
        } else {
            BTreeSet::new()
        };
        Ok(Self {
            path: sources.path().to_owned(),
            layout: survey.layout(),
            object_from_states: survey.object_from_states(),
            sources: sources.with_models(models),
            file,
            all: demos.len() == found,
            demos,
            warnings,
            sidecars: Mutex::default(),
        })
    }

    /// The files that are read.
    pub fn sources(&self) -> &Sources {
        &self.sources
    }

    /// What was found odd when the file was opened.
    pub fn warnings(&self) -> &[Warning] {
        &self.warnings
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
            && !is_model(text)
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
        if !is_model_name(name) {
            let shown: String = name.chars().take(60).collect();
            return Err(refuse(format!("is neither a model nor the name of one: {shown:?}")));
        }
        let mut sidecars = self.sidecars.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(text) = sidecars.get(name) {
            return Ok(Arc::clone(text));
        }
        let text = self.sources.model(name).map_err(|fault| match fault {
            Fault::Changed { .. } | Fault::MissingPath => refuse(format!(
                "names {MODELS_FOLDER}/{name} beside the file, which is not there"
            )),
            fault => refuse(format!("names {MODELS_FOLDER}/{name} beside the file ({fault})")),
        })?;
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
    /// order. `work` gets the place of a demonstration among those asked for, and the demonstration, or why it cannot be read.
    ///
    /// # Errors
    /// A file that cannot be read without the HDF5 library, or whatever the two closures refuse.
    pub fn for_each<T: Send, E: From<IngestError> + Send>(
        &self,
        work: impl Fn(usize, Result<Demo, LeftOut>) -> Result<T, E> + Sync,
        mut take: impl FnMut(usize, T) -> Result<(), E>,
    ) -> Result<(), E> {
        std::thread::scope(|scope| -> Result<(), E> {
            let (sender, receiver) = sync_channel(AHEAD);
            scope.spawn(move || {
                for (episode, demo) in self.demos.iter().enumerate() {
                    let found = self.find(&demo.name, self.wanted());
                    let last = found.as_ref().is_err_and(|fault| self.file.ends_with(fault));
                    if sender.send((episode, demo, found)).is_err() || last {
                        break;
                    }
                }
            });
            while let Ok(first) = receiver.recv() {
                let batch: Vec<_> = std::iter::once(first).chain(receiver.try_iter().take(AHEAD)).collect();
                let done: Vec<Result<(usize, T), E>> = batch
                    .into_par_iter()
                    .map(|(episode, demo, found)| {
                        let read = found.and_then(|found| found.read(&self.file));
                        Ok((episode, work(episode, self.left_out(demo, read)?)?))
                    })
                    .collect();
                for done in done {
                    let (episode, result) = done?;
                    take(episode, result)?;
                }
            }
            Ok(())
        })
    }

    /// A demonstration that cannot be read as one that is left out. What the library is needed for is no fault of it.
    pub(super) fn left_out(
        &self,
        demo: &DemoName,
        read: Result<Demo, Hdf5Fault>,
    ) -> Result<Result<Demo, LeftOut>, IngestError> {
        match read {
            Ok(read) => Ok(Ok(read)),
            Err(fault) if self.file.ends_with(&fault) => Err(Fault::from(fault).of(&self.path)),
            Err(fault) => Ok(Err(LeftOut {
                demo: demo.name.clone(),
                why: fault.to_string(),
            })),
        }
    }

    /// A warning where the attribute `total` of `/data` is not the number of frames of all demonstrations. Nothing reads it,
    /// and programs that remove demonstrations leave it as it was.
    ///
    /// # Errors
    /// A file that cannot be read without the HDF5 library.
    pub fn total_warning(&self, frames: u64) -> Result<Option<Warning>, IngestError> {
        if !self.all {
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
                    "attribute total of /data is {total}, but all demonstrations have {frames} frames; it is not used"
                )
            }
            Ok(_) => return Ok(None),
            Err(why) => format!("{why}; it is not used"),
        };
        Ok(Some(warning(WarningCode::StaleTotal, message, 1)))
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

/// Whether the text of `model_file` is a model; a byte order mark may stand before it.
fn is_model(text: &str) -> bool {
    text.trim_start_matches('\u{feff}').trim_start().starts_with('<')
}

/// Whether the text of `model_file` is the name of a file beside the source.
fn is_model_name(text: &str) -> bool {
    !text.contains(['/', '\\']) && !text.starts_with('.') && !is_model(text) && (1..=255).contains(&text.len())
}

/// The names of models that demonstrations give in place of a model.
fn models_of(file: &File, demos: &[DemoName]) -> Result<BTreeSet<String>, Hdf5Fault> {
    let mut names = BTreeSet::new();
    for demo in demos {
        match file.text(&format!("data/{}", demo.name), "model_file") {
            Ok(Some(text)) if is_model_name(&text) => {
                names.insert(text);
            }
            Err(Hdf5Fault::NeedsLibrary) => return Err(Hdf5Fault::NeedsLibrary),
            // What is wrong is told when the demonstration is read.
            _ => {}
        }
    }
    Ok(names)
}

pub(super) fn warning(code: WarningCode, message: String, count: usize) -> Warning {
    Warning {
        code,
        message,
        episode: None,
        frame: None,
        count: count as u64,
    }
}

/// Names of the groups below `/data` that are demonstrations, and a warning of what stands beside them.
fn demonstrations(file: &File) -> Result<(Vec<String>, Vec<Warning>), Hdf5Fault> {
    let names = file.members_or_none("data")?;
    if let Some(name) = names
        .iter()
        .find(|name| name.len() > LONGEST_NAME || name.chars().any(char::is_control))
    {
        let start: String = name.chars().take(40).collect();
        return Err(Hdf5Fault::Other(format!(
            "a group below /data has the name {start:?}, {} bytes long; rename it to one of at most {LONGEST_NAME} bytes without control characters, such as demo_0",
            name.len()
        )));
    }
    let mut demos = Vec::new();
    let mut others = Vec::new();
    for name in names {
        let path = format!("data/{name}");
        // What the others look like is not asked before the first one is read.
        if file.is_cautious() && is_numbered(&name) {
            demos.push(name);
            continue;
        }
        let is_group = match file.kind(&path)? {
            Kind::Group => true,
            Kind::Dataset => false,
            // A link that leads nowhere is a demonstration that is lost, where it has the name of one.
            Kind::Other => is_numbered(&name),
        };
        // A group that holds nothing of a demonstration is one all the same where it has the name of one: its data is lost.
        let has_actions = || Ok::<_, Hdf5Fault>(is_numbered(&name) || file.exists(&format!("{path}/actions"))?);
        if is_group && has_actions()? {
            demos.push(name);
        } else {
            others.push(name);
        }
    }
    if demos.is_empty() {
        return Err(Hdf5Fault::NoData);
    }
    let mut warnings = Vec::new();
    if !others.is_empty() {
        let message = format!(
            "not read, since they are no demonstrations: {}",
            listed(&others, "/data/")
        );
        warnings.push(warning(WarningCode::SkippedMembers, message, others.len()));
    }
    Ok((demos, warnings))
}

/// Whether a name ends in a number, as those of demonstrations do.
fn is_numbered(name: &str) -> bool {
    name.ends_with(|last: char| last.is_ascii_digit())
}

/// Some of many names.
pub(super) fn listed(names: &[String], prefix: &str) -> String {
    const SHOWN: usize = 8;
    let shown: Vec<String> = names.iter().take(SHOWN).map(|name| format!("{prefix}{name}")).collect();
    match names.len().checked_sub(SHOWN) {
        Some(more) if more > 0 => format!("{} and {more} more", shown.join(", ")),
        _ => shown.join(", "),
    }
}

/// Notes with each demonstration which filter keys list it. What is wrong with a filter key that is not asked for is a warning.
fn mark_filter_keys(
    file: &File,
    choice: &DemoChoice,
    demos: &mut [DemoName],
    warnings: &mut Vec<Warning>,
) -> Result<(), Hdf5Fault> {
    let keys = match (file.members_or_none("mask"), &choice.filter) {
        (Ok(keys), _) => keys,
        (Err(fault), None) if !file.ends_with(&fault) => {
            let message = format!("{fault}; no filter key is read");
            warnings.push(warning(WarningCode::SkippedFilterKeys, message, 1));
            return Ok(());
        }
        (Err(fault), _) => return Err(fault),
    };
    let mut unread = Vec::new();
    for key in &keys {
        let asked_for = choice.filter.as_ref() == Some(key);
        let listed = match file.names(&format!("mask/{key}")) {
            Ok(listed) => listed,
            Err(fault) if asked_for || file.ends_with(&fault) => return Err(fault),
            Err(_) => {
                unread.push(key.clone());
                continue;
            }
        };
        if let Some(name) = listed
            .iter()
            .find(|name| asked_for && demos.iter().all(|demo| demo.name != **name))
        {
            return Err(Hdf5Fault::FilterNames {
                filter: key.clone(),
                demo: name.clone(),
            });
        }
        let listed: BTreeSet<String> = listed.into_iter().collect();
        for demo in demos.iter_mut().filter(|demo| listed.contains(&demo.name)) {
            demo.filter_keys.push(key.clone());
        }
    }
    if !unread.is_empty() {
        let message = format!(
            "not read, since they hold no list of demonstrations: {}; correct them before you use one as ingest.filter",
            listed(&unread, "/mask/")
        );
        warnings.push(warning(WarningCode::SkippedFilterKeys, message, unread.len()));
    }
    match &choice.filter {
        Some(filter) if !keys.contains(filter) => Err(Hdf5Fault::UnknownFilter {
            filter: filter.clone(),
            known: keys,
        }),
        _ => Ok(()),
    }
}

/// The demonstrations that a choice takes.
fn chosen(demos: &[DemoName], choice: &DemoChoice) -> Result<Vec<DemoName>, SelectionError> {
    let names: Vec<SourceName> = demos.iter().map(|demo| SourceName::new(&demo.name)).collect();
    let listed = |place: usize| match &choice.filter {
        Some(filter) => demos[place].filter_keys.contains(filter),
        None => true,
    };
    let places = choice.select.resolve_among(&names, &listed)?;
    Ok(places.into_iter().map(|place| demos[place].clone()).collect())
}

/// Demonstrations in the order of [`SourceName`].
fn numbered(names: Vec<String>) -> Vec<DemoName> {
    let mut names: Vec<SourceName> = names.into_iter().map(SourceName::new).collect();
    names.sort_unstable();
    let own = |place: usize| Some(names.get(place)?.number()).flatten();
    // In this order, those of the same number are neighbours.
    let shared = |place: usize, number: u64| {
        let before = place.checked_sub(1).and_then(own);
        before == Some(number) || own(place + 1) == Some(number)
    };
    let numbers: Vec<Option<u32>> = (0..names.len())
        .map(|place| {
            let number = own(place).filter(|number| !shared(place, *number))?;
            u32::try_from(number).ok()
        })
        .collect();
    names
        .iter()
        .zip(numbers)
        .map(|(name, number)| DemoName {
            name: name.to_string(),
            number,
            filter_keys: Vec::new(),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn demonstrations_come_in_the_order_of_their_own_numbers() {
        let names = [
            "demo_0",
            "demo_1",
            "demo_10",
            "demo_2",
            "extra",
            "demo_03",
            "b_1",
            "demo4294967296",
            "demo11",
        ];
        let numbered = numbered(names.map(str::to_owned).to_vec());
        let names: Vec<(&str, Option<u32>)> = numbered.iter().map(|demo| (demo.name.as_str(), demo.number)).collect();
        let expected = [
            ("demo_0", Some(0)),
            ("b_1", None),
            ("demo_1", None),
            ("demo_2", Some(2)),
            ("demo_03", Some(3)),
            ("demo_10", Some(10)),
            ("demo11", Some(11)),
            ("demo4294967296", None),
            ("extra", None),
        ];
        assert_eq!(names, expected);
    }

    #[test]
    fn a_selection_is_by_own_numbers_among_what_the_filter_lists() {
        let mut demos = numbered([0, 1, 3, 4, 6].map(|number| format!("demo_{number}")).to_vec());
        for demo in demos.iter_mut().filter(|demo| demo.number != Some(4)) {
            demo.filter_keys.push("train".to_owned());
        }
        let take = |filter: Option<&str>, select: Selection| {
            let filter = filter.map(str::to_owned);
            let chosen = chosen(
                &demos,
                &DemoChoice {
                    filter,
                    select,
                    cautious: false,
                },
            )
            .map_err(|error| error.to_string())?;
            Ok(chosen.into_iter().map(|demo| demo.name).collect::<Vec<_>>().join(" "))
        };
        let three = || Selection::List(vec![3.into()]);
        let four = || Selection::List(vec![4.into()]);
        assert_eq!(take(None, three()), Ok("demo_3".to_owned()));
        assert_eq!(take(Some("train"), three()), Ok("demo_3".to_owned()));
        assert_eq!(take(Some("train"), Selection::Last(2)), Ok("demo_3 demo_6".to_owned()));
        assert_eq!(take(None, four()), Ok("demo_4".to_owned()));
        let refused: Result<String, String> = take(Some("train"), four());
        assert!(refused.unwrap_err().contains("the filter key does not list demo_4"));
    }
}
