//! The estimator: from an image to the block's pose.

use std::f64::consts::TAU;

use re4_artifact::columns;
use re4_geometry::{Point2, Pose2};

use crate::anchor::Anchor;
use crate::component::{centroid, largest};
use crate::image::{BlockLayer, PushtImage};
use crate::log_polar::{LogPolar, Signature};
use crate::outline::Outline;
use crate::refine::{agreement, refine};

/// A largest region of less than this fraction of the block's area is not taken for the block.
const LEAST_REGION: f64 = 0.15;

/// More block-coloured area than this beyond the outline, as a fraction of the block's, is a second block.
const MOST_BEYOND: f64 = 0.25;

/// With less than this fraction of the block in view, its pose is a guess.
const LEAST_SEEN: f64 = 0.7;

/// With less intersection over union than this, the outline does not fit.
const LEAST_FIT: f64 = 0.8;

/// Agreement that a second start may improve on.
const GOOD_FIT: f64 = 0.82;

/// Starts, evenly over the circle, where the first one did not fit.
const RESTARTS: usize = 12;

/// What to think of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Flag {
    /// The outline fits what is seen.
    Clear,
    /// Much of the block is hidden; the pose is a guess.
    Occluded,
    /// The outline does not fit what is seen; the pose is a guess.
    PoorFit,
    /// Block-coloured area is left over: there are two blocks, or something else of that colour.
    SecondBlock,
    /// Nothing of the block's colour is seen, or too little of it; there is no pose.
    NoBlock,
}

impl Flag {
    /// Every flag.
    pub const ALL: [Self; 5] = [
        Self::Clear,
        Self::Occluded,
        Self::PoorFit,
        Self::SecondBlock,
        Self::NoBlock,
    ];

    /// The word used in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Clear => "clear",
            Self::Occluded => "occluded",
            Self::PoorFit => "poor_fit",
            Self::SecondBlock => "second_block",
            Self::NoBlock => "no_block",
        }
    }
}

columns! {
    /// An estimated pose.
    #[derive(Copy)]
    pub struct Estimate {
        /// Estimated pose of the block's frame, its angle in [0, 2 pi); null where no block is seen.
        #[frame = "world"]
        #[prefix = "object"]
        pub pose: Option<Pose2>,
        /// Intersection over union of the block's outline at the pose with the block-coloured pixels, over what neither the pusher nor
        /// a contact mark hides, times the fraction of the outline in view: 0 (nothing agrees) to 1. Images being coarse, an exact
        /// pose in full view has 0.9 to 0.97.
        pub confidence: f64,
        /// What to think of the pose: clear; or occluded, poor_fit or second_block, when it is a guess; or no_block, when there is
        /// none.
        pub flag: Flag,
    }
}

impl Estimate {
    const NOTHING: Self = Self {
        pose: None,
        confidence: 0.0,
        flag: Flag::NoBlock,
    };
}

/// The log-polar pose estimator of Push-T.
#[derive(Clone)]
pub struct LogPolarEstimator {
    log_polar: LogPolar,
    signature: Signature,
    /// Angle of the T in the anchor.
    angle: f64,
    /// The mask's centroid in the block's frame, by the anchor.
    centroid: Point2,
    outline: Outline,
    refined: bool,
}

impl LogPolarEstimator {
    /// An estimator that measures angles from `anchor`, for a block of this outline. With `refined`, the outline is aligned
    /// with the image after the paper's estimate.
    pub fn new(anchor: &Anchor, outline: Outline, refined: bool) -> Self {
        let log_polar = LogPolar::new();
        Self {
            signature: log_polar.signature(anchor.share(), anchor.centroid()),
            log_polar,
            angle: anchor.goal().theta,
            centroid: outline.centroid(),
            outline,
            refined,
        }
    }

    /// The pose of the block in an image.
    pub fn estimate(&self, image: &PushtImage<'_>) -> Estimate {
        let layer = BlockLayer::of(image);
        let Some(region) = largest(&layer.share, &layer.pixels) else {
            return Estimate::NOTHING;
        };
        if region.area < LEAST_REGION * self.outline.pixels() {
            return Estimate::NOTHING;
        }
        let signature = self.log_polar.signature(&region.mask, region.centroid);
        let rotation = self.log_polar.rotation(&self.signature, &signature);
        let mut pose = self.pose_at(region.centroid, rotation);
        if self.refined {
            pose = refine(&layer, &self.outline, pose);
        }
        let mut fit = agreement(&layer, &self.outline, pose);
        if self.refined && fit.iou < GOOD_FIT {
            // A pusher before the block moves the centroid, distorts the signature and may cut the block in two: try the
            // whole circle, about the largest region's centroid and about that of all that has the block's colour.
            for centroid in [region.centroid, centroid(&layer.share, &layer.pixels)] {
                for start in 0..RESTARTS {
                    let angle = rotation + TAU * start as f64 / RESTARTS as f64;
                    let other = refine(&layer, &self.outline, self.pose_at(centroid, angle));
                    let other_fit = agreement(&layer, &self.outline, other);
                    if other_fit.iou > fit.iou {
                        (pose, fit) = (other, other_fit);
                    }
                }
            }
        }
        let flag = if fit.beyond > MOST_BEYOND {
            Flag::SecondBlock
        } else if fit.seen < LEAST_SEEN {
            Flag::Occluded
        } else if fit.iou < LEAST_FIT {
            Flag::PoorFit
        } else {
            Flag::Clear
        };
        Estimate {
            pose: Some(pose.normalized()),
            confidence: fit.iou * fit.seen,
            flag,
        }
    }

    /// The pose that has its mask's centroid there and is turned from the anchor by `rotation`.
    fn pose_at(&self, centroid: Point2, rotation: f64) -> Pose2 {
        let turned = Pose2::new(0.0, 0.0, self.angle + rotation);
        let origin = centroid - turned.transform_point(self.centroid);
        Pose2::new(origin.x, origin.y, turned.theta)
    }
}
