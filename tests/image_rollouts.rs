//! Rollouts of robosuite tasks from images, with a mock encoder instead of a trained one. The tests need the datasets in the
//! folder that `RE4_DATA` names (or in ../shared/data), and the simulators in the folder that `RE4_SIMULATORS` names (or in
//! data/simulators, where scripts/setup-simulators.sh installs them).

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use crate::support::{Answer, Place, filters, repository, scripted_and_simulators};
use insta::{assert_snapshot, with_settings};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use re4_artifact::{
    Artifact, ArtifactSummary, Columns, Recipe, Row as _, Stage, Store, col_binary, col_bool, col_f64, col_f64_list,
    col_text, col_u32,
};
use re4_ingest::{DemoRow, FrameRow, ImageRow, ModelRow, SpatialColumns, StateRow};
use re4_mujoco::{Library, Version};
use re4_policy::spatial::{
    SpatialDecision, SpatialDemoFrame, SpatialDemoSet, SpatialKnowledge, SpatialPolicyConfig, SpatialRe4Factory,
};
use re4_robosuite::models::{split_appearance, with_assets};
use re4_robosuite::physics::without_visuals;
use re4_rollout::{
    Conditions, Estimator, Image, ObservedPose, PolicyError, RobosuiteEnv, Rollout, SceneRenderer, Source, Space,
    Start, rollout,
};
use re4_sim::robosuite::{Placement, Profile, RobosuiteModel, RobosuiteTask};
use re4_stages::testing::{Estimate, MockRun, images as rendered_images};
use serde_json::json;

fn pipeline(task: &str, source: &Path, variant: &str, policy: &str) -> String {
    let pose = if variant == "image" { "encoder" } else { "recorded" };
    format!(
        r#"task = "{task}"
variant = "{variant}"
[ingest]
source = "{}"
select = {{ first = 20 }}
[segment]
[pose]
source = "{pose}"
[index]
leave_out = ["missed_grasp", "lost_grasp"]
[rollout]
policy = "{policy}"
symmetry = {{ kind = "none" }}
seeds = "200000..200005"
"#,
        source.display()
    )
}

fn run(place: &Place, simulators: &Path, arguments: &str) -> Answer {
    let mut command: Command = place.command();
    command
        .env("RE4_SIMULATORS", simulators)
        .args(arguments.split_whitespace());
    Answer::new(&command.output().unwrap(), place.path())
}

/// The datasets and the simulators. Sets the simulators for this process, too.
fn data_and_simulators() -> Option<(PathBuf, PathBuf)> {
    let there = scripted_and_simulators()?;
    std::env::set_current_dir(repository()).unwrap();
    Some(there)
}

fn only(place: &Place, artifacts: &str, stage: Stage) -> Artifact {
    let mut folders = crate::support::folders_in(&place.path().join(artifacts).join(stage.artifact()));
    assert_eq!(folders.len(), 1, "{stage:?}");
    Artifact::open(&folders.remove(0)).unwrap()
}

const POSE: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];

/// Writes a `poses` artifact with these rows (episode, frame, pose). Returns its folder.
pub(crate) fn write_poses(artifacts: &Path, episodes: &Artifact, name: &str, rows: &[(u32, u32, [f64; 7])]) -> PathBuf {
    let recipe = Recipe::new(Stage::TrainPose, 1)
        .config(&json!({ "mock": name }))
        .unwrap()
        .input("episodes", episodes.key());
    let writer = Store::open(artifacts).unwrap().begin(&recipe).unwrap();
    let mut table = writer
        .table(re4_pose::PoseRow::<re4_pose::SpatialEstimate>::table())
        .unwrap();
    let mut columns = Columns::new(re4_pose::PoseRow::<re4_pose::SpatialEstimate>::table())
        .u32("episode", rows.iter().map(|row| row.0).collect())
        .u32("frame", rows.iter().map(|row| row.1).collect())
        .bool("trained_on", vec![true; rows.len()])
        .f64_or_null("confidence", vec![None; rows.len()])
        .bool_or_null("unsure", vec![None; rows.len()])
        .f32_rows("embedding", vec![0.0; rows.len()], 1);
    for (k, part) in POSE.into_iter().enumerate() {
        columns = columns.f64(&format!("object_{part}"), rows.iter().map(|row| row.2[k]).collect());
    }
    table.write_columns(columns).unwrap();
    table.finish().unwrap();
    let summary = ArtifactSummary {
        summary: json!({}),
        warnings: Vec::new(),
    };
    writer.publish(summary).unwrap().path().to_owned()
}

/// The recorded object poses, as (episode, frame, pose).
pub(crate) fn recorded(episodes: &Artifact) -> Vec<(u32, u32, [f64; 7])> {
    let table = episodes
        .table(FrameRow::<SpatialColumns>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let parts = POSE.map(|part| col_f64(&table, &format!("object_{part}")).unwrap());
    let numbers = col_u32(&table, "episode").unwrap();
    let frames = col_u32(&table, "frame").unwrap();
    (0..table.num_rows())
        .map(|row| (numbers[row], frames[row], parts.map(|part| part[row])))
        .collect()
}

/// The actions by step, and whether each rollout succeeded.
fn actions(rollouts: &Artifact) -> (Vec<Vec<u64>>, Vec<bool>) {
    let steps = crate::support::steps(rollouts);
    let bits = ["x", "y", "z", "rx", "ry", "rz"].map(|part| {
        let column = col_f64(&steps, &format!("action_{part}")).unwrap();
        column.iter().map(|number| number.to_bits()).collect()
    });
    let results = crate::support::results(rollouts);
    let success = col_bool(&results, "success").unwrap();
    (
        bits.to_vec(),
        (0..results.num_rows()).map(|row| success.value(row)).collect(),
    )
}

/// With an encoder without errors, a policy that observes the object only at decisions executes the same actions as one that
/// observes it at every step but uses it only at decisions. A policy that uses it at every step succeeds as often without that.
#[test]
fn an_encoder_without_errors_matches_recorded_poses() {
    let Some((data, simulators)) = data_and_simulators() else {
        return;
    };
    let place = Place::empty();
    let lift = data.join("lift/low_dim.hdf5");
    let artifacts = place.path().join("artifacts");
    for policy in ["paper", "re4"] {
        place.write(&format!("{policy}.toml"), pipeline("lift", &lift, "state", policy));
        place.write(
            &format!("{policy}-image.toml"),
            pipeline("lift", &lift, "image", policy),
        );
    }
    run(&place, &simulators, "segment paper.toml").done();
    let episodes = only(&place, "artifacts", Stage::Ingest);
    let poses = write_poses(&artifacts, &episodes, "recorded", &recorded(&episodes));
    for policy in ["paper", "re4"] {
        let folder = format!("{policy}-state");
        run(
            &place,
            &simulators,
            &format!("rollout {policy}.toml --artifacts {folder}"),
        )
        .done();
        let state = only(&place, &folder, Stage::Rollout);
        let asked = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&asked);
        let truth: Estimate = Arc::new(move |image, object| {
            assert_eq!(image.len(), 84 * 84 * 3);
            count.fetch_add(1, Ordering::Relaxed);
            *object
        });
        let start = Instant::now();
        let mock = MockRun {
            pipeline: &place.path().join(format!("{policy}-image.toml")),
            overrides: &[],
            artifacts: &artifacts,
            poses: &poses,
        };
        let image = Artifact::open(&mock.roll_out(&truth).unwrap()).unwrap();
        println!("{policy}: {:.1} s from images", start.elapsed().as_secs_f64());
        let (there, seen) = (actions(&state), actions(&image));
        assert_eq!(there.1, seen.1, "{policy}");
        assert!(seen.1.iter().filter(|success| **success).count() >= 4, "{policy}");
        if policy == "paper" {
            assert!(there.0 == seen.0, "paper: the actions differ");
        }
        // One image is rendered per decision that depends on the object, and none in between.
        let summary = &image.manifest().summary;
        let steps = crate::support::steps(&image).num_rows() as u64;
        assert_eq!(summary["images"], asked.load(Ordering::Relaxed));
        let decisions = crate::support::decisions(&image);
        let kinds = col_text(&decisions, "kind").unwrap();
        let looked = kinds
            .iter()
            .filter(|kind| matches!(kind, Some("retrieve" | "continue")))
            .count() as u64;
        assert_eq!(summary["images"], looked);
        assert!(10 * looked < steps, "{looked} images in {steps} steps");
        assert!(state.manifest().summary.get("images").is_none());
        assert!(image.manifest().inputs.contains_key("poses"));
    }
}

/// The image that the policy observes in a state equals the image that robosuite recorded.
#[test]
fn images_equal_those_of_the_demonstrations() {
    let Some((data, simulators)) = data_and_simulators() else {
        return;
    };
    for task in ["lift", "can", "square"] {
        let place = Place::empty();
        let text =
            pipeline(task, &data.join(task).join("image_5.hdf5"), "image", "re4").replace("first = 20", "first = 3");
        place.write("task.toml", text);
        run(&place, &simulators, "segment task.toml").done();
        let episodes = only(&place, "artifacts", Stage::Ingest);
        let images = episodes.table(ImageRow::table()).unwrap().read_all().unwrap();
        let (cameras, of_episode) = (
            col_text(&images, "camera").unwrap(),
            col_u32(&images, "episode").unwrap(),
        );
        let states = episodes.table(StateRow::table()).unwrap().read_all().unwrap();
        let (demos, states) = (
            col_u32(&states, "episode").unwrap().to_vec(),
            col_f64_list(&states, "state").unwrap(),
        );
        let models = episodes.table(ModelRow::table()).unwrap().read_all().unwrap();
        let models = col_text(&models, "mjcf").unwrap();
        let listing = episodes.table(DemoRow::table()).unwrap().read_all().unwrap();
        let model_of = re4_artifact::col_u32_or_null(&listing, "model").unwrap();
        let front = cameras.iter().position(|camera| *camera == Some("agentview")).unwrap();
        for demo in 0..3_u32 {
            let mjcf = models[model_of[demo as usize].unwrap() as usize].unwrap();
            let boxes = split_appearance(mjcf).unwrap().boxes;
            let rows: Vec<usize> = (0..demos.len()).filter(|row| demos[*row] == demo).step_by(9).collect();
            let of_rows: Vec<Vec<f64>> = rows.iter().map(|row| states[*row].clone()).collect();
            let start = Instant::now();
            let rendered =
                rendered_images(&place.path().join("task.toml"), &place.artifacts(), &boxes, &of_rows).unwrap();
            println!(
                "{task}: {} images in {:.2} s",
                rendered.len(),
                start.elapsed().as_secs_f64()
            );
            for (row, rendered) in rows.iter().zip(&rendered) {
                let recorded = front + row;
                assert_eq!(of_episode[recorded], demo);
                let png = col_binary(&images, "image").unwrap().value(recorded);
                let recorded = image::load_from_memory(png).unwrap().into_rgb8().into_raw();
                assert!(recorded == *rendered, "{task}, demonstration {demo}, row {row}");
            }
        }
    }
}

/// An estimator that always returns the same pose.
struct Always(Isometry3<f64>);

impl Estimator<Space> for Always {
    fn estimate(&mut self, image: &Image) -> Result<ObservedPose<Space>, PolicyError> {
        assert_eq!(image.pixels.len(), 84 * 84 * 3);
        Ok(ObservedPose {
            pose: self.0,
            confidence: None,
            flag: None,
        })
    }
}

/// The policy learns the object pose only from the estimator. With an estimator that always returns the same pose, the actions up
/// to the grasp are bit-exact the same for a cube at another position.
#[test]
fn the_policy_observes_the_object_only_through_the_estimator() {
    let Some((data, simulators)) = data_and_simulators() else {
        return;
    };
    let place = Place::empty();
    place.write(
        "lift.toml",
        pipeline("lift", &data.join("lift/low_dim.hdf5"), "state", "re4"),
    );
    run(&place, &simulators, "index lift.toml").done();
    let episodes = only(&place, "artifacts", Stage::Ingest);
    let models = episodes.table(ModelRow::table()).unwrap().read_all().unwrap();
    let mjcf = without_visuals(col_text(&models, "mjcf").unwrap()[0].unwrap()).unwrap();
    let mjcf = with_assets(&mjcf, &simulators.join("robosuite-1.4.1")).unwrap();
    let lift = RobosuiteTask::named("lift").unwrap();
    let placement = Placement::sample(lift, 200_000);
    let mjcf = placement.in_model(&mjcf).unwrap();
    let library = Library::open(&simulators.join("mujoco-2.3.7"), Version::V2_3_7).unwrap();
    let model = RobosuiteModel::compile(&library, lift, Profile::V1_4, &mjcf).unwrap();
    let index = only(&place, "artifacts", Stage::Index);
    let config = SpatialPolicyConfig::re4();
    let knowledge = Arc::new(knowledge(&index, &config));
    let here = placement.clone();
    let mut elsewhere = here.clone();
    let cube = placement.objects[0].position;
    elsewhere.objects[0].position[0] += 0.1;
    let constant = Isometry3::from_parts(
        Translation3::from(Vector3::new(cube[0], cube[1] - 0.02, cube[2])),
        UnitQuaternion::identity(),
    );
    let with_visuals = with_assets(
        col_text(&models, "mjcf").unwrap()[0].unwrap(),
        &simulators.join("robosuite-1.4.1"),
    )
    .unwrap();
    let visual_model = RobosuiteModel::compile(&library, lift, Profile::V1_4, &with_visuals).unwrap();
    let scene_renderer = SceneRenderer::new(with_visuals, visual_model.mujoco().clone(), 84);
    let factory = SpatialRe4Factory { config, knowledge };
    let roll_out = |scene: &Placement, truthful: bool| -> Rollout<Space, SpatialDecision> {
        let start = Start {
            seed: 200_000,
            scene: scene.clone(),
        };
        let mut env = RobosuiteEnv::new(&model, Some(&scene_renderer)).unwrap();
        let source = if truthful {
            Source::Recorded
        } else {
            Source::Image {
                camera: "agentview".to_owned(),
                estimator: Box::new(Always(constant)),
            }
        };
        rollout(&factory, &mut env, source, start, 30, &Conditions::default()).unwrap()
    };
    let (one, other) = (roll_out(&here, false), roll_out(&elsewhere, false));
    assert_ne!(one.first.observation.object, other.first.observation.object);
    assert_eq!(one.first.observation.grip_site, other.first.observation.grip_site);
    assert_eq!(one.decisions[0], other.decisions[0]);
    // Until the first contact, all actions are the same.
    let same = one
        .steps
        .iter()
        .zip(&other.steps)
        .take_while(|(a, b)| a.action == b.action)
        .count();
    assert!(same >= 15, "{same} steps");
    assert!(one.steps.iter().take(same).all(|step| step.seen == Some(constant)));
    // An image is rendered only when the pose is requested.
    assert!(one.images() >= 1 && one.images() as usize <= one.decisions.len());
    assert!(
        one.steps
            .iter()
            .all(|step| step.asked.object.is_some() == (step.asked.images == 1))
    );
    // With recorded poses, the actions differ.
    let (one, other) = (roll_out(&here, true), roll_out(&elsewhere, true));
    assert_ne!(one.decisions[0].set_point, other.decisions[0].set_point);
    assert!(one.steps.iter().all(|step| step.asked.object.is_some()) && one.images() == 0);
}

fn knowledge(index: &Artifact, config: &SpatialPolicyConfig) -> SpatialKnowledge {
    let table = index
        .table(re4_index::IndexRow::<re4_index::SpatialState>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let column = |name: &str| col_f64(&table, name).unwrap();
    let pose = |prefix: &str, row: usize| {
        let [x, y, z, qx, qy, qz, qw] = POSE.map(|part| column(&format!("{prefix}_{part}"))[row]);
        Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(qw, qx, qy, qz)),
        )
    };
    let modes = col_text(&table, "mode").unwrap();
    let mut demos: Vec<(u32, Vec<SpatialDemoFrame>)> = Vec::new();
    for (row, episode) in col_u32(&table, "episode").unwrap().iter().enumerate() {
        let [x, y, z, rx, ry, rz] = ["x", "y", "z", "rx", "ry", "rz"].map(|part| column(&format!("goal_{part}"))[row]);
        let frame = SpatialDemoFrame {
            eef: pose("eef", row),
            object: pose("object", row),
            goal: Isometry3::new(Vector3::new(x, y, z), Vector3::new(rx, ry, rz)),
            gripper: column("gripper")[row],
            mode: re4_episode::Mode::from_name(modes[row].unwrap()).unwrap(),
        };
        match demos.last_mut().filter(|(number, _)| number == episode) {
            Some((_, frames)) => frames.push(frame),
            None => demos.push((*episode, vec![frame])),
        }
    }
    let demos = SpatialDemoSet::new(demos);
    SpatialKnowledge::new(
        demos,
        &config.retrieve,
        re4_geometry::spatial::Symmetry::None,
        |_, _| false,
    )
    .unwrap()
}

/// An index of estimated poses does not depend on the recorded ones, neither in its poses nor in the frames that it leaves out.
#[test]
fn the_index_contains_estimated_poses_and_never_recorded_ones() {
    let Some((data, simulators)) = data_and_simulators() else {
        return;
    };
    let place = Place::empty();
    let lift = data.join("lift/low_dim.hdf5");
    place.write("lift.toml", pipeline("lift", &lift, "image", "re4"));
    place.write("state.toml", pipeline("lift", &lift, "state", "re4"));
    run(&place, &simulators, "index state.toml --artifacts state").done();
    run(&place, &simulators, "segment lift.toml").done();
    let episodes = only(&place, "artifacts", Stage::Ingest);
    // Poses that differ from all recorded ones.
    let rows: Vec<_> = recorded(&episodes)
        .into_iter()
        .map(|(episode, frame, _)| {
            let rotated = UnitQuaternion::from_euler_angles(0.0, 0.0, f64::from(frame)).coords;
            let place = [f64::from(episode), f64::from(frame), 1.0];
            (
                episode,
                frame,
                [place[0], place[1], place[2], rotated.x, rotated.y, rotated.z, rotated.w],
            )
        })
        .collect();
    let (toml, artifacts) = (place.path().join("lift.toml"), place.path().join("artifacts"));
    let index_over = |poses: &Path| {
        let mock = MockRun {
            pipeline: &toml,
            overrides: &[],
            artifacts: &artifacts,
            poses,
        };
        mock.index()
    };
    let index = index_over(&write_poses(&artifacts, &episodes, "nowhere", &rows)).unwrap();
    let index = Artifact::open(&index).unwrap();
    let table = index
        .table(re4_index::IndexRow::<re4_index::SpatialState>::table())
        .unwrap()
        .read_all()
        .unwrap();
    for (k, part) in POSE.into_iter().enumerate() {
        let column = col_f64(&table, &format!("object_{part}")).unwrap();
        assert!(
            column.iter().zip(&rows).all(|(found, row)| *found == row.2[k]),
            "{part}"
        );
    }
    assert!(index.manifest().inputs.contains_key("poses") && !index.manifest().inputs.contains_key("audit"));
    // Failed grasps are detected from the fingers, too.
    let state = only(&place, "state", Stage::Index);
    let of_state = state
        .table(re4_index::IndexRow::<re4_index::SpatialState>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let retrievable = |table| {
        col_bool(table, "retrievable")
            .unwrap()
            .iter()
            .map(Option::unwrap)
            .collect::<Vec<_>>()
    };
    let (by_fingers, by_object) = (retrievable(&table), retrievable(&of_state));
    let left_out = by_fingers.iter().filter(|kept| !**kept).count();
    println!(
        "left out: {left_out} frames by the fingers, {} by fingers and object",
        by_object.iter().filter(|kept| !**kept).count()
    );
    assert!(left_out > 0);
    for part in ["eef_x", "goal_x", "gripper"] {
        assert_eq!(col_f64(&table, part).unwrap(), col_f64(&of_state, part).unwrap());
    }

    // Poses of other demonstrations are refused.
    let mut errors = String::new();
    let mut refuse = |what: &str, rows: &[(u32, u32, [f64; 7])]| {
        let sentence = index_over(&write_poses(&artifacts, &episodes, what, rows)).unwrap_err();
        writeln!(errors, "{what}\n  {sentence}").unwrap();
    };
    refuse("a frame short", &rows[..rows.len() - 1]);
    let first: Vec<_> = rows.iter().copied().filter(|row| row.0 != 3).collect();
    refuse("a demonstration short", &first);
    let mut more = rows.clone();
    more.push((100, 0, rows[0].2));
    refuse("a demonstration too many", &more);
    let mut mixed = rows.clone();
    mixed.swap(4, 5);
    refuse("not sorted", &mixed);
    let folder = place.path().canonicalize().unwrap();
    let mut filters = filters();
    filters.push((folder.to_str().unwrap(), "[folder]"));
    filters.push((place.path().to_str().unwrap(), "[folder]"));
    filters.push(("poses/[0-9a-f]+", "poses/[key]"));
    with_settings!({ filters => filters }, { assert_snapshot!(errors) });
}

/// Everything that prevents an image variant from starting gives one sentence and exit code 2.
#[test]
fn missing_images_and_conflicting_settings() {
    let Some((data, simulators)) = data_and_simulators() else {
        return;
    };
    let place = Place::empty();
    let text = pipeline("lift", &data.join("lift/low_dim.hdf5"), "image", "re4").replace("first = 20", "first = 1");
    place.write("lift.toml", &text);
    let recorded = text.replace("low_dim.hdf5", "image_5.hdf5");
    place.write("recorded.toml", &recorded);
    place.write(
        "state.toml",
        pipeline("lift", &data.join("lift/low_dim.hdf5"), "state", "re4"),
    );
    let mut errors = String::new();
    let mut refuse = |what: &str, arguments: &str| {
        let sentence = run(&place, &simulators, &format!("{arguments} --quiet")).refused();
        writeln!(errors, "{what}\n  {}", sentence.trim_end()).unwrap();
    };
    for command in ["train-pose", "index", "rollout", "run"] {
        refuse(&format!("{command}, no images"), &format!("{command} lift.toml"));
    }
    refuse("no images at all", "rollout lift.toml --no-images");
    refuse("nothing to train", "train-pose state.toml");
    let settings = [
        ("another camera rendered", "ingest.render=[\"robot0_eye_in_hand\"]"),
        ("rule", "segment.rule=\"rigid_motion\""),
        ("check of the object", "index.leave_out=[\"dropped\"]"),
        ("noise", "rollout.noise={translation=0.01}"),
        ("state", "variant=\"state\""),
    ];
    for (what, setting) in settings {
        refuse(what, &format!("rollout lift.toml --set {setting}"));
    }
    refuse(
        "another camera recorded",
        "rollout recorded.toml --set pose.encoder.camera=\"frontview\"",
    );
    refuse(
        "another camera taken",
        "rollout recorded.toml --set ingest.cameras=[\"robot0_eye_in_hand\"]",
    );
    let mut filters = filters();
    filters.push((data.to_str().unwrap(), "[data]"));
    filters.push((simulators.to_str().unwrap(), "[simulators]"));
    let folder = place.path().canonicalize().unwrap();
    filters.push((folder.to_str().unwrap(), "[folder]"));
    filters.push(("episodes/[0-9a-f]+", "episodes/[key]"));
    with_settings!({ filters => filters }, { assert_snapshot!(errors) });
}
