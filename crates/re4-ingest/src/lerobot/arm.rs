//! The vectors of an arm: which features they are, what their elements are, and the columns that are derived from them.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use re4_artifact::Label;
use re4_lerobot::{Content, Dataset, Feature, Frames, Info, LerobotError};

use super::keys::{LerobotKeys, Wanted, width};
use super::opened::error_of;
use super::roles::{Orientation, arm_of, roles};
use crate::describe::Description;
use crate::error::{Fault, IngestError};
use crate::source::Stop;
use crate::tables::{ArmColumns, Convention, SignalRole, SignalRow, SignalVector};

/// Demonstrations from which the form of the gripper's numbers is proven.
const PROVEN: usize = 10;

/// Two fingers mirror each other if their positions sum to less than this fraction of their largest difference. In simulation, the
/// fingers of robosuite's gripper differ by up to 5 % while they push against something.
const MIRRORED: f64 = 0.25;

/// Largest deviation of the length of a quaternion from 1: that of numbers in single precision, with a margin.
const UNIT: f64 = 1e-3;

/// An element of a vector.
#[derive(Debug, Clone, PartialEq)]
struct Element {
    /// Its feature.
    feature: String,
    /// Its place in a frame of the feature, and the number of values of such a frame.
    place: usize,
    width: usize,
    name: String,
    role: SignalRole,
    basis: &'static str,
}

/// Which elements of which features are read.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ArmLayout {
    state: Vec<Element>,
    action: Vec<Element>,
    /// Places in the state of x, y and z of the end effector.
    eef: Option<[usize; 3]>,
    /// Places in the state of its orientation.
    orientation: Option<(Vec<usize>, Orientation)>,
    /// Places in the state of the gripper, one or two.
    gripper: Vec<usize>,
    /// Place in the action of the gripper command.
    command: Option<usize>,
    reward: Option<String>,
    done: Option<String>,
    /// Whether two fingers mirror each other.
    mirrored: bool,
}

impl ArmLayout {
    /// Chooses the elements.
    ///
    /// # Errors
    /// There is no state or action, there are two arms, or a setting names what is not there.
    pub(super) fn of(info: &Info, keys: &LerobotKeys) -> Result<Self, Fault> {
        keys.check(false)?;
        let state = vector(
            info,
            "state",
            keys.state.as_deref(),
            &["observation.state"],
            "observation.",
        )?;
        let action = vector(
            info,
            "action",
            keys.action.as_deref(),
            &["action", "actions"],
            "action.",
        )?;
        let mut layout = Self {
            state: one_arm(state, keys)?,
            action: one_arm(action, keys)?,
            eef: None,
            orientation: None,
            gripper: Vec::new(),
            command: None,
            reward: None,
            done: None,
            mirrored: false,
        };
        let reward = Wanted {
            setting: "reward",
            given: keys.reward.as_deref(),
            default: "next.reward",
        };
        let scalar = |feature: &&Feature| width(feature) == 1;
        layout.reward = reward
            .optional(info)?
            .filter(scalar)
            .map(|feature| feature.name.clone());
        let done = info
            .feature("next.done")
            .filter(|feature| feature.content == Content::Numbers);
        layout.done = done.filter(scalar).map(|feature| feature.name.clone());
        layout.choose_gripper(keys)?;
        layout.choose_command(keys)?;
        let places = |role| {
            let of_role = layout
                .state
                .iter()
                .enumerate()
                .filter(move |(_, element)| element.role == role);
            of_role.map(|(place, _)| place).collect::<Vec<usize>>()
        };
        layout.eef = places(SignalRole::EefPosition).try_into().ok();
        let orientation = places(SignalRole::EefOrientation);
        let names: Vec<String> = orientation
            .iter()
            .map(|&place| layout.state[place].name.clone())
            .collect();
        layout.orientation = Orientation::of(&names).map(|form| (orientation, form));
        Ok(layout)
    }

    /// Chooses the elements of the first of several arms; returns its name, too. `None` if no names of elements begin with that of an
    /// arm, or its elements cannot be chosen.
    pub(super) fn of_first_arm(info: &Info, keys: &LerobotKeys) -> Option<(String, Self)> {
        let names = info.features.iter().flat_map(|feature| &feature.names);
        let arm = names.filter_map(|name| arm_of(name)).min()?;
        let keys = LerobotKeys {
            arm: Some(arm.clone()),
            ..keys.clone()
        };
        Some((arm, Self::of(info, &keys).ok()?))
    }

    fn choose_gripper(&mut self, keys: &LerobotKeys) -> Result<(), Fault> {
        let Some(names) = &keys.gripper else {
            let of_role = |(place, element): (usize, &Element)| (element.role == SignalRole::Gripper).then_some(place);
            self.gripper = self.state.iter().enumerate().filter_map(of_role).collect();
            // Of more than two, which ones measure the opening is not known.
            self.gripper.truncate(if self.gripper.len() > 2 { 0 } else { 2 });
            return Ok(());
        };
        if !(1..=2).contains(&names.len()) {
            return Err(Fault::Lerobot(format!(
                "ingest.lerobot.gripper names {} elements; name the one that measures the opening, or those of the two fingers",
                names.len()
            )));
        }
        for element in &mut self.state {
            if element.role == SignalRole::Gripper {
                element.role = SignalRole::Other;
            }
        }
        self.gripper.clear();
        for name in names {
            let place = named(&self.state, name, "gripper", "state")?;
            self.state[place].role = SignalRole::Gripper;
            self.state[place].basis = "setting";
            self.gripper.push(place);
        }
        Ok(())
    }

    fn choose_command(&mut self, keys: &LerobotKeys) -> Result<(), Fault> {
        if let Some(name) = &keys.gripper_command {
            let place = named(&self.action, name, "gripper_command", "action")?;
            for element in &mut self.action {
                if element.role == SignalRole::Gripper {
                    element.role = SignalRole::Other;
                }
            }
            self.action[place].role = SignalRole::Gripper;
            self.action[place].basis = "setting";
            self.command = Some(place);
            return Ok(());
        }
        let grippers: Vec<usize> = (0..self.action.len())
            .filter(|&place| self.action[place].role == SignalRole::Gripper)
            .collect();
        match grippers.as_slice() {
            [only] => self.command = Some(*only),
            [] => self.choose_command_by_count(),
            // Which of several commands the gripper is not known.
            _ => {}
        }
        Ok(())
    }

    /// Without names, an action of four or seven elements of an arm whose state has the position of the end effector moves it: three
    /// numbers of its position, three of its rotation, and the gripper.
    fn choose_command_by_count(&mut self) {
        let position = self
            .state
            .iter()
            .filter(|element| element.role == SignalRole::EefPosition)
            .count();
        let unnamed = self.action.iter().all(|element| element.role == SignalRole::Other);
        let count = self.action.len();
        if position != 3 || !unnamed || ![4, 7].contains(&count) {
            return;
        }
        for (place, element) in self.action.iter_mut().enumerate() {
            element.role = match place {
                0..3 => SignalRole::EefPosition,
                last if last + 1 == count => SignalRole::Gripper,
                _ => SignalRole::EefOrientation,
            };
            element.basis = "count";
        }
        self.command = Some(count - 1);
    }

    /// Whether the gripper is known.
    pub(super) fn has_gripper(&self) -> bool {
        !self.gripper.is_empty() || self.command.is_some()
    }

    /// Adds which elements were found.
    pub(super) fn describe(&self, about: &mut Description) {
        let listed = |elements: &[Element], role: SignalRole| {
            let of_role = elements.iter().filter(|element| element.role == role);
            of_role
                .map(|element| element.name.as_str())
                .collect::<Vec<_>>()
                .join(", ")
        };
        let found = [
            ("joints", listed(&self.state, SignalRole::Joint)),
            ("position", listed(&self.state, SignalRole::EefPosition)),
            ("rotation", listed(&self.state, SignalRole::EefOrientation)),
            ("gripper", listed(&self.state, SignalRole::Gripper)),
            (
                "command",
                self.command
                    .map_or_else(String::new, |place| self.action[place].name.clone()),
            ),
        ];
        for (name, value) in found.into_iter().filter(|(_, value)| !value.is_empty()) {
            about.fact(name, value);
        }
    }

    /// The rows of table `signals`.
    pub(super) fn signals(&self) -> Vec<SignalRow> {
        let of = |vector: SignalVector, elements: &[Element]| -> Vec<SignalRow> {
            (0..)
                .zip(elements)
                .map(|(index, element)| SignalRow {
                    vector,
                    index,
                    name: element.name.clone(),
                    role: element.role,
                    unit: None,
                    basis: element.basis.into(),
                })
                .collect()
        };
        let mut signals = of(SignalVector::State, &self.state);
        signals.extend(of(SignalVector::Action, &self.action));
        signals
    }

    /// Proves from the first episodes whether two fingers mirror each other.
    ///
    /// # Errors
    /// A stop.
    pub(super) fn learn(
        &mut self,
        dataset: &Dataset,
        chosen: &[usize],
        stop: Stop<'_>,
    ) -> Result<Option<Convention>, IngestError> {
        let &[first, second] = self.gripper.as_slice() else {
            return Ok(None);
        };
        let (mut apart, mut largest, mut frames) = (0.0_f64, 0.0_f64, 0);
        let read = dataset.read(chosen.iter().copied().take(PROVEN), stop, |_, read| {
            // Faults of an episode are reported when it is read.
            let Ok(read) = read else {
                return Ok::<(), LerobotError>(());
            };
            for frame in 0..read.timestamps.len() {
                let finger = |place: usize| self.state[place].value(&read, frame);
                let (a, b) = (finger(first), finger(second));
                apart = apart.max((a + b).abs());
                largest = largest.max((a - b).abs());
                frames += 1;
            }
            Ok(())
        });
        read.map_err(error_of)?;
        self.mirrored = frames > 0 && apart < MIRRORED * largest;
        let (value, evidence): (Label, &str) = if self.mirrored {
            (
                "finger_distance".into(),
                "fingers that mirror each other are their difference apart",
            )
        } else {
            (
                "finger_sum".into(),
                "fingers that mirror each other are not recorded here",
            )
        };
        Ok(Some(Convention {
            convention: "gripper_opening".into(),
            value,
            basis: "proven".into(),
            evidence: format!(
                "largest sum of the two finger positions, relative to their largest difference: {evidence}"
            ),
            residual: (largest > 0.0).then(|| apart / largest),
            runner_up: None,
            threshold: Some(MIRRORED),
            unit: "1".into(),
            frames,
        }))
    }

    /// The columns of an episode.
    ///
    /// # Errors
    /// The reason why it cannot be used, with the remedy.
    pub(super) fn columns(&self, read: &Frames) -> Result<Vec<ArmColumns>, String> {
        (0..read.timestamps.len())
            .map(|frame| self.frame(read, frame))
            .collect()
    }

    fn frame(&self, read: &Frames, frame: usize) -> Result<ArmColumns, String> {
        let values = |elements: &[Element]| -> Result<Vec<f64>, String> {
            let value = |element: &Element| {
                let value = element.value(read, frame);
                if value.is_finite() {
                    return Ok(value);
                }
                Err(format!(
                    "column {}: it has {value} at frame {frame}, element {} ({}); repair that frame, or leave that episode out",
                    element.feature, element.place, element.name
                ))
            };
            elements.iter().map(value).collect()
        };
        let (state, action) = (values(&self.state)?, values(&self.action)?);
        let number = |name: &Option<String>| {
            read.column(name.as_deref()?)?
                .values
                .number(frame)
                .filter(|value| value.is_finite())
        };
        let orientation = match &self.orientation {
            Some((places, form)) => Some(self.rotation(places, *form, &state, frame)?),
            None => None,
        };
        let opening = match self.gripper.as_slice() {
            [] => None,
            [only] => Some(state[*only]),
            [a, b, ..] if self.mirrored => Some((state[*a] - state[*b]).abs()),
            [a, b, ..] => Some(state[*a] + state[*b]),
        };
        Ok(ArmColumns {
            time: read.timestamps.get(frame).copied(),
            eef: self.eef.map(|[x, y, z]| Vector3::new(state[x], state[y], state[z])),
            eef_orientation: orientation,
            opening,
            gripper: self.command.map(|place| action[place]),
            reward: number(&self.reward),
            done: number(&self.done).map(|done| done != 0.0),
            state,
            action,
        })
    }

    fn rotation(
        &self,
        places: &[usize],
        form: Orientation,
        state: &[f64],
        frame: usize,
    ) -> Result<UnitQuaternion<f64>, String> {
        let number = |place: usize| places.get(place).map_or(0.0, |&at| state[at]);
        match form {
            Orientation::Vector => Ok(UnitQuaternion::from_scaled_axis(Vector3::new(
                number(0),
                number(1),
                number(2),
            ))),
            Orientation::Quaternion([x, y, z, w]) => {
                let quaternion = Quaternion::new(number(w), number(x), number(y), number(z));
                let length = quaternion.norm();
                if (length - 1.0).abs() <= UNIT {
                    return Ok(UnitQuaternion::new_unchecked(quaternion));
                }
                let feature = places.first().map_or("", |&at| self.state[at].feature.as_str());
                Err(format!(
                    "column {feature}: the quaternion of frame {frame} has length {length:.4}; repair that frame, or leave that episode out"
                ))
            }
        }
    }
}

impl Element {
    fn value(&self, read: &Frames, frame: usize) -> f64 {
        let column = read.column(&self.feature);
        column
            .and_then(|column| column.values.number(frame * self.width + self.place))
            .unwrap_or(f64::NAN)
    }
}

/// The elements of a vector: those of the feature that a setting names, of the usual one, or of all features with a prefix.
fn vector(
    info: &Info,
    setting: &'static str,
    given: Option<&str>,
    usual: &[&'static str],
    prefix: &str,
) -> Result<Vec<Element>, Fault> {
    let numbers = |name: &str| info.feature(name).filter(|feature| feature.content == Content::Numbers);
    let features: Vec<&Feature> = match (given, usual.iter().find_map(|name| numbers(name))) {
        (None, Some(feature)) => vec![feature],
        (None, None) => info
            .with(Content::Numbers)
            .filter(|feature| feature.name.starts_with(prefix))
            .collect(),
        (Some(_), _) => Vec::new(),
    };
    let features = if features.is_empty() {
        let default = usual.first().copied().unwrap_or_default();
        vec![
            Wanted {
                setting,
                given,
                default,
            }
            .required(info)?,
        ]
    } else {
        features
    };
    let mut elements = Vec::new();
    for feature in features {
        let count = width(feature);
        for place in 0..count {
            let name = match feature.names.get(place) {
                Some(name) => name.clone(),
                None if count == 1 => feature.name.clone(),
                None => format!("{}_{place}", feature.name),
            };
            elements.push(Element {
                feature: feature.name.clone(),
                place,
                width: count,
                name,
                role: SignalRole::Other,
                basis: "name",
            });
        }
    }
    // Elements of several features also have the names of these, such as observation.gripper.0.
    let plain = elements.windows(2).all(|pair| pair[0].feature == pair[1].feature);
    let names: Vec<String> = elements
        .iter()
        .map(|element| {
            if plain || element.name.starts_with(&element.feature) {
                element.name.clone()
            } else {
                format!("{}.{}", element.feature, element.name)
            }
        })
        .collect();
    for ((element, role), name) in elements.iter_mut().zip(roles(&names)).zip(names) {
        element.role = role;
        element.name = name;
    }
    Ok(elements)
}

/// The elements of one arm.
fn one_arm(elements: Vec<Element>, keys: &LerobotKeys) -> Result<Vec<Element>, Fault> {
    let mut arms: Vec<String> = elements.iter().filter_map(|element| arm_of(&element.name)).collect();
    arms.sort();
    arms.dedup();
    let list = arms.join(", ");
    match &keys.arm {
        None if arms.len() > 1 => Err(Fault::Lerobot(format!(
            "meta/info.json: the elements of {} are those of several arms ({list}); set ingest.lerobot.arm to one of them",
            elements.first().map_or("a vector", |element| element.feature.as_str())
        ))),
        None => Ok(elements),
        Some(arm) if arms.contains(arm) => Ok(elements
            .into_iter()
            .filter(|element| arm_of(&element.name).as_ref() == Some(arm))
            .collect()),
        Some(arm) => Err(Fault::Lerobot(format!(
            "meta/info.json: no names of {} begin with {arm}; set ingest.lerobot.arm to one of the arms ({}), or remove it",
            elements.first().map_or("a vector", |element| element.feature.as_str()),
            if arms.is_empty() {
                "no names begin with that of an arm"
            } else {
                &list
            }
        ))),
    }
}

/// The place of the element with a name.
fn named(elements: &[Element], name: &str, setting: &str, vector: &str) -> Result<usize, Fault> {
    elements.iter().position(|element| element.name == name).ok_or_else(|| {
        let names: Vec<&str> = elements.iter().map(|element| element.name.as_str()).take(20).collect();
        Fault::Lerobot(format!(
            "meta/info.json: no element of the {vector} is called {name}; set ingest.lerobot.{setting} to its name ({})",
            names.join(", ")
        ))
    })
}
