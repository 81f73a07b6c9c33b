//! The stage `train` and the policies that it trains.

use std::collections::BTreeMap;
use std::path::Path;

use re4_artifact::{Artifact, Stage};
use re4_policy::kinds::{GenerativeRow, PolicyCard};
use re4_rollout::{PlaneDecisionRow, PlaneStepRow};

use crate::support::{Place, artifact_bytes, assert_same_bytes, scripted_and_simulators, wait_for};

/// A training of seconds. The small dataset has 12 demonstrations.
const SHORT: &str = "--set policy.training.steps=50 --set policy.training.batch=16";

/// The bytes of all artifacts, without the records of runs.
fn bytes(place: &Place, artifacts: &str) -> BTreeMap<String, Vec<u8>> {
    artifact_bytes(&place.path().join(artifacts))
}

/// The weights of the only `policy` artifact.
fn weights(policy: &Artifact) -> Vec<u8> {
    std::fs::read(policy.path().join(PolicyCard::WEIGHTS)).unwrap()
}

fn check_rollouts(rollouts: &Artifact, sampler: &str, passes: u32) {
    let decisions: Vec<PlaneDecisionRow> = rollouts.read().unwrap();
    let details: Vec<GenerativeRow> = rollouts.read().unwrap();
    let steps: Vec<PlaneStepRow> = rollouts.read().unwrap();
    assert_eq!(details.len(), decisions.len());
    assert!(!details.is_empty());
    for (decision, detail) in decisions.iter().zip(&details) {
        assert_eq!(&*detail.sampler, sampler);
        assert_eq!((detail.passes, detail.actions), (passes, 8));
        // Every eighth step is a decision, and it is based on the observed pose.
        assert_eq!(decision.core.step, 8 * decision.core.decision);
        assert!(decision.core.demo.is_none());
        assert!(
            decision.core.reason.contains(&detail.nearest_demo),
            "{}",
            decision.core.reason
        );
        assert!(detail.nearest_distance.is_finite());
    }
    // The object is observed in the steps that a decision is based on: its own and the one before it.
    for step in &steps {
        let expected = step.core.step % 8 == 0 || step.core.step % 8 == 7;
        assert_eq!(step.core.asked_object, Some(expected), "step {}", step.core.step);
    }
}

#[test]
fn learned_policies_run_with_equal_bytes_for_any_number_of_threads() {
    let place = Place::new();
    for (policy, settings, sampler, passes) in [
        ("diffusion", "", "ddim", 10),
        ("diffusion", "--set policy.sampler=ddpm", "ddpm", 100),
        ("flow", "", "flow", 8),
        (
            "flow",
            "--set policy.flow={deviation=0.2,stabilization=2,stochastic=true} --set policy.steps=2",
            "flow",
            16,
        ),
        ("flow", "--set policy.observation=pose", "flow", 8),
    ] {
        for jobs in [1, 2] {
            let arguments = format!(
                "rollout small.toml --policy {policy} {settings} {SHORT} --seeds 500..503 --max-steps 40 --no-images --jobs {jobs} --artifacts jobs{jobs}"
            );
            place.run(&arguments).done();
        }
        let (one, two) = (bytes(&place, "jobs1"), bytes(&place, "jobs2"));
        assert_same_bytes(&one, &two);
        let rollouts = place.path().join("jobs1").join(Stage::Rollout.artifact());
        let newest = crate::support::folders_in(&rollouts);
        let opened = newest.iter().map(|path| Artifact::open(path).unwrap());
        let own = opened.filter(|artifact| {
            let rows = artifact.read::<GenerativeRow>().unwrap();
            &*rows[0].sampler == sampler && rows[0].passes == passes
        });
        own.for_each(|artifact| check_rollouts(&artifact, sampler, passes));
    }
    // Both samplers of diffusion use the same weights, so four policies were trained.
    let policies = crate::support::folders_in(&place.path().join("jobs1").join(Stage::Train.artifact()));
    assert_eq!(policies.len(), 4);
    assert!(!place.path().join("jobs1/checkpoints").exists());
}

#[test]
fn a_killed_training_resumes_with_equal_bytes() {
    let train =
        "train small.toml --policy diffusion --set policy.training.steps=600 --set policy.training.batch=8 --no-images";
    let undisturbed = Place::new();
    undisturbed.run(train).done();
    let expected = weights(&undisturbed.artifact(Stage::Train));
    let place = Place::new();
    for epochs in [1, 3] {
        let mut child = place.start(train);
        let checkpoints = place.artifacts().join("checkpoints");
        let finished = || {
            let folder = std::fs::read_dir(&checkpoints).ok()?.next()?.ok()?.path();
            let names = std::fs::read_dir(folder).ok()?.flatten();
            let numbers =
                names.filter_map(|entry| entry.file_name().to_str()?.strip_prefix("epoch-")?.parse::<u32>().ok());
            numbers.max().filter(|number| *number >= epochs)
        };
        wait_for("a checkpoint", finished);
        child.kill().unwrap();
        child.wait().unwrap();
        // A checkpoint that was cut off is not used.
        if epochs == 3 {
            let folder = std::fs::read_dir(&checkpoints).unwrap().next().unwrap().unwrap().path();
            let newest = std::fs::read_dir(folder)
                .unwrap()
                .flatten()
                .map(|entry| entry.path())
                .max()
                .unwrap();
            let bytes = std::fs::read(&newest).unwrap();
            let later = newest.with_file_name("epoch-00099");
            std::fs::write(later, &bytes[..bytes.len() / 2]).unwrap();
        }
    }
    place.run(train).done();
    assert!(weights(&place.artifact(Stage::Train)) == expected, "the weights differ");
    assert_same_bytes(&place.bytes(), &undisturbed.bytes());
    // The artifact contains what is needed to use the policy elsewhere.
    let policy = place.artifact(Stage::Train);
    let card: PolicyCard =
        serde_json::from_slice(&std::fs::read(policy.path().join(PolicyCard::FILE)).unwrap()).unwrap();
    assert_eq!(card.observations.dimensions(), 18);
    let markdown = std::fs::read_to_string(policy.path().join("model_card.md")).unwrap();
    assert!(
        markdown.contains("no checkpoint was selected by its score"),
        "{markdown}"
    );
}

#[test]
fn a_robosuite_task_is_learned_and_rolled_out() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::empty();
    let source = data.join("lift/low_dim.hdf5");
    place.write(
        "lift.toml",
        format!(
            "task = \"lift\"\nvariant = \"state\"\n[ingest]\nsource = {source:?}\nselect = {{ first = 3 }}\n[segment]\nrule = \
             \"gripper_command\"\n[pose]\nsource = \"recorded\"\n[index]\n[policy]\nkind = \"diffusion\"\n[rollout]\nseeds = \
             \"200000..200002\"\nmax_steps = 24\n"
        ),
    );
    for policy in ["diffusion", "flow"] {
        let output = place
            .command()
            .env("RE4_SIMULATORS", &simulators)
            .args(format!("rollout lift.toml --policy {policy} {SHORT} --json").split_whitespace())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let folders = crate::support::folders_in(&place.artifacts().join(Stage::Rollout.artifact()));
    for folder in folders {
        let rows: Vec<GenerativeRow> = Artifact::open(&folder).unwrap().read().unwrap();
        assert_eq!(rows.len(), 6, "three decisions in each of two rollouts");
    }
}

#[test]
fn unusable_settings_are_one_sentence() {
    let place = Place::new();
    let refused = |arguments: &str| place.run(arguments).refused_at_once();
    for (settings, expected) in [
        ("policy.training.steps=0", "policy.training.steps is 0; give 1 or more"),
        (
            "policy.training.horizon=6",
            "policy.training.horizon is 6; give a multiple of 4",
        ),
        (
            "policy.actions=16",
            "policy.actions is 16; give 1 or more, and less than policy.training.horizon",
        ),
        (
            "policy.sampler_steps=7",
            "policy.sampler_steps is 7; give a divisor of 100",
        ),
        (
            "policy.training.learning_rate=-1",
            "policy.training.learning_rate is -1",
        ),
        ("policy.training.batch=0", "policy.training.batch is 0"),
        (
            "policy.training.network=huge",
            "policy.training.network: unknown variant `huge`",
        ),
        (
            "policy.training.step=3",
            "unknown key policy.training.step (did you mean steps?)",
        ),
        ("policy.flow={}", "unknown key policy.flow"),
    ] {
        let sentence = refused(&format!("train small.toml --policy diffusion --set {settings}"));
        assert!(sentence.contains(expected), "{settings}: {sentence}");
    }
    let sentence = refused("train small.toml");
    assert!(
        sentence.contains("nothing to train: the policy \"re4\" replays demonstrations"),
        "{sentence}"
    );
    let backend = place.run(&format!(
        "train small.toml --policy flow {SHORT} --no-images --set policy.training.backend=torch"
    ));
    let sentence = backend.refused();
    assert!(
        sentence.contains("policy.training.backend is \"torch\", but this program was built without it"),
        "{sentence}"
    );
    let wild = format!("train small.toml --policy flow {SHORT} --no-images --set policy.training.learning_rate=1e30");
    let sentence = place.run(&wild).refused();
    assert!(
        sentence.contains("the loss is not a finite number in step"),
        "{sentence}"
    );
    assert!(sentence.contains("lower policy.training.learning_rate"), "{sentence}");
}

#[test]
fn damaged_weights_are_refused() {
    let place = Place::new();
    let run = format!("rollout small.toml --policy flow {SHORT} --seeds 500..502 --no-images");
    place.run(&run).done();
    let policy = place.artifact(Stage::Train);
    let path = policy.path().join(PolicyCard::WEIGHTS);
    truncate(&path);
    // The rollouts exist, but their input is damaged.
    let sentence = place.run(&run).refused();
    assert!(sentence.contains(PolicyCard::WEIGHTS), "{sentence}");
}

fn truncate(path: &Path) {
    let bytes = std::fs::read(path).unwrap();
    std::fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
}
