//! Confidence of an estimate, calibrated on held-out demonstrations.
//!
//! The score of an estimate is how much the estimates of the image's crops disagree. An estimate agrees if it is near the anchor
//! of its demonstration; recorded object poses are not needed. The confidence of a score is the fraction of held-out frames with
//! this score whose estimates agree, made monotone by the pool-adjacent-violators algorithm.

use serde::{Deserialize, Serialize};

/// An estimate agrees with the anchor if their distance is at most this multiple of the median distance.
const AGREES: f64 = 3.0;

/// Estimates with a lower confidence are unsure.
const UNSURE: f64 = 0.5;

/// A score this many times as large as all held-out ones is unlike them, and its confidence is 0.
const UNKNOWN: f64 = 2.0;

/// Minimum number of frames of a step of the calibration.
const STEP: usize = 10;

/// The confidence of a score.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Largest score of each step, in metres, ascending.
    pub scores: Vec<f64>,
    /// Confidence of each step, descending.
    pub confidences: Vec<f64>,
    /// Distance from the anchor up to which an estimate agrees, in metres.
    pub agrees_within: f64,
}

impl Calibration {
    /// Fits a calibration to the scores and the distances from the anchor of held-out frames, in metres. `None` without frames.
    #[must_use]
    pub fn fit(frames: &[[f64; 2]]) -> Option<Self> {
        let mut distances: Vec<f64> = frames.iter().map(|frame| frame[1]).collect();
        distances.sort_by(f64::total_cmp);
        let within = AGREES * distances.get(distances.len() / 2)?;
        let mut sorted = frames.to_vec();
        sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        // Steps of equal size: largest score, number of frames, number that agree.
        let mut steps: Vec<(f64, usize, usize)> = Vec::new();
        for chunk in sorted.chunks(STEP.max(sorted.len() / 32)) {
            let agree = chunk.iter().filter(|frame| frame[1] <= within).count();
            steps.push((chunk[chunk.len() - 1][0], chunk.len(), agree));
            // A step whose confidence is not lower than that of the step before it is merged with it.
            while let [.., a, b] = steps[..]
                && a.2 * b.1 <= b.2 * a.1
            {
                steps.truncate(steps.len() - 2);
                steps.push((b.0, a.1 + b.1, a.2 + b.2));
            }
        }
        Some(Self {
            scores: steps.iter().map(|step| step.0).collect(),
            confidences: steps.iter().map(|step| step.2 as f64 / step.1 as f64).collect(),
            agrees_within: within,
        })
    }

    /// The confidence of a score, from 0 to 1.
    #[must_use]
    pub fn confidence(&self, score: f64) -> f64 {
        let last = self.scores.last().copied().unwrap_or(0.0);
        if score.is_nan() || score > UNKNOWN * last {
            return 0.0;
        }
        let step = self.scores.partition_point(|largest| *largest < score);
        let step = step.min(self.confidences.len().saturating_sub(1));
        self.confidences.get(step).copied().unwrap_or(0.0)
    }

    /// Whether an estimate with this confidence is unsure.
    #[must_use]
    pub fn is_unsure(confidence: f64) -> bool {
        confidence < UNSURE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_confidence_falls_where_the_estimates_stop_to_agree() {
        // Scores up to 10 mm: the estimates with scores above 6 mm are wrong.
        let frames: Vec<[f64; 2]> = (0..400)
            .map(|i| {
                let score = f64::from(i) * 25e-6;
                [
                    score,
                    if score > 6e-3 {
                        0.1
                    } else {
                        2e-3 + 1e-6 * f64::from(i % 7)
                    },
                ]
            })
            .collect();
        let calibration = Calibration::fit(&frames).unwrap();
        assert!(calibration.confidence(1e-3) > 0.99);
        assert!(Calibration::is_unsure(calibration.confidence(9e-3)));
        assert!(calibration.confidences.is_sorted_by(|a, b| a > b));
        assert_eq!(calibration.confidence(1.0), 0.0);
        assert_eq!(calibration.confidence(f64::NAN), 0.0);
        assert_eq!(Calibration::fit(&[]), None);
    }

    #[test]
    fn equal_frames_have_one_step() {
        let calibration = Calibration::fit(&[[1e-3, 2e-3]; 25]).unwrap();
        assert_eq!(calibration.confidences, [1.0]);
        assert_eq!(calibration.confidence(1e-3), 1.0);
    }
}
