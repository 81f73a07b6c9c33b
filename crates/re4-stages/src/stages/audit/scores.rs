//! Sketches of demonstrations, from which the table `scores` is made.

use re4_audit::{PlanarDemo, SpatialDemo};
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

    /// Duration of a frame, in s.
    fn period(&self) -> f64 {
        1.0 / self.pipeline.task.control_rate() as f64
    }
}
