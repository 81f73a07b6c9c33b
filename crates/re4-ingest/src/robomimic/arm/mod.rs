//! HDF5 files of one arm with a gripper, read without an object: the layouts of robomimic, robosuite and LIBERO, and others whose
//! datasets a setting names.

mod config;
mod layout;

use std::ops::Range;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::{Map, json};

pub use config::ArmConfig;

use self::layout::{ArmLayout, Array};
use super::fault::Hdf5Fault;
use super::file::{Element, Located};
use super::reader::RobomimicReader;
use super::several::{CamerasAsked, FileSource, Files, Several};
use crate::demos::{DemoName, DemoSource, Episode, Frames, ImageBlock, Info, Tally};
use crate::error::{Fault, IngestError};
use crate::tables::{ArmColumns, Convention, LeftOut, SignalRole, SignalRow};
use crate::warning::{Warning, WarningCode};

/// An opened file of an arm.
pub struct ArmSource {
    reader: RobomimicReader,
    layout: ArmLayout,
    info: Info,
    conventions: Vec<Convention>,
}

/// The datasets of a demonstration, located but not read.
struct Found {
    frames: usize,
    arrays: Vec<(SignalRole, Located)>,
    actions: Located,
    rewards: Option<Located>,
    dones: Option<Located>,
    skipped: Vec<String>,
}

/// Largest deviation of the length of a quaternion from 1: that of numbers in single precision, with a margin.
const UNIT: f64 = 1e-3;

impl ArmSource {
    /// The requested demonstrations, in order.
    pub fn demos(&self) -> &[DemoName] {
        self.reader.demos()
    }

    /// Creates a source from a reader. `cameras` are those with requested images.
    ///
    /// # Errors
    /// The file has several arms, or none under a known name, or a setting does not fit it.
    pub fn new(reader: RobomimicReader, config: &ArmConfig, cameras: Vec<String>) -> Result<Self, IngestError> {
        let of = |fault: Hdf5Fault| Fault::from(fault).of(&reader.path);
        let layout = ArmLayout::of(&reader.file, reader.demos(), config).map_err(of)?;
        // A file that does not say how it was recorded can be read all the same.
        let env = reader.environment(None).ok();
        let mut details = Map::new();
        if let Some(env) = &env {
            details.insert("environment".to_owned(), json!(env.env_name));
        }
        let file = reader.path.file_name().map(|name| name.to_string_lossy());
        details.insert("file".to_owned(), json!(file));
        let info = reader.describe(Info {
            rate: config.rate.or(env.and_then(|env| env.control_freq)),
            cameras,
            object_poses: false,
            details,
            ..Info::default()
        })?;
        let mut source = Self {
            conventions: Vec::new(),
            reader,
            layout,
            info,
        };
        source.conventions = source.gripper_convention()?.into_iter().collect();
        Ok(source)
    }

    /// Several files as one dataset.
    ///
    /// # Errors
    /// A file cannot be read, or differs from the first one.
    pub fn several(files: Files, config: &ArmConfig, cameras: &CamerasAsked) -> Result<Several<Self>, IngestError> {
        let (config, cameras) = (config.clone(), cameras.clone());
        Several::new(files, move |reader| {
            let asked = cameras.of(&reader)?;
            Self::new(reader, &config, asked)
        })
    }

    /// Whether an opened file is one of an arm, or of several: whether the gripper of the first is known, and the settings that choose
    /// it. `None` if it has no arm under known names.
    ///
    /// # Errors
    /// The file needs the HDF5 library but was opened without it.
    pub(super) fn probe(reader: &RobomimicReader) -> Result<Option<(bool, Vec<String>)>, IngestError> {
        let of = |config: &ArmConfig| match ArmLayout::of(&reader.file, reader.demos(), config) {
            Err(fault @ Hdf5Fault::NeedsLibrary) => Err(Fault::from(fault).of(&reader.path)),
            layout => Ok(layout
                .ok()
                .map(|layout| layout.gripper.is_some() || layout.command.is_some())),
        };
        if let Some(gripper) = of(&ArmConfig::default())? {
            return Ok(Some((gripper, Vec::new())));
        }
        for arm in layout::arms() {
            // Which elements of an action are the arm's is not known here.
            let one = ArmConfig {
                arm: Some(arm.to_owned()),
                action_elements: Some([0, 1]),
                ..ArmConfig::default()
            };
            if let Some(gripper) = of(&one)? {
                let more = [
                    format!("ingest.arm.arm = \"{arm}\""),
                    "ingest.arm.action_elements (its part of an action)".to_owned(),
                ];
                return Ok(Some((gripper, more.to_vec())));
            }
        }
        Ok(None)
    }

    /// The conventions, each with its evidence.
    pub fn conventions(&self) -> &[Convention] {
        &self.conventions
    }

    /// The reader of the file.
    pub fn reader(&self) -> &RobomimicReader {
        &self.reader
    }

    /// What the numbers of the gripper are, from the demonstrations that are read first.
    fn gripper_convention(&self) -> Result<Option<Convention>, IngestError> {
        let Some(gripper) = self.layout.gripper.as_ref().filter(|gripper| gripper.columns == 2) else {
            return Ok(None);
        };
        let (mut apart, mut frames) = (0.0_f64, 0);
        let mut largest = 0.0_f64;
        for demo in self.reader.demos().iter().take(PROVEN) {
            let path = format!("data/{}/{}", demo.name, gripper.path);
            let values = self
                .reader
                .file
                .locate(&path)
                .and_then(|located| self.reader.file.read(&located));
            let values = match values {
                Ok(values) => values,
                Err(fault @ Hdf5Fault::NeedsLibrary) => return Err(Fault::from(fault).of(&self.reader.path)),
                // The fault is reported when the demonstration is read.
                Err(_) => continue,
            };
            for [a, b] in values.as_chunks::<2>().0 {
                apart = apart.max((a + b).abs());
                largest = largest.max((a - b).abs());
                frames += 1;
            }
        }
        let mirrored = frames > 0 && apart < MIRRORED * largest;
        Ok(Some(Convention {
            convention: "gripper_opening".into(),
            value: if mirrored { "finger_distance" } else { "finger_sum" }.into(),
            basis: "proven".into(),
            evidence: format!(
                "largest sum of the two finger positions, relative to their largest difference: fingers that mirror each other are {}",
                if mirrored {
                    "their difference apart"
                } else {
                    "not recorded here"
                }
            ),
            residual: (largest > 0.0).then(|| apart / largest),
            runner_up: None,
            threshold: Some(MIRRORED),
            unit: "".into(),
            frames,
        }))
    }

    fn mirrored(&self) -> bool {
        self.conventions.iter().any(|row| &*row.value == "finger_distance")
    }

    /// Locates the datasets of a demonstration and checks their shapes. All faults are reported at once.
    fn find(&self, demo: &str) -> Result<Found, Hdf5Fault> {
        let file = &self.reader.file;
        let mut faults = Vec::new();
        let mut locate = |array: &Array| -> Result<Option<Located>, Hdf5Fault> {
            match located(&self.reader, demo, array) {
                Ok(located) => Ok(Some(located)),
                Err(fault) => file.note(&mut faults, fault).map(|()| None),
            }
        };
        let actions = locate(&self.layout.actions)?;
        let mut arrays = Vec::new();
        for (array, role, _) in self.layout.state() {
            arrays.extend(locate(array)?.map(|located| (role, located)));
        }
        let Some(actions) = actions.filter(|_| faults.is_empty()) else {
            return Err(Hdf5Fault::all(faults).unwrap_or(Hdf5Fault::NoData));
        };
        let rows = |located: &Located| located.shape.first().copied().unwrap_or(0);
        let frames = rows(&actions);
        if frames == 0 {
            return Err(Hdf5Fault::NoFrames { object: actions.name });
        }
        let mut skipped = Vec::new();
        let mut optional = |name: &str| -> Result<Option<Located>, Hdf5Fault> {
            let path = format!("data/{demo}/{name}");
            if !file.exists(&path)? {
                return Ok(None);
            }
            let found = match file.locate(&path) {
                Err(fault) if file.is_fatal(&fault) => return Err(fault),
                Ok(found) if rows(&found) == frames && matches!(found.shape[..], [_] | [_, 1]) => Some(found),
                _ => None,
            };
            if found.is_none() {
                skipped.push(format!("dataset {path} does not have one number per frame"));
            }
            Ok(found)
        };
        let (rewards, dones) = (optional("rewards")?, optional("dones")?);
        for (_, other) in &arrays {
            if rows(other) != frames {
                faults.push(Hdf5Fault::Length {
                    objects: vec![other.name.clone()],
                    found: rows(other),
                    other: actions.name.clone(),
                    expected: frames,
                });
            }
        }
        match Hdf5Fault::all(faults) {
            Some(fault) => Err(fault),
            None => Ok(Found {
                frames,
                arrays,
                actions,
                rewards,
                dones,
                skipped,
            }),
        }
    }

    fn read(&self, name: &DemoName, found: Found) -> Result<Episode, Hdf5Fault> {
        let file = &self.reader.file;
        let mut skipped = found.skipped;
        let mut single_precision = Vec::new();
        let all = found.arrays.iter().map(|(_, located)| located).chain([&found.actions]);
        if all.into_iter().any(|located| located.element == Element::F32) {
            single_precision.push("obs");
        }
        let mut faults = Vec::new();
        let mut read = |located: &Located| -> Result<Vec<f64>, Hdf5Fault> {
            let values = file.read(located)?;
            let columns = values.len().checked_div(found.frames).unwrap_or(1).max(1);
            if let Some(at) = values.iter().position(|value| !value.is_finite()) {
                faults.push(Hdf5Fault::NotFinite {
                    object: located.name.clone(),
                    row: at / columns,
                    column: at % columns,
                    value: values[at],
                });
            }
            Ok(values)
        };
        let actions = read(&found.actions)?;
        let mut state = Vec::new();
        for (role, located) in &found.arrays {
            state.push((*role, located.name.as_str(), read(located)?));
        }
        if let Some(fault) = Hdf5Fault::all(faults) {
            return Err(fault);
        }
        let mut optional = |located: &Option<Located>| -> Result<Option<Vec<f64>>, Hdf5Fault> {
            let Some(located) = located else { return Ok(None) };
            let values = file.read(located)?;
            if values.iter().all(|value| value.is_finite()) {
                return Ok(Some(values));
            }
            skipped.push(format!("dataset {} has values that are not finite", located.name));
            Ok(None)
        };
        let (rewards, dones) = (optional(&found.rewards)?, optional(&found.dones)?);
        let frames = self.frames(&state, &actions, found.frames, rewards.as_deref(), dones.as_deref())?;
        Ok(Episode {
            name: name.clone(),
            frames: Frames::Arm(frames),
            states: None,
            model: None,
            goal_errors: None,
            single_precision,
            skipped,
            contradiction: None,
        })
    }

    fn frames(
        &self,
        state: &[(SignalRole, &str, Vec<f64>)],
        actions: &[f64],
        count: usize,
        rewards: Option<&[f64]>,
        dones: Option<&[f64]>,
    ) -> Result<Vec<ArmColumns>, Hdf5Fault> {
        let width = self.layout.actions.columns;
        let row = |values: &[f64], frame: usize| -> Vec<f64> {
            let columns = values.len() / count;
            values[frame * columns..(frame + 1) * columns].to_vec()
        };
        let of = |role: SignalRole, frame: usize| {
            let found = state.iter().find(|(other, ..)| *other == role);
            found.map(|(_, name, values)| (*name, row(values, frame)))
        };
        (0..count)
            .map(|frame| {
                let action = &actions[frame * width..(frame + 1) * width];
                let action = action[self.layout.elements.clone()].to_vec();
                let orientation = of(SignalRole::EefOrientation, frame);
                let eef = of(SignalRole::EefPosition, frame).map(|(_, at)| Vector3::from_column_slice(&at[..3]));
                Ok(ArmColumns {
                    time: None,
                    state: state.iter().flat_map(|(_, _, values)| row(values, frame)).collect(),
                    eef,
                    eef_orientation: orientation
                        .map(|(name, numbers)| quaternion(name, frame, &numbers))
                        .transpose()?,
                    opening: of(SignalRole::Gripper, frame).and_then(|(_, fingers)| self.opening(&fingers)),
                    gripper: self.layout.command.and_then(|at| action.get(at).copied()),
                    action,
                    reward: rewards.and_then(|rewards| rewards.get(frame).copied()),
                    done: dones.and_then(|dones| dones.get(frame)).map(|done| *done != 0.0),
                })
            })
            .collect()
    }

    /// The opening from the recorded numbers of the gripper: the distance between mirrored fingers, the sum of two others, else the
    /// first number.
    fn opening(&self, fingers: &[f64]) -> Option<f64> {
        match fingers {
            [a, b] if self.mirrored() => Some((a - b).abs()),
            [a, b] => Some(a + b),
            numbers => numbers.first().copied(),
        }
    }
}

/// Number of demonstrations from which the form of the gripper's numbers is proven.
const PROVEN: usize = 10;

/// Two fingers mirror each other if their positions sum to less than this fraction of their largest difference. In simulation, the
/// fingers of robosuite's gripper differ by up to 5 % while they push against something.
const MIRRORED: f64 = 0.25;

fn located(reader: &RobomimicReader, demo: &str, array: &Array) -> Result<Located, Hdf5Fault> {
    let path = format!("data/{demo}/{}", array.path);
    if !reader.file.exists(&path)? {
        return Err(Hdf5Fault::Missing {
            objects: vec![path],
            fix: "restore it, or leave the demonstration out with a filter key or ingest.select",
        });
    }
    let located = reader.file.locate(&path)?;
    let fits = match located.shape[..] {
        [_] => array.columns == 1,
        [_, columns] => columns == array.columns,
        _ => false,
    };
    if fits {
        return Ok(located);
    }
    Err(Hdf5Fault::Shape {
        object: located.name,
        found: located.shape,
        expected: format!("(N, {}), as in the first demonstration,", array.columns),
        fix: "leave the demonstration out with a filter key or ingest.select",
    })
}

/// The orientation from a quaternion (x, y, z, w) or a rotation vector.
fn quaternion(dataset: &str, frame: usize, numbers: &[f64]) -> Result<UnitQuaternion<f64>, Hdf5Fault> {
    match *numbers {
        [x, y, z] => Ok(UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z))),
        [x, y, z, w] => {
            let quaternion = Quaternion::new(w, x, y, z);
            let length = quaternion.norm();
            if (length - 1.0).abs() <= UNIT {
                return Ok(UnitQuaternion::new_unchecked(quaternion));
            }
            Err(Hdf5Fault::Other(format!(
                "dataset {dataset} has a quaternion of length {length:.4} in row {frame}; repair it, or leave the demonstration out"
            )))
        }
        _ => Err(Hdf5Fault::Other(format!(
            "dataset {dataset} is no orientation; name another one as ingest.arm.eef_orientation"
        ))),
    }
}

impl DemoSource for ArmSource {
    fn probe(path: &std::path::Path) -> bool {
        super::RobomimicSource::probe(path)
    }

    fn info(&self) -> &Info {
        &self.info
    }

    fn signals(&self) -> &[SignalRow] {
        &self.layout.signals
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
        self.reader.for_each_found(
            range,
            |demo| self.find(demo),
            |place, found| {
                let name = &demos[place];
                let read = found.and_then(|found| self.read(name, found));
                let read = match self.reader.left_out(&name.name, read)? {
                    Ok(episode) => {
                        let checked =
                            self.reader
                                .check_cameras(&name.name, episode.frames.count(), &self.info.cameras)?;
                        checked.map(|()| episode)
                    }
                    Err(left) => Err(left),
                };
                Ok(read)
            },
            take,
        )
    }

    fn images<E: From<IngestError>>(
        &self,
        camera: &str,
        of: &[(DemoName, usize)],
        take: impl FnMut(Result<ImageBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        self.reader.for_each_block(camera, of, false, take)
    }

    fn warnings(&self, tally: &Tally) -> Result<Vec<Warning>, IngestError> {
        let mut warnings = self.own_warnings();
        match tally.left_out_warning(self.demos().len()) {
            Some(left_out) => warnings.push(left_out),
            None => warnings.extend(self.reader.total_warning(tally.frames as u64)?),
        }
        warnings.extend(tally.warnings());
        Ok(warnings)
    }

    fn unchanged(&self) -> Result<(), IngestError> {
        self.reader.sources().unchanged()
    }
}

impl FileSource for ArmSource {
    fn reader(&self) -> &RobomimicReader {
        &self.reader
    }

    fn same(&self) -> Vec<(String, String)> {
        let names: Vec<&str> = self.layout.signals.iter().map(|signal| signal.name.as_str()).collect();
        let convention = self
            .conventions
            .iter()
            .map(|row| row.value.to_string())
            .collect::<Vec<_>>();
        vec![
            ("recorded numbers".to_owned(), names.join(", ")),
            ("opening of the gripper".to_owned(), convention.join(", ")),
        ]
    }

    fn contradiction(&self) -> Result<Option<String>, IngestError> {
        Ok(None)
    }

    fn general_warnings(&self) -> Result<Vec<Warning>, IngestError> {
        Ok(Vec::new())
    }

    fn own_warnings(&self) -> Vec<Warning> {
        let unused = WarningCode::UnusedObservations;
        let own = self.reader.warnings().iter().filter(|warning| warning.code != unused);
        own.cloned().collect()
    }
}
