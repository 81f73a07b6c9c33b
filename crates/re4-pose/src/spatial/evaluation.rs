//! Estimates of whole demonstrations against their recorded poses, beside what a constant and the labels would score.

use nalgebra::Isometry3;
use re4_geometry::spatial::{Symmetry, SymmetryError, SymmetryGroup};

use super::{FrameError, GraspPhase, Offset, arrival_error, mean_pose};

/// Frames of a held-out demonstration that ask for a grasp, at most; evenly spaced.
const QUERIES: usize = 32;

/// The distance in metres that counts as much as a rad when the nearest frame is retrieved, as the policies have it.
const METRES_PER_RAD: f64 = 0.1;

/// A demonstration with its estimated poses; all lists have one entry a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Demonstration {
    /// Whether the estimator was trained on it.
    pub trained_on: bool,
    /// When each frame is.
    pub phases: Vec<GraspPhase>,
    /// Estimated poses of the object.
    pub estimated: Vec<Isometry3<f64>>,
    /// Recorded poses of the object.
    pub recorded: Vec<Isometry3<f64>>,
    /// Grip site.
    pub eef: Vec<Isometry3<f64>>,
}

impl Demonstration {
    /// The grasp frame g(d): the first one in transfer.
    pub fn grasp_frame(&self) -> Option<usize> {
        self.phases.iter().position(|phase| *phase == GraspPhase::Held)
    }

    /// What a frame is labelled with for training: the end effector in transfer, that at g(d) before it, and otherwise nothing.
    fn label(&self, frame: usize) -> Option<Isometry3<f64>> {
        let grasp = self.grasp_frame()?;
        match self.phases[frame] {
            GraspPhase::Held => Some(self.eef[frame]),
            _ => (frame < grasp).then(|| self.eef[grasp]),
        }
    }

    fn before_grasp(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.phases.len()).filter(|&frame| self.phases[frame] == GraspPhase::BeforeGrasp)
    }
}

/// Errors of one way to estimate, after the offset that was fitted for it is taken away.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Fitted on frames before the grasp of the demonstrations that were trained on, and on nothing else.
    pub offset: Offset,
    /// By demonstration and frame; nothing where there is no estimate.
    pub errors: Vec<Vec<Option<FrameError>>>,
}

/// Where a grasp that is carried to a held-out demonstration would arrive; see [`arrival_error`]. Both objects are taken to be
/// where they are when they are grasped: in robosuite they still fall onto the table in the first frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Distance from where it should, in metres.
    pub distance: f64,
    /// Angle to how it should, in rad.
    pub angle: f64,
}

/// What the estimates of some demonstrations are worth.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The estimates. Nothing where no frame can fix the offset; the same holds for the other two.
    pub estimates: Option<Measured>,
    /// The labels of training as estimates, where frames have them: their spread is that of the demonstrator's grasps, and an
    /// encoder that learned them by heart would have their errors. One that generalises averages them, and can be better.
    pub labels: Option<Measured>,
    /// One and the same pose for every frame: the mean of the labels of the frames before the grasp that were trained on.
    pub mean: Option<Measured>,
    /// Grasps of the demonstrations trained on, carried to frames before the first grasp of those held out: each time from the
    /// frame whose estimated pose is nearest.
    pub arrivals: Vec<Arrival>,
}

/// Measures the estimates of demonstrations. The object has this symmetry.
///
/// # Errors
/// When the symmetry is none.
///
/// # Panics
/// When the lists of a demonstration differ in length.
pub fn evaluate(demonstrations: &[Demonstration], symmetry: Symmetry) -> Result<Evaluation, SymmetryError> {
    for own in demonstrations {
        let frames = own.phases.len();
        assert!(
            own.estimated.len() == frames && own.recorded.len() == frames && own.eef.len() == frames,
            "one entry a frame"
        );
    }
    let trained_on = || demonstrations.iter().filter(|own| own.trained_on);
    let labels: Vec<Isometry3<f64>> = trained_on()
        .flat_map(|own| own.before_grasp().filter_map(|frame| own.label(frame)))
        .collect();
    let mean = mean_pose(&labels);
    Ok(Evaluation {
        estimates: measure(demonstrations, symmetry, |own, frame| Some(own.estimated[frame]))?,
        labels: measure(demonstrations, symmetry, Demonstration::label)?,
        mean: measure(demonstrations, symmetry, |_, _| mean)?,
        arrivals: arrivals(demonstrations, &symmetry.group()?),
    })
}

fn measure(
    demonstrations: &[Demonstration],
    symmetry: Symmetry,
    estimate: impl Fn(&Demonstration, usize) -> Option<Isometry3<f64>>,
) -> Result<Option<Measured>, SymmetryError> {
    let mut pairs = Vec::new();
    for own in demonstrations.iter().filter(|own| own.trained_on) {
        let known = own
            .before_grasp()
            .filter_map(|frame| Some([estimate(own, frame)?, own.recorded[frame]]));
        pairs.extend(known);
    }
    let Some(offset) = Offset::fit(&pairs, symmetry)? else {
        return Ok(None);
    };
    let of_frame = |own: &Demonstration, frame: usize| Some(offset.error(&estimate(own, frame)?, &own.recorded[frame]));
    let errors = demonstrations
        .iter()
        .map(|own| (0..own.phases.len()).map(|frame| of_frame(own, frame)).collect())
        .collect();
    Ok(Some(Measured { offset, errors }))
}

/// A frame before a demonstration's first grasp, and the frame of that.
#[derive(Clone, Copy)]
struct Waiting<'a> {
    own: &'a Demonstration,
    frame: usize,
    grasp: usize,
}

impl Waiting<'_> {
    fn estimated(&self) -> &Isometry3<f64> {
        &self.own.estimated[self.frame]
    }

    /// Where the object is when it is grasped.
    fn recorded(&self) -> &Isometry3<f64> {
        &self.own.recorded[self.grasp]
    }
}

fn arrivals(demonstrations: &[Demonstration], symmetry: &SymmetryGroup) -> Vec<Arrival> {
    let waiting = |own| {
        let grasp = Demonstration::grasp_frame(own).unwrap_or(0);
        (0..grasp).map(move |frame| Waiting { own, frame, grasp })
    };
    let of = |trained_on: bool| demonstrations.iter().filter(move |own| own.trained_on == trained_on);
    let known: Vec<Waiting<'_>> = of(true).flat_map(waiting).collect();
    let mut arrivals = Vec::new();
    for own in of(false) {
        let frames: Vec<Waiting<'_>> = waiting(own).collect();
        for query in frames.iter().step_by(frames.len().div_ceil(QUERIES).max(1)) {
            let Some(demo) = nearest(query.estimated(), &known, symmetry) else {
                continue;
            };
            let (distance, angle) = arrival_error(
                symmetry,
                [query.estimated(), query.recorded()],
                [demo.estimated(), demo.recorded()],
                &demo.own.eef[demo.grasp],
            );
            arrivals.push(Arrival { distance, angle });
        }
    }
    arrivals
}

/// The frame whose estimated pose is nearest; ties go to the first.
fn nearest<'a, 'b>(
    query: &Isometry3<f64>,
    known: &'b [Waiting<'a>],
    symmetry: &SymmetryGroup,
) -> Option<&'b Waiting<'a>> {
    let mut best = (f64::INFINITY, None);
    for candidate in known {
        let estimated = candidate.estimated();
        let apart = (estimated.translation.vector - query.translation.vector).norm() / METRES_PER_RAD;
        // Most are too far away for their turn to matter.
        if apart < best.0 {
            let distance = apart + symmetry.angle(&query.rotation, &estimated.rotation);
            if distance < best.0 {
                best = (distance, Some(candidate));
            }
        }
    }
    best.1
}
