//! The anchor: the reference mask from which angles are measured, calibrated with the task's goal pose.
//!
//! Every image of Push-T shows the goal, the same T as the block, filled light green. Its visible pixels are the same in all
//! images, so the maximum of each pixel's goal-coloured fraction over many images is a mask of the T at the goal pose. That mask is
//! the anchor; its pose is the goal pose, which the task defines. No recorded pose is used.

use re4_fault::Remedy;
use re4_geometry::{Point2, Pose2};
use thiserror::Error;

use crate::component::{Region, largest};
use crate::image::{PushtImage, SCALE, SIDE, Storage, goal_fraction, image, is_block_in_bgr};
use crate::outline::Outline;

/// Relative tolerance between the area of the goal in the images and that of its outline.
const AREA_TOLERANCE: f64 = 0.08;

/// Tolerance for an area that is larger in lossy images, where the goal's colour reaches one pixel beyond its edges: an edge of 480 px
/// and pixels of 5.3 px add 41 % to the area. The maximum over all images adds more; videos at `LeRobot`'s settings reach 52 %.
const LOSSY_EXCESS: f64 = 0.7;

/// Tolerance between the goal's centroid in the images and that of the goal pose, in world pixels.
const POSITION_TOLERANCE: f64 = 4.0;

/// A mask of the T at a known pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Anchor {
    fractions: Vec<f32>,
    goal: Pose2,
    centroid: Point2,
}

/// Why images cannot calibrate an anchor.
#[derive(Debug, Clone, PartialEq, Error, Remedy)]
pub enum AnchorError {
    /// The goal would not be completely inside the image.
    #[error(
        "the goal pose ({:.1}, {:.1}, {:.3} rad) puts a part of the goal outside of the image, which shows 0 to 512 px",
        goal.x,
        goal.y,
        goal.theta
    )]
    #[remedy("give a goal pose inside the image")]
    GoalOutside {
        /// The goal pose.
        goal: Pose2,
    },
    /// No image was added.
    #[error("there are no images to calibrate on")]
    #[remedy("ingest the images too (ingest.images = true)")]
    NoImages,
    /// No image has a region with the goal's colour.
    #[error("none of the {images} images shows the goal's light green (144, 238, 144)")]
    #[remedy("use RGB images with 8 bits per channel, 0 to 255")]
    NoGoal {
        /// Number of images that were searched.
        images: usize,
    },
    /// The channels are in BGR order.
    #[error("the images are in BGR order: {pixels} pixels have the block's colour as BGR and none as RGB")]
    #[remedy("convert the images to RGB")]
    Bgr {
        /// Number of pixels that have the block's colour as BGR.
        pixels: usize,
    },
    /// The goal's region has the wrong size.
    #[error(
        "the goal in the {images} images covers {found:.0} px^2 and should cover {expected:.0}: it is never completely visible, or it is rendered differently"
    )]
    #[remedy("ingest more episodes")]
    Area {
        /// Number of images that were searched.
        images: usize,
        /// Area in the images, world px^2.
        found: f64,
        /// Area of the outline, world px^2.
        expected: f64,
    },
    /// The goal's region is at the wrong position.
    #[error(
        "the goal in the images has its centre at ({:.1}, {:.1}), but the goal pose puts it at ({:.1}, {:.1})",
        found.x,
        found.y,
        expected.x,
        expected.y
    )]
    #[remedy("give the goal pose of this dataset")]
    Position {
        /// Centroid in the images, world px.
        found: Point2,
        /// Centroid for the goal pose, world px.
        expected: Point2,
    },
}

/// Accumulates the visible parts of the goal over images. The order of the images does not matter.
#[derive(Debug, Clone)]
pub struct AnchorBuilder {
    fractions: Vec<f32>,
    images: usize,
    block_pixels: usize,
    bgr_pixels: usize,
}

impl Default for AnchorBuilder {
    fn default() -> Self {
        Self {
            fractions: vec![0.0; SIDE * SIDE],
            images: 0,
            block_pixels: 0,
            bgr_pixels: 0,
        }
    }
}

impl AnchorBuilder {
    /// Adds an image.
    pub fn add(&mut self, image: &PushtImage<'_>) {
        self.images += 1;
        for (fraction, &pixel) in self.fractions.iter_mut().zip(image.pixels()) {
            *fraction = fraction.max(goal_fraction(pixel));
            let [red, green, blue] = pixel;
            self.bgr_pixels += usize::from(is_block_in_bgr(pixel));
            self.block_pixels += usize::from(is_block_in_bgr([blue, green, red]));
        }
    }

    /// The anchor from the added images, for a T of this outline with the goal pose `goal`. Lossy images have the goal's colour beyond its
    /// edges: for them the anchor is the outline at the goal pose, and the images only have to show the goal there.
    ///
    /// # Errors
    /// If the goal is not completely visible over all images, or is not at `goal`.
    pub fn finish(self, goal: Pose2, outline: &Outline, storage: Storage) -> Result<Anchor, AnchorError> {
        if self.images == 0 {
            return Err(AnchorError::NoImages);
        }
        if self.block_pixels == 0 && self.bgr_pixels > 0 {
            return Err(AnchorError::Bgr {
                pixels: self.bgr_pixels,
            });
        }
        let seen = Anchor::of_goal_mask(&self.fractions, goal, outline, self.images, storage)?;
        match storage {
            Storage::Lossless => Ok(seen),
            Storage::Lossy => Anchor::of_outline(goal, outline),
        }
    }
}

impl Anchor {
    /// The anchor that is computed from the outline, without images.
    fn of_outline(goal: Pose2, outline: &Outline) -> Result<Self, AnchorError> {
        Self::from_goal_mask(&outline.without_stroke().mask(goal), goal, outline)
    }

    /// The anchor from a mask of the goal: for each of the 96 x 96 pixels, row by row, the fraction that has the goal's colour.
    ///
    /// # Errors
    /// If the mask does not show a goal at `goal`.
    pub fn from_goal_mask(fractions: &[f32], goal: Pose2, outline: &Outline) -> Result<Self, AnchorError> {
        Self::of_goal_mask(fractions, goal, outline, 1, Storage::Lossless)
    }

    fn of_goal_mask(
        fractions: &[f32],
        goal: Pose2,
        outline: &Outline,
        images: usize,
        storage: Storage,
    ) -> Result<Self, AnchorError> {
        let outline = outline.without_stroke();
        let inside = |v: f64| (0.0..=(SIDE - 1) as f64).contains(&image(v));
        if !outline.corners(goal).all(|corner| inside(corner.x) && inside(corner.y)) {
            return Err(AnchorError::GoalOutside { goal });
        }
        if fractions.len() != SIDE * SIDE {
            return Err(AnchorError::NoGoal { images });
        }
        let covered: Vec<usize> = (0..fractions.len()).filter(|&at| fractions[at] > 0.0).collect();
        let Region { area, centroid, mask } = largest(fractions, &covered).ok_or(AnchorError::NoGoal { images })?;
        let expected_area = outline.pixels() * SCALE * SCALE;
        let found = area * SCALE * SCALE;
        let excess = found / expected_area - 1.0;
        let largest_excess = match storage {
            Storage::Lossless => AREA_TOLERANCE,
            Storage::Lossy => LOSSY_EXCESS,
        };
        if excess < -AREA_TOLERANCE || excess > largest_excess {
            return Err(AnchorError::Area {
                images,
                found,
                expected: expected_area,
            });
        }
        let expected = goal.transform_point(outline.centroid());
        if (centroid - expected).norm() > POSITION_TOLERANCE {
            return Err(AnchorError::Position {
                found: centroid,
                expected,
            });
        }
        Ok(Self {
            fractions: mask,
            goal,
            centroid,
        })
    }

    /// For each of the 96 x 96 pixels, row by row, the fraction that has the goal's colour.
    pub fn fractions(&self) -> &[f32] {
        &self.fractions
    }

    /// Pose of the T in the mask: the goal pose.
    pub fn goal(&self) -> Pose2 {
        self.goal
    }

    /// Centroid of the mask, world frame, px.
    pub fn centroid(&self) -> Point2 {
        self.centroid
    }
}
