//! Films of robosuite's tasks: the rollout is simulated again from its first state with its own actions, checked against the
//! table, and drawn by MuJoCo's renderer.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};
use arrow::array::RecordBatch;
use re4_artifact::{Artifact, Stage, col_bool, col_f64, col_f64_list, col_text, col_u32, col_u32_or_null};
use re4_mujoco::{Data, Model, Renderer, View};
use re4_report::html::spatial::SpatialPhase;
use re4_report::{SceneRollout, SceneState};
use re4_robosuite::models::looks;
use re4_sim::Simulator as _;
use re4_sim::robosuite::{
    ArmAction, Fidelity, FirstTorques, Placement, Robosuite, RobosuiteAction, RobosuiteModel, RobosuiteScene,
    RobosuiteTask,
};

use super::super::report::{find_input, stated};
use super::super::{names_of_decisions, rollout_tables};
use re4_stages::Scenes;

/// robosuite's camera in front of the robot.
pub(in super::super) const CAMERA: &str = "agentview";
/// How far the object may be from where the table has it, m.
const TOLERANCE: f64 = 1e-6;

/// Rollouts to be drawn, and what draws them.
pub(in super::super) struct Films {
    /// What the strips below the pictures say.
    pub(super) rollouts: Vec<SceneRollout>,
    /// Coordinates of each rollout's states.
    coordinates: Vec<Vec<Vec<f64>>>,
    /// Each rollout's model with all that is drawn.
    sets: Vec<Data>,
    /// None where there are no rollouts.
    renderer: Option<Renderer>,
}

impl Films {
    /// Simulates the rollouts of these seeds again.
    ///
    /// # Errors
    /// When the artifact has no such rollout, an input of it cannot be found, the simulation goes another way than the table,
    /// or nothing can be drawn.
    pub(in super::super) fn read(artifact: &Artifact, seeds: &[u32], size: u32, store: &Path) -> Result<Self> {
        let config = &artifact.manifest().config;
        let task: RobosuiteTask = stated(artifact, "config", config, "task")?;
        let fidelity: Fidelity = stated(artifact, "config", config, "fidelity")?;
        let episodes = find_input(artifact, Stage::Ingest, store)?.with_context(|| {
            format!(
                "cannot draw the rollouts of {}: the episodes artifact with their models is neither beside it nor in {}; name the artifacts folder with --artifacts",
                artifact.path().display(),
                store.display()
            )
        })?;
        let scenes = Scenes::open(&episodes, task, fidelity)?;
        let drawn = scenes.drawn_mjcf(&episodes)?;
        let results = rollout_tables::results(artifact)?;
        let steps = Steps::read(artifact)?;
        let mut films = Self {
            rollouts: Vec::new(),
            coordinates: Vec::new(),
            sets: Vec::new(),
            renderer: None,
        };
        for &seed in seeds {
            let row = col_u32(&results, "seed")?.iter().position(|other| *other == seed);
            let row = row.with_context(|| {
                format!(
                    "cannot film seed {seed}: the artifact {} has no such rollout; give one of its seeds",
                    artifact.path().display()
                )
            })?;
            let placement = Placement::draw(task, seed);
            let model = scenes.compile(&placement.in_model(scenes.first_mjcf()?)?)?;
            let state = col_f64_list(&results, "state")?[row].clone();
            let of_seed = steps.of(seed)?;
            films.coordinates.push(again(artifact, &model, seed, &state, &of_seed)?);
            films.set(&placement.in_model(&drawn)?, &scenes, size)?;
            films.rollouts.push(SceneRollout {
                seed,
                success: col_bool(&results, "success")?.value(row),
                states: of_seed.states()?,
                names: of_seed.names()?,
            });
        }
        Ok(films)
    }

    /// The next rollout's model. Compiling one with all that is drawn takes seconds, so it is done once: seeds differ in the
    /// sizes of boxes alone.
    fn set(&mut self, mjcf: &str, scenes: &Scenes, size: u32) -> Result<()> {
        let model: Model = if let Some(renderer) = &self.renderer {
            let boxes = looks(mjcf)?.boxes;
            let boxes = boxes.iter().map(|(name, size)| (name.as_str(), *size));
            renderer.model().with_boxes(boxes)?
        } else {
            let model = scenes.compile(mjcf)?.mujoco().clone();
            self.renderer = Some(Renderer::new(&model, size as usize, size as usize)?);
            model
        };
        self.sets.push(Data::new(&model)?);
        Ok(())
    }

    /// Draws a rollout in a state.
    pub(in super::super) fn draw(&mut self, rollout: usize, state: usize) -> Result<Vec<u8>> {
        let data = &mut self.sets[rollout];
        let renderer = self.renderer.as_mut().context("no model to draw")?;
        data.qpos_mut().copy_from_slice(&self.coordinates[rollout][state]);
        data.forward();
        Ok(renderer.draw(data, CAMERA)?)
    }

    /// What the camera of the last picture saw.
    pub(in super::super) fn view(&mut self) -> Option<View> {
        self.renderer.as_mut()?.view()
    }
}

/// Coordinates before each step and after the last, of the rollout simulated again.
fn again(
    artifact: &Artifact,
    model: &RobosuiteModel,
    seed: u32,
    state: &[f64],
    steps: &Steps,
) -> Result<Vec<Vec<f64>>> {
    let mut simulation = Robosuite::new(model)?;
    let nq = model.mujoco().nq();
    let path = artifact.path().display();
    let Some(start) = state.get(1..=nq) else {
        bail!(
            "cannot draw seed {seed} of {path}: its first state has {} numbers, and the model has {nq} coordinates; run the rollout again",
            state.len()
        );
    };
    simulation.reset(&RobosuiteScene::Placed(start.to_vec()), FirstTorques::AsRobosuite)?;
    let mut coordinates = vec![simulation.data().qpos().to_vec()];
    for step in 0..steps.count() {
        let (action, object) = steps.row(step)?;
        let after = simulation.step(&action)?;
        let found = after.observation.object.translation.vector;
        let away = (0..3).map(|k| (found[k] - object[k]).abs()).fold(0.0, f64::max);
        ensure!(
            away <= TOLERANCE,
            "cannot draw seed {seed} of {path}: simulated again, the object is {away:.1e} m from where table steps has it after step {step}, so pictures would show another rollout; run the rollout again on this machine"
        );
        coordinates.push(simulation.data().qpos().to_vec());
    }
    Ok(coordinates)
}

/// Steps of rollouts, and of a decision what it retrieved.
struct Steps {
    rows: RecordBatch,
    decisions: RecordBatch,
}

impl Steps {
    fn read(artifact: &Artifact) -> Result<Self> {
        Ok(Self {
            rows: rollout_tables::steps(artifact)?,
            decisions: rollout_tables::decisions(artifact)?,
        })
    }

    /// Those of a seed, whose rows stand together.
    fn of(&self, seed: u32) -> Result<Self> {
        let part = |rows: &RecordBatch| -> Result<RecordBatch> {
            let seeds = col_u32(rows, "seed")?;
            let start = seeds.iter().position(|other| *other == seed).unwrap_or(seeds.len());
            let count = seeds[start..].iter().take_while(|other| **other == seed).count();
            Ok(rows.slice(start, count))
        };
        Ok(Self {
            rows: part(&self.rows)?,
            decisions: part(&self.decisions)?,
        })
    }

    fn count(&self) -> usize {
        self.rows.num_rows()
    }

    /// The action of a step, and where the object is after it.
    fn row(&self, step: usize) -> Result<(RobosuiteAction, [f64; 3])> {
        let at = |name: &str| -> Result<f64> { Ok(col_f64(&self.rows, name)?[step]) };
        let arm = [
            at("action_x")?,
            at("action_y")?,
            at("action_z")?,
            at("action_rx")?,
            at("action_ry")?,
            at("action_rz")?,
        ];
        let action = RobosuiteAction {
            arm: ArmAction::Absolute(arm),
            gripper: at("gripper")?,
        };
        Ok((action, [at("object_x")?, at("object_y")?, at("object_z")?]))
    }

    /// What demonstrations are called, by their numbers.
    fn names(&self) -> Result<BTreeMap<u32, String>> {
        let demos = col_u32_or_null(&self.decisions, "demo")?;
        let names = names_of_decisions(&self.decisions)?;
        Ok(demos
            .into_iter()
            .zip(names)
            .filter_map(|(demo, name)| Some((demo?, name)))
            .collect())
    }

    /// States with the action that follows; the last one has that of the action before it.
    fn states(&self) -> Result<Vec<SceneState>> {
        let demos = col_u32_or_null(&self.decisions, "demo")?;
        let decisions = col_u32(&self.rows, "decision")?;
        let phases = col_text(&self.rows, "phase")?;
        let of_step = |(decision, phase): (&u32, Option<&str>)| SceneState {
            demo: demos.get(*decision as usize).copied().flatten(),
            phase: phase.and_then(SpatialPhase::from_name).unwrap_or(SpatialPhase::Replay),
        };
        let mut states: Vec<SceneState> = decisions.iter().zip(phases).map(of_step).collect();
        states.extend(states.last().copied());
        Ok(states)
    }
}
