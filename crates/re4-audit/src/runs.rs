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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_maximal_and_long_enough() {
        let flags = [true, false, true, true, true, false, true, true];
        assert_eq!(runs(flags, 2), vec![2..5, 6..8]);
        assert_eq!(runs(flags, 1).len(), 3);
        assert_eq!(longest(flags), 3);
        assert_eq!(longest([]), 0);
    }
}
