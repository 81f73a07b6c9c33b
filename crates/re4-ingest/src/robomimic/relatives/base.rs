//! Delta actions in the axes of the robot's base, and robots whose base moves.
//!
//! robosuite 1.5 reads deltas in the frame of the robot's base unless `input_ref_frame` is `world`. Tables have actions in world axes,
//! so such deltas are rotated when they are read. A base that is not rotated needs no conversion.
//!
//! Actions of a mobile manipulator (`PandaOmron` in `RoboCasa`) have 12 columns: translation 3, rotation 3, gripper 1, base 4 (planar
//! motion and torso), and a mode that is above 0 while the base moves instead of the arm.

use nalgebra::UnitQuaternion;
use re4_robosuite::actions::Osc;
use re4_robosuite::conventions::{ActionFrame, ActionKind, BasedDeltas, Settings, delta_frame};
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::kinematics::Model;

use super::super::demo::Demo;
use super::super::fault::Hdf5Fault;
use super::super::interpret::{LEAVE_OUT, Prepared};
use super::super::stated::convention;
use crate::tables::Convention;

/// Smallest angle (radians) by which a base counts as rotated. Models are saved with six digits.
const ROTATED: f64 = 1e-5;
/// How far a delta may exceed the controller's range by rounding.
const TOLERANCE: f64 = 1e-6;

/// How the actions of a file are converted from the axes of the robot's base to those of the world.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::robomimic) struct BaseFrame {
    /// The controller, if actions must be converted.
    osc: Option<Osc>,
    /// Whether actions beyond the controller's range are accepted.
    beyond: bool,
}

impl BaseFrame {
    /// Whether actions must be converted.
    pub(super) fn is_rotated(&self) -> bool {
        self.osc.is_some()
    }

    /// Determines the frame from the first demonstrations, and converts their actions.
    pub(super) fn learn(
        first: &mut [Prepared],
        env: &EnvArgs,
        settings: &Settings,
    ) -> Result<(Self, Option<Convention>), Hdf5Fault> {
        let nothing = (Self::default(), None);
        let kind = settings
            .action_kind
            .or(env.controller.as_ref().and_then(|controller| controller.declared));
        if !env.declares_base_frame() || kind == Some(ActionKind::Absolute) {
            return Ok(nothing);
        }
        let Ok(osc) = Osc::from_env(env) else {
            return Ok(nothing);
        };
        let mut rotated = false;
        let mut bases = Vec::new();
        for prepared in &*first {
            let rotations = rotations(&prepared.demo, prepared.model.as_deref())?;
            rotated |= rotations.iter().flatten().any(|rotation| rotation.angle() > ROTATED);
            bases.push(rotations);
        }
        if !rotated {
            return Ok(nothing);
        }
        let known = first.iter().zip(&bases).filter_map(|(prepared, base)| {
            let base = base.as_deref()?;
            Some(BasedDeltas {
                eef_pos: &prepared.poses.eef_position,
                actions: &prepared.demo.actions,
                base,
            })
        });
        let known: Vec<BasedDeltas<'_>> = known.filter(|demo| demo.eef_pos.len() == demo.actions.len()).collect();
        let learned = delta_frame(&known, &osc, env, settings)
            .map_err(|error| Hdf5Fault::Other(format!("{error} (settings are keys of [ingest.conventions])")))?;
        let Some((frame, proof)) = learned else {
            return Ok(nothing);
        };
        let row = Some(convention(&proof));
        if frame == ActionFrame::World {
            return Ok((Self::default(), row));
        }
        let base = Self {
            osc: Some(osc),
            beyond: settings.allow_actions_beyond_range,
        };
        for prepared in first {
            base.convert(&mut prepared.demo, prepared.model.as_deref())?;
        }
        Ok((base, row))
    }

    /// Converts the actions of a demonstration.
    pub(super) fn convert(&self, demo: &mut Demo, model: Option<&Model>) -> Result<(), Hdf5Fault> {
        let Some(osc) = &self.osc else { return Ok(()) };
        let refuse = |why: String| Hdf5Fault::Other(format!("{}: {why}", demo.name));
        let Some(rotations) = rotations(demo, model)? else {
            return Err(refuse(
                "its actions are in the frame of the robot's base, whose pose needs states and the attribute model_file; restore what is missing, or leave the demonstration out".to_owned(),
            ));
        };
        let beyond = |action: &[f64; 7]| action[..6].iter().any(|value| value.abs() > 1.0 + TOLERANCE);
        if let Some(row) = demo.actions.iter().position(beyond).filter(|_| !self.beyond) {
            return Err(refuse(format!(
                "a delta action exceeds [-1, 1] in row {row} (ingest.conventions.allow_actions_beyond_range = true accepts it); {LEAVE_OUT}"
            )));
        }
        let rotated: Option<Vec<[f64; 7]>> = demo
            .actions
            .iter()
            .zip(&rotations)
            .map(|(action, base)| osc.in_world_axes(action, base))
            .collect();
        demo.actions = rotated.ok_or_else(|| {
            refuse(
                "its actions are in the frame of a rotated base, but the scales of its controller differ between axes or have an offset, so they cannot be rotated; correct env_args".to_owned(),
            )
        })?;
        Ok(())
    }
}

/// Orientation of the base in each frame; `None` without states, model or base.
fn rotations(demo: &Demo, model: Option<&Model>) -> Result<Option<Vec<UnitQuaternion<f64>>>, Hdf5Fault> {
    let (Some(model), Some(states)) = (model, &demo.states) else {
        return Ok(None);
    };
    let frames = model.command_frames(states.values.chunks_exact(states.columns));
    let frames = frames.map_err(|error| {
        Hdf5Fault::Other(format!(
            "{}: the pose of the robot's base cannot be computed from states and model_file: {error}; {LEAVE_OUT}",
            demo.name
        ))
    })?;
    Ok(frames.map(|frames| frames.into_iter().map(|frame| frame.rotation).collect()))
}

/// Refuses a demonstration whose base moves, and one with actions for a base that its robot does not have.
pub(in crate::robomimic) fn check_base(demo: &Demo, model: Option<&Model>) -> Result<(), Hdf5Fault> {
    let Some(commands) = &demo.base_commands else {
        return Ok(());
    };
    if model.is_some_and(|model| !model.moves_its_base()) {
        return Err(Hdf5Fault::Shape {
            object: format!("data/{}/actions", demo.name),
            found: vec![commands.len(), 12],
            expected: "(N, 7)".to_owned(),
            fix: "the robot in its model_file has no mobile base, so give a file of one arm with a two-finger gripper",
        });
    }
    let moving = |command: &[f64; 5]| command[4] > 0.0;
    let Some(start) = commands.iter().position(moving) else {
        return Ok(());
    };
    let end = commands.iter().rposition(moving).unwrap_or(start);
    Err(Hdf5Fault::Other(format!(
        "{}: the base of the robot moves in rows {start} to {end} (column 11 of actions is above 0), which is no manipulation by the arm; cut these rows out of all its arrays, or leave the demonstration out with a filter key, ingest.select or ingest.on_bad = \"leave_out\"",
        demo.name
    )))
}
