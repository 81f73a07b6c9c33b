//! The anchor: the one frame of reference for angles, calibrated by the task's goal pose.
//!
//! Every picture of Push-T shows the goal, the same T as the block, filled light green. Where it is not hidden, its pixels
//! are the same in all pictures; the greatest share of the goal's colour over many pictures is a mask of the T at the
//! goal pose. That mask is the anchor, and the goal pose, which the task gives, is its pose. No recorded pose is used.

use re4_fault::Remedy;
use re4_geometry::{Point2, Pose2};
use thiserror::Error;

use crate::component::{Region, largest};
use crate::outline::Outline;
use crate::picture::{Picture, SCALE, SIDE, goal_share, is_block_in_bgr, picture};

/// The goal seen in pictures may have this share of its area more or less than its outline.
const AREA_TOLERANCE: f64 = 0.08;

/// The goal may be seen this far, in world pixels, from where its pose says.
const PLACE_TOLERANCE: f64 = 4.0;

/// A mask of the T at a known pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Anchor {
    share: Vec<f32>,
    goal: Pose2,
    centroid: Point2,
}

/// Why pictures give no anchor.
#[derive(Debug, Clone, PartialEq, Error, Remedy)]
pub enum AnchorError {
    /// The goal pose would not be seen.
    #[error(
        "the goal pose ({:.1}, {:.1}, {:.3} rad) puts a part of the goal outside of the picture, which shows 0 to 512 px",
        goal.x,
        goal.y,
        goal.theta
    )]
    #[remedy("give a goal pose that lies inside")]
    GoalOutside {
        /// The goal pose.
        goal: Pose2,
    },
    /// No picture to look at.
    #[error("there is no picture to calibrate on")]
    #[remedy("ingest the pictures too (ingest.images = true)")]
    NoPictures,
    /// No region with the goal's colour.
    #[error("none of the {pictures} pictures looked at shows the goal's light green (144, 238, 144)")]
    #[remedy("pictures of Push-T have 8 bits a channel, 0 to 255, in the order RGB")]
    NoGoal {
        /// Pictures looked at.
        pictures: usize,
    },
    /// Red and blue have changed places.
    #[error("the pictures hold blue before red: {pixels} pixels have the block's colour read as BGR and none as RGB")]
    #[remedy("convert them to RGB")]
    Bgr {
        /// Pixels with the block's colour backwards.
        pixels: usize,
    },
    /// The goal's region has another size.
    #[error(
        "the goal seen in {pictures} pictures covers {found:.0} px^2 and should cover {expected:.0}: it is never seen whole, or drawn otherwise"
    )]
    #[remedy("ingest more episodes")]
    Area {
        /// Pictures looked at.
        pictures: usize,
        /// Area seen.
        found: f64,
        /// Area of the outline.
        expected: f64,
    },
    /// The goal is elsewhere.
    #[error(
        "the goal in the pictures has its centre at ({:.1}, {:.1}) and the goal pose puts it at ({:.1}, {:.1})",
        found.x,
        found.y,
        expected.x,
        expected.y
    )]
    #[remedy("give the goal pose of this dataset")]
    Place {
        /// Centroid seen.
        found: Point2,
        /// Centroid by the goal pose.
        expected: Point2,
    },
}

/// Collects what pictures show of the goal. The order of pictures does not matter.
#[derive(Debug, Clone)]
pub struct AnchorBuilder {
    share: Vec<f32>,
    pictures: usize,
    block_pixels: usize,
    bgr_pixels: usize,
}

impl Default for AnchorBuilder {
    fn default() -> Self {
        Self {
            share: vec![0.0; SIDE * SIDE],
            pictures: 0,
            block_pixels: 0,
            bgr_pixels: 0,
        }
    }
}

impl AnchorBuilder {
    /// Looks at a picture.
    pub fn add(&mut self, picture: &Picture<'_>) {
        self.pictures += 1;
        for (share, &pixel) in self.share.iter_mut().zip(picture.pixels()) {
            *share = share.max(goal_share(pixel));
            let [red, green, blue] = pixel;
            self.bgr_pixels += usize::from(is_block_in_bgr(pixel));
            self.block_pixels += usize::from(is_block_in_bgr([blue, green, red]));
        }
    }

    /// The anchor of the pictures that were added, for a T of this outline whose goal is at `goal`.
    ///
    /// # Errors
    /// When the goal was not seen whole, or not where `goal` says.
    pub fn finish(self, goal: Pose2, outline: &Outline) -> Result<Anchor, AnchorError> {
        if self.pictures == 0 {
            return Err(AnchorError::NoPictures);
        }
        if self.block_pixels == 0 && self.bgr_pixels > 0 {
            return Err(AnchorError::Bgr {
                pixels: self.bgr_pixels,
            });
        }
        Anchor::of_goal_mask(&self.share, goal, outline, self.pictures)
    }
}

impl Anchor {
    /// The anchor of a mask of the goal: for each of the 96 x 96 pixels, row by row, the share that has the goal's colour.
    ///
    /// # Errors
    /// When the mask is not that of a goal at `goal`.
    pub fn from_goal_mask(share: &[f32], goal: Pose2, outline: &Outline) -> Result<Self, AnchorError> {
        Self::of_goal_mask(share, goal, outline, 1)
    }

    fn of_goal_mask(share: &[f32], goal: Pose2, outline: &Outline, pictures: usize) -> Result<Self, AnchorError> {
        let outline = outline.without_stroke();
        let inside = |v: f64| (0.0..=(SIDE - 1) as f64).contains(&picture(v));
        if !outline.corners(goal).all(|corner| inside(corner.x) && inside(corner.y)) {
            return Err(AnchorError::GoalOutside { goal });
        }
        if share.len() != SIDE * SIDE {
            return Err(AnchorError::NoGoal { pictures });
        }
        let covered: Vec<usize> = (0..share.len()).filter(|&at| share[at] > 0.0).collect();
        let Region { area, centroid, mask } = largest(share, &covered).ok_or(AnchorError::NoGoal { pictures })?;
        let expected_area = outline.pixels() * SCALE * SCALE;
        let found = area * SCALE * SCALE;
        if (found / expected_area - 1.0).abs() > AREA_TOLERANCE {
            return Err(AnchorError::Area {
                pictures,
                found,
                expected: expected_area,
            });
        }
        let expected = goal.transform_point(outline.centroid());
        if (centroid - expected).norm() > PLACE_TOLERANCE {
            return Err(AnchorError::Place {
                found: centroid,
                expected,
            });
        }
        Ok(Self {
            share: mask,
            goal,
            centroid,
        })
    }

    /// Share of each of the 96 x 96 pixels that has the goal's colour, row by row.
    pub fn share(&self) -> &[f32] {
        &self.share
    }

    /// Pose of the T in the anchor: the goal pose.
    pub fn goal(&self) -> Pose2 {
        self.goal
    }

    /// Centroid of the mask, world frame, px.
    pub fn centroid(&self) -> Point2 {
        self.centroid
    }
}
