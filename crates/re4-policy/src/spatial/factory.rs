//! Starts the policy for every episode.

use std::collections::BTreeSet;
use std::sync::Arc;

use re4_rollout::{ArmState, PolicyFactory, Space};

use crate::spatial::config::SpatialPolicyConfig;
use crate::spatial::demos::SpatialKnowledge;
use crate::spatial::policy::SpatialRe4;

/// Starts a [`SpatialRe4`] policy for every episode.
pub struct SpatialRe4Factory {
    /// The settings.
    pub config: SpatialPolicyConfig,
    /// The data of the policy.
    pub knowledge: Arc<SpatialKnowledge>,
}

impl PolicyFactory<Space> for SpatialRe4Factory {
    type Policy = SpatialRe4;

    fn start(&self, _: u32, first: &ArmState) -> SpatialRe4 {
        SpatialRe4::new(self.config.clone(), Arc::clone(&self.knowledge), first.eef)
    }

    fn start_without(&self, seed: u32, first: &ArmState, without: &Arc<BTreeSet<u32>>) -> Option<SpatialRe4> {
        Some(self.start(seed, first).without(without))
    }
}
