//! Push-T's numbers from a LeRobot dataset.

use std::ops::Range;

use re4_geometry::Pose2;
use re4_lerobot::{Column, Dataset, Frames, LerobotError};
use re4_sim::GOAL;

use super::conventions::{AngleUnit, PushtConventions, pixels};
use super::episodes::{PushtEpisodes, Recorded};
use super::judge::judged;
use super::keypoints::{Layout, MAX_RESIDUAL, VALUES};
use super::reader::{FRAME_LIMIT, PushtOptions, PushtReading, RATE};
use super::reward::{MAX_DIFFERENCE, Of, differences};
use super::validate::Notes;
use crate::error::{Fault, IngestError};
use crate::lerobot::{LerobotKeys, Wanted, error_of, sentence, width};
use crate::tables::Convention;
use crate::warning::{Warning, WarningCode};

/// Fraction of the episodes that may contradict a convention; if there are more, it is the dataset that contradicts.
const MAX_CONTRADICTIONS: f64 = 0.5;

/// The features that are used, by name.
struct Features {
    state: String,
    /// Whether the state has the pose of the block after the position of the agent.
    block: bool,
    action: String,
    /// A feature with the pose of the block.
    pose: Option<String>,
    keypoints: Option<String>,
    reward: Option<String>,
}

impl Features {
    fn of(dataset: &Dataset, keys: &LerobotKeys) -> Result<Self, Fault> {
        let info = dataset.info();
        let wanted = |setting, given, default| Wanted {
            setting,
            given,
            default,
        };
        let state = wanted("state", keys.state.as_deref(), "observation.state").required(info)?;
        let action = wanted("action", keys.action.as_deref(), "action").required(info)?;
        let keypoints =
            wanted("keypoints", keys.keypoints.as_deref(), "observation.environment_state").optional(info)?;
        let pose = wanted("pose", keys.pose.as_deref(), "re4.object_pose").optional(info)?;
        let reward = wanted("reward", keys.reward.as_deref(), "next.reward").optional(info)?;
        let wrong = |name: &str, found: usize, needed: &str, fix: &str| {
            Fault::Lerobot(format!(
                "meta/info.json, key features.{name}: a frame has {found} values, but Push-T has {needed}; {fix}"
            ))
        };
        let states = width(state);
        if ![2, 5].contains(&states) {
            let needed = "2 (x and y of the agent) or 5 (and x, y and angle of the block)";
            return Err(wrong(
                &state.name,
                states,
                needed,
                "set ingest.lerobot.state to such a feature",
            ));
        }
        if width(action) != 2 {
            let needed = "2 (x and y of the target)";
            return Err(wrong(
                &action.name,
                width(action),
                needed,
                "set ingest.lerobot.action to such a feature",
            ));
        }
        if let Some(keypoints) = keypoints
            && width(keypoints) != VALUES
        {
            let needed = "16 (x and y of the block's eight corners)";
            let fix = "set ingest.lerobot.keypoints to such a feature, or to \"\" if there is none";
            return Err(wrong(&keypoints.name, width(keypoints), needed, fix));
        }
        if let Some(pose) = pose
            && width(pose) != 3
        {
            let needed = "3 (x, y and angle of the block)";
            let fix = "set ingest.lerobot.pose to such a feature, or to \"\" if there is none";
            return Err(wrong(&pose.name, width(pose), needed, fix));
        }
        if let Some(reward) = reward
            && width(reward) != 1
        {
            let fix = "set ingest.lerobot.reward to such a feature, or to \"\" if there is none";
            return Err(wrong(&reward.name, width(reward), "1 reward", fix));
        }
        let block = states == 5;
        let pose = pose.map(|feature| feature.name.clone()).filter(|_| !block);
        Ok(Self {
            state: state.name.clone(),
            block,
            action: action.name.clone(),
            keypoints: keypoints
                .map(|feature| feature.name.clone())
                .filter(|_| !block && pose.is_none()),
            pose,
            reward: reward.map(|feature| feature.name.clone()),
        })
    }
}

/// What the poses of an episode show.
#[derive(Debug, Clone, Copy)]
struct Evidence {
    /// Its index among the selected ones.
    number: usize,
    frames: usize,
    /// Largest distances between recorded and fitted corners in the two layouts, in pixels; 0 without keypoints.
    residuals: [f64; 2],
    /// Largest differences of the rewards as those of the next and of the same frame; `None` without rewards.
    rewards: Option<[f64; 2]>,
}

/// Whether the features are those of Push-T.
pub(crate) fn fits(dataset: &Dataset, keys: &LerobotKeys) -> bool {
    Features::of(dataset, keys).is_ok()
}

/// Reads and judges the numbers of these episodes. Also returns the conventions that they prove.
///
/// # Errors
/// Faults of the dataset, and with [`crate::OnBad::Refuse`] those of episodes.
pub(crate) fn read(
    dataset: &Dataset,
    chosen: &[usize],
    keys: &LerobotKeys,
    options: &PushtOptions<'_>,
) -> Result<(PushtReading, Vec<Convention>), IngestError> {
    let at = |fault: Fault| fault.of(dataset.root());
    let features = Features::of(dataset, keys).map_err(at)?;
    let frames: usize = chosen
        .iter()
        .filter_map(|&number| dataset.episodes().get(number))
        .map(|episode| episode.length)
        .sum();
    if frames as u64 > FRAME_LIMIT {
        let (frames, limit) = (frames as u64, FRAME_LIMIT);
        return Err(at(Fault::TooManyFrames { frames, limit }));
    }
    if features.keypoints.is_some() && options.conventions.angle == Some(AngleUnit::Degrees) {
        return Err(at(Fault::Convention {
            what: "ingest.pusht.angle is \"degrees\", but the angles are computed from corners".to_owned(),
            fix: "remove it".to_owned(),
        }));
    }
    let mut reading = Reading::new(features, options.conventions);
    let read = dataset.read(chosen.iter().copied(), options.stop, |episode, frames| {
        reading.add(episode.index, episode.start..episode.start + episode.length, frames);
        Ok::<(), LerobotError>(())
    });
    read.map_err(error_of)?;
    let (mut conventions, faults, mut bad) = reading.conclude();
    bad.extend(reading.bad);
    let notes = Notes::default();
    let mut options = *options;
    if !faults.is_empty() {
        // The faults of single episodes follow from those of the whole dataset.
        return Err(at(Fault::of_all(faults).unwrap_or(Fault::NoEpisodes)));
    }
    options.images = false;
    let mut judged = judged(reading.episodes, notes, Vec::new(), bad, &options).map_err(at)?;
    if let Some(explained) = judged.explained {
        conventions.push(Convention {
            convention: "action_kind".into(),
            value: match options.conventions.action {
                Some(super::ActionKind::Relative) => "relative".into(),
                _ => "absolute".into(),
            },
            basis: "proven".into(),
            evidence: "fraction of the change in the agent's steps that its targets do not explain".into(),
            residual: Some(1.0 - explained),
            runner_up: None,
            threshold: Some(0.5),
            unit: "1".into(),
            frames: judged.episodes.frame_count(),
        });
    }
    judged.warnings.extend(warnings(dataset, &judged.episodes.recorded));
    Ok((judged, conventions))
}

/// Warnings about what the dataset lacks.
fn warnings(dataset: &Dataset, recorded: &Recorded) -> Vec<Warning> {
    let mut warnings = Vec::new();
    if !recorded.block {
        let message = "the dataset has neither the block's pose nor its corners: poses of the block are unknown";
        warnings.push(Warning::new(WarningCode::NoObjectPoses, message.to_owned(), 1));
    }
    let fps = dataset.info().fps;
    if (fps - RATE).abs() > 1e-6 {
        let message = format!("the dataset has {fps} frames per second, but Push-T is controlled at {RATE} Hz");
        warnings.push(Warning::new(WarningCode::Convention, message, 1));
    }
    warnings
}

/// The numbers while episodes are read.
struct Reading {
    features: Features,
    conventions: PushtConventions,
    layout: Option<Layout>,
    episodes: PushtEpisodes,
    bad: Vec<(usize, Fault)>,
    evidence: Vec<Evidence>,
}

impl Reading {
    fn new(features: Features, conventions: PushtConventions) -> Self {
        let recorded = Recorded {
            kind: "column",
            state: features.state.clone().into(),
            action: features.action.clone().into(),
            block: features.block || features.pose.is_some() || features.keypoints.is_some(),
            angle: features.block || features.pose.is_some(),
        };
        Self {
            features,
            conventions,
            layout: None,
            episodes: PushtEpisodes {
                recorded,
                ..PushtEpisodes::default()
            },
            bad: Vec::new(),
            evidence: Vec::new(),
        }
    }

    /// Adds an episode. Without numbers it has no frames.
    fn add(&mut self, index: usize, rows: Range<usize>, frames: Result<Frames, re4_lerobot::Faults>) {
        let number = self.episodes.sources.len();
        let start = self.episodes.state.len();
        self.episodes.sources.push(u32::try_from(index).unwrap_or(u32::MAX));
        match frames {
            Ok(frames) => {
                self.append(number, &frames);
                self.episodes.rows.push(rows);
            }
            Err(faults) => {
                self.bad.push((number, Fault::Lerobot(sentence(&faults))));
                self.episodes.rows.push(rows.start..rows.start);
            }
        }
        self.episodes.frames.push(start..self.episodes.state.len());
    }

    fn append(&mut self, number: usize, frames: &Frames) {
        let count = frames.timestamps.len();
        let column = |name: &str| frames.column(name);
        let value = |column: Option<&Column>, at: usize| column.and_then(|c| c.values.number(at)).unwrap_or(f64::NAN);
        let state = column(&self.features.state);
        let action = column(&self.features.action);
        let pose = self.features.pose.as_deref().map(column);
        let keypoints = self.features.keypoints.as_deref().map(column);
        let reward = self.features.reward.as_deref().map(column);
        let window = self.conventions.window;
        let [low, _] = window.unwrap_or_default();
        let units = self.conventions.pixels_per_unit();
        // In the unit of the dataset, from which the common checks convert.
        let stored = |pose: Pose2| match window {
            None => [pose.x, pose.y, pose.theta],
            Some(_) => [pose.x / units + low, pose.y / units + low, pose.theta],
        };
        let mut poses = Vec::new();
        let mut residuals = [0.0_f64; 2];
        for i in 0..count {
            let mut block = [GOAL.x, GOAL.y, GOAL.theta];
            if self.features.block || pose.is_some() {
                block = match pose {
                    Some(pose) => [0, 1, 2].map(|place| value(pose, 3 * i + place)),
                    None => [2, 3, 4].map(|place| value(state, 5 * i + place)),
                };
                let theta = match self.conventions.angle {
                    Some(AngleUnit::Degrees) => block[2].to_radians(),
                    _ => block[2],
                };
                poses.push(Pose2::new(pixels(block[0], window), pixels(block[1], window), theta));
            } else if let Some(keypoints) = keypoints {
                let corners = std::array::from_fn(|j| pixels(value(keypoints, VALUES * i + j), window));
                let fits = Layout::ALL.map(|layout| layout.fit(&corners));
                let layout = *self.layout.get_or_insert(if fits[1].1 < fits[0].1 {
                    Layout::Halves
                } else {
                    Layout::Pairs
                });
                for (worst, (_, residual)) in residuals.iter_mut().zip(fits) {
                    *worst = if residual > *worst || residual.is_nan() {
                        residual
                    } else {
                        *worst
                    };
                }
                let pose = fits[usize::from(layout == Layout::Halves)].0;
                // A corner that is not a number gives no pose; the episode is left out for its residual.
                let pose = if pose.x.is_finite() && pose.y.is_finite() {
                    pose
                } else {
                    GOAL
                };
                block = stored(pose);
                poses.push(pose);
            }
            let width = if self.features.block { 5 } else { 2 };
            let agent = [0, 1].map(|place| value(state, width * i + place));
            self.episodes
                .state
                .push([agent[0], agent[1], block[0], block[1], block[2]]);
            self.episodes
                .action
                .push([0, 1].map(|place| value(action, 2 * i + place)));
        }
        let rewards = reward.filter(|_| !poses.is_empty()).map(|reward| {
            let rewards: Vec<f64> = (0..count).map(|i| value(reward, i)).collect();
            differences(&poses, &rewards)
        });
        self.evidence.push(Evidence {
            number,
            frames: count,
            residuals,
            rewards,
        });
    }

    /// The conventions that the episodes prove, contradictions of the dataset as a whole, and of single episodes.
    fn conclude(&self) -> (Vec<Convention>, Vec<Fault>, Vec<(usize, Fault)>) {
        let (mut conventions, mut faults, mut bad) = (Vec::new(), Vec::new(), Vec::new());
        if let (Some(name), Some(layout)) = (&self.features.keypoints, self.layout) {
            let own = usize::from(layout == Layout::Halves);
            let judged = self.judge(MAX_RESIDUAL, |evidence| evidence.residuals[own]);
            if judged.many() {
                faults.push(Fault::Convention {
                    what: format!(
                        "column {name} does not contain the corners of Push-T's block: in {} of {} episodes they are off by up to {:.3} px",
                        judged.over.len(), judged.of, judged.largest
                    ),
                    fix: "set ingest.lerobot.keypoints to the feature with the corners, or to \"\" if there is none".to_owned(),
                });
            }
            let contradiction = |residual: f64| {
                format!("the corners in column {name} are off by {residual:.3} px from those of a rigid block")
            };
            bad.extend(self.contradictions(&judged, contradiction));
            conventions.push(Convention {
                convention: "object_pose".into(),
                value: layout.name().into(),
                basis: "proven".into(),
                evidence: format!("largest distance between the corners in column {name} and those of the block that fits best; the next best is another order of the values"),
                residual: Some(judged.worst),
                runner_up: self.evidence.iter().map(|evidence| evidence.residuals[1 - own]).reduce(f64::max),
                threshold: Some(MAX_RESIDUAL),
                unit: "px".into(),
                frames: judged.frames,
            });
        }
        if let Some(name) = &self.features.reward
            && self.evidence.iter().any(|evidence| evidence.rewards.is_some())
        {
            let by = [Of::Next, Of::Same].map(|of| {
                let place = usize::from(of == Of::Same);
                (
                    of,
                    self.judge(MAX_DIFFERENCE, |evidence| {
                        evidence.rewards.map_or(0.0, |rewards| rewards[place])
                    }),
                )
            });
            let [next, same] = &by;
            // Where the block hardly moves, both are below the limit.
            let worse = |judged: &Judged| (judged.over.len(), judged.largest);
            let (of, judged, other) = if worse(&same.1) < worse(&next.1) {
                (same.0, &same.1, &next.1)
            } else {
                (next.0, &next.1, &same.1)
            };
            if judged.many() {
                faults.push(Fault::Convention {
                    what: format!(
                        "column {name} contradicts the poses of the block: in {} of {} episodes it differs by up to {:.3} from the coverage of the goal in the next frame, divided by 0.95",
                        judged.over.len(), judged.of, judged.largest
                    ),
                    fix: "correct the poses, or set ingest.lerobot.reward to \"\" if the column is another reward".to_owned(),
                });
            }
            let contradiction = |difference: f64| {
                format!("column {name} differs by {difference:.3} from the reward of the block's poses")
            };
            bad.extend(self.contradictions(judged, contradiction));
            conventions.push(Convention {
                convention: "reward".into(),
                value: of.name().into(),
                basis: "proven".into(),
                evidence: format!("largest difference between column {name} and the coverage of the goal by the block's poses, divided by 0.95 and at most 1; the next best is another frame"),
                residual: Some(judged.worst),
                runner_up: Some(other.largest),
                threshold: Some(MAX_DIFFERENCE),
                unit: "1".into(),
                frames: judged.frames,
            });
        }
        (conventions, faults, bad)
    }

    fn judge(&self, threshold: f64, of: impl Fn(&Evidence) -> f64) -> Judged {
        let mut judged = Judged {
            of: self.evidence.len(),
            ..Judged::default()
        };
        for evidence in &self.evidence {
            let value = of(evidence);
            let shown = if value.is_nan() { f64::INFINITY } else { value };
            judged.largest = judged.largest.max(shown);
            if shown <= threshold {
                judged.worst = judged.worst.max(shown);
                judged.frames += evidence.frames;
            } else {
                judged.over.push((evidence.number, value));
            }
        }
        judged
    }

    fn contradictions(&self, judged: &Judged, what: impl Fn(f64) -> String) -> Vec<(usize, Fault)> {
        let over = judged.over.iter();
        over.map(|&(number, value)| {
            let episode = self.episodes.sources[number];
            let what = what(value);
            (number, Fault::Contradicts { episode, what })
        })
        .collect()
    }
}

/// Episodes compared with a threshold.
#[derive(Debug, Default)]
struct Judged {
    /// Number of episodes.
    of: usize,
    /// Those above the threshold, or without a number.
    over: Vec<(usize, f64)>,
    /// The largest value of the others.
    worst: f64,
    /// The largest value of all.
    largest: f64,
    /// Frames of the episodes that are not above it.
    frames: usize,
}

impl Judged {
    /// Whether the dataset as a whole contradicts, not single episodes.
    fn many(&self) -> bool {
        self.over.len() as f64 > MAX_CONTRADICTIONS * self.of as f64
    }
}
