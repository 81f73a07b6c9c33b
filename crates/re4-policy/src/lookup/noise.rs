//! Gaussian noise on queries, whose standard deviation decays during an episode.

use std::f64::consts::TAU;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::kinds::SettingError;

/// Noise that is added to every query, so that the policy does not repeat the same sequence of frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct QueryNoiseConfig {
    /// Standard deviation at the first query, in normalised coordinates, whose range is 2. 0 for no noise. 0.01 is the value of
    /// GPI's authors and of the paper.
    pub sigma: f64,
    /// Factor of the standard deviation after every query (authors: 0.995).
    pub decay: f64,
    /// Lower limit of the standard deviation (authors: 0.001).
    pub floor: f64,
}

impl Default for QueryNoiseConfig {
    fn default() -> Self {
        Self {
            sigma: 0.01,
            decay: 0.995,
            floor: 0.001,
        }
    }
}

impl QueryNoiseConfig {
    pub(crate) fn check(&self) -> Result<(), SettingError> {
        for (setting, value) in [
            ("noise.sigma", self.sigma),
            ("noise.floor", self.floor),
            ("noise.decay", self.decay),
        ] {
            let valid = (0.0..=1.0).contains(&value);
            SettingError::unless(valid, setting, value, "give a number from 0 to 1")?;
        }
        Ok(())
    }
}

/// The noise of one episode. The same seed gives the same numbers.
pub(crate) struct QueryNoise {
    config: QueryNoiseConfig,
    sigma: f64,
    random: Pcg64,
}

impl QueryNoise {
    pub(crate) fn new(seed: u32, config: QueryNoiseConfig) -> Self {
        Self {
            config,
            sigma: config.sigma,
            // The stream number is the ASCII code of "query_noise", so that the noise is independent of other numbers of the seed.
            random: Pcg64::new(u128::from(seed), 0x71_7565_7279_5f6e_6f69_7365),
        }
    }

    /// The standard deviation of the next query, or `None` without noise. Advances the decay.
    pub(crate) fn next_sigma(&mut self) -> Option<f64> {
        if self.config.sigma == 0.0 {
            return None;
        }
        let sigma = self.sigma;
        self.sigma = (sigma * self.config.decay).max(self.config.floor);
        Some(sigma)
    }

    /// A standard normal number, by the Box-Muller transform.
    pub(crate) fn normal(&mut self) -> f64 {
        // `unit` is in (0, 1], so the logarithm is finite.
        let radius = (-2.0 * self.unit().ln()).sqrt();
        radius * (TAU * self.unit()).cos()
    }

    fn unit(&mut self) -> f64 {
        ((self.random.next_u64() >> 11) + 1) as f64 * (1.0 / (1u64 << 53) as f64)
    }
}
