//! `MimicGen`'s files: which object a task moves, and the proof of the poses in `datagen_info`.

use std::collections::BTreeSet;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use re4_robosuite::actions::{Action, Osc};
use re4_robosuite::hand_from_site;
use re4_robosuite::kinematics::Model;

use super::super::demo::Demo;
use super::super::fault::Hdf5Fault;
use super::super::interpret::Reading;
use super::datagen::Datagen;
use super::evidence::{CLOSE, Fit, difference, proven};
use crate::tables::Convention;

/// A task of `MimicGen`, by the names in `datagen_info/object_poses`. Source: `MimicGen`'s `env_interfaces/robosuite.py`.
struct Record {
    /// Name of the scene: `Square` for `Square_D0`.
    scene: &'static str,
    /// The objects that the robot grasps, in their order.
    moved: &'static [&'static str],
    /// Where the only one of them goes.
    target: Option<&'static str>,
    /// What the robot does besides.
    besides: Option<&'static str>,
}

const fn one(scene: &'static str, moved: &'static [&'static str], target: &'static str) -> Record {
    Record {
        scene,
        moved,
        target: Some(target),
        besides: None,
    }
}

const fn several(scene: &'static str, moved: &'static [&'static str]) -> Record {
    Record {
        scene,
        moved,
        target: None,
        besides: None,
    }
}

static RECORDS: [Record; 13] = [
    one("Square", &["square_nut"], "square_peg"),
    one("Threading", &["needle"], "tripod"),
    Record {
        besides: Some("pushes the lid of the machine"),
        ..one("Coffee", &["coffee_pod"], "coffee_machine")
    },
    one("Stack", &["cubeA"], "cubeB"),
    Record {
        besides: Some("opens and closes a drawer"),
        ..one("MugCleanup", &["object"], "drawer")
    },
    Record {
        besides: Some("opens and closes a drawer"),
        ..one("HammerCleanup", &["hammer"], "drawer")
    },
    several("StackThree", &["cubeA", "cubeC"]),
    several("ThreePieceAssembly", &["piece_1", "piece_2"]),
    several("NutAssembly", &["square_nut", "round_nut"]),
    several("PickPlace", &["milk", "cereal", "bread", "can"]),
    several("Kitchen", &["pot", "bread"]),
    several("CoffeePreparation", &["mug", "coffee_pod"]),
    // robosuite's name of the scene `Square`.
    one("NutAssemblySquare", &["square_nut"], "square_peg"),
];

/// The scene of an environment of `MimicGen`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Scene {
    /// Index of its record; `None` for a scene without one.
    record: Option<usize>,
}

impl Scene {
    /// The scene of an environment, by its name (`Square_D0`, `MugCleanup_O1`), or because the file has poses of objects in
    /// `datagen_info`. `None` for other files.
    pub(super) fn of(environment: &str, has_poses: bool) -> Option<Self> {
        let variant = environment.rsplit_once('_').filter(|(_, ending)| {
            let digits = ending.strip_prefix(['D', 'O']).unwrap_or_default();
            !digits.is_empty() && digits.bytes().all(|digit| digit.is_ascii_digit())
        });
        if variant.is_none() && !has_poses {
            return None;
        }
        let (scene, _) = variant.unwrap_or((environment, ""));
        Some(Self {
            record: RECORDS.iter().position(|record| record.scene == scene),
        })
    }

    fn record(&self) -> Option<&'static Record> {
        RECORDS.get(self.record?)
    }

    /// The object that the task moves, if it is one.
    pub(super) fn object(&self) -> Option<&'static str> {
        match self.record()?.moved {
            [only] => Some(only),
            _ => None,
        }
    }

    /// Where the only object goes.
    pub(super) fn target(&self) -> Option<&'static str> {
        self.record()?.target
    }

    /// Refuses a scene with several objects unless a setting names one, and returns warnings about what is not followed.
    pub(super) fn check(&self, environment: &str, reading: &Reading) -> Result<Option<String>, Hdf5Fault> {
        let Some(record) = self.record() else { return Ok(None) };
        if let Some(does) = record.besides {
            return Ok(Some(format!(
                "in environment {environment} the robot also {does}, which is not followed: these frames are in mode transit"
            )));
        }
        if record.moved.len() < 2 {
            return Ok(None);
        }
        let objects = record.moved.join(", ");
        match &reading.object {
            Some(object) => Ok(Some(format!(
                "environment {environment} moves several objects ({objects}), but only {object} is followed: frames in which the gripper holds another one are in mode transfer all the same; restrict the demonstrations to its frames before they are used for a policy"
            ))),
            None => Err(Hdf5Fault::Other(format!(
                "environment {environment} moves several objects one after another ({objects}), but a demonstration has one manipulated object; set task = \"robosuite\" and ingest.object to one of them"
            ))),
        }
    }
}

/// The free body whose poses are those of a name in `datagen_info/object_poses`, in the first demonstration that has both.
pub(super) fn body_of(name: &str, model: &Model, demos: &[Result<Demo, Hdf5Fault>]) -> Option<String> {
    demos.iter().flatten().find_map(|demo| {
        let poses = demo.datagen.as_ref()?.object(name)?;
        let states = demo.states.as_ref()?;
        let fits = model.free_bodies().filter_map(|(_, body)| {
            let rows = states.values.chunks_exact(states.columns);
            let known = model.body_poses(body, rows).ok().flatten()?;
            let residuals = known.iter().zip(poses).map(|(known, pose)| difference(known, pose));
            Some((body, Fit::of(residuals)))
        });
        let (body, fit) = fits.min_by(|a, b| a.1.high.total_cmp(&b.1.high))?;
        (fit.high <= CLOSE).then(|| body.to_owned())
    })
}

/// What is proven of the poses in `datagen_info`.
#[derive(Debug, Clone, Default)]
pub(super) struct Proven {
    /// The name of the manipulated object in `object_poses`.
    pub(super) follows: Option<String>,
    /// Whether `eef_pose` is the pose of the end effector.
    pub(super) eef: bool,
    /// Whether `target_pose` has the goals of the actions.
    pub(super) targets: bool,
    pub(super) rows: Vec<Convention>,
    pub(super) warnings: Vec<String>,
}

/// The tables' poses of a demonstration, with what `datagen_info` says.
pub(in crate::robomimic) struct Checked<'a> {
    pub(in crate::robomimic) datagen: Option<&'a Datagen>,
    /// Poses of the grip site.
    pub(in crate::robomimic) sites: &'a [Isometry3<f64>],
    /// Poses of the object: position, then quaternion x, y, z, w; `None` if `datagen_info` is their only source.
    pub(in crate::robomimic) object: Option<&'a [[f64; 7]]>,
    /// Deltas in the controller's unit and world axes, if the recorded actions are deltas.
    pub(in crate::robomimic) deltas: Option<&'a [Action]>,
    /// Recorded gripper commands.
    pub(in crate::robomimic) recorded: &'a [Action],
    pub(in crate::robomimic) osc: &'a Osc,
}

/// The pose of a row of object poses.
pub(super) fn pose_of(&[x, y, z, qx, qy, qz, qw]: &[f64; 7]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::new_normalize(nalgebra::Quaternion::new(qw, qx, qy, qz));
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}

/// Where a delta asks the grip site to go. `MimicGen` applies a rotation of zero to the current orientation.
fn target_of(osc: &Osc, delta: &Action, site: &Isometry3<f64>) -> Isometry3<f64> {
    let [x, y, z, rx, ry, rz] = osc.motion(delta);
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz)) * site.rotation;
    Isometry3::from_parts(
        Translation3::from(site.translation.vector + Vector3::new(x, y, z)),
        rotation,
    )
}

/// The hand body of a grip site, at the place of the site as in observations.
fn hand_of(site: &Isometry3<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(site.translation, site.rotation * hand_from_site().inverse())
}

/// A demonstration with `datagen_info`.
type Both<'a> = (&'a Checked<'a>, &'a Datagen);

/// Proves the poses in `datagen_info` from the first demonstrations.
pub(super) fn prove(views: &[Checked<'_>]) -> Result<Proven, Hdf5Fault> {
    let both: Vec<Both<'_>> = views.iter().filter_map(|view| Some((view, view.datagen?))).collect();
    let mut found = Proven::default();
    // Poses that no column depends on are not used if they contradict the others.
    let needed = views.iter().any(|view| view.object.is_none());
    match prove_eef(&both) {
        Ok(row) => {
            found.eef = row.is_some();
            found.rows.extend(row);
        }
        Err(what) if needed => return Err(refused(&what)),
        Err(what) => found.warnings.push(format!("{what}; it is not used")),
    }
    match prove_object(&both) {
        Ok(proven) => {
            let (name, row) = proven.unzip();
            found.follows = name;
            found.rows.extend(row);
        }
        Err(what) => found.warnings.push(format!("{what}; they are not used")),
    }
    let residuals = both.iter().filter_map(|(view, datagen)| {
        let rows = view.deltas?.iter().zip(view.sites).zip(datagen.target.as_ref()?);
        Some(Fit::of(rows.map(|((delta, site), target)| {
            difference(&target_of(view.osc, delta, site), target)
        })))
    });
    let fit = Fit::of_demos(residuals);
    if fit.frames > 0 && fit.high > CLOSE {
        found.warnings.push(format!(
            "the targets in datagen_info/target_pose differ from those of the delta actions by {:.2e} m or rad (99th percentile); the actions are used",
            fit.high
        ));
    } else if fit.frames > 0 {
        found.targets = true;
        let evidence = "difference of datagen_info/target_pose from the goals that delta actions and end effector give";
        let value = "goals of the actions".to_owned();
        found
            .rows
            .push(proven("datagen_target_pose", value, evidence, fit, None, CLOSE));
    }
    Ok(found)
}

fn refused(what: &str) -> Hdf5Fault {
    Hdf5Fault::Other(format!(
        "{what}; restore it, since the poses of the object in that group are in the same frame"
    ))
}

/// Proves which frame `eef_pose` is.
fn prove_eef(both: &[Both<'_>]) -> Result<Option<Convention>, String> {
    let fit = |frame: fn(&Isometry3<f64>) -> Isometry3<f64>| {
        let demos = both.iter().filter_map(|(view, datagen)| {
            let pairs = view.sites.iter().zip(datagen.eef.as_ref()?);
            Some(Fit::of(pairs.map(|(site, eef)| difference(&frame(site), eef))))
        });
        Fit::of_demos(demos)
    };
    let mut fits = [("grip_site", fit(|site| *site)), ("hand_body", fit(hand_of))];
    fits.sort_by(|a, b| a.1.high.total_cmp(&b.1.high));
    let [(value, own), (_, rival)] = fits;
    if own.frames == 0 {
        return Ok(None);
    }
    if own.high > CLOSE {
        return Err(format!(
            "datagen_info/eef_pose is neither the pose of the grip site nor that of the hand: it differs from the closer one by {:.2e} m or rad (99th percentile)",
            own.high
        ));
    }
    let evidence = "difference of datagen_info/eef_pose from the grip site (grip_site) and from the hand body (hand_body) of the tables";
    Ok(Some(proven(
        "datagen_eef_pose",
        value.to_owned(),
        evidence,
        own,
        Some(rival),
        CLOSE,
    )))
}

/// Proves which name in `object_poses` has the poses of the manipulated object.
fn prove_object(both: &[Both<'_>]) -> Result<Option<(String, Convention)>, String> {
    let names = both
        .iter()
        .flat_map(|(_, datagen)| datagen.objects.iter().map(|(name, _)| name.as_str()));
    let names: BTreeSet<&str> = names.collect();
    let fit = |name: &str| {
        let demos = both.iter().filter_map(|(view, datagen)| {
            let pairs = view.object?.iter().zip(datagen.object(name)?);
            Some(Fit::of(pairs.map(|(known, pose)| difference(&pose_of(known), pose))))
        });
        Fit::of_demos(demos)
    };
    let mut fits: Vec<(&str, Fit)> = names.into_iter().map(|name| (name, fit(name))).collect();
    fits.sort_by(|a, b| a.1.high.total_cmp(&b.1.high));
    let Some((name, own)) = fits.first().copied().filter(|(_, own)| own.frames > 0) else {
        return Ok(None);
    };
    if own.high > CLOSE {
        return Err(format!(
            "no poses in datagen_info/object_poses are those of the manipulated object: {name} has the smallest difference, {:.2e} m or rad (99th percentile)",
            own.high
        ));
    }
    let rival = fits.get(1).map(|(_, rival)| *rival);
    let evidence = "difference of the poses in datagen_info/object_poses from those of the manipulated object in observations or states";
    let row = proven("datagen_object", name.to_owned(), evidence, own, rival, CLOSE);
    Ok(Some((name.to_owned(), row)))
}

/// Checks the poses in `datagen_info` of one demonstration; the error says what differs.
pub(super) fn check(view: &Checked<'_>, proven: &Proven) -> Result<(), String> {
    let Some(datagen) = view.datagen else { return Ok(()) };
    let worst = |residuals: &mut dyn Iterator<Item = f64>| {
        residuals
            .enumerate()
            .reduce(|worst, next| if next.1 > worst.1 { next } else { worst })
            .filter(|(_, residual)| *residual > 2.0 * CLOSE)
    };
    if let (true, Some(eef)) = (proven.eef, &datagen.eef) {
        let pairs = view.sites.iter().zip(eef);
        let mut both = pairs.map(|(site, eef)| difference(site, eef).min(difference(&hand_of(site), eef)));
        if let Some((row, by)) = worst(&mut both) {
            return Err(format!(
                "datagen_info/eef_pose differs in row {row} from the end effector by {by:.3} m or rad"
            ));
        }
    }
    if let (Some(name), Some(object)) = (&proven.follows, view.object) {
        let Some(poses) = datagen.object(name) else {
            return Err(format!(
                "datagen_info/object_poses/{name} is missing, which the other demonstrations have"
            ));
        };
        let residuals = object
            .iter()
            .zip(poses)
            .map(|(known, pose)| difference(&pose_of(known), pose));
        if let Some((row, by)) = worst(&mut residuals.into_iter()) {
            return Err(format!(
                "datagen_info/object_poses/{name} differs in row {row} from the object's pose by {by:.3} m or rad"
            ));
        }
    }
    if let (true, Some(deltas), Some(target)) = (proven.targets, view.deltas, &datagen.target) {
        let rows = deltas.iter().zip(view.sites).zip(target);
        let residuals = rows.map(|((delta, site), target)| difference(&target_of(view.osc, delta, site), target));
        if let Some((row, by)) = worst(&mut residuals.into_iter()) {
            return Err(format!(
                "datagen_info/target_pose differs in row {row} from the goal of its action by {by:.3} m or rad"
            ));
        }
    }
    let commands = datagen
        .gripper
        .as_ref()
        .map(|gripper| gripper.iter().zip(view.recorded));
    let different = commands.and_then(|mut rows| rows.position(|(command, action)| (command - action[6]).abs() > 1e-6));
    different.map_or(Ok(()), |row| {
        Err(format!(
            "datagen_info/gripper_action differs in row {row} from the last column of actions"
        ))
    })
}
