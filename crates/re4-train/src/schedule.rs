//! The learning rate of every step.

/// Length of the linear warm-up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WarmUp {
    /// The first of this many equal parts of all steps.
    Part(u32),
    /// A number of steps.
    Steps(u32),
}

/// The learning rate as a function of the step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Schedule {
    /// The same in every step.
    Constant(f64),
    /// A linear warm-up to the highest rate, multiplied by half a cosine period that decays to zero at the last step.
    Cosine {
        /// The rate without warm-up and decay.
        highest: f64,
        /// Length of the warm-up, during which the gradients are unreliable.
        warm_up: WarmUp,
    },
}

impl Schedule {
    /// The learning rate of a step, from 0, in a training of `all` steps.
    pub fn rate(self, step: u64, all: u64) -> f64 {
        match self {
            Self::Constant(rate) => rate,
            Self::Cosine { highest, warm_up } => {
                let fraction = step as f64 / all as f64;
                let warm_up = match warm_up {
                    // The first step is not lost to a rate of 0.
                    WarmUp::Part(parts) => (fraction * f64::from(parts)).min(1.0).max(1.0 / all as f64),
                    WarmUp::Steps(steps) => ((step + 1) as f64 / f64::from(steps.max(1))).min(1.0),
                };
                highest * warm_up * 0.5 * (1.0 + (std::f64::consts::PI * fraction).cos())
            }
        }
    }
}
