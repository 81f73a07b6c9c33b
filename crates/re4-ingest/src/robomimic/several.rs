//! Several HDF5 files as one [`DemoSource`]: the demonstrations of all files, in the order of the files.
//!
//! The demonstration `demo_3` of the file `a.hdf5` is named `a/demo_3`. Conventions are proven on the first demonstrations of the
//! dataset. Files that were recorded in another way than the first one are refused. A file is open only while it is read.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use serde_json::json;

use super::fault::Hdf5Fault;
use super::file::Access;
use super::interpret::{Interpreter, PROVEN_ON, Reading};
use super::members::{Member, Members, combined};
use super::reader::{DemoChoice, RobomimicReader};
use super::sources::Sources;
use super::survey::Surveyed;
use super::used::{Used, other};
use crate::demos::{DemoName, DemoSource, Episode, ImageBlock, Info, Tally};
use crate::error::{Fault, IngestError};
use crate::name::SourceName;
use crate::selection::Selection;
use crate::tables::{LeftOut, SignalRow};
use crate::warning::Warning;

/// A source that reads one of several files.
pub trait FileSource: DemoSource + Send {
    /// The reader of the file.
    fn reader(&self) -> &RobomimicReader;

    /// What must be the same in all files, besides what their attributes and layouts say.
    fn same(&self) -> Vec<(String, String)>;

    /// Why the first demonstrations of the file contradict the conventions of the dataset, if all of them do.
    ///
    /// # Errors
    /// The file needs the HDF5 library but was opened without it.
    fn contradiction(&self) -> Result<Option<String>, IngestError>;

    /// Warnings about the dataset that follow from its first file.
    ///
    /// # Errors
    /// The file cannot be read.
    fn general_warnings(&self) -> Result<Vec<Warning>, IngestError>;

    /// Warnings about the file alone.
    fn own_warnings(&self) -> Vec<Warning>;
}

/// The cameras whose recorded images are requested.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CamerasAsked {
    /// None.
    None,
    /// Those with these names; `None` for all that a file has.
    Named(Option<Vec<String>>),
}

impl CamerasAsked {
    /// The requested cameras of a file.
    ///
    /// # Errors
    /// A requested camera does not exist.
    pub fn of(&self, reader: &RobomimicReader) -> Result<Vec<String>, IngestError> {
        match self {
            Self::None => Ok(Vec::new()),
            Self::Named(asked) => reader.cameras(asked.as_deref()),
        }
    }
}

/// The demonstrations of a file.
enum Listed {
    /// All that the filter lists are requested.
    All(Surveyed),
    /// Those that the filter lists, of which some may be requested, and the number of all in the file.
    Names(Vec<DemoName>, usize),
}

/// The files of a dataset, with the requested demonstrations of each.
#[derive(Debug, Clone)]
pub struct Files {
    label: std::path::PathBuf,
    /// Number of all files.
    of: usize,
    used: Vec<Used>,
    /// Number of demonstrations in all files.
    found: usize,
    choice: DemoChoice,
    access: Access,
    /// The demonstrations that this process reads.
    needed: Range<usize>,
}

impl Files {
    /// Finds the requested demonstrations by their names, opens the files of those that are needed, and checks that these files were
    /// recorded in the same way as the first one. `needed` returns the range of the demonstrations that are read, from the number of
    /// all. Files that were surveyed are not opened if none of their demonstrations is needed.
    ///
    /// # Errors
    /// Names all files that cannot be used: a filter key does not exist in one, or it differs from the first; or the selection does
    /// not match.
    pub fn open(
        members: &Members,
        choice: &DemoChoice,
        access: Access,
        setting: Option<&str>,
        needed: impl FnOnce(usize) -> Range<usize>,
    ) -> Result<Self, IngestError> {
        let of_file = DemoChoice {
            select: Selection::All,
            ..choice.clone()
        };
        let mut files = Self {
            label: members.label().to_owned(),
            of: members.files().len(),
            used: Vec::new(),
            found: 0,
            choice: of_file,
            access,
            needed: 0..usize::MAX,
        };
        let mut faults = files.list(members, &choice.select)?;
        if faults.is_empty() {
            files.needed = needed(files.count());
        }
        faults.extend(files.differing(setting)?);
        match combined(&files.label, files.of, faults) {
            Some(error) => Err(error),
            None => Ok(files),
        }
    }

    /// Number of requested demonstrations.
    fn count(&self) -> usize {
        self.used.last().map_or(0, |last| last.range().end)
    }

    /// What is known of the demonstrations of the files, for opening the dataset again.
    pub fn surveyed(&self) -> impl Iterator<Item = (&Path, &Surveyed)> {
        let whole = self.used.iter().filter(|used| used.places.is_none());
        whole.filter_map(|used| Some((used.file.path.as_path(), used.surveyed.get()?)))
    }

    /// Lists the demonstrations of all files, and selects among them. Returns the faults of files.
    fn list(&mut self, members: &Members, select: &Selection) -> Result<Vec<IngestError>, IngestError> {
        let whole = *select == Selection::All;
        let (mut faults, mut names): (Vec<IngestError>, Vec<SourceName>) = (Vec::new(), Vec::new());
        let mut start = 0;
        for file in members.files() {
            let known = file.surveyed.as_ref();
            let known = known.filter(|known| whole && known.choice == self.choice).cloned();
            let listed = known.map_or_else(|| self.listed(file, whole), |known| Ok(Listed::All(known)));
            let listed = match listed {
                Ok(listed) => listed,
                Err(error) if error.needs_library() || error.fault.ends_reading() || self.choice.cautious => {
                    return Err(error);
                }
                Err(error) => {
                    faults.push(error);
                    continue;
                }
            };
            let mut used = Used {
                file: file.clone(),
                start,
                count: 0,
                places: None,
                surveyed: OnceLock::new(),
            };
            match listed {
                Listed::All(known) => {
                    used.count = known.demonstrations;
                    self.found += known.found;
                    used.surveyed = known.into();
                }
                Listed::Names(demos, found) => {
                    used.count = demos.len();
                    self.found += found;
                    let full = |demo: &DemoName| SourceName::new([file.prefix.as_str(), &demo.name].concat());
                    names.extend(demos.iter().map(full));
                }
            }
            start += used.count;
            self.used.push(used);
        }
        if whole || !faults.is_empty() {
            return Ok(faults);
        }
        let places = select
            .resolve(&names)
            .map_err(|error| Fault::from(error).of(&self.label))?;
        let (mut at, mut start) = (0, 0);
        for used in &mut self.used {
            let end = at + places[at..].partition_point(|place| used.range().contains(place));
            let own: Vec<usize> = places[at..end].iter().map(|place| place - used.start).collect();
            used.start = start;
            used.count = own.len();
            used.places = Some(own);
            start += used.count;
            at = end;
        }
        self.used.retain(|used| used.count > 0);
        Ok(faults)
    }

    /// Finds the demonstrations of a file; if `whole`, all of them are requested, and looked at.
    fn listed(&self, file: &Member, whole: bool) -> Result<Listed, IngestError> {
        let sources = Sources::open_again(&file.path, &file.identity)?;
        if whole {
            let reader = RobomimicReader::open(&sources, &self.choice, self.access, None)?;
            return Ok(Listed::All(reader.surveyed().clone()));
        }
        let (demos, found) = RobomimicReader::list(&sources, &self.choice, self.access)?;
        Ok(Listed::Names(demos, found))
    }

    /// Whether this process reads demonstrations of a file.
    fn is_needed(&self, used: &Used) -> bool {
        used.start < self.needed.end && self.needed.start < used.range().end
    }

    /// The faults of the needed files, and their differences from the first file.
    fn differing(&self, setting: Option<&str>) -> Result<Vec<IngestError>, IngestError> {
        let mut faults = Vec::new();
        let mut first: Option<(&Used, Vec<(String, String)>)> = None;
        for (place, used) in self.used.iter().enumerate() {
            if place > 0 && !self.is_needed(used) {
                continue;
            }
            let opened = used.open(&self.choice, self.access);
            let found = opened.and_then(|reader| reader.recorded(setting));
            match (found, &first) {
                (Err(error), _) if error.needs_library() || error.fault.ends_reading() || self.choice.cautious => {
                    return Err(error);
                }
                (Err(error), _) => faults.push(error),
                (Ok(found), None) => first = Some((used, found)),
                (Ok(found), Some((one, known))) => faults.extend(self.difference(one, used, known, &found)),
            }
        }
        Ok(faults)
    }

    /// The error about the first property in which two files differ, if they do.
    fn difference(
        &self,
        one: &Used,
        used: &Used,
        known: &[(String, String)],
        found: &[(String, String)],
    ) -> Option<IngestError> {
        let differs = |(known, found): &(&(String, String), &(String, String))| known != found;
        let (known, found) = known.iter().zip(found).find(differs)?;
        Some(other(
            &self.label,
            format!(
                "{} and {} differ in the {} ({} and {}); all files of a dataset must be recorded in the same way, so ingest them separately",
                one.file.path.display(),
                used.file.path.display(),
                known.0,
                known.1,
                found.1,
            ),
        ))
    }

    fn refuse(&self, faults: Vec<IngestError>) -> Result<(), IngestError> {
        combined(&self.label, self.of, faults).map_or(Ok(()), Err)
    }

    /// Proves the conventions on the first demonstrations of the dataset. Only the files that have them are opened.
    ///
    /// # Errors
    /// As [`Interpreter::learn`].
    pub fn learn(&self, reading: &Reading) -> Result<(Arc<Interpreter>, Vec<LeftOut>), IngestError> {
        let (mut readers, mut demos, mut unusable) = (Vec::new(), 0, 0);
        let mut more = self.used.iter();
        loop {
            for used in more.by_ref() {
                let reader = used.open(&self.choice, self.access)?;
                demos += reader.demos().len();
                readers.push(reader);
                if demos >= PROVEN_ON + unusable {
                    break;
                }
            }
            let (interpreter, left) = Interpreter::learn_from(&readers, reading)?;
            // Others take the place of demonstrations that cannot be used, as in one file.
            if demos >= PROVEN_ON + left.len() || more.len() == 0 {
                return Ok((Arc::new(interpreter), left));
            }
            unusable = left.len();
        }
    }

    /// Of demonstrations of the dataset that cannot be used, those of the file of this reader, with their names in it.
    pub fn left_out_in(reader: &RobomimicReader, left: &[LeftOut]) -> Vec<LeftOut> {
        let own = |left: &LeftOut| {
            Some(LeftOut {
                demo: left.demo.strip_prefix(&reader.prefix)?.to_owned(),
                why: left.why.clone(),
            })
        };
        left.iter().filter_map(own).collect()
    }
}

/// Makes the source of a file from its reader.
type Make<S> = Box<dyn Fn(RobomimicReader) -> Result<S, IngestError> + Send + Sync>;

/// Several files as one dataset.
pub struct Several<S> {
    files: Files,
    info: Info,
    signals: Vec<SignalRow>,
    make: Make<S>,
    /// The file that was read last, which stays open.
    last: Mutex<Option<(usize, Arc<S>)>>,
    /// Files that were read since the last check that they have not changed.
    read: Mutex<BTreeSet<usize>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<S: FileSource> Several<S> {
    /// Creates a source from files; `make` creates the source of one of them. Checks the first demonstrations of each needed file
    /// against the conventions.
    ///
    /// # Errors
    /// Names all files that contradict the conventions, or cannot be read.
    pub fn new(
        files: Files,
        make: impl Fn(RobomimicReader) -> Result<S, IngestError> + Send + Sync + 'static,
    ) -> Result<Self, IngestError> {
        let mut source = Self {
            files,
            info: Info::default(),
            signals: Vec::new(),
            make: Box::new(make),
            last: Mutex::default(),
            read: Mutex::default(),
        };
        let first = source.at(0)?;
        source.signals = first.signals().to_vec();
        source.info = Info {
            demonstrations: source.files.found,
            ..first.info().clone()
        };
        if let Some(name) = source.info.details.get_mut("file") {
            let text = name.as_str().unwrap_or_default();
            *name = json!(format!("{text} and {} more", source.files.of - 1));
        }
        source.info.details.insert("files".to_owned(), json!(source.files.of));
        source.check(&first)?;
        Ok(source)
    }

    /// The source of the first file.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn first(&self) -> Result<Arc<S>, IngestError> {
        self.at(0)
    }

    fn check(&self, first: &S) -> Result<(), IngestError> {
        let files = &self.files;
        let (known, mut faults) = (first.same(), Vec::new());
        for (place, used) in files.used.iter().enumerate().skip(1) {
            if !files.is_needed(used) {
                continue;
            }
            let checked = self.at(place).and_then(|source| {
                let one = &files.used[0];
                let differs = files.difference(one, used, &known, &source.same());
                Ok(match (differs, source.contradiction()?) {
                    (None, Some(why)) => Some(other(
                        &files.label,
                        format!(
                            "{} contradicts the conventions of {} ({why}); all files of a dataset must be recorded in the same way, so ingest them separately",
                            used.file.path.display(),
                            one.file.path.display(),
                        ),
                    )),
                    (differs, _) => differs,
                })
            });
            match checked {
                Err(error) if error.needs_library() || error.fault.ends_reading() || files.choice.cautious => {
                    return Err(error);
                }
                Err(error) => faults.push(error),
                Ok(fault) => faults.extend(fault),
            }
        }
        files.refuse(faults)
    }

    /// The source of a file. It is opened if it is not the last one that was read.
    fn at(&self, place: usize) -> Result<Arc<S>, IngestError> {
        let mut last = locked(&self.last);
        if let Some((known, source)) = &*last
            && *known == place
        {
            return Ok(Arc::clone(source));
        }
        *last = None;
        let Some(used) = self.files.used.get(place) else {
            return Err(Fault::from(Hdf5Fault::NoData).of(&self.files.label));
        };
        let source = Arc::new((self.make)(used.open(&self.files.choice, self.files.access)?)?);
        locked(&self.read).insert(place);
        *last = Some((place, Arc::clone(&source)));
        Ok(source)
    }

    /// Index of the file of a demonstration.
    fn file_of(&self, demo: &DemoName) -> Option<usize> {
        let (prefix, _) = demo.name.rsplit_once('/')?;
        let own = |used: &Used| used.file.prefix.strip_suffix('/') == Some(prefix);
        self.files.used.iter().position(own)
    }
}

impl<S: FileSource> DemoSource for Several<S> {
    /// Several files are not at one path.
    fn probe(_path: &Path) -> bool {
        false
    }

    fn info(&self) -> &Info {
        &self.info
    }

    fn signals(&self) -> &[SignalRow] {
        &self.signals
    }

    fn count(&self) -> usize {
        self.files.count()
    }

    fn episodes<E: From<IngestError> + Send>(
        &self,
        range: Range<usize>,
        mut take: impl FnMut(usize, Result<Episode, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        let used = &self.files.used;
        let first = used.partition_point(|used| used.range().end <= range.start);
        for (place, used) in used.iter().enumerate().skip(first) {
            let own = range.start.max(used.start)..range.end.min(used.range().end);
            if own.is_empty() {
                break;
            }
            let own = own.start - used.start..own.end - used.start;
            let source = self.at(place)?;
            source.episodes(own, |place, episode| take(used.start + place, used.episode(episode)))?;
        }
        Ok(())
    }

    fn images<E: From<IngestError>>(
        &self,
        camera: &str,
        of: &[(DemoName, usize)],
        mut take: impl FnMut(Result<ImageBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        let places: Vec<Option<usize>> = of.iter().map(|(demo, _)| self.file_of(demo)).collect();
        let mut before = 0;
        for run in places.chunk_by(|a, b| a == b) {
            let own = &of[before..before + run.len()];
            let first = before as u32;
            before += run.len();
            let Some(place) = run[0] else { continue };
            let (used, source) = (&self.files.used[place], self.at(place)?);
            let own: Vec<(DemoName, usize)> = own
                .iter()
                .map(|(demo, frames)| {
                    let name = demo
                        .name
                        .strip_prefix(&used.file.prefix)
                        .unwrap_or(&demo.name)
                        .to_owned();
                    (DemoName { name, ..demo.clone() }, *frames)
                })
                .collect();
            source.images(camera, &own, |block| {
                take(match block {
                    Ok(mut block) => {
                        block.places.iter_mut().for_each(|place| place.0 += first);
                        Ok(block)
                    }
                    Err(left) => Err(used.left_out(&left)),
                })
            })?;
        }
        Ok(())
    }

    fn warnings(&self, tally: &Tally) -> Result<Vec<Warning>, IngestError> {
        // Warnings of one kind are one warning, with the text of the first file that has it.
        let mut warnings: Vec<Warning> = Vec::new();
        for (place, used) in self.files.used.iter().enumerate() {
            for mut own in self.at(place)?.own_warnings() {
                if let Some(known) = warnings.iter_mut().find(|known| known.code == own.code) {
                    known.count += own.count;
                } else {
                    own.message = format!("in {}, {}", used.file.prefix.trim_end_matches('/'), own.message);
                    warnings.push(own);
                }
            }
        }
        warnings.extend(tally.left_out_warning(self.count()));
        warnings.extend(tally.warnings());
        warnings.extend(self.at(0)?.general_warnings()?);
        Ok(warnings)
    }

    fn unchanged(&self) -> Result<(), IngestError> {
        for place in locked(&self.read).iter() {
            let used = &self.files.used[*place];
            used.file.unchanged()?;
        }
        let open = locked(&self.last).as_ref().map(|(place, _)| *place);
        locked(&self.read).retain(|place| Some(*place) == open);
        Ok(())
    }
}
