//! The results that the paper reports for Push-T.

/// The demonstrations that a result of the paper was measured with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Demonstrations {
    /// All 206 human demonstrations.
    All,
    /// The first 50 of them.
    First50,
}

/// Demonstrations in the paper's dataset (section "Sparse Demonstration Experiment").
pub(super) const DEMONSTRATIONS: u64 = 206;

/// Maximum number of control steps of an episode in the paper's tables for Push-T.
pub(super) const MAX_STEPS: u32 = 200;

/// One method's row in the paper's tables: means over 100 seeds, without intervals. `None` if the paper reports no value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PaperRow {
    /// Name of the method in the paper.
    pub(super) method: &'static str,
    /// Results with all demonstrations, from states and from images.
    pub(super) all: [Option<f64>; 2],
    /// Results with the first 50 demonstrations, from states and from images.
    pub(super) first_50: [Option<f64>; 2],
}

/// Source of the results.
pub(super) const SOURCE: &str = "RE4: Transformation-aware Imitation of Object Interactions Using Manipulation Modes, \
    tables “Performance over 100 seeded runs” and “Sparse Demonstrations”";

/// Tables "Performance over 100 seeded runs" (`tab:main`, columns Push-T) and "Sparse Demonstrations" (`tab:sparse-demo`).
pub(super) const ROWS: [PaperRow; 6] = [
    row("RE4", [Some(0.919), Some(0.883)], [Some(0.781), Some(0.733)]),
    row("GPI", [Some(0.912), Some(0.624)], [None, None]),
    row("DDIM-10", [Some(0.901), Some(0.826)], [Some(0.507), Some(0.579)]),
    row("DDPM-100", [Some(0.894), Some(0.798)], [Some(0.531), Some(0.609)]),
    row("SFP", [Some(0.838), Some(0.696)], [None, None]),
    row("RE2", [Some(0.255), Some(0.304)], [None, None]),
];

const fn row(method: &'static str, all: [Option<f64>; 2], first_50: [Option<f64>; 2]) -> PaperRow {
    PaperRow { method, all, first_50 }
}

/// Returns the name and the result of the paper's method that corresponds to a preset, if the paper reports one.
pub(super) fn counterpart(preset: &str, variant: &str, demonstrations: Demonstrations) -> Option<(&'static str, f64)> {
    let method = match preset {
        "re4" | "paper" => "RE4",
        "re2" => "RE2",
        _ => return None,
    };
    let column = match variant {
        "state" => 0,
        "image" => 1,
        _ => return None,
    };
    let row = ROWS.iter().find(|row| row.method == method)?;
    let figures = match demonstrations {
        Demonstrations::All => row.all,
        Demonstrations::First50 => row.first_50,
    };
    Some((method, figures[column]?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_have_the_results_of_the_corresponding_method() {
        assert_eq!(counterpart("paper", "image", Demonstrations::All), Some(("RE4", 0.883)));
        assert_eq!(
            counterpart("re4", "state", Demonstrations::First50),
            Some(("RE4", 0.781))
        );
        assert_eq!(counterpart("re2", "state", Demonstrations::All), Some(("RE2", 0.255)));
        assert_eq!(counterpart("re2", "state", Demonstrations::First50), None);
        assert_eq!(counterpart("other", "state", Demonstrations::All), None);
    }
}
