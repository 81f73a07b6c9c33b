//! Conversion of rollouts to table rows, for every policy.

use re4_artifact::{ArtifactError, Label, Row, RowWriter, Writer};
use re4_episode::DemoNames;
use re4_fault::Remedy;
use thiserror::Error;

use crate::live::start;
use crate::trace::traced;
use crate::{
    Acting, DecisionCore, Domain, Harness, Job, Policy, PolicyFactory, Recorded, ResultCore, RolloutError, Start,
    StepCore, Traced, rollouts,
};

/// A decision record that can be written to tables.
///
/// Table `decisions` has the columns that all policies share; they come from [`Explained::explanation`]. The columns that are
/// specific to a policy are in a separate table, which has one row per row of table `decisions`; they come from
/// [`Explained::detail`].
pub trait Explained<D: Domain> {
    /// Row type of the policy-specific table, `decisions_<policy>`.
    type Detail: Row;

    /// Returns the columns that all policies share, with poses in the frame of the policy's observations. `names` maps the number
    /// of a demonstration to its name.
    fn explanation(&self, names: &DemoNames) -> Explanation<D>;

    /// Returns the row of the policy-specific table. `seed` and `decision` identify the rollout and the number of the decision in
    /// it.
    fn detail(&self, seed: u32, decision: u32) -> Self::Detail;

    /// Returns the same row with its poses in the world frame, for a policy that observed another frame. Rows without poses do not
    /// need it.
    fn detail_in_world(&self, seed: u32, decision: u32, _world_from_observed: &D::Motion) -> Self::Detail {
        self.detail(seed, decision)
    }
}

/// The description of a decision that all policies share.
#[derive(Debug, Clone, PartialEq)]
pub struct Explanation<D: Domain> {
    /// Number of control steps taken before the decision.
    pub step: u32,
    /// Kind of decision in one word, such as `retrieve`.
    pub kind: &'static str,
    /// Proprioception at the decision.
    pub proprio: D::Proprio,
    /// Object pose in the world frame on which the decision is based, or `None` if it uses no pose.
    pub object: Option<D::Pose>,
    /// The demonstration that the policy follows: its number in the index, the first frame and the last frame (included). `None`
    /// if the policy follows none.
    pub demo: Option<(u32, u32, u32)>,
    /// The reason for the decision, as an English sentence without a full stop. It appears in the column `reason` and on the HTML
    /// page.
    pub reason: String,
}

/// Table rows of a batch of rollouts.
pub struct Batch<D: Recorded> {
    /// Rows of table `results`.
    pub results: Vec<D::ResultRow>,
    /// Rows of table `steps`.
    pub steps: Vec<D::StepRow>,
    /// Rows of table `decisions`.
    pub decisions: Vec<D::DecisionRow>,
    /// Rows of table `worlds`.
    pub worlds: Vec<D::WorldRow>,
}

/// An opened policy with its type erased.
pub trait Opened<D: Recorded>: Send + Sync {
    /// Starts the policy for an episode whose observations the caller gives. `seed` and `first` are as in
    /// [`PolicyFactory::start`].
    fn start(&self, seed: u32, first: &D::Proprio) -> Box<dyn Acting<D>>;

    /// Starts the policy-specific table.
    ///
    /// # Errors
    /// If the table cannot be written.
    fn begin<'a>(&'a self, writer: &Writer, first: u32) -> Result<Box<dyn Recording<D> + 'a>, ArtifactError>;

    /// Rolls out episodes, each without its own set of demonstrations, and reports what each depends on. Nothing is written. Returns
    /// `None` if the policy cannot do without single demonstrations, as learned policies cannot.
    ///
    /// # Errors
    /// If a rollout fails, see [`rollouts`].
    fn traced(&self, harness: &Harness<'_, '_, D>, jobs: &[Job<D>]) -> Result<Option<Vec<Traced>>, RolloutError>;
}

/// Rolls out a policy and writes its policy-specific table.
pub trait Recording<D: Recorded> {
    /// Rolls out the policy from the next starts and returns the rows of the shared tables.
    ///
    /// # Errors
    /// If a rollout fails (see [`rollouts`]) or the policy-specific table cannot be written.
    fn roll_out(&mut self, harness: &Harness<'_, '_, D>, starts: &[Start<D>]) -> Result<Batch<D>, RecordError>;

    /// Finishes the policy-specific table.
    ///
    /// # Errors
    /// If the table cannot be written.
    fn finish(self: Box<Self>) -> Result<(), ArtifactError>;
}

/// An error from rolling out a policy or recording the rollouts.
#[derive(Debug, Error, Remedy)]
pub enum RecordError {
    /// A rollout failed.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Rollout(#[from] RolloutError),
    /// A table could not be written.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Artifact(#[from] ArtifactError),
}

/// A policy factory with the names of the demonstrations. It implements [`Opened`].
pub struct Named<F> {
    /// The factory.
    pub factory: F,
    /// Names of the demonstrations.
    pub names: DemoNames,
}

impl<D: Recorded, F: PolicyFactory<D> + Send> Opened<D> for Named<F>
where
    F::Policy: Send + 'static,
    <F::Policy as Policy<D>>::Decision: Explained<D>,
{
    fn start(&self, seed: u32, first: &D::Proprio) -> Box<dyn Acting<D>> {
        start(&self.factory, &self.names, seed, first)
    }

    fn begin<'a>(&'a self, writer: &Writer, first: u32) -> Result<Box<dyn Recording<D> + 'a>, ArtifactError> {
        Ok(Box::new(Detailed::<'a, D, F> {
            opened: self,
            episodes: first,
            details: writer.rows()?,
        }))
    }

    fn traced(&self, harness: &Harness<'_, '_, D>, jobs: &[Job<D>]) -> Result<Option<Vec<Traced>>, RolloutError> {
        traced(&self.factory, harness, jobs)
    }
}

type Detail<D, F> = <<<F as PolicyFactory<D>>::Policy as Policy<D>>::Decision as Explained<D>>::Detail;

struct Detailed<'a, D: Recorded, F: PolicyFactory<D>>
where
    <F::Policy as Policy<D>>::Decision: Explained<D>,
{
    opened: &'a Named<F>,
    episodes: u32,
    details: RowWriter<Detail<D, F>>,
}

impl<D: Recorded, F: PolicyFactory<D>> Recording<D> for Detailed<'_, D, F>
where
    <F::Policy as Policy<D>>::Decision: Explained<D>,
{
    fn roll_out(&mut self, harness: &Harness<'_, '_, D>, starts: &[Start<D>]) -> Result<Batch<D>, RecordError> {
        let names = &self.opened.names;
        let mut batch = Batch {
            results: Vec::new(),
            steps: Vec::new(),
            decisions: Vec::new(),
            worlds: Vec::new(),
        };
        for rollout in rollouts(&self.opened.factory, harness, starts)? {
            let seed = rollout.start.seed;
            let core = ResultCore {
                episode: self.episodes,
                seed,
                success: rollout.success(),
                steps: rollout.steps.len() as u32,
                decisions: rollout.decisions.len() as u32,
                images: Some(rollout.images()),
            };
            self.episodes += 1;
            batch.results.push(D::result_row(core, &rollout));
            batch.worlds.push(D::world_row(&rollout));
            let world = rollout.world_from_observed();
            batch.steps.extend((0..).zip(&rollout.steps).map(|(number, step)| {
                let core = StepCore {
                    seed,
                    step: number,
                    decision: step.decision,
                    phase: step.phase,
                    asked_object: Some(step.asked.object.is_some()),
                    asked_images: Some(step.asked.images),
                };
                D::step_row(core, step)
            }));
            for (number, decision) in (0..).zip(&rollout.decisions) {
                let explanation = decision.explanation(names);
                let core = DecisionCore {
                    seed,
                    decision: number,
                    step: explanation.step,
                    kind: Some(Label::from(explanation.kind)),
                    demo: explanation.demo.map(|(demo, ..)| demo),
                    demo_frame: explanation.demo.map(|(_, frame, _)| frame),
                    demo_end: explanation.demo.map(|(.., end)| end),
                    reason: explanation.reason,
                    demo_name: explanation
                        .demo
                        .and_then(|(demo, ..)| names.get(demo))
                        .map(str::to_owned),
                };
                let (proprio, object, detail) = match &world {
                    Some(motion) => (
                        D::proprio_in(motion, &explanation.proprio),
                        explanation.object.map(|pose| D::pose_in(motion, &pose)),
                        decision.detail_in_world(seed, number, motion),
                    ),
                    None => (explanation.proprio, explanation.object, decision.detail(seed, number)),
                };
                batch.decisions.push(D::decision_row(core, &proprio, object));
                self.details.push(&detail)?;
            }
        }
        Ok(batch)
    }

    fn finish(self: Box<Self>) -> Result<(), ArtifactError> {
        self.details.finish().map(drop)
    }
}
