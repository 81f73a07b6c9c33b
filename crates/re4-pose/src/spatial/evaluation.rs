//! Compares the estimates of whole demonstrations with their recorded poses, and with two baselines: a constant and the labels.

use nalgebra::Isometry3;
use re4_geometry::spatial::{Symmetry, SymmetryError, SymmetryGroup};

use super::{FrameError, GraspPhase, Offset, arrival_error, mean_pose};

/// Maximum number of query frames per held-out demonstration, evenly spaced.
const MAXIMUM_QUERIES: usize = 32;

/// The distance in metres that counts as one rad when the nearest frame is retrieved, as in the policies.
const METRES_PER_RAD: f64 = 0.1;

/// A demonstration with its estimated poses; all lists have one entry per frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Demonstration {
    /// Whether the estimator was trained on this demonstration.
    pub trained_on: bool,
    /// Phase of each frame.
    pub phases: Vec<GraspPhase>,
    /// Estimated poses of the object.
    pub estimated: Vec<Isometry3<f64>>,
    /// Recorded poses of the object.
    pub recorded: Vec<Isometry3<f64>>,
    /// Poses of the grip site.
    pub eef: Vec<Isometry3<f64>>,
}

impl Demonstration {
    /// The grasp frame g(d): the first frame in transfer.
    pub fn grasp_frame(&self) -> Option<usize> {
        self.phases.iter().position(|phase| *phase == GraspPhase::Held)
    }

    /// The training label of a frame: the end effector's pose in transfer, that at g(d) before it, and `None` otherwise.
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

/// Errors of one estimation method, after the offset fitted for it is removed.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The offset, fitted only on frames before the grasp of the demonstrations trained on.
    pub offset: Offset,
    /// Errors by demonstration and frame; `None` if a frame has no estimate.
    pub errors: Vec<Vec<Option<FrameError>>>,
}

/// The error of a grasp that is transported to a held-out demonstration; see [`arrival_error`]. The recorded pose of each object
/// is that at the grasp, because in robosuite objects still fall onto the table in the first frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Distance from the correct position, in metres.
    pub distance: f64,
    /// Angle to the correct orientation, in rad.
    pub angle: f64,
}

/// Evaluation of the estimates of some demonstrations.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The estimates; `None` if no frame can calibrate the offset, here and in the next two fields.
    pub estimates: Option<Measured>,
    /// The training labels as estimates, for frames that have them. Their spread is that of the demonstrator's grasps. An
    /// encoder that memorises the labels has these errors; one that generalises averages them and can be better.
    pub labels: Option<Measured>,
    /// The same pose for every frame: the mean of the training labels of frames before the grasp.
    pub mean: Option<Measured>,
    /// Grasps of the training demonstrations, transported to frames before the first grasp of the held-out demonstrations: each
    /// from the frame with the nearest estimated pose.
    pub arrivals: Vec<Arrival>,
}

/// Evaluates the estimates of demonstrations with an object of this symmetry.
///
/// # Errors
/// If the symmetry is invalid.
///
/// # Panics
/// If the lists of a demonstration differ in length.
pub fn evaluate(demonstrations: &[Demonstration], symmetry: Symmetry) -> Result<Evaluation, SymmetryError> {
    for own in demonstrations {
        let frames = own.phases.len();
        assert!(
            own.estimated.len() == frames && own.recorded.len() == frames && own.eef.len() == frames,
            "all lists must have one entry per frame"
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

/// A frame before a demonstration's first grasp, with the frame of that grasp.
#[derive(Clone, Copy)]
struct PreGraspFrame<'a> {
    own: &'a Demonstration,
    frame: usize,
    grasp: usize,
}

impl PreGraspFrame<'_> {
    fn estimated(&self) -> &Isometry3<f64> {
        &self.own.estimated[self.frame]
    }

    /// The recorded pose of the object at the grasp.
    fn recorded(&self) -> &Isometry3<f64> {
        &self.own.recorded[self.grasp]
    }
}

fn arrivals(demonstrations: &[Demonstration], symmetry: &SymmetryGroup) -> Vec<Arrival> {
    let before_first_grasp = |own| {
        let grasp = Demonstration::grasp_frame(own).unwrap_or(0);
        (0..grasp).map(move |frame| PreGraspFrame { own, frame, grasp })
    };
    let of = |trained_on: bool| demonstrations.iter().filter(move |own| own.trained_on == trained_on);
    let known: Vec<PreGraspFrame<'_>> = of(true).flat_map(before_first_grasp).collect();
    let mut arrivals = Vec::new();
    for own in of(false) {
        let frames: Vec<PreGraspFrame<'_>> = before_first_grasp(own).collect();
        for query in frames.iter().step_by(frames.len().div_ceil(MAXIMUM_QUERIES).max(1)) {
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

/// The frame with the nearest estimated pose; ties go to the first one.
fn nearest<'a, 'b>(
    query: &Isometry3<f64>,
    known: &'b [PreGraspFrame<'a>],
    symmetry: &SymmetryGroup,
) -> Option<&'b PreGraspFrame<'a>> {
    let mut best = (f64::INFINITY, None);
    for candidate in known {
        let estimated = candidate.estimated();
        let apart = (estimated.translation.vector - query.translation.vector).norm() / METRES_PER_RAD;
        // Most candidates are already too far by their translation, so the angle is not computed.
        if apart < best.0 {
            let distance = apart + symmetry.angle(&query.rotation, &estimated.rotation);
            if distance < best.0 {
                best = (distance, Some(candidate));
            }
        }
    }
    best.1
}
