//! Conventions of a dataset (units and the kind of actions): settings for differences from the original dataset, and checks.

use re4_geometry::wrap_to_two_pi;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::episodes::PushtEpisodes;
use super::validate::{ANGLE_TOLERANCE, POSITION_HIGH, POSITION_LOW, WINDOW};
use crate::error::Fault;

/// Units and the kind of actions of a dataset that differ from those of the original dataset: positions in pixels of a 512 x 512
/// window, angles in radians, and absolute targets as actions. The numbers are converted to the conventions of the original dataset
/// and then checked; settings that contradict the numbers are refused.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PushtConventions {
    /// Coordinates of the window's edges in the dataset, the same for both axes: `[0, 1]` or `[-1, 1]` for unit coordinates,
    /// `[0, 96]` for pixels of the images. `[0, 512]` by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub window: Option<[f64; 2]>,
    /// Unit of the block's angle; radians by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angle: Option<AngleUnit>,
    /// Kind of actions; absolute targets by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<ActionKind>,
    /// For absolute actions in other units than the states: coordinates of the window's edges in these units, as in `window`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action_window: Option<[f64; 2]>,
    /// For relative actions in other units than the states: number of pixels of the 512 px window per unit of an action, such as
    /// 100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action_scale: Option<f64>,
}

/// Unit of an angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AngleUnit {
    /// Radians.
    Radians,
    /// Degrees.
    Degrees,
}

/// Kind of an action.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActionKind {
    /// The target position of the agent.
    Absolute,
    /// The target position relative to the agent's position in the same row.
    Relative,
}

/// The window of the original dataset.
const PIXELS: [f64; 2] = [0.0, WINDOW];

/// Maximum angle in radians that is wrapped rather than refused: the scenes of Diffusion Policy start with up to about three
/// full rotations.
const UNWRAPPED: f64 = 25.0;

/// The block is 120 px wide and stays between the walls, so its larger coordinate always exceeds this value, in pixels.
const BLOCK_LOW: f64 = 40.0;

/// Minimum number of frames for judging a range of values.
const MIN_FRAMES: usize = 100;

/// Minimum number of episodes for judging the region in which the block moves.
const MIN_EPISODES: usize = 5;

/// Lower bound of the upper half and upper bound of the lower half of the window, in pixels. Both halves include the middle, where
/// the goal is.
const MIDDLE: [f64; 2] = [230.0, 282.0];

/// Fraction of unusual frames above which the whole dataset, not single frames, is at fault.
const MAX_UNUSUAL: f64 = 0.2;

impl PushtConventions {
    /// Whether all conventions are those of the original dataset.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Checks the settings for contradictions.
    ///
    /// # Errors
    /// Names the first invalid setting, what is wrong with it, and the accepted values.
    pub fn check(&self) -> Result<(), String> {
        for (name, window) in [("window", self.window), ("action_window", self.action_window)] {
            if let Some([low, high]) = window
                && !(low.is_finite() && high.is_finite() && low < high)
            {
                return Err(format!(
                    "{name} is [{low}, {high}]; give the lower edge of the window first, such as [-1, 1]"
                ));
            }
        }
        let relative = self.action == Some(ActionKind::Relative);
        if relative && self.action_window.is_some() {
            return Err(
                "action_window is for absolute actions, but action is \"relative\"; give action_scale instead"
                    .to_owned(),
            );
        }
        match self.action_scale {
            Some(_) if !relative => Err(
                "action_scale is for relative actions; set action to \"relative\", or give action_window instead"
                    .to_owned(),
            ),
            Some(scale) if !(scale.is_finite() && scale > 0.0) => {
                Err(format!("action_scale is {scale}; give a number of pixels above 0"))
            }
            _ => Ok(()),
        }
    }

    /// The settings as in the pipeline file, for messages.
    fn settings(&self) -> String {
        let mut words = Vec::new();
        if let Some([low, high]) = self.window {
            words.push(format!("ingest.pusht.window = [{low}, {high}]"));
        }
        match self.angle {
            Some(AngleUnit::Degrees) => words.push("ingest.pusht.angle = \"degrees\"".to_owned()),
            Some(AngleUnit::Radians) | None => {}
        }
        words.extend(self.action_settings());
        words.join(", ")
    }

    /// The settings of actions as in the pipeline file, if any.
    pub(super) fn action_settings(&self) -> Option<String> {
        match (self.action, self.action_window, self.action_scale) {
            (Some(ActionKind::Relative), _, None) => Some("ingest.pusht.action = \"relative\"".to_owned()),
            (Some(ActionKind::Relative), _, Some(scale)) => Some(format!(
                "ingest.pusht.action = \"relative\", ingest.pusht.action_scale = {scale}"
            )),
            (_, Some([low, high]), _) => Some(format!("ingest.pusht.action_window = [{low}, {high}]")),
            _ => None,
        }
    }

    /// Pixels per unit of a coordinate.
    pub(super) fn pixels_per_unit(&self) -> f64 {
        let [low, high] = self.window.unwrap_or(PIXELS);
        WINDOW / (high - low)
    }

    /// Pixels per unit of a relative action.
    pub(super) fn pixels_per_action(&self) -> f64 {
        self.action_scale.unwrap_or_else(|| self.pixels_per_unit())
    }

    /// The target of an action, in pixels; `agent` is in pixels, too.
    pub(super) fn target(&self, agent: [f64; 2], action: [f64; 2]) -> [f64; 2] {
        match self.action {
            Some(ActionKind::Relative) => {
                let scale = self.pixels_per_action();
                [agent[0] + scale * action[0], agent[1] + scale * action[1]]
            }
            _ => action.map(|value| pixels(value, self.action_window.or(self.window))),
        }
    }

    /// Whether actions of zeros are plausible: relative actions of an agent that stays where it is.
    pub(super) fn zero_action_is_usual(&self) -> bool {
        self.action == Some(ActionKind::Relative)
    }

    /// Converts the numbers to pixels and radians, and wraps angles to 0 to 2π. Returns the number of wrapped angles.
    pub(super) fn convert(&self, episodes: &mut PushtEpisodes) -> usize {
        let mut wrapped = 0;
        for (state, action) in episodes.state.iter_mut().zip(&mut episodes.action) {
            let coordinates = if episodes.recorded.block { 4 } else { 2 };
            for value in &mut state[..coordinates] {
                *value = pixels(*value, self.window);
            }
            let degrees = self.angle == Some(AngleUnit::Degrees) && episodes.recorded.angle;
            if degrees {
                state[4] = state[4].to_radians();
            }
            // Larger values are not angles; the check of values reports them.
            if !in_full_circle(state[4]) && state[4].abs() <= UNWRAPPED {
                state[4] = wrap_to_two_pi(state[4]);
                wrapped += usize::from(!degrees);
            }
            *action = self.target([state[0], state[1]], *action);
        }
        for value in episodes.keypoint.iter_mut().flatten().flatten().flatten() {
            *value = pixels(*value, self.window);
        }
        wrapped
    }

    /// Checks coordinates and angles, as they are in the dataset, against the settings. `good` marks the episodes with finite
    /// numbers.
    pub(super) fn judge(&self, episodes: &PushtEpisodes, good: &[bool]) -> Judgement {
        let frames: Vec<&[f64; 5]> = episodes
            .frames
            .iter()
            .zip(good)
            .filter(|(_, good)| **good)
            .flat_map(|(frames, _)| &episodes.state[frames.clone()])
            .collect();
        let mut judgement = Judgement::default();
        if frames.is_empty() {
            return judgement;
        }
        judgement.likely = Self {
            window: self.judge_coordinates(&frames, episodes, good, &mut judgement),
            ..*self
        };
        if episodes.recorded.angle {
            self.judge_angles(&frames, judgement.likely.window, &mut judgement.faults);
        }
        judgement
    }

    /// Checks the coordinates, and returns the window that they appear to have.
    fn judge_coordinates(
        &self,
        frames: &[&[f64; 5]],
        episodes: &PushtEpisodes,
        good: &[bool],
        judgement: &mut Judgement,
    ) -> Option<[f64; 2]> {
        let block = episodes.recorded.block;
        let coordinates = if block { 4 } else { 2 };
        let [low, high] = middle(frames.iter().flat_map(|state| state[..coordinates].iter().copied()));
        let inside = |value: f64| (POSITION_LOW..=POSITION_HIGH).contains(&pixels(value, self.window));
        let outside = frames
            .iter()
            .filter(|state| !state[..coordinates].iter().copied().all(inside))
            .count();
        let is_small = |frames: &std::ops::Range<usize>| {
            let block = episodes.state[frames.clone()].iter().flat_map(|state| &state[2..4]);
            block
                .map(|&value| pixels(value, self.window))
                .fold(f64::NEG_INFINITY, f64::max)
                < BLOCK_LOW
        };
        let small: Vec<usize> = (0..good.len())
            .filter(|&number| block && good[number] && is_small(&episodes.frames[number]))
            .collect();
        let enough = frames.len() >= MIN_FRAMES;
        let far = outside as f64 > MAX_UNUSUAL * frames.len() as f64;
        let tiny = 2 * small.len() > good.iter().filter(|good| **good).count();
        // Coordinates up to 96 are probably pixels of the 96 px images.
        let of_images = self.window.is_none() && frames.len() >= MIN_FRAMES / 2 && high <= 97.0 && high > 20.0;
        // If the window is too large for the coordinates, all of them are in one half of it.
        let several = frames.len() >= 3 * MIN_FRAMES && good.iter().filter(|good| **good).count() >= MIN_EPISODES;
        let upper = (several || self.window.is_some() && enough) && pixels(high, self.window) <= MIDDLE[1];
        let half = upper || self.window.is_some() && enough && pixels(low, self.window) >= MIDDLE[0];
        if !(far || tiny || of_images || half) {
            judgement.small = small;
            return self.window;
        }
        let likely = likely_window(low, high);
        let [low_text, high_text] = [low, high].map(|value| rounded(value).to_string());
        let (what, fix) = match self.window {
            None => (
                format!(
                    "positions range from {low_text} to {high_text}, which does not match a 512 px window"
                ),
                match likely {
                    Some([low, high]) => format!(
                        "set ingest.pusht.window = [{low}, {high}] if these are the window's edges, otherwise to the actual edges"
                    ),
                    None => "set ingest.pusht.window to the coordinates of the window's edges, such as [-1, 1], or convert the dataset to pixels"
                        .to_owned(),
                },
            ),
            Some([left, right]) => (
                format!(
                    "with ingest.pusht.window = [{left}, {right}], positions, which range from {low_text} to {high_text} in the dataset, would range from {} to {} px in a 512 px window",
                    rounded(pixels(low, self.window)),
                    rounded(pixels(high, self.window))
                ),
                match likely {
                    Some(PIXELS) => "remove that setting, because positions are in pixels already".to_owned(),
                    Some([low, high]) => format!("set it to [{low}, {high}]"),
                    None => "set it to the coordinates of the window's edges".to_owned(),
                },
            ),
        };
        judgement.faults.push(Fault::Convention { what, fix });
        likely.filter(|window| *window != PIXELS)
    }

    fn judge_angles(&self, frames: &[&[f64; 5]], window: Option<[f64; 2]>, faults: &mut Vec<Fault>) {
        let [low, high] = middle(frames.iter().map(|state| state[4]));
        let [low_text, high_text] = [low, high].map(|value| rounded(value).to_string());
        let largest = low.abs().max(high.abs());
        let enough = frames.len() >= MIN_FRAMES;
        // In unit coordinates, angles of at most 1 were probably normalized, too.
        let normalised = window.is_some_and(|[left, right]| right - left <= 2.2);
        if self.angle == Some(AngleUnit::Degrees) {
            if enough && largest <= 6.3 {
                faults.push(Fault::Convention {
                    what: format!("with ingest.pusht.angle = \"degrees\", block_theta, which ranges from {low_text} to {high_text}, would hardly rotate"),
                    fix: "remove that setting, because the angles are in radians".to_owned(),
                });
            }
            return;
        }
        let far = frames.iter().filter(|state| state[4].abs() > UNWRAPPED).count();
        if far as f64 > MAX_UNUSUAL * frames.len() as f64 {
            faults.push(Fault::Convention {
                what: format!("block_theta ranges from {low_text} to {high_text}, which are not radians"),
                fix: if largest <= 720.0 {
                    "set ingest.pusht.angle = \"degrees\"".to_owned()
                } else {
                    "convert it to radians".to_owned()
                },
            });
        } else if enough && normalised && largest <= 1.05 {
            faults.push(Fault::Convention {
                what: format!(
                    "block_theta ranges from {low_text} to {high_text}, so it appears to be scaled like the positions"
                ),
                fix: "convert it to radians".to_owned(),
            });
        }
    }
}

impl std::fmt::Display for PushtConventions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.settings())
    }
}

/// Result of checking coordinates and angles.
#[derive(Default)]
pub(super) struct Judgement {
    /// Contradictions of the dataset as a whole.
    pub(super) faults: Vec<Fault>,
    /// The same settings with the window that the coordinates appear to have.
    pub(super) likely: PushtConventions,
    /// Indices of episodes in which the block is where it cannot be, if this concerns only a minority.
    pub(super) small: Vec<usize>,
}

pub(super) fn pixels(value: f64, window: Option<[f64; 2]>) -> f64 {
    match window {
        // Returned unchanged, without a rounding error.
        None => value,
        Some([low, high]) => (value - low) * (WINDOW / (high - low)),
    }
}

fn in_full_circle(angle: f64) -> bool {
    (0.0..=std::f64::consts::TAU + ANGLE_TOLERANCE).contains(&angle)
}

/// The range of values without the lowest and the highest half percent.
fn middle(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    let skip = values.len() / 200;
    [skip, last - skip.min(last)].map(|place| values.get(place).copied().unwrap_or_default())
}

/// The most likely of the usual windows for coordinates in this range.
fn likely_window(low: f64, high: f64) -> Option<[f64; 2]> {
    let within = |left: f64, right: f64| low >= left && high <= right;
    Some(if within(-0.05, 1.05) && high > 0.6 {
        [0.0, 1.0]
    } else if within(-1.05, 1.05) && high - low > 1.0 {
        [-1.0, 1.0]
    } else if within(-5.0, 97.0) && high > 60.0 {
        [0.0, 96.0]
    } else if within(-5.0, 130.0) && high > 97.0 {
        [0.0, 128.0]
    } else if within(-10.0, 265.0) && high > 130.0 {
        [0.0, 256.0]
    } else if within(-265.0, 265.0) && low < -60.0 && high > 60.0 {
        [-256.0, 256.0]
    } else if within(POSITION_LOW, POSITION_HIGH) && high > 265.0 {
        PIXELS
    } else if within(-50.0, 1075.0) && high > POSITION_HIGH {
        [0.0, 1024.0]
    } else {
        return None;
    })
}

/// Rounds to four significant digits, for messages.
pub(super) fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let digits = 3 - value.abs().log10().floor() as i32;
    if digits >= 0 {
        let factor = 10_f64.powi(digits.min(300));
        (value * factor).round() / factor
    } else {
        value.round()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meaningless_settings_are_refused() {
        let sentences: Vec<String> = [
            r#"{"window": [1, -1]}"#,
            r#"{"action_window": [2, 2]}"#,
            r#"{"action": "relative", "action_window": [-1, 1]}"#,
            r#"{"action_scale": 100}"#,
            r#"{"action": "relative", "action_scale": 0}"#,
        ]
        .iter()
        .map(|text| {
            let settings: PushtConventions = serde_json::from_str(text).unwrap();
            settings.check().unwrap_err()
        })
        .collect();
        insta::assert_snapshot!(sentences.join("\n"));
        assert!(serde_json::from_str::<PushtConventions>(r#"{"units": "px"}"#).is_err());
        assert_eq!(serde_json::to_string(&PushtConventions::default()).unwrap(), "{}");
    }

    #[test]
    fn numbers_in_messages_have_four_digits() {
        for (value, expected) in [
            (0.0, 0.0),
            (-0.83256, -0.8326),
            (511.97, 512.0),
            (123_456.7, 123_457.0),
            (1e-5, 1e-5),
        ] {
            assert_eq!(rounded(value), expected);
        }
    }
}
