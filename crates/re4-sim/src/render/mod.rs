//! Images of Push-T: the 512 x 512 canvas and the 96 x 96 observation, byte-identical to gym-pusht 0.1.8's.
//!
//! gym-pusht renders with pygame on a white surface, in this order: the goal, then what Chipmunk's debug drawing reports (the
//! block's rectangles, the agent, the walls, and a red mark across each contact point). It then shrinks the surface with
//! `OpenCV`. The order, the colours and the rounding rules are those observed of pygame 2.6.1 and `OpenCV` 4.14.

mod paint;
mod shrink;

use re4_geometry::{Point2, Pose2};

use crate::chipmunk::{Drawing, WALL_RADIUS, WALLS};
use crate::{AGENT_RADIUS, GOAL, PushT, tee_vertices};
use paint::{Pixel, pixel, pixels};

pub use shrink::OBSERVATION_SIDE;

const SIDE: usize = 512;

const WHITE: [u8; 3] = [255, 255, 255];
const GOAL_COLOUR: [u8; 3] = [144, 238, 144];
const AGENT_COLOUR: [u8; 3] = [65, 105, 225];
/// 1.2 times the agent's colour, at most 255.
const AGENT_CORE: [u8; 3] = [78, 126, 255];
/// 1.2 times the outline's colour.
const BLOCK_COLOUR: [u8; 3] = [143, 163, 184];
const BLOCK_OUTLINE: [u8; 3] = [119, 136, 153];
const WALL_COLOUR: [u8; 3] = [211, 211, 211];
const MARK_COLOUR: [u8; 3] = [231, 76, 60];

/// Difference between the radii of the agent's disc and of the lighter disc inside it, in pixels.
const AGENT_RIM: f64 = 4.0;
/// Radius of the outline around each of the block's rectangles, in pixels.
pub const OUTLINE_RADIUS: f64 = 2.0;

/// An image of 512 x 512 pixels: 8-bit RGB, row by row from the top.
///
/// Reusing a canvas, with [`PushT::render_into`] or [`Canvas::render_state`], saves an allocation of 768 KiB per frame.
#[derive(Clone, PartialEq)]
pub struct Canvas {
    pixels: Vec<[u8; 3]>,
    goal: Pose2,
    /// White with the goal on it; every image starts from these pixels.
    background: Vec<[u8; 3]>,
}

/// What an image of a state shows: the goal, the walls, the block, the agent and the marks of contacts.
#[derive(Debug, Clone)]
pub struct Shapes {
    goal: Pose2,
    walls: [[Point2; 2]; 4],
    drawing: Drawing,
}

impl Shapes {
    pub(crate) fn new(goal: Pose2, drawing: Drawing) -> Self {
        Self {
            goal,
            walls: WALLS,
            drawing,
        }
    }

    /// The same scene as seen by a camera that stands elsewhere: everything, the walls included, is moved by `motion`.
    #[must_use]
    pub fn moved(mut self, motion: Pose2) -> Self {
        let drawing = &mut self.drawing;
        let points = drawing.circles.iter_mut();
        let points = points.chain(drawing.rectangles.iter_mut().flatten());
        let points = points.chain(drawing.marks.iter_mut().flatten());
        for point in points.chain(self.walls.iter_mut().flatten()) {
            *point = motion.transform_point(*point);
        }
        self.goal = motion.compose(self.goal);
        self
    }
}

impl std::fmt::Debug for Canvas {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Canvas").finish_non_exhaustive()
    }
}

impl Default for Canvas {
    fn default() -> Self {
        Self::new()
    }
}

impl Canvas {
    /// Width and height, in pixels.
    pub const SIDE: usize = SIDE;

    /// Background colour: red, green and blue.
    pub const PAPER: [u8; 3] = WHITE;

    /// Colour of the block's outline.
    pub const OUTLINE: [u8; 3] = BLOCK_OUTLINE;

    /// All colours of an image without contact marks.
    pub const COLOURS: [[u8; 3]; 7] = [
        WHITE,
        GOAL_COLOUR,
        AGENT_COLOUR,
        AGENT_CORE,
        BLOCK_COLOUR,
        BLOCK_OUTLINE,
        WALL_COLOUR,
    ];

    /// A canvas that shows only the goal of the task.
    pub fn new() -> Self {
        let mut canvas = Self {
            pixels: vec![WHITE; SIDE * SIDE],
            goal: GOAL,
            background: Vec::new(),
        };
        canvas.paint_background();
        canvas
    }

    /// Sets the goal of the images that are rendered from now on.
    pub fn set_goal(&mut self, goal: Pose2) {
        if goal != self.goal {
            self.goal = goal;
            self.paint_background();
        }
    }

    fn paint_background(&mut self) {
        self.pixels.fill(WHITE);
        for corners in tee_vertices(self.goal) {
            self.fill(&pixels(&corners), GOAL_COLOUR);
        }
        self.background.clone_from(&self.pixels);
    }

    /// The `512 * 512 * 3` bytes: red, green and blue of each pixel, row by row from the top.
    pub fn bytes(&self) -> &[u8] {
        self.pixels.as_flattened()
    }

    /// The image shrunk to 96 x 96, as policies observe it: `96 * 96 * 3` bytes in the order of [`Canvas::bytes`].
    ///
    /// Bilinear interpolation without antialiasing, in `OpenCV`'s fixed-point arithmetic.
    pub fn observation(&self) -> Vec<u8> {
        let mut observation = Vec::new();
        self.observation_into(&mut observation);
        observation
    }

    /// Writes [`Canvas::observation`] to a buffer, whose content is replaced.
    pub fn observation_into(&self, observation: &mut Vec<u8>) {
        shrink::shrink(&self.pixels, observation);
    }

    /// Renders a state and replaces the previous image: [`render_state`] without a new canvas, with the goal of the canvas.
    pub fn render_state(&mut self, agent: Point2, block: Pose2) {
        self.draw_scene(&[agent], &tee_vertices(block), &WALLS, &[]);
    }

    /// Renders shapes and replaces the previous image and the goal.
    pub fn render_shapes(&mut self, shapes: &Shapes) {
        self.set_goal(shapes.goal);
        let Drawing {
            circles,
            rectangles,
            marks,
        } = &shapes.drawing;
        self.draw_scene(circles, rectangles, &shapes.walls, marks);
    }

    fn draw_scene(&mut self, agents: &[Point2], block: &[[Point2; 4]], walls: &[[Point2; 2]], marks: &[[Point2; 2]]) {
        self.pixels.copy_from_slice(&self.background);
        for corners in block {
            self.fill(&pixels(corners), BLOCK_COLOUR);
            for (i, &corner) in corners.iter().enumerate() {
                let next = corners[(i + 1) % corners.len()];
                self.fat_line(pixel(corner), pixel(next), OUTLINE_RADIUS, BLOCK_OUTLINE);
            }
        }
        for &centre in agents {
            self.disc(pixel(centre), AGENT_RADIUS as i64, AGENT_COLOUR);
            self.disc(pixel(centre), (AGENT_RADIUS - AGENT_RIM) as i64, AGENT_CORE);
        }
        for &[a, b] in walls {
            self.fat_line(pixel(a), pixel(b), WALL_RADIUS, WALL_COLOUR);
        }
        for &[a, b] in marks {
            self.smooth_line(pixel(a), pixel(b), MARK_COLOUR);
        }
    }

    /// A line with round ends: a thick line, a rectangle over it and a disc at each end.
    fn fat_line(&mut self, from: Pixel, to: Pixel, radius: f64, colour: [u8; 3]) {
        let (dx, dy) = ((to.x - from.x).abs(), (to.y - from.y).abs());
        self.thick_line(from, to, (2.0 * radius) as i64, colour);
        if (dx, dy) == (0, 0) {
            return;
        }
        let scale = radius / ((dx * dx + dy * dy) as f64).sqrt();
        // This is perpendicular to the line only if x and y grow together: as in gym-pusht, absolute values lose the direction.
        let x = (dy as f64 * scale).round_ties_even() as i64;
        let y = (dx as f64 * scale).round_ties_even() as i64;
        let corners = [(from, -1), (from, 1), (to, 1), (to, -1)];
        self.fill(
            &corners.map(|(end, sign)| Pixel::new(end.x + sign * x, end.y + sign * y)),
            colour,
        );
        self.disc(from, radius as i64, colour);
        self.disc(to, radius as i64, colour);
    }
}

impl PushT {
    /// An image of the current state with marks at the contacts of the last physics step: gym-pusht's canvas after the
    /// same reset and steps.
    ///
    /// [`Canvas::observation`] shrinks it to the image that policies observe.
    pub fn render(&self) -> Canvas {
        let mut canvas = Canvas::new();
        self.render_into(&mut canvas);
        canvas
    }

    /// Renders to an existing canvas and replaces its image; see [`PushT::render`].
    pub fn render_into(&self, canvas: &mut Canvas) {
        canvas.render_shapes(&self.shapes());
    }
}

/// An image of a state, in pixels and radians, without physics and therefore without contact marks.
///
/// `block` is the recorded or observed pose (the pose of the block's own frame), not one to request in a reset.
/// For the same state the image differs from [`PushT::render`] in the contact marks, and by one pixel where a corner is
/// within the last bits of half a pixel. Shapes that are outside of the window, or not finite, are not rendered.
pub fn render_state(agent: Point2, block: Pose2) -> Canvas {
    let mut canvas = Canvas::new();
    canvas.render_state(agent, block);
    canvas
}
