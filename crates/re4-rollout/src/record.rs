//! Rollouts on their way to tables, whatever the policy.

use re4_artifact::{ArtifactError, Label, Row, RowWriter, Writer};
use re4_episode::DemoNames;
use re4_fault::Remedy;
use thiserror::Error;

use crate::{
    DecisionCore, Domain, Harness, Policy, PolicyFactory, Recorded, ResultCore, RolloutError, Start, StepCore, rollouts,
};

/// A decision record that can be written.
pub trait Explained<D: Domain> {
    /// Row of the table with what is particular to the policy, `decisions_<policy>`.
    type Detail: Row;

    /// What every policy tells of a decision.
    fn explanation(&self, names: &DemoNames) -> Explanation<D>;

    /// The rest.
    fn detail(&self, seed: u32, decision: u32) -> Self::Detail;
}

/// What every policy tells of a decision.
#[derive(Debug, Clone, PartialEq)]
pub struct Explanation<D: Domain> {
    /// Control steps taken before it.
    pub step: u32,
    /// What was decided, in a word.
    pub kind: &'static str,
    /// What was felt.
    pub proprio: D::Proprio,
    /// Pose of the object that it goes by, where it goes by one.
    pub object: Option<D::Pose>,
    /// Demonstration that is followed, by its number in the index, with the first and the last frame; where one is.
    pub demo: Option<(u32, u32, u32)>,
    /// The decision in words.
    pub reason: String,
}

/// The rows of some rollouts.
pub struct Batch<D: Recorded> {
    /// Table `results`.
    pub results: Vec<D::ResultRow>,
    /// Table `steps`.
    pub steps: Vec<D::StepRow>,
    /// Table `decisions`.
    pub decisions: Vec<D::DecisionRow>,
}

/// A policy that was opened, of any type.
pub trait Opened<D: Recorded>: Sync {
    /// Begins the policy's own table.
    ///
    /// # Errors
    /// When it cannot be written.
    fn begin<'a>(&'a self, writer: &Writer) -> Result<Box<dyn Recording<D> + 'a>, ArtifactError>;
}

/// Rollouts of a policy, whose own table is being written.
pub trait Recording<D: Recorded> {
    /// Rolls out from more starts.
    ///
    /// # Errors
    /// As [`rollouts`]; when the policy's own table cannot be written.
    fn roll_out(&mut self, harness: &Harness<'_, '_, D>, starts: &[Start<D>]) -> Result<Batch<D>, RecordError>;

    /// Finishes the policy's own table.
    ///
    /// # Errors
    /// When it cannot be written.
    fn finish(self: Box<Self>) -> Result<(), ArtifactError>;
}

/// Why rollouts could not be recorded.
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

/// A factory of policies whose decisions name demonstrations.
pub struct Named<F> {
    /// Starts the policies.
    pub factory: F,
    /// What demonstrations are called.
    pub names: DemoNames,
}

impl<D: Recorded, F: PolicyFactory<D>> Opened<D> for Named<F>
where
    <F::Policy as Policy<D>>::Decision: Explained<D>,
{
    fn begin<'a>(&'a self, writer: &Writer) -> Result<Box<dyn Recording<D> + 'a>, ArtifactError> {
        Ok(Box::new(Detailed::<'a, D, F> {
            opened: self,
            episodes: 0,
            details: writer.rows()?,
        }))
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
                batch
                    .decisions
                    .push(D::decision_row(core, &explanation.proprio, explanation.object));
                self.details.push(&decision.detail(seed, number))?;
            }
        }
        Ok(batch)
    }

    fn finish(self: Box<Self>) -> Result<(), ArtifactError> {
        self.details.finish().map(drop)
    }
}
