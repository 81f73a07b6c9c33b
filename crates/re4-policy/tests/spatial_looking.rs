//! A policy that is not told where the object is, and looks.
#![allow(clippy::unwrap_used, reason = "tests may end where they fail")]

mod shown;
mod toy;

use std::sync::Arc;

use nalgebra::Isometry3;
use re4_episode::Mode;
use re4_geometry::spatial::{Symmetry, pose_distance};
use re4_policy::spatial::{ObjectEstimate, SpatialDecisionKind, SpatialPolicyConfig, SpatialRe4};
use re4_rollout::{ArmState, Policy as _, PolicyError};
use shown::Shown;
use toy::{SpatialAct, World, block, demonstrations, episode, knowledge};

fn look(
    policy: &mut SpatialRe4,
    proprio: ArmState,
    object: &mut dyn FnMut() -> Result<Isometry3<f64>, PolicyError>,
) -> Result<SpatialAct, PolicyError> {
    policy.act(&mut Shown {
        proprio,
        tells: false,
        object,
    })
}

/// What became of an episode: its acts, at which of them the policy looked, and whether it succeeded.
struct Looked {
    acts: Vec<SpatialAct>,
    at: Vec<usize>,
    success: bool,
}

/// An episode in which the policy is shown what `eye` makes of the true pose.
fn looking(
    config: &SpatialPolicyConfig,
    demos: u32,
    object: Isometry3<f64>,
    eye: impl Fn(&Isometry3<f64>) -> Isometry3<f64>,
    mut meddle: impl FnMut(&mut World),
) -> Looked {
    let mut world = World::new(object);
    let known = knowledge(demonstrations(demos, 0.6, 1), config, Symmetry::None);
    let mut policy = SpatialRe4::new(config.clone(), known, world.eef);
    let (mut acts, mut at) = (Vec::new(), Vec::new());
    while acts.len() < 400 && !world.success() {
        meddle(&mut world);
        let mut looks = 0;
        let act = look(&mut policy, world.feel(), &mut || {
            looks += 1;
            Ok(eye(&world.object))
        })
        .unwrap();
        assert!(looks <= 1);
        if looks == 1 {
            at.push(acts.len());
        }
        world.step(&act.action);
        acts.push(act);
    }
    Looked {
        success: world.success(),
        acts,
        at,
    }
}

#[test]
fn it_looks_where_it_chooses_and_nowhere_else() {
    for config in [SpatialPolicyConfig::paper(), SpatialPolicyConfig::re4()] {
        // The block slips out of the first grasp, so that there is a way home, too.
        let mut slipped = false;
        let run = looking(
            &config,
            8,
            block(-0.05, -0.1, 0.1),
            |object| *object,
            |world| {
                world.slippery = !slipped;
                slipped |= world.separation < 0.011;
            },
        );
        assert!(run.success && run.acts.len() > 5 * run.at.len());
        let chosen: Vec<usize> = (0..run.acts.len())
            .filter(|step| {
                let decision = run.acts[*step].decision.as_ref();
                decision
                    .is_some_and(|d| matches!(d.kind, SpatialDecisionKind::Retrieve | SpatialDecisionKind::Continue))
            })
            .collect();
        assert_eq!(run.at, chosen);
        let kinds: Vec<_> = run
            .acts
            .iter()
            .filter_map(|act| Some(act.decision.as_ref()?.kind))
            .collect();
        assert!(kinds.contains(&SpatialDecisionKind::GraspLost), "{kinds:?}");
    }
}

/// The paper's policy uses poses at decisions alone: whether it is told the others, too, changes no bit.
#[test]
fn poses_between_decisions_are_not_missed() {
    let config = SpatialPolicyConfig::paper();
    for seed in 0..8 {
        let placed = block(-0.12 + 0.02 * f64::from(seed), -0.1, 0.1 * f64::from(seed));
        let run = looking(&config, 5, placed, |object| *object, |_| {});
        let known = knowledge(demonstrations(5, 0.6, 1), &config, Symmetry::None);
        let told = episode(&config, &known, placed, None, |_, _| {});
        assert_eq!(run.success, told.success);
        let actions = |acts: &[SpatialAct]| acts.iter().map(|act| act.action).collect::<Vec<_>>();
        assert_eq!(actions(&run.acts), actions(&told.acts));
        let decisions = |acts: &[SpatialAct]| acts.iter().filter_map(|act| act.decision.clone()).collect::<Vec<_>>();
        assert_eq!(decisions(&run.acts), decisions(&told.acts));
    }
}

#[test]
fn what_is_not_seen_has_no_influence() {
    let config = SpatialPolicyConfig::re4();
    let said = block(0.0, -0.12, 0.3);
    let ways: Vec<Vec<SpatialAct>> = [block(-0.1, 0.0, 0.0), block(0.2, 0.3, -0.5)]
        .map(|placed| looking(&config, 5, placed, |_| said, |world| world.slippery = true).acts)
        .into();
    assert_eq!(ways[0], ways[1]);
    let seeing = looking(&config, 5, block(-0.1, 0.0, 0.0), |object| *object, |_| {}).acts;
    assert_ne!(seeing[0], ways[0][0]);
}

#[test]
fn between_looks_the_object_rests_in_the_world_or_in_the_gripper() {
    let near = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let (moved, turned) = pose_distance(a, b);
        moved < 1e-12 && turned < 1e-7
    };
    let filter = SpatialPolicyConfig::re4().filter;
    for filter in [None, filter] {
        let group = Symmetry::None.group().unwrap();
        let mut estimate = ObjectEstimate::new(filter, group);
        let (over, lifted) = (toy::home(), toy::home() * Isometry3::translation(0.1, 0.0, -0.2));
        assert_eq!(estimate.carry(Mode::Transit, &over), None);
        let object = block(0.05, -0.02, 0.4);
        estimate.observe(Mode::Transit, &over, &object);
        assert!(near(&estimate.carry(Mode::Transit, &lifted).unwrap(), &object));
        // The gripper closes over it, and takes it along.
        assert!(near(&estimate.carry(Mode::Transfer, &over).unwrap(), &object));
        let along = lifted * over.inv_mul(&object);
        assert!(near(&estimate.carry(Mode::Transfer, &lifted).unwrap(), &along));
        // Let go, it stays.
        assert!(near(&estimate.carry(Mode::Transit, &lifted).unwrap(), &along));
        assert!(near(&estimate.carry(Mode::Transit, &over).unwrap(), &along));
    }
}

#[test]
fn what_cannot_be_seen_is_an_error() {
    let config = SpatialPolicyConfig::re4();
    let known = knowledge(demonstrations(5, 0.6, 1), &config, Symmetry::None);
    let world = World::new(block(0.0, 0.0, 0.0));
    let seen = world.feel();
    let mut policy = SpatialRe4::new(config.clone(), Arc::clone(&known), world.eef);
    let blind = look(&mut policy, seen, &mut || Err(PolicyError::look("it is dark")));
    assert_eq!(
        blind.unwrap_err().to_string(),
        "cannot retrieve: the object's pose is not known, since it is dark"
    );
    let mut policy = SpatialRe4::new(config, known, world.eef);
    let nowhere = look(&mut policy, seen, &mut || {
        Ok(Isometry3::translation(f64::NAN, 0.0, 0.0))
    });
    assert!(matches!(nowhere.unwrap_err(), PolicyError::Own(_)));
    let mut broken = seen;
    broken.fingers[0] = f64::NAN;
    assert!(look(&mut policy, broken, &mut || unreachable!()).is_err());
}
