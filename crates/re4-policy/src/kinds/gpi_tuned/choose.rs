//! Which frame a plan starts with: gated distances, a vote of neighbouring frames, and a re-ranking by progress.

use re4_geometry::spatial::rotation_angle;

use super::frames::Frame;
use super::library::Library;
use super::phases::{LIFT_STEPS, Live, Stage};
use super::tuning::{OPEN, Rerank, Rule};
use crate::lookup::{nearest, squared};

/// How the first frame of a plan was chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum How {
    Nearest,
    Vote,
    Rerank,
}

impl How {
    pub(super) fn as_str(self) -> &'static str {
        match self {
            Self::Nearest => "nearest",
            Self::Vote => "vote",
            Self::Rerank => "rerank",
        }
    }
}

/// Number of nearest frames that vote, and the distance in frames up to which they support each other.
const VOTERS: usize = 32;
const VOTE_STEPS: u32 = 16;

impl Library {
    /// Distances of all frames to a state; `None` for frames that the phase or the used frames exclude. Without gate if it would
    /// exclude every frame.
    pub(super) fn distances(
        &self,
        code: &[f64],
        live: &Live,
        fingers: f64,
        followed: Option<usize>,
        used: &dyn Fn(usize) -> bool,
    ) -> Vec<Option<f64>> {
        let free: Vec<Option<f64>> = (0..self.frames.len())
            .map(|at| {
                let admitted = self.frames[at].retrievable && !used(at);
                admitted.then(|| squared(&self.codes[at], code))
            })
            .collect();
        if !self.switches.gate {
            return free;
        }
        let mut gated: Vec<Option<f64>> = free
            .iter()
            .enumerate()
            .map(|(at, distance)| distance.filter(|_| self.admits(at, live.stage)))
            .collect();
        if self.tuning.rule == Rule::Square {
            self.adjust_square(&mut gated, live, fingers, followed);
        }
        if gated.iter().any(Option::is_some) { gated } else { free }
    }

    /// Whether the gate of a phase keeps a frame.
    fn admits(&self, at: usize, stage: Stage) -> bool {
        let label = self.phases.labels[at];
        let next = stage.next();
        match self.tuning.rule {
            Rule::Lift => true,
            Rule::Can if stage < Stage::Lift => true,
            Rule::Can => label.stage == stage || (label.stage == next && label.since < LIFT_STEPS),
            Rule::Square => label.stage == stage || label.stage == next,
        }
    }

    fn adjust_square(&self, distances: &mut [Option<f64>], live: &Live, fingers: f64, followed: Option<usize>) {
        if live.stage == Stage::PreInsert {
            let smallest: Vec<f64> = nearest(distances.iter().copied(), 64)
                .into_iter()
                .map(|(d, _)| d)
                .collect();
            let spread = match (smallest.first(), re4_stats::median(&smallest)) {
                (Some(first), Some(middle)) => (middle - first).max(0.004_062),
                _ => 0.004_062,
            };
            for (distance, label) in distances.iter_mut().zip(&self.phases.labels) {
                if let Some(distance) = distance.as_mut().filter(|_| label.stage == Stage::Insert) {
                    *distance += spread * 0.242_575 * (label.since as f64 / 36.0).min(2.0);
                }
            }
        }
        if live.grasped {
            for (distance, label) in distances.iter_mut().zip(&self.phases.labels) {
                if let Some(distance) = distance.as_mut().filter(|_| label.lift_start) {
                    *distance *= 0.7;
                }
            }
        }
        // Progress guard: late in a demonstration, its earlier frames are not taken again while the gripper is closed.
        if let Some(at) = followed.filter(|at| fingers <= OPEN && self.frames[*at].frame >= 220) {
            let (demo, frame) = (self.frames[at].demo, self.frames[at].frame);
            for (distance, other) in distances.iter_mut().zip(&self.frames) {
                if other.demo == demo && other.frame < frame {
                    *distance = None;
                }
            }
        }
    }

    /// Chooses the first frame of a plan. Returns its distance and position.
    pub(super) fn choose(&self, distances: &[Option<f64>], stage: Stage) -> Option<(f64, usize, How)> {
        let count = self
            .tuning
            .rerank
            .map_or(VOTERS, |rerank| rerank.candidates.max(VOTERS));
        let found = nearest(distances.iter().copied(), count);
        let (distance, at) = *found.first()?;
        let mut choice = (distance, at, How::Nearest);
        if self.switches.vote
            && let Some((distance, at)) = self.vote(&found[..found.len().min(VOTERS)])
        {
            choice = (distance, at, How::Vote);
        }
        if let Some(rerank) = &self.tuning.rerank
            && self.switches.rerank
            && stage >= Stage::Transport
        {
            let candidates = &found[..found.len().min(rerank.candidates)];
            choice = self.reranked(candidates, rerank, choice);
        }
        Some(choice)
    }

    /// Votes among the nearest frames: frames of one demonstration that are close in time support each other.
    fn vote(&self, found: &[(f64, usize)]) -> Option<(f64, usize)> {
        let group = |at: usize| -> Vec<(f64, usize)> {
            let of = &self.frames[at];
            let near = |other: &Frame| other.demo == of.demo && other.frame.abs_diff(of.frame) <= VOTE_STEPS;
            found
                .iter()
                .copied()
                .filter(|(_, at)| near(&self.frames[*at]))
                .collect()
        };
        let score = |group: &[(f64, usize)]| {
            let mean = group.iter().map(|(d, _)| d).sum::<f64>() / group.len() as f64;
            group.len() as f64 / (mean + 1e-12)
        };
        let (first, at) = *found.first()?;
        let own = group(at);
        let best = found
            .iter()
            .map(|(_, at)| group(*at))
            .reduce(|best, other| if score(&other) > score(&best) { other } else { best })?;
        let (distance, member) = *best.first()?;
        let accepted = best.len() >= (own.len() + 2).max(3)
            && score(&best) >= 1.5 * score(&own)
            && distance <= 1.5 * first + 0.02
            && member != at;
        accepted.then_some((distance, member))
    }

    fn reranked(&self, candidates: &[(f64, usize)], rerank: &Rerank, choice: (f64, usize, How)) -> (f64, usize, How) {
        let Some((least, _)) = candidates.first().copied() else {
            return choice;
        };
        let score =
            |distance: f64, at: usize| -((distance - least) / (least + 1e-6)).ln_1p() + self.progress(at, rerank);
        let limit = rerank.factor * choice.0 + rerank.offset;
        let mut best = (score(choice.0, choice.1), choice);
        for (distance, at) in candidates.iter().copied().filter(|(distance, _)| *distance <= limit) {
            let value = score(distance, at);
            if value > best.0 {
                best = (value, (distance, at, How::Rerank));
            }
        }
        best.1
    }

    /// How much a demonstration progresses in the frames after a frame.
    fn progress(&self, at: usize, rerank: &Rerank) -> f64 {
        let target = &self.space.target;
        let end = self.end_of(at);
        let later = (at + rerank.ahead).min(end);
        let ahead = &self.frames[at..=later];
        let (now, last) = (&self.frames[at], &self.frames[end]);
        let gain = |of: &dyn Fn(&Frame) -> f64| {
            let least = ahead.iter().map(of).fold(f64::INFINITY, f64::min);
            of(now) - least
        };
        let part = |value: f64, scale: f64| (value / scale).clamp(-2.0, 2.0);
        let mut sum = part(gain(&|f| f.off_target(target)), 0.04) + 0.5 * part(gain(&Frame::height), 0.04);
        if rerank.orientation > 0.0 {
            let angle = |f: &Frame| rotation_angle(&f.object.rotation, &last.object.rotation);
            sum += rerank.orientation * part(gain(&angle), 0.35);
        }
        sum += rerank.ending * (-((end - at) as f64) / 80.0).exp();
        if rerank.penalties {
            let then = &self.frames[later];
            let excess = |value: f64| (value.max(0.0) / 0.05).clamp(0.0, 5.0);
            sum -= 0.8 * excess(then.apart() - 0.07) + 0.35 * excess(then.height() - 0.9);
        }
        sum
    }
}
