//! Estimates the block's pose from an image.

use std::f64::consts::TAU;

use re4_artifact::columns;
use re4_geometry::{Point2, Pose2};

use crate::anchor::Anchor;
use crate::component::{centroid, largest};
use crate::image::{BlockLayer, PushtImage, Storage};
use crate::log_polar::{LogPolar, Signature};
use crate::outline::Outline;
use crate::refine::{agreement, refine};

/// Minimum area of the largest region, as a fraction of the block's area; a smaller region is not taken for the block.
const MINIMUM_REGION: f64 = 0.15;

/// Maximum block-coloured area outside of the outline, as a fraction of the block's area; more indicates a second block.
const MAXIMUM_OUTSIDE: f64 = 0.25;

/// Minimum visible fraction of the block; with less, the pose is unreliable.
const MINIMUM_VISIBLE: f64 = 0.7;

/// Minimum intersection over union of outline and image; with less, the outline does not fit.
const MINIMUM_FIT: f64 = 0.8;

/// Intersection over union from which no restarts are tried.
const GOOD_FIT: f64 = 0.82;

/// Number of restarts, at equally spaced angles, if the first fit is poor.
const RESTARTS: usize = 12;

/// The reliability of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Flag {
    /// The outline fits the visible part of the image.
    Clear,
    /// Much of the block is hidden; the pose is unreliable.
    Occluded,
    /// The outline does not fit the visible part of the image; the pose is unreliable.
    PoorFit,
    /// There is block-coloured area outside of the outline: a second block, or something else of that colour.
    SecondBlock,
    /// No or too little block-coloured area is visible; there is no pose.
    NoBlock,
}

impl Flag {
    /// All flags.
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
        /// Estimated pose of the block's frame, with the angle in [0, 2 pi); null if no block is visible.
        #[frame = "world"]
        #[prefix = "object"]
        pub pose: Option<Pose2>,
        /// Intersection over union of the block's outline at the pose and the block-coloured pixels, computed where neither the
        /// pusher nor a contact mark hides them, times the visible fraction of the outline: 0 (no agreement) to 1. Because the
        /// images are coarse, an exact pose of a completely visible block has 0.9 to 0.97.
        pub confidence: f64,
        /// Reliability of the pose: clear; occluded, poor_fit or second_block if the pose is unreliable; no_block if there is no
        /// pose.
        pub flag: Flag,
    }
}

impl Estimate {
    const NO_BLOCK: Self = Self {
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
    /// The centroid in the block's frame, including the stroke.
    centroid: Point2,
    outline: Outline,
    refined: bool,
    /// Fraction of each pixel that the goal covers.
    goal: Vec<f32>,
    storage: Storage,
}

impl LogPolarEstimator {
    /// An estimator that measures angles relative to `anchor`, for a block of this outline. If `refined` is set, the paper's
    /// closed-form estimate is refined by alignment of the outline with the image.
    pub fn new(anchor: &Anchor, outline: Outline, refined: bool) -> Self {
        let log_polar = LogPolar::new();
        Self {
            signature: log_polar.signature(anchor.fractions(), anchor.centroid()),
            log_polar,
            angle: anchor.goal().theta,
            centroid: outline.centroid(),
            outline,
            refined,
            goal: anchor.fractions().to_vec(),
            storage: Storage::Lossless,
        }
    }

    /// The same estimator for images that were stored in this way.
    #[must_use]
    pub fn for_images(self, storage: Storage) -> Self {
        Self { storage, ..self }
    }

    /// Estimates the pose of the block in an image.
    pub fn estimate(&self, image: &PushtImage<'_>) -> Estimate {
        let layer = BlockLayer::of(image, self.storage, &self.goal);
        let Some(region) = largest(&layer.fractions, &layer.pixels) else {
            return Estimate::NO_BLOCK;
        };
        if region.area < MINIMUM_REGION * self.outline.pixels() {
            return Estimate::NO_BLOCK;
        }
        let signature = self.log_polar.signature(&region.mask, region.centroid);
        let rotation = self.log_polar.rotation(&self.signature, &signature);
        let mut pose = self.pose_at(region.centroid, rotation);
        if self.refined {
            pose = refine(&layer, &self.outline, pose);
        }
        let mut fit = agreement(&layer, &self.outline, pose);
        if self.refined && fit.iou < GOOD_FIT {
            // A pusher in front of the block shifts the centroid, distorts the signature and may split the block: restart at
            // angles over the full circle, from the largest region's centroid and from that of all block-coloured pixels.
            for centroid in [region.centroid, centroid(&layer.fractions, &layer.pixels)] {
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
        let flag = if fit.outside > MAXIMUM_OUTSIDE {
            Flag::SecondBlock
        } else if fit.visible < MINIMUM_VISIBLE {
            Flag::Occluded
        } else if fit.iou < MINIMUM_FIT {
            Flag::PoorFit
        } else {
            Flag::Clear
        };
        Estimate {
            pose: Some(pose.normalized()),
            confidence: fit.iou * fit.visible,
            flag,
        }
    }

    /// The pose with the mask's centroid at `centroid`, rotated by `rotation` relative to the anchor.
    fn pose_at(&self, centroid: Point2, rotation: f64) -> Pose2 {
        let rotated = Pose2::new(0.0, 0.0, self.angle + rotation);
        let origin = centroid - rotated.transform_point(self.centroid);
        Pose2::new(origin.x, origin.y, rotated.theta)
    }
}
