//! LIBERO's files: one task a file, whose object and goal are in a task file (BDDL) in the attributes of `/data`.
//!
//! Each row of `obs` was made after the action of that row, while `states` are those before it. End effector, fingers and objects are
//! therefore computed from `states` and `model_file`. Source: LIBERO's `scripts/create_dataset.py`.

use nalgebra::{Isometry3, Vector3};
use re4_robosuite::env_args::EnvArgs;

use super::super::demo::Demo;
use super::super::fault::Hdf5Fault;
use super::super::interpret::{Prepared, Reading};
use super::super::reader::RobomimicReader;
use super::bddl::{self, Predicate};
use super::evidence::{CLOSE, Fit, declared, proven};
use crate::tables::Convention;

/// Attribute of `/data` that states in which direction the rows of images run. Only LIBERO's files have it.
const IMAGE_CONVENTION: &str = "macros_image_convention";
const BDDL: &str = "bddl_file_content";

/// The task of a file.
pub(super) struct Task {
    /// What the task file says, if the file has one.
    bddl: Option<bddl::Task>,
}

impl Task {
    /// The task of a LIBERO file; `None` for other files.
    pub(super) fn of(reader: &RobomimicReader, env: &EnvArgs) -> Result<Option<Self>, Hdf5Fault> {
        let text = reader.data_text(BDDL)?;
        if text.is_none() && !env.env_name.to_ascii_lowercase().starts_with("libero") {
            return Ok(None);
        }
        let bddl = text
            .map(|text| bddl::parse(&text))
            .transpose()
            .map_err(|why| Hdf5Fault::Attribute {
                object: "/data".to_owned(),
                attribute: BDDL,
                why: format!("is not a task file of LIBERO: {why}"),
                fix: "restore it from LIBERO's folder bddl_files".to_owned(),
            })?;
        Ok(Some(Self { bddl }))
    }

    fn goals(&self) -> &[Predicate] {
        self.bddl.as_ref().map_or(&[], |bddl| &bddl.goals)
    }

    /// The goal, if the task is to place one object.
    fn placement(&self) -> Option<(&str, &str)> {
        match self.goals() {
            [only] => only.placement(),
            _ => None,
        }
    }

    /// Refuses a task of another kind unless a setting names an object; returns a warning if one does, or if the task file disagrees
    /// with itself.
    pub(super) fn check(&self, reading: &Reading) -> Result<Option<String>, Hdf5Fault> {
        let Some(bddl) = &self.bddl else { return Ok(None) };
        if let Some((object, _)) = self.placement() {
            let first = bddl.of_interest.first();
            return Ok(first.filter(|first| *first != object && reading.object.is_none()).map(|first| {
                format!(
                    "the goal in attribute {BDDL} places {object}, but its first object of interest is {first}; {object} is followed, and ingest.object chooses another one"
                )
            }));
        }
        let goals: Vec<String> = bddl.goals.iter().map(ToString::to_string).collect();
        let kind = if bddl.goals.len() > 1 {
            "has several goals"
        } else {
            "does not place an object"
        };
        let what = format!("its task {kind}: {}", goals.join(" and "));
        if let Some(object) = &reading.object {
            return Ok(Some(format!(
                "{what}; only {object} is followed, so motions of other objects, doors and drawers are in mode transit"
            )));
        }
        let placed = bddl
            .goals
            .iter()
            .filter_map(|goal| Some(goal.placement()?.0.to_owned()));
        let mut candidates: Vec<String> = placed.chain(bddl.of_interest.iter().cloned()).collect();
        let mut seen = std::collections::BTreeSet::new();
        candidates.retain(|name| seen.insert(name.clone()));
        Err(Hdf5Fault::Other(format!(
            "{what}, but only one object that is placed in or on another one is followed; set ingest.object to the object to follow{}",
            if candidates.is_empty() {
                String::new()
            } else {
                format!(", such as {}", candidates.join(" or "))
            }
        )))
    }

    /// The moved object.
    pub(super) fn object(&self) -> Option<String> {
        self.placement().map(|(object, _)| object.to_owned())
    }

    /// The object that the moved one is placed on or in. Regions are named after their object: `basket_1_contain_region`.
    pub(super) fn target(&self) -> Option<String> {
        let (_, region) = self.placement()?;
        let bddl = self.bddl.as_ref()?;
        let owner = bddl.of_interest.iter().filter(|name| region.starts_with(name.as_str()));
        let owner = owner.max_by_key(|name| name.len());
        Some(owner.cloned().unwrap_or_else(|| region.to_owned()))
    }
}

/// Distance (metres) that the end effector must move in a step to tell the state before it from the one after it.
const MOVES: f64 = 2e-3;
/// Minimum number of such steps.
const STEPS: usize = 20;
/// Minimum factor between the residuals of the two hypotheses.
const BETTER: f64 = 4.0;

/// Median distance (metres) beyond which observations are of other states. LIBERO replays actions to make observations, which ends
/// millimetres apart after contacts.
const APART: f64 = 0.05;

const AFTER: &str = "after_action";
const BEFORE: &str = "before_action";
const EVIDENCE: &str = "distance of obs/ee_pos from the end effector that states and model_file give for the next row (after_action) or the same row";

/// Proves whether observations were made before or after the action of their row. Also returns whether they are late.
pub(super) fn prove(first: &[Prepared]) -> (bool, Convention) {
    let all = first.iter().filter_map(|prepared| {
        let sites: Vec<Vector3<f64>> = prepared
            .poses
            .eef_position
            .iter()
            .map(|site| Vector3::from(*site))
            .collect();
        Some(residuals(prepared.demo.late_position.as_deref()?, &sites))
    });
    let [after, before] = fits(all);
    let row = if decides(after, before) {
        proven(
            "observation_time",
            AFTER.to_owned(),
            EVIDENCE,
            after,
            Some(before),
            CLOSE,
        )
    } else if decides(before, after) {
        proven(
            "observation_time",
            BEFORE.to_owned(),
            EVIDENCE,
            before,
            Some(after),
            CLOSE,
        )
    } else {
        declared(
            "observation_time",
            AFTER,
            "LIBERO's own script makes observations after the action; obs/ee_pos is missing, or fits the states before and after an action equally",
        )
    };
    (row.value == AFTER, row)
}

/// Distances of the observed positions from the end effector in the next and in the same row, where the two are apart.
fn residuals(observed: &[[f64; 3]], sites: &[Vector3<f64>]) -> Vec<[f64; 2]> {
    let rows = observed.iter().zip(sites.windows(2));
    let moving = rows.filter(|(_, pair)| (pair[1] - pair[0]).norm() >= MOVES);
    let distances = moving.map(|(seen, pair)| [pair[1], pair[0]].map(|site| (Vector3::from(*seen) - site).norm()));
    distances.collect()
}

/// The residuals of both hypotheses: after and before the action.
fn fits(residuals: impl Iterator<Item = Vec<[f64; 2]>>) -> [Fit; 2] {
    let all: Vec<[f64; 2]> = residuals.flatten().collect();
    [0, 1].map(|hypothesis| Fit::of(all.iter().map(|pair| pair[hypothesis])))
}

/// Whether the data decides for the first of two hypotheses.
fn decides(own: Fit, other: Fit) -> bool {
    own.frames >= STEPS && own.median <= CLOSE && other.median >= BETTER * own.median
}

/// Checks the observations of one demonstration; `late` is what is proven for the file.
pub(super) fn check(demo: &Demo, sites: &[Isometry3<f64>], late: bool) -> Result<(), String> {
    let Some(observed) = &demo.late_position else {
        return Ok(());
    };
    let sites: Vec<Vector3<f64>> = sites.iter().map(|site| site.translation.vector).collect();
    let [after, before] = fits(std::iter::once(residuals(observed, &sites)));
    let (own, other) = if late { (after, before) } else { (before, after) };
    if decides(other, own) {
        return Err(format!(
            "obs/ee_pos belongs to the state {} the action of its row, unlike in the other demonstrations",
            if late { "before" } else { "after" }
        ));
    }
    if own.frames >= STEPS && own.median > APART {
        return Err(format!(
            "obs/ee_pos is {:.3} m (median) from the end effector that states and model_file give, so observations, states and model do not belong together",
            own.median
        ));
    }
    Ok(())
}

/// The cameras of a file, which LIBERO names in its own way.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(in crate::robomimic) struct Cameras {
    libero: bool,
    upside_down: bool,
}

/// LIBERO's datasets of images, with robosuite's names of their cameras.
const DATASETS: [(&str, &str); 2] = [
    ("agentview", "agentview_rgb"),
    ("robot0_eye_in_hand", "eye_in_hand_rgb"),
];

impl Cameras {
    /// The cameras of a file with this value of `macros_image_convention`, if it has the attribute.
    pub(in crate::robomimic) fn of(convention: Option<&str>) -> Self {
        Self {
            libero: convention.is_some(),
            // robosuite keeps the order in which OpenGL renders rows, from the bottom up, by default.
            upside_down: convention.is_some_and(|convention| !convention.eq_ignore_ascii_case("opencv")),
        }
    }

    /// The attribute of `/data` to give to [`Self::of`].
    pub(in crate::robomimic) const ATTRIBUTE: &'static str = IMAGE_CONVENTION;

    /// Whether the file names its images as LIBERO does.
    pub(in crate::robomimic) fn are_libero(self) -> bool {
        self.libero
    }

    /// Whether rows of images run from the bottom up.
    pub(in crate::robomimic) fn upside_down(self) -> bool {
        self.upside_down
    }

    /// The camera of a dataset of `obs`, if it has images.
    pub(in crate::robomimic) fn camera(self, dataset: &str) -> Option<&str> {
        let own = DATASETS.iter().find(|(_, name)| self.libero && *name == dataset);
        own.map(|(camera, _)| *camera)
            .or_else(|| dataset.strip_suffix("_image"))
    }

    /// The dataset of `obs` with the images of a camera.
    pub(in crate::robomimic) fn dataset(self, camera: &str) -> String {
        let own = DATASETS.iter().find(|(name, _)| self.libero && *name == camera);
        own.map_or_else(|| format!("{camera}_image"), |(_, dataset)| (*dataset).to_owned())
    }
}
