//! What the encoder's training and its estimates read of the demonstrations: frames and anchors, and checks of the estimates against the
//! anchors. No recorded object pose is used.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::Result;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use re4_artifact::{Artifact, Row as _, columns};
use re4_audit::SpatialDemo;
use re4_encoder::batches::{Sample, TrainingDemo};
use re4_encoder::{EncoderConfig, GraspFrame};
use re4_episode::{Mode, SpatialFrame};
use re4_fault::ensure;
use re4_ingest::{FrameRow, SpatialColumns};
use re4_policy::DemoNames;
use re4_pose::LabelRow;
use re4_segment::{ModeRow, SpatialEvidence};
use re4_stats::upper_median;
use serde_json::{Value, json};

/// Fingers that move less than this in a control step are at rest, in metres.
const STILL: f64 = 5e-4;

/// An anchor contradicts the images if it is this many times as far from the estimates as the median demonstration's.
const CONTRADICTS: f64 = 5.0;

/// The same, at least, in metres: about the width of a gripper's finger.
const MINIMUM_CONTRADICTION: f64 = 0.03;

/// Estimates are no better than the mean anchor if their median distance is more than this fraction of the mean's.
const NO_BETTER: f64 = 0.9;

/// The stride of held-out demonstrations: every n-th demonstration, starting with the first, is held out. `None` for no held-out
/// demonstrations.
fn held_out_every(fraction: f64) -> Option<usize> {
    (fraction > 0.0).then(|| (1.0 / fraction).round().max(2.0) as usize)
}

/// The data of a demonstration that training reads. `first` is the index of its first image.
pub(super) struct Demo {
    pub(super) episode: u32,
    pub(super) first: u64,
    pub(super) eef: Vec<Isometry3<f64>>,
    /// Distance between the fingers, in metres.
    separation: Vec<f64>,
    modes: Vec<Mode>,
    pub(super) trained_on: bool,
}

/// Frames of a demonstration that are trained on: those before the grasp, and those while the object is held.
struct Phases {
    before: std::ops::Range<usize>,
    held: std::ops::Range<usize>,
}

impl Demo {
    /// Whether the demonstration with this number is trained on.
    pub(super) fn is_trained_on(number: u32, config: &EncoderConfig) -> bool {
        held_out_every(config.held_out).is_none_or(|every| !(number as usize).is_multiple_of(every))
    }

    /// A demonstration that was read with its recorded poses. It has no images.
    pub(super) fn of(demo: &SpatialDemo, config: &EncoderConfig) -> Self {
        let frames = &demo.episode.frames;
        Self {
            episode: demo.number,
            first: 0,
            eef: frames.iter().map(|frame| frame.eef).collect(),
            separation: frames.iter().map(SpatialFrame::finger_separation).collect(),
            modes: demo.segmented.modes.clone(),
            trained_on: Self::is_trained_on(demo.number, config),
        }
    }

    /// The longest run of transfer frames and the transit frames before it. In a demonstration with one grasp, the run starts at
    /// the paper's g(d). In a demonstration that missed and tried again, the first transfer frame has no object in the gripper;
    /// the longest run is the one that carried the object.
    fn phases(&self) -> Option<Phases> {
        let mut best: Option<Phases> = None;
        let (mut start, mut before) = (0, 0);
        for run in self.modes.chunk_by(|a, b| a == b) {
            let end = start + run.len();
            if run[0] == Mode::Transfer {
                if start > before && best.as_ref().is_none_or(|best| run.len() > best.held.len()) {
                    best = Some(Phases {
                        before: before..start,
                        held: start..end,
                    });
                }
                before = end;
            }
            start = end;
        }
        best
    }

    /// The first frame of a run that holds the object in which the fingers have come to rest: they have closed, and move less
    /// than [`STILL`] in a step. The last frame of the run if they never do.
    fn settled(&self, held: &std::ops::Range<usize>) -> usize {
        let moved = |frame: usize| (self.separation[frame] - self.separation[frame - 1]).abs();
        let closing = (held.start + 1..held.end).find(|&frame| moved(frame) > STILL);
        let rest = closing.and_then(|start| (start + 1..held.end).find(|&frame| moved(frame) <= STILL));
        rest.unwrap_or(held.end - 1)
    }

    /// What is trained on, and the frame of its anchor. `None` if the object is never held.
    pub(super) fn training(&self, config: &EncoderConfig) -> Option<(usize, TrainingDemo)> {
        let phases = self.phases()?;
        let frame = |of: GraspFrame| match of {
            GraspFrame::Command => phases.held.start,
            GraspFrame::Settled => self.settled(&phases.held),
        };
        let anchor = frame(config.anchor);
        let training = TrainingDemo {
            first: self.first,
            before: phases.before.clone().map(|frame| frame as u32).collect(),
            anchor: self.eef[anchor],
            held: (frame(config.held_from)..phases.held.end)
                .map(|frame| frame as u32)
                .collect(),
            eef: self.eef.clone(),
        };
        Some((anchor, training))
    }
}

/// Frames by demonstration.
pub(super) type Frames = BTreeMap<u32, BTreeSet<u32>>;

/// What is trained on, and what is held out.
#[derive(Default)]
pub(super) struct TrainingData {
    /// Demonstrations of the training set, with their numbers.
    pub(super) training: Vec<(u32, TrainingDemo)>,
    /// Frames before the grasp of held-out demonstrations: demonstration, frame, and sample.
    held_out: Vec<(u32, u32, Sample)>,
    /// The anchors of all demonstrations.
    pub(super) labels: Vec<LabelRow>,
    /// Warnings for the user.
    pub(super) warnings: Vec<Value>,
}

impl TrainingData {
    pub(super) fn of(demos: &[Demo], config: &EncoderConfig, names: &DemoNames) -> Self {
        let mut data = Self::default();
        for demo in demos {
            let Some((anchor, training)) = demo.training(config) else {
                data.warnings.push(json!({
                    "code": "no_grasp",
                    "demo_name": names.of(demo.episode),
                    "message": format!(
                        "{} is not trained on: it has no transfer frame after a transit frame, so its object poses are unknown",
                        names.of(demo.episode),
                    ),
                }));
                continue;
            };
            data.labels.push(LabelRow {
                episode: demo.episode,
                trained_on: demo.trained_on,
                frame: anchor as u32,
                anchor: training.anchor,
            });
            if demo.trained_on {
                data.training.push((demo.episode, training));
            } else {
                let first = training.first;
                let sample = |frame| Sample::plain(first + u64::from(frame), training.anchor);
                let before = training.before.iter();
                data.held_out
                    .extend(before.map(|&frame| (demo.episode, frame, sample(frame))));
            }
        }
        data
    }

    /// Leaves out frames whose images have a single color.
    pub(super) fn leave_out(&mut self, blank: &Frames, demos: &[Demo], names: &DemoNames) {
        for (demo, own) in demos.iter().filter_map(|demo| Some((demo, blank.get(&demo.episode)?))) {
            self.warnings.push(json!({
                "code": "blank_images",
                "demo_name": names.of(demo.episode),
                "message": format!(
                    "{} of the {} images of {} have a single color, as of a camera that does not work; they are not trained on",
                    own.len(),
                    demo.eef.len(),
                    names.of(demo.episode),
                ),
            }));
        }
        for (episode, training) in &mut self.training {
            if let Some(blank) = blank.get(episode) {
                training.before.retain(|frame| !blank.contains(frame));
                training.held.retain(|frame| !blank.contains(frame));
            }
        }
        self.training
            .retain(|(_, training)| !training.before.is_empty() && !training.held.is_empty());
        self.held_out
            .retain(|(episode, frame, _)| !blank.get(episode).is_some_and(|blank| blank.contains(frame)));
    }

    /// Takes the training set and the held-out samples.
    pub(super) fn split(&mut self) -> (Vec<TrainingDemo>, Vec<Sample>) {
        let training = std::mem::take(&mut self.training).into_iter();
        let held_out = std::mem::take(&mut self.held_out).into_iter();
        (
            training.map(|(_, training)| training).collect(),
            held_out.map(|(_, _, sample)| sample).collect(),
        )
    }
}

/// How well estimates agree with the anchors, of demonstrations that are added one at a time: some 16 bytes of each, and of a
/// held-out one another 32 and 8 per frame before the grasp.
#[derive(Default)]
pub(super) struct Agreement {
    /// The median distance of the estimates before the grasp from the anchor in metres, by demonstration.
    distances: Vec<(u32, f64)>,
    /// Sum of the positions of the anchors that were trained on, and their number.
    trained_on: (Vector3<f64>, f64),
    /// The positions of the anchors of held-out demonstrations, and the numbers of their frames before the grasp.
    held_out: Vec<(Vector3<f64>, usize)>,
    /// The distances of the estimates in these frames from the anchors.
    of_held_out: Vec<f64>,
}

impl Agreement {
    /// Adds a demonstration and its estimates by frame.
    pub(super) fn add(&mut self, demo: &Demo, poses: &[Isometry3<f64>], config: &EncoderConfig) {
        let Some((_, training)) = demo.training(config) else {
            return;
        };
        let anchor = training.anchor.translation.vector;
        let distances = || {
            let before = training.before.iter();
            before.map(|&frame| (poses[frame as usize].translation.vector - anchor).norm())
        };
        let median = upper_median(distances());
        self.distances.extend(median.map(|median| (demo.episode, median)));
        if demo.trained_on {
            self.trained_on.0 += anchor;
            self.trained_on.1 += 1.0;
        } else {
            self.held_out.push((anchor, training.before.len()));
            self.of_held_out.extend(distances());
        }
    }

    /// Warnings of estimates that do not agree with the anchors. `name` returns the name of a demonstration.
    pub(super) fn warnings(&self, config: &EncoderConfig, name: &dyn Fn(u32) -> String) -> Vec<Value> {
        let contradictions = self.contradictions().map(|(demo, distance)| {
            json!({
                "code": "anchor_contradicts_images",
                "demo_name": name(demo),
                "message": format!(
                    "the grasp of {} is {:.0} mm from where its images show the object, far more than in the other demonstrations; \
                     check that its images and its actions belong together, and that the camera did not move",
                    name(demo),
                    1e3 * distance,
                ),
            })
        });
        let no_better = self.no_better_than_mean().map(|(own, mean)| {
            json!({
                "code": "no_better_than_mean",
                "message": format!(
                    "the estimates of held-out demonstrations are as far from their anchors as the mean anchor is ({:.0} and {:.0} mm in the \
                     median): the encoder has not learned where the object is; train for longer, and check that the images are those of \
                     camera {:?}, show the object, and belong to the actions",
                    1e3 * own,
                    1e3 * mean,
                    config.camera,
                ),
            })
        });
        contradictions.chain(no_better).collect()
    }

    /// The demonstrations whose anchor is far from their estimates before the grasp, with the distance in metres: much farther than in
    /// the other demonstrations, and farther than demonstrators' grasps differ.
    fn contradictions(&self) -> impl Iterator<Item = (u32, f64)> {
        let typical = upper_median(self.distances.iter().map(|(_, distance)| *distance)).unwrap_or_default();
        let limit = (CONTRADICTS * typical).max(MINIMUM_CONTRADICTION);
        self.distances
            .iter()
            .copied()
            .filter(move |(_, distance)| *distance > limit)
    }

    /// The median distance of the estimates before the grasp from the anchor of their held-out demonstration, and that of the mean
    /// anchor of the training set, if the former is not clearly smaller.
    fn no_better_than_mean(&self) -> Option<(f64, f64)> {
        let (sum, count) = self.trained_on;
        let mean = sum / count;
        let of_mean = self.held_out.iter().flat_map(|(anchor, frames)| {
            let distance = (mean - anchor).norm();
            std::iter::repeat_n(distance, *frames)
        });
        let own = upper_median(self.of_held_out.iter().copied())?;
        let of_mean = upper_median(of_mean)?;
        (own > NO_BETTER * of_mean).then_some((own, of_mean))
    }
}

columns! {
    /// The only columns of table `frames` that are read before the poses are written.
    pub struct EefOf {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// Pose of the end effector, world frame.
        pub eef: Isometry3<f64>,
        /// Joint positions of the fingers, in metres.
        #[prefix = "finger"]
        pub fingers: [f64; 2],
    }
}

columns! {
    /// The columns of table `modes` that are read.
    pub struct ModeOf {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// Mode.
        pub mode: Mode,
    }
}

/// Reads end-effector poses and modes.
pub(super) fn read_demos(config: &EncoderConfig, episodes: &Artifact, modes: &Artifact) -> Result<Vec<Demo>> {
    let frames: Vec<EefOf> = episodes.table(FrameRow::<SpatialColumns>::table())?.read()?;
    let modes_of: Vec<ModeOf> = modes.table(ModeRow::<SpatialEvidence>::table())?.read()?;
    let ids = frames.iter().map(|row| (row.episode, row.frame));
    ensure!(
        ids.eq(modes_of.iter().map(|row| (row.episode, row.frame))),
        "cannot read {} and {}: they have different frames", episodes.path().display(), modes.path().display();
        "delete the modes artifact and segment again"
    );
    let mut demos: Vec<Demo> = Vec::new();
    for (
        row,
        (
            EefOf {
                episode, eef, fingers, ..
            },
            ModeOf { mode, .. },
        ),
    ) in frames.into_iter().zip(modes_of).enumerate()
    {
        // Recorded quaternions are stored bit for bit and may not have unit length exactly.
        let rotation = UnitQuaternion::new_normalize(eef.rotation.into_inner());
        let eef = Isometry3::from_parts(eef.translation, rotation);
        if demos.last().is_none_or(|demo| demo.episode != episode) {
            demos.push(Demo {
                episode,
                first: row as u64,
                eef: Vec::new(),
                separation: Vec::new(),
                modes: Vec::new(),
                trained_on: Demo::is_trained_on(episode, config),
            });
        }
        if let Some(demo) = demos.last_mut() {
            demo.eef.push(eef);
            demo.separation.push((fingers[0] - fingers[1]).abs());
            demo.modes.push(mode);
        }
    }
    Ok(demos)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three frames before the grasp, the command, and fingers that come to rest in the third frame that holds the object. The
    /// end effector moves by 1 mm in every step.
    fn demo(episode: u32, x: f64, trained_on: bool) -> Demo {
        let modes = [[Mode::Transit; 3], [Mode::Transfer; 3]].concat();
        Demo {
            episode,
            first: 0,
            eef: (0..6)
                .map(|frame| Isometry3::translation(x, 1e-3 * f64::from(frame), 0.0))
                .collect(),
            separation: vec![0.08, 0.08, 0.08, 0.08, 0.04, 0.04],
            modes,
            trained_on,
        }
    }

    fn agreement(config: &EncoderConfig, demos: &[Demo], poses: &[Vec<Isometry3<f64>>]) -> Agreement {
        let mut agreement = Agreement::default();
        for (demo, poses) in demos.iter().zip(poses) {
            agreement.add(demo, poses, config);
        }
        agreement
    }

    #[test]
    fn the_anchor_is_the_pose_at_the_command_and_frames_that_hold_the_object_begin_later() {
        let mut config = EncoderConfig::default();
        let (frame, training) = demo(0, 0.0, true).training(&config).unwrap();
        assert_eq!((frame, training.anchor.translation.y), (3, 3e-3));
        assert_eq!((training.before, training.held), (vec![0, 1, 2], vec![5]));
        config.anchor = GraspFrame::Settled;
        let (frame, training) = demo(0, 0.0, true).training(&config).unwrap();
        assert_eq!((frame, training.anchor.translation.y), (5, 5e-3));
        let paper = EncoderConfig::preset(re4_encoder::Preset::Paper);
        let (frame, training) = demo(0, 0.0, true).training(&paper).unwrap();
        assert_eq!((frame, training.held), (3, vec![3, 4, 5]));
        let mut open = demo(0, 0.0, true);
        open.modes.fill(Mode::Transit);
        assert!(open.training(&config).is_none());
    }

    #[test]
    fn estimates_that_are_not_nearer_than_the_mean_anchor_are_reported() {
        let config = EncoderConfig::default();
        let demos = [demo(0, 0.1, false), demo(1, -0.1, true), demo(2, 0.1, true)];
        let estimates = |x: f64| vec![vec![Isometry3::translation(x, 3e-3, 0.0); 6]; 3];
        // The mean anchor is at 0, and the held-out one at 0.1.
        let no_better =
            |demos: &[Demo], poses: &[Vec<Isometry3<f64>>]| agreement(&config, demos, poses).no_better_than_mean();
        assert_eq!(no_better(&demos, &estimates(0.09)), None);
        let (own, mean) = no_better(&demos, &estimates(0.005)).unwrap();
        assert!((own - 0.095).abs() < 1e-9 && (mean - 0.1).abs() < 1e-9);
        assert_eq!(no_better(&demos[1..], &estimates(0.0)[1..]), None);
    }

    #[test]
    fn an_anchor_far_from_the_estimates_is_a_contradiction() {
        let config = EncoderConfig::default();
        let demos = [demo(0, 0.1, false), demo(1, -0.1, true), demo(2, 0.2, true)];
        let poses: Vec<_> = [0.11, -0.1, 0.3]
            .map(|x| vec![Isometry3::translation(x, 3e-3, 0.0); 6])
            .into();
        let agreement = agreement(&config, &demos, &poses);
        let found: Vec<u32> = agreement.contradictions().map(|(demo, _)| demo).collect();
        assert_eq!(found, [2]);
    }
}
