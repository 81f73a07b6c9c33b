//! Evaluations without demonstrations, at the cost of the episodes that depend on them.

use std::collections::BTreeSet;
use std::sync::Arc;

use re4_rollout::Traced;

/// Demonstrations that are left out.
pub type Without = Arc<BTreeSet<u32>>;

/// An episode to roll out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Episode {
    /// Number of the scene, from 0.
    pub scene: usize,
    /// Demonstrations that the policy does without.
    pub without: Without,
}

/// Rolls out episodes; the results are in their order.
pub type Roll<'a, E> = dyn FnMut(&[Episode]) -> Result<Vec<Traced>, E> + 'a;

/// The episodes of all scenes without some demonstrations.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The demonstrations that were left out.
    pub without: Without,
    /// The episodes, by the number of the scene.
    pub episodes: Vec<Traced>,
}

/// An episode without one more demonstration.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// The demonstration that was left out.
    pub demo: u32,
    /// Number of the scene.
    pub scene: usize,
    /// The episode without it.
    pub after: Traced,
}

impl Evaluation {
    /// Mean of a value of the episodes.
    pub fn mean(&self, value: impl Fn(&Traced) -> f64) -> f64 {
        let values: Vec<f64> = self.episodes.iter().map(value).collect();
        re4_stats::mean(&values)
    }

    /// Fraction of episodes that succeed.
    pub fn success(&self) -> f64 {
        self.mean(|episode| f64::from(u8::from(episode.success)))
    }
}

/// The cost of an episode, from 0 to 1: `1 - score (1 - steps / (2 max_steps))`. A success costs at most a half, and less if it takes
/// fewer steps; a failure costs at least a half.
pub fn cost(episode: &Traced, max_steps: u32) -> f64 {
    1.0 - episode.score * (1.0 - 0.5 * f64::from(episode.steps) / f64::from(max_steps.max(1)))
}

/// Rolls out all scenes.
///
/// # Errors
/// Those of `roll`.
pub fn evaluate<E>(roll: &mut Roll<'_, E>, scenes: usize, without: &Without) -> Result<Evaluation, E> {
    let episodes = |scene| Episode {
        scene,
        without: Arc::clone(without),
    };
    let episodes: Vec<Episode> = (0..scenes).map(episodes).collect();
    Ok(Evaluation {
        without: Arc::clone(without),
        episodes: roll(&episodes)?,
    })
}

/// The evaluation without more demonstrations. Only the episodes that considered one of them are rolled out again.
///
/// # Errors
/// Those of `roll`.
pub fn evaluate_without<E>(roll: &mut Roll<'_, E>, base: &Evaluation, more: &BTreeSet<u32>) -> Result<Evaluation, E> {
    let without: Without = Arc::new(base.without.union(more).copied().collect());
    let depends = |episode: &Traced| !episode.considered.is_disjoint(more);
    let again = base.episodes.iter().enumerate().filter(|(_, episode)| depends(episode));
    let again: Vec<Episode> = again
        .map(|(scene, _)| Episode {
            scene,
            without: Arc::clone(&without),
        })
        .collect();
    let mut episodes = base.episodes.clone();
    for (Episode { scene, .. }, episode) in again.iter().zip(roll(&again)?) {
        episodes[*scene] = episode;
    }
    Ok(Evaluation { without, episodes })
}

/// Every episode of an evaluation without each demonstration that it considered, sorted by demonstration and scene. All other
/// combinations of a scene and a demonstration give the episode of the evaluation.
///
/// # Errors
/// Those of `roll`.
pub fn leave_one_out<E>(roll: &mut Roll<'_, E>, base: &Evaluation) -> Result<Vec<Change>, E> {
    let demos: BTreeSet<u32> = base
        .episodes
        .iter()
        .flat_map(|episode| &episode.considered)
        .copied()
        .collect();
    let mut all = Vec::new();
    for demo in demos {
        let mut without = (*base.without).clone();
        without.insert(demo);
        let without = Arc::new(without);
        let scenes = base.episodes.iter().enumerate();
        all.extend(
            scenes
                .filter(|(_, episode)| episode.considered.contains(&demo))
                .map(|(scene, _)| {
                    let without = Arc::clone(&without);
                    (demo, Episode { scene, without })
                }),
        );
    }
    let episodes: Vec<Episode> = all.iter().map(|(_, episode)| episode.clone()).collect();
    let results = roll(&episodes)?;
    Ok(all
        .into_iter()
        .zip(results)
        .map(|((demo, Episode { scene, .. }), after)| Change { demo, scene, after })
        .collect())
}
