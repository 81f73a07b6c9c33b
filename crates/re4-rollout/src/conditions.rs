//! Conditions of rollouts that make a task harder: old observations and disturbances.

use std::f64::consts::TAU;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_artifact::Word;
use re4_geometry::{Point2, Pose2};
use re4_sim::SimError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Domain, Env};

/// Number of directions that are tried at a control step before the disturbance is put off to the next one.
const DIRECTIONS: usize = 100;

/// Conditions of all episodes of a harness. The default ones change nothing.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Conditions {
    /// Age of the observations that the policy acts on, in control steps. In the first steps of an episode, the policy acts on
    /// the observation after the reset.
    pub latency: u32,
    /// The disturbance of every episode.
    pub disturbance: Option<Disturbance>,
}

/// What a disturbance moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Disturbed {
    /// The manipulated object.
    Object,
    /// Push-T: the pusher.
    Pusher,
    /// Push-T: the object or the pusher, with equal probability, by the seed of the episode.
    Either,
}

/// One sudden change of the scene per episode, between two control steps. The step, what is moved, and the direction are random,
/// by the seed of the episode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Disturbance {
    /// What is moved.
    #[serde(default = "object")]
    pub kind: Disturbed,
    /// First and last control step, counted from 0, before which the disturbance happens; every step between them has the same
    /// probability. An episode that ends earlier is not disturbed. If no valid direction is found at the step, the disturbance
    /// happens at the next step with one.
    pub steps: [u32; 2],
    /// Length of the translation in a random direction: in px for Push-T, in metres along the table for robosuite tasks.
    pub translation: f64,
    /// Magnitude of the rotation of the object, with a random sign, in rad: about the centre of gravity of Push-T's block, or
    /// about the vertical axis of a robosuite object. Has no effect on the pusher.
    pub rotation: f64,
}

fn object() -> Disturbed {
    Disturbed::Object
}

/// What an applied disturbance moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Displaced {
    /// The manipulated object.
    Object,
    /// The pusher.
    Pusher,
}

impl Word for Displaced {
    const ALL: &'static [Self] = &[Self::Object, Self::Pusher];

    fn word(self) -> &'static str {
        match self {
            Self::Object => "object",
            Self::Pusher => "pusher",
        }
    }
}

/// A displacement in the horizontal plane of the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Displacement {
    /// What is moved.
    pub what: Displaced,
    /// Translation of the object's centre of gravity (robosuite: of the object frame's origin) or of the pusher, and rotation of
    /// the object about it. In px or metres, and rad.
    pub motion: Pose2,
}

/// A disturbance that happened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AppliedDisturbance {
    /// Number of control steps taken before it.
    pub step: u32,
    /// The displacement.
    pub displacement: Displacement,
}

/// Applies the disturbance of one episode.
pub(crate) struct Disturber {
    disturbance: Disturbance,
    what: Displaced,
    step: u32,
    random: Pcg64,
    applied: Option<AppliedDisturbance>,
}

impl Disturber {
    pub(crate) fn new(disturbance: Disturbance, seed: u32) -> Self {
        // The stream number is the ASCII code of "disturb", so that the numbers are independent of other numbers of the seed.
        let mut random = Pcg64::new(u128::from(seed), 0x0064_6973_7475_7262);
        let [first, last] = disturbance.steps;
        let step = first + (unit(&mut random) * f64::from(last.saturating_sub(first) + 1)) as u32;
        let coin = unit(&mut random) < 0.5;
        let what = match disturbance.kind {
            Disturbed::Object => Displaced::Object,
            Disturbed::Pusher => Displaced::Pusher,
            Disturbed::Either => [Displaced::Pusher, Displaced::Object][usize::from(coin)],
        };
        Self {
            disturbance,
            what,
            step,
            random,
            applied: None,
        }
    }

    /// Called before every control step with its number.
    pub(crate) fn before_step<D: Domain>(&mut self, step: u32, env: &mut dyn Env<D>) -> Result<(), SimError> {
        if self.applied.is_some() || step < self.step {
            return Ok(());
        }
        for _ in 0..DIRECTIONS {
            let displacement = self.sample();
            if env.displace(&displacement)? {
                self.applied = Some(AppliedDisturbance { step, displacement });
                break;
            }
        }
        Ok(())
    }

    pub(crate) fn applied(&self) -> Option<AppliedDisturbance> {
        self.applied
    }

    fn sample(&mut self) -> Displacement {
        let direction = TAU * unit(&mut self.random);
        let sign = if unit(&mut self.random) < 0.5 { -1.0 } else { 1.0 };
        let translation = Point2::new(direction.cos(), direction.sin()) * self.disturbance.translation;
        let rotation = match self.what {
            Displaced::Object => sign * self.disturbance.rotation,
            Displaced::Pusher => 0.0,
        };
        Displacement {
            what: self.what,
            motion: Pose2::new(translation.x, translation.y, rotation),
        }
    }
}

/// Samples a uniform number in `[0, 1)` with 53 random bits.
fn unit(random: &mut Pcg64) -> f64 {
    (random.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}
