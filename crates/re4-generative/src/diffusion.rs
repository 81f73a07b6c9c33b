//! The noise schedule of Diffusion Policy, and its two samplers.

/// Number of noise levels.
pub const LEVELS: usize = 100;

/// Upper limit of a level's variance.
const MAXIMUM_BETA: f64 = 0.999;

/// Smallest variance of the noise that DDPM adds.
const MINIMUM_VARIANCE: f64 = 1e-20;

/// The squared cosine schedule (Nichol and Dhariwal 2021) with [`LEVELS`] levels.
#[derive(Debug, Clone, PartialEq)]
pub struct NoiseSchedule {
    /// Variance that a level adds.
    beta: Vec<f64>,
    /// Fraction of the signal's variance that is left at a level.
    remaining: Vec<f64>,
}

impl Default for NoiseSchedule {
    fn default() -> Self {
        let level = |number: usize| {
            let fraction = number as f64 / LEVELS as f64;
            ((fraction + 0.008) / 1.008 * std::f64::consts::FRAC_PI_2).cos().powi(2)
        };
        let beta: Vec<f64> = (0..LEVELS)
            .map(|number| (1.0 - level(number + 1) / level(number)).min(MAXIMUM_BETA))
            .collect();
        let mut product = 1.0;
        let remaining = beta.iter().map(|beta| {
            product *= 1.0 - beta;
            product
        });
        Self {
            remaining: remaining.collect(),
            beta,
        }
    }
}

impl NoiseSchedule {
    /// Variance that a level adds.
    pub fn beta(&self, level: usize) -> f64 {
        self.beta[level]
    }

    /// Fraction of the signal's variance that is left at a level (the cumulative alpha).
    pub fn remaining(&self, level: usize) -> f64 {
        self.remaining[level]
    }

    /// The fraction at the level before, which is 1 before the first.
    fn before(&self, level: Option<usize>) -> f64 {
        level.map_or(1.0, |level| self.remaining[level])
    }

    /// Adds noise to a clean value.
    pub fn noisy(&self, clean: f32, noise: f32, level: usize) -> f32 {
        let remaining = self.remaining[level];
        (remaining.sqrt() * f64::from(clean) + (1.0 - remaining).sqrt() * f64::from(noise)) as f32
    }

    /// The clean value that a noisy value and the predicted noise imply, limited to [-1, 1].
    fn clean(&self, value: f32, noise: f32, level: usize) -> f64 {
        let remaining = self.remaining[level];
        ((f64::from(value) - (1.0 - remaining).sqrt() * f64::from(noise)) / remaining.sqrt()).clamp(-1.0, 1.0)
    }

    /// A step of DDPM: from a level to the one before. `fresh` is a standard normal number, which the last step ignores.
    pub fn ddpm(&self, value: f32, noise: f32, level: usize, fresh: f32) -> f32 {
        let clean = self.clean(value, noise, level);
        let (remaining, beta) = (self.remaining[level], self.beta[level]);
        let before = self.before(level.checked_sub(1));
        let of_clean = before.sqrt() * beta / (1.0 - remaining);
        let of_value = (1.0 - beta).sqrt() * (1.0 - before) / (1.0 - remaining);
        let mean = of_clean * clean + of_value * f64::from(value);
        if level == 0 {
            return mean as f32;
        }
        let variance = (beta * (1.0 - before) / (1.0 - remaining)).max(MINIMUM_VARIANCE);
        (mean + variance.sqrt() * f64::from(fresh)) as f32
    }

    /// A deterministic step of DDIM: from a level to another one, or to the clean value.
    pub fn ddim(&self, value: f32, noise: f32, level: usize, to: Option<usize>) -> f32 {
        let before = self.before(to);
        (before.sqrt() * self.clean(value, noise, level) + (1.0 - before).sqrt() * f64::from(noise)) as f32
    }

    /// The levels that DDIM visits with this number of steps, the highest first: multiples of [`LEVELS`] / `steps`.
    pub fn ddim_levels(steps: usize) -> impl Iterator<Item = usize> {
        let stride = LEVELS / steps;
        (0..steps).rev().map(move |number| number * stride)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of the schedule's formula, computed with numpy in double precision.
    #[test]
    fn schedule_has_the_known_values() {
        let schedule = NoiseSchedule::default();
        let near = |value: f64, expected: f64| assert!((value / expected - 1.0).abs() < 1e-3, "{value} {expected}");
        near(schedule.beta(0), 6.313e-4);
        near(schedule.beta(98), 0.74994);
        near(schedule.beta(99), 0.999);
        for (level, expected) in [
            (0, 0.99937),
            (10, 0.96672),
            (50, 0.47826),
            (90, 0.019_544),
            (99, 2.43e-7),
        ] {
            near(schedule.remaining(level), expected);
        }
        let levels: Vec<usize> = NoiseSchedule::ddim_levels(10).collect();
        assert_eq!(levels, [90, 80, 70, 60, 50, 40, 30, 20, 10, 0]);
    }

    /// With the true noise, every sampler returns the clean value.
    #[test]
    fn samplers_invert_the_noise() {
        let schedule = NoiseSchedule::default();
        for clean in [-1.0_f32, -0.3, 0.0, 0.7] {
            for noise in [-1.5_f32, 0.2, 2.0] {
                for level in [0, 10, 50, 90] {
                    let noisy = schedule.noisy(clean, noise, level);
                    assert!((schedule.ddim(noisy, noise, level, None) - clean).abs() < 1e-4);
                    let step = schedule.ddim(noisy, noise, level, level.checked_sub(10));
                    let expected = level
                        .checked_sub(10)
                        .map_or(clean, |to| schedule.noisy(clean, noise, to));
                    assert!((step - expected).abs() < 1e-4);
                }
                let noisy = schedule.noisy(clean, noise, 0);
                assert!((schedule.ddpm(noisy, noise, 0, 9.0) - clean).abs() < 1e-4);
            }
        }
    }

    /// The mean of a step of DDPM is that of the posterior of the level before, by Bayes' rule for two normal distributions.
    #[test]
    fn ddpm_step_is_the_posterior() {
        let schedule = NoiseSchedule::default();
        for level in [1, 20, 60, 98] {
            let (clean, noise) = (0.4_f32, -0.8_f32);
            let value = schedule.noisy(clean, noise, level);
            let before = schedule.remaining(level - 1);
            let beta = schedule.beta(level);
            // Prior of the level before: mean sqrt(before) clean, variance 1 - before. Likelihood: value = sqrt(1 - beta) x + noise.
            let (prior, likelihood) = (1.0 / (1.0 - before), (1.0 - beta) / beta);
            let mean = (prior * before.sqrt() * f64::from(clean) + likelihood * f64::from(value) / (1.0 - beta).sqrt())
                / (prior + likelihood);
            let variance = 1.0 / (prior + likelihood);
            assert!((f64::from(schedule.ddpm(value, noise, level, 0.0)) - mean).abs() < 1e-5);
            let moved = schedule.ddpm(value, noise, level, 1.0) - schedule.ddpm(value, noise, level, 0.0);
            assert!((f64::from(moved) - variance.sqrt()).abs() < 1e-5);
        }
    }
}
