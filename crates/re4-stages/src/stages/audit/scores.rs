//! Sketches of demonstrations, from which the table `scores` is made.

use re4_audit::{ArmDemo, ArmFacts, PlanarDemo, SpatialDemo};
use re4_scores::{Motion, Sketch};

use crate::runner::Runner;

impl Runner {
    pub(super) fn sketch_spatial(&self, demo: &SpatialDemo) -> Sketch {
        let segments: Vec<_> = demo.segmented.segments.iter().map(|s| s.segment.clone()).collect();
        Sketch::of(demo.number, &Motion::spatial(&demo.episode, &segments, self.period()))
    }

    pub(super) fn sketch_planar(&self, demo: &PlanarDemo) -> Sketch {
        let segments: Vec<_> = demo.segmented.segments.iter().map(|s| s.segment.clone()).collect();
        Sketch::of(demo.number, &Motion::planar(&demo.episode, &segments, self.period()))
    }

    /// The arm's control rate is that of robosuite if the dataset states none.
    pub(super) fn sketch_arm(&self, demo: &ArmDemo, facts: &ArmFacts) -> Sketch {
        let segments: Vec<_> = demo.segmented.segments.iter().map(|s| s.segment.clone()).collect();
        let openings: Option<Vec<f64>> = demo.segmented.evidence.iter().map(|e| e.opening).collect();
        let period = facts.period.unwrap_or_else(|| self.period());
        Sketch::of(
            demo.number,
            &Motion::arm(&demo.episode.frames, openings.as_deref(), &segments, period),
        )
    }

    /// Duration of a frame, in s.
    fn period(&self) -> f64 {
        1.0 / self.pipeline.task.control_rate() as f64
    }
}
