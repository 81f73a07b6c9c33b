//! An HDF5 file of robosuite demonstrations as a [`DemoSource`].

use std::fs::File;
use std::ops::Range;
use std::os::unix::fs::FileExt as _;
use std::path::Path;
use std::sync::Arc;

use re4_robosuite::conventions::ActionKind;
use re4_robosuite::env_args::EnvArgs;
use serde_json::{Map, Value, json};

use super::demo::Demo;
use super::interpret::{Interpreted, Interpreter, Reading};
use super::look::SIGNATURE;
use super::reader::RobomimicReader;
use super::several::{CamerasAsked, FileSource, Files, Several};
use super::summary::Comparison;
use crate::demos::{DemoName, DemoSource, Episode, Frames, ImageBlock, Info, Tally};
use crate::error::IngestError;
use crate::left_out::parts;
use crate::tables::{Convention, LeftOut};
use crate::warning::{Warning, WarningCode};

/// Number of demonstrations of a file that are compared with the conventions of the other files.
const COMPARED: usize = 3;

/// An opened file with known conventions.
pub struct RobomimicSource {
    reader: RobomimicReader,
    interpreter: Arc<Interpreter>,
    comparison: Option<Comparison>,
    info: Info,
    /// Demonstrations that were found unusable when the conventions were proven.
    excluded: Vec<LeftOut>,
    /// Whether each image was made after the action of its row. The first frame of each demonstration is then left out, so that the
    /// image in row `t` of the file is that of frame `t`.
    late: bool,
}

impl RobomimicSource {
    /// The requested demonstrations, in order.
    pub fn demos(&self) -> &[DemoName] {
        self.reader.demos()
    }

    /// Creates a source from a reader and the result of [`Interpreter::learn`]; `cameras` are those with requested images.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn new(
        reader: RobomimicReader,
        (interpreter, excluded): (Interpreter, Vec<LeftOut>),
        comparison: Option<Comparison>,
        cameras: Vec<String>,
    ) -> Result<Self, IngestError> {
        Self::interpreted(reader, (Arc::new(interpreter), excluded), comparison, cameras)
    }

    /// Like [`Self::new`], with conventions that several files share.
    pub(super) fn interpreted(
        reader: RobomimicReader,
        (interpreter, excluded): (Arc<Interpreter>, Vec<LeftOut>),
        comparison: Option<Comparison>,
        cameras: Vec<String>,
    ) -> Result<Self, IngestError> {
        let env = interpreter.env();
        let mut details = Map::new();
        details.insert("environment".to_owned(), json!(env.env_name));
        details.insert("robosuite_version".to_owned(), json!(env.env_version));
        details.insert(
            "file".to_owned(),
            json!(reader.path.file_name().map(|name| name.to_string_lossy())),
        );
        let actions = match interpreter.action_kind() {
            ActionKind::Delta => "delta",
            ActionKind::Absolute => "absolute",
        };
        details.insert("actions".to_owned(), Value::from(actions));
        let format = interpreter.relative().format();
        let info = reader.describe(Info {
            rate: env.control_freq,
            cameras,
            object_poses: true,
            details,
            ..Info::default()
        })?;
        let info = Info {
            format: format.map_or(info.format, str::to_owned),
            ..info
        };
        Ok(Self {
            late: interpreter.relative().is_late() && !info.cameras.is_empty(),
            reader,
            interpreter,
            comparison,
            info,
            excluded,
        })
    }

    /// Several files as one dataset.
    ///
    /// # Errors
    /// A file cannot be read, or contradicts the conventions of the first demonstrations.
    pub fn several(files: Files, reading: &Reading, cameras: &CamerasAsked) -> Result<Several<Self>, IngestError> {
        let (interpreter, left) = files.learn(reading)?;
        let cameras = cameras.clone();
        Several::new(files, move |reader| {
            let asked = cameras.of(&reader)?;
            let excluded = Files::left_out_in(&reader, &left);
            Self::interpreted(reader, (Arc::clone(&interpreter), excluded), None, asked)
        })
    }

    /// The conventions, each with its evidence.
    pub fn conventions(&self) -> &[Convention] {
        self.interpreter.conventions()
    }

    /// Metadata on how the file was recorded.
    pub fn env(&self) -> &EnvArgs {
        self.interpreter.env()
    }

    /// The reader of the file.
    pub fn reader(&self) -> &RobomimicReader {
        &self.reader
    }

    /// Interprets a demonstration, or returns why it cannot be used.
    fn episode(&self, name: &DemoName, demo: Result<Demo, LeftOut>) -> Result<Result<Episode, LeftOut>, IngestError> {
        let known = self.excluded.iter().find(|left| left.demo == name.name);
        let mut demo = match demo {
            Ok(demo) => demo,
            Err(left) => return Ok(Err(known.cloned().unwrap_or(left))),
        };
        if let Err(left) = self.reader.check_cameras(&demo.name, demo.frames, &self.info.cameras)? {
            return Ok(Err(known.cloned().unwrap_or(left)));
        }
        let other = match &self.comparison {
            Some(comparison) => comparison.actions(&demo.name, demo.frames)?,
            None => None,
        };
        let interpreted = self.interpreter.interpret(&self.reader, &mut demo, other.as_deref());
        let interpreted = interpreted.map(|interpreted| self.without_first(&mut demo, interpreted));
        match interpreted {
            Ok(interpreted) => Ok(Ok(Episode {
                name: name.clone(),
                frames: Frames::Spatial(interpreted.frames),
                goal_errors: interpreted.goal_errors,
                states: demo.states,
                model: demo.model,
                single_precision: demo.single_precision,
                skipped: demo.skipped,
                contradiction: known.map(|known| known.why.clone()).or(interpreted.contradiction),
            })),
            Err(error) if error.needs_library() => Err(error),
            Err(error) => Ok(Err(known.cloned().unwrap_or_else(|| LeftOut {
                demo: name.name.clone(),
                why: error.fault.to_string(),
            }))),
        }
    }
}

impl RobomimicSource {
    /// Leaves out the first frame, of which there is no image, if images are late.
    fn without_first(&self, demo: &mut Demo, mut interpreted: Interpreted) -> Interpreted {
        if self.late {
            interpreted.frames.drain(..interpreted.frames.len().min(1));
            if let Some(states) = &mut demo.states {
                states.values.drain(..states.columns.min(states.values.len()));
            }
        }
        interpreted
    }
}

impl DemoSource for RobomimicSource {
    /// Accepts a file with HDF5's signature, or with the extension `hdf5` or `h5`.
    fn probe(path: &Path) -> bool {
        let named = path.extension().is_some_and(|end| end == "hdf5" || end == "h5");
        let signed = || {
            let mut start = [0; SIGNATURE.len()];
            let read = File::open(path).and_then(|file| file.read_exact_at(&mut start, 0));
            read.is_ok() && start == *SIGNATURE
        };
        path.is_file() && (named || signed())
    }

    fn info(&self) -> &Info {
        &self.info
    }

    fn count(&self) -> usize {
        self.demos().len()
    }

    fn episodes<E: From<IngestError> + Send>(
        &self,
        range: Range<usize>,
        take: impl FnMut(usize, Result<Episode, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        let demos = self.reader.demos();
        self.reader
            .for_each(range, |place, demo| Ok(self.episode(&demos[place], demo)?), take)
    }

    fn images<E: From<IngestError>>(
        &self,
        camera: &str,
        of: &[(DemoName, usize)],
        take: impl FnMut(Result<ImageBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        self.reader.for_each_block(camera, of, self.late, take)
    }

    fn warnings(&self, tally: &Tally) -> Result<Vec<Warning>, IngestError> {
        let mut warnings = self.reader.warnings().to_vec();
        if let Some(left_out) = tally.left_out_warning(self.demos().len()) {
            warnings.push(left_out);
        } else {
            let without_first = if self.late { self.demos().len() } else { 0 };
            let recorded = tally.frames + without_first;
            warnings.extend(self.reader.total_warning(recorded as u64)?);
        }
        warnings.extend(tally.warnings());
        let conventions = self.interpreter.warnings().iter();
        warnings.extend(conventions.map(|text| Warning::new(WarningCode::Convention, text.clone(), 1)));
        if let (Some(_), Some(first)) = (&self.comparison, &tally.not_compared.first) {
            let message = format!("missing from the file used for comparison: {first}");
            warnings.push(Warning::new(
                WarningCode::NotCompared,
                message,
                tally.not_compared.count,
            ));
        }
        warnings.extend(self.reader.skipped_warning(&self.info.cameras)?);
        Ok(warnings)
    }

    fn unchanged(&self) -> Result<(), IngestError> {
        self.reader.sources().unchanged()?;
        self.comparison.as_ref().map_or(Ok(()), Comparison::unchanged)
    }
}

impl FileSource for RobomimicSource {
    fn reader(&self) -> &RobomimicReader {
        &self.reader
    }

    fn same(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    fn contradiction(&self) -> Result<Option<String>, IngestError> {
        let mut first = None;
        let (mut read, mut contradicting) = (0, 0);
        for name in self.demos().iter().take(COMPARED) {
            let demo = self.reader.left_out(&name.name, self.reader.read(name))?;
            // Those that cannot be read are reported with the others.
            let Ok(mut demo) = demo else { continue };
            read += 1;
            let why = match self.interpreter.interpret(&self.reader, &mut demo, None) {
                Ok(interpreted) => interpreted.contradiction,
                Err(error) if error.needs_library() => return Err(error),
                Err(error) => Some(error.fault.to_string()),
            };
            if let Some(why) = why {
                contradicting += 1;
                first.get_or_insert(parts(&why).0.to_owned());
            }
        }
        // A single one may be an odd demonstration.
        Ok(first.filter(|_| read > 1 && contradicting == read))
    }

    fn general_warnings(&self) -> Result<Vec<Warning>, IngestError> {
        let conventions = self.interpreter.warnings().iter();
        let mut warnings: Vec<Warning> = conventions
            .map(|text| Warning::new(WarningCode::Convention, text.clone(), 1))
            .collect();
        warnings.extend(self.reader.skipped_warning(&self.info.cameras)?);
        Ok(warnings)
    }

    fn own_warnings(&self) -> Vec<Warning> {
        self.reader.warnings().to_vec()
    }
}
