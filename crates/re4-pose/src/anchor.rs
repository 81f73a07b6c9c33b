//! The anchor: the one frame of reference for angles, calibrated by the task's goal pose.
//!
//! Every image of Push-T shows the goal, the same T as the block, filled light green. Where it is not hidden, its pixels
//! are the same in all images; the maximum fraction of the goal's colour over many images is a mask of the T at the
//! goal pose. That mask is the anchor, and the goal pose, which the task gives, is its pose. No recorded pose is used.

use re4_fault::Remedy;
use re4_geometry::{Point2, Pose2};
use thiserror::Error;

use crate::component::{Region, largest};
use crate::image::{PushtImage, SCALE, SIDE, goal_fraction, image, is_block_in_bgr};
use crate::outline::Outline;

/// The goal seen in images may have this fraction of its area more or less than its outline.
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

/// Why images give no anchor.
#[derive(Debug, Clone, PartialEq, Error, Remedy)]
pub enum AnchorError {
    /// The goal pose would not be seen.
    #[error(
        "the goal pose ({:.1}, {:.1}, {:.3} rad) puts a part of the goal outside of the image, which shows 0 to 512 px",
        goal.x,
        goal.y,
        goal.theta
    )]
    #[remedy("give a goal pose that lies inside")]
    GoalOutside {
        /// The goal pose.
        goal: Pose2,
    },
    /// No image to look at.
    #[error("there is no image to calibrate on")]
    #[remedy("ingest the images too (ingest.images = true)")]
    NoImages,
    /// No region with the goal's colour.
    #[error("none of the {images} images looked at shows the goal's light green (144, 238, 144)")]
    #[remedy("images of Push-T have 8 bits a channel, 0 to 255, in the order RGB")]
    NoGoal {
        /// Images looked at.
        images: usize,
    },
    /// Red and blue have changed places.
    #[error("the images hold blue before red: {pixels} pixels have the block's colour read as BGR and none as RGB")]
    #[remedy("convert them to RGB")]
    Bgr {
        /// Pixels with the block's colour backwards.
        pixels: usize,
    },
    /// The goal's region has another size.
    #[error(
        "the goal seen in {images} images covers {found:.0} px^2 and should cover {expected:.0}: it is never seen whole, or drawn otherwise"
    )]
    #[remedy("ingest more episodes")]
    Area {
        /// Images looked at.
        images: usize,
        /// Area seen.
        found: f64,
        /// Area of the outline.
        expected: f64,
    },
    /// The goal is elsewhere.
    #[error(
        "the goal in the images has its centre at ({:.1}, {:.1}) and the goal pose puts it at ({:.1}, {:.1})",
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

/// Collects what images show of the goal. The order of images does not matter.
#[derive(Debug, Clone)]
pub struct AnchorBuilder {
    share: Vec<f32>,
    images: usize,
    block_pixels: usize,
    bgr_pixels: usize,
}

impl Default for AnchorBuilder {
    fn default() -> Self {
        Self {
            share: vec![0.0; SIDE * SIDE],
            images: 0,
            block_pixels: 0,
            bgr_pixels: 0,
        }
    }
}

impl AnchorBuilder {
    /// Looks at an image.
    pub fn add(&mut self, image: &PushtImage<'_>) {
        self.images += 1;
        for (share, &pixel) in self.share.iter_mut().zip(image.pixels()) {
            *share = share.max(goal_fraction(pixel));
            let [red, green, blue] = pixel;
            self.bgr_pixels += usize::from(is_block_in_bgr(pixel));
            self.block_pixels += usize::from(is_block_in_bgr([blue, green, red]));
        }
    }

    /// The anchor of the images that were added, for a T of this outline whose goal is at `goal`.
    ///
    /// # Errors
    /// When the goal was not seen whole, or not where `goal` says.
    pub fn finish(self, goal: Pose2, outline: &Outline) -> Result<Anchor, AnchorError> {
        if self.images == 0 {
            return Err(AnchorError::NoImages);
        }
        if self.block_pixels == 0 && self.bgr_pixels > 0 {
            return Err(AnchorError::Bgr {
                pixels: self.bgr_pixels,
            });
        }
        Anchor::of_goal_mask(&self.share, goal, outline, self.images)
    }
}

impl Anchor {
    /// The anchor of a mask of the goal: for each of the 96 x 96 pixels, row by row, the fraction that has the goal's colour.
    ///
    /// # Errors
    /// When the mask is not that of a goal at `goal`.
    pub fn from_goal_mask(share: &[f32], goal: Pose2, outline: &Outline) -> Result<Self, AnchorError> {
        Self::of_goal_mask(share, goal, outline, 1)
    }

    fn of_goal_mask(share: &[f32], goal: Pose2, outline: &Outline, images: usize) -> Result<Self, AnchorError> {
        let outline = outline.without_stroke();
        let inside = |v: f64| (0.0..=(SIDE - 1) as f64).contains(&image(v));
        if !outline.corners(goal).all(|corner| inside(corner.x) && inside(corner.y)) {
            return Err(AnchorError::GoalOutside { goal });
        }
        if share.len() != SIDE * SIDE {
            return Err(AnchorError::NoGoal { images });
        }
        let covered: Vec<usize> = (0..share.len()).filter(|&at| share[at] > 0.0).collect();
        let Region { area, centroid, mask } = largest(share, &covered).ok_or(AnchorError::NoGoal { images })?;
        let expected_area = outline.pixels() * SCALE * SCALE;
        let found = area * SCALE * SCALE;
        if (found / expected_area - 1.0).abs() > AREA_TOLERANCE {
            return Err(AnchorError::Area {
                images,
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

    /// Fraction of each of the 96 x 96 pixels that has the goal's colour, row by row.
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
