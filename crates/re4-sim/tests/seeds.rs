//! Scenes from seeds equal those that numpy samples; `tests/data/make_seed_states.py` writes the table.

use re4_sim::{SeedScheme, scene_from_seed};
use serde_json::Value;

#[test]
fn scenes_equal_those_of_numpy() {
    let table: Value = serde_json::from_str(include_str!("data/seed_states.json")).unwrap();
    for (scheme, count) in [(SeedScheme::DiffusionPolicy, 407), (SeedScheme::GymPusht, 101)] {
        let name = serde_json::to_value(scheme).unwrap();
        let scenes = table[name.as_str().unwrap()].as_object().unwrap();
        assert_eq!(scenes.len(), count);
        for (seed, row) in scenes {
            let expected: [f64; 5] = serde_json::from_value(row.clone()).unwrap();
            let scene = scene_from_seed(scheme, seed.parse().unwrap());
            let sampled = [
                scene.agent.x,
                scene.agent.y,
                scene.block.x,
                scene.block.y,
                scene.block.theta,
            ];
            assert_eq!(
                sampled.map(f64::to_bits),
                expected.map(f64::to_bits),
                "{name}, seed {seed}: {sampled:?}, not {expected:?}"
            );
        }
    }
}
