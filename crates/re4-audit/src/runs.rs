//! Runs of consecutive frames that satisfy a condition.

use std::ops::Range;

/// Returns the maximal runs of `true` that have at least `minimum` frames.
pub(crate) fn runs(flags: impl IntoIterator<Item = bool>, minimum: usize) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = Vec::new();
    let mut start = None;
    for (frame, flag) in flags.into_iter().chain([false]).enumerate() {
        match (flag, start) {
            (true, None) => start = Some(frame),
            (false, Some(first)) => {
                if frame - first >= minimum.max(1) {
                    found.push(first..frame);
                }
                start = None;
            }
            _ => {}
        }
    }
    found
}

/// Returns the length of the longest run of `true`, or 0 if there is none.
pub(crate) fn longest(flags: impl IntoIterator<Item = bool>) -> usize {
    runs(flags, 1).into_iter().map(|run| run.len()).max().unwrap_or(0)
}

/// Values that exceed the threshold with fewer than this many others between them belong to one burst.
const BURST: usize = 3;

/// Returns the bursts of values above a threshold, each with its largest value.
pub(crate) fn bursts(values: &[f64], threshold: f64) -> Vec<(Range<usize>, f64)> {
    let mut found: Vec<(Range<usize>, f64)> = Vec::new();
    for (place, &value) in values.iter().enumerate().filter(|(_, value)| **value > threshold) {
        match found.last_mut() {
            Some((range, largest)) if place < range.end + BURST => {
                range.end = place + 1;
                *largest = largest.max(value);
            }
            _ => found.push((place..place + 1, value)),
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_close_to_each_other_are_one_burst() {
        let values = [0.0, 2.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 2.0];
        assert_eq!(bursts(&values, 1.0), [(1..5, 3.0), (8..9, 2.0)]);
        assert_eq!(bursts(&values, f64::INFINITY), []);
    }

    #[test]
    fn runs_are_maximal_and_long_enough() {
        let flags = [true, false, true, true, true, false, true, true];
        assert_eq!(runs(flags, 2), vec![2..5, 6..8]);
        assert_eq!(runs(flags, 1).len(), 3);
        assert_eq!(longest(flags), 3);
        assert_eq!(longest([]), 0);
    }
}
