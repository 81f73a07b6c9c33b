//! Demonstrations that cannot be used.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::tables::LeftOut;

/// What to do with a demonstration that cannot be read, or that contradicts the others.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnBad {
    /// Refuse the dataset, and name all such demonstrations.
    #[default]
    Refuse,
    /// Ingest the other demonstrations; the artifact lists those that were left out.
    LeaveOut,
}

/// Maximum number of demonstrations that a message names individually.
const NAMED: usize = 20;

/// Splits a message into the fault and its remedy, which the first `"; "` separates.
pub(crate) fn parts(sentence: &str) -> (&str, &str) {
    sentence.split_once("; ").unwrap_or((sentence, ""))
}

/// Returns the message that refuses a dataset of `of` demonstrations because of these. A single fault keeps its own message;
/// several are listed in one message.
pub fn refusal(left: &[LeftOut], of: usize) -> String {
    if let [only] = left {
        return only.why.clone();
    }
    if let Some(sentence) = same(left).filter(|_| left.len() == of) {
        return sentence;
    }
    let what = |left: &LeftOut| {
        let (what, _) = parts(&left.why);
        let what = what.strip_prefix(&format!("{}: ", left.demo)).unwrap_or(what);
        format!("{} ({what})", left.demo)
    };
    let named: Vec<String> = left.iter().take(NAMED).map(what).collect();
    let more = match left.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    format!(
        "{} of {of} demonstrations cannot be used: {}{more}; repair them, leave them out with ingest.select, or set ingest.on_bad = \"leave_out\" to ingest the others",
        left.len(),
        named.join(", ")
    )
}

/// Returns one message for all demonstrations if their messages differ only in names and numbers: the fault is then a property of
/// the whole dataset.
fn same(left: &[LeftOut]) -> Option<String> {
    let plain = |left: &LeftOut| -> String {
        let text = left.why.replace(&left.demo, "");
        text.chars().filter(|c| !c.is_ascii_digit()).collect()
    };
    let first = left.first()?;
    let (what, remedy) = parts(&first.why);
    let all = left.iter().all(|other| plain(other) == plain(first));
    all.then(|| {
        format!(
            "{what}, and all {} demonstrations have this fault; {remedy}",
            left.len()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_faults_are_listed_at_once() {
        let left = |demo: usize| LeftOut {
            demo: format!("demo_{demo}"),
            why: format!("row {demo} is odd; repair it"),
        };
        assert_eq!(refusal(&[left(3)], 9), "row 3 is odd; repair it");
        let two = refusal(&[left(3), left(5)], 9);
        assert!(
            two.starts_with("2 of 9 demonstrations cannot be used: demo_3 (row 3 is odd), demo_5 (row 5 is odd); "),
            "{two}"
        );
        let all = refusal(&[left(3), left(5)], 2);
        assert_eq!(all, "row 3 is odd, and all 2 demonstrations have this fault; repair it");
        let many: Vec<LeftOut> = (0..25).map(left).collect();
        assert!(refusal(&many, 30).contains("demo_19 (row 19 is odd) and 5 more; "));
    }
}
