//! Rollouts of robosuite's tasks from images, with an invented encoder in the place of a trained one. They run where `RE4_DATA`
//! names the folder of the datasets (or it lies in ../shared/data) and `RE4_SIMULATORS` that of the simulators (or
//! scripts/setup-simulators.sh has put them into data/simulators).

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
use re4_robosuite::models::{looks, with_assets};
use re4_robosuite::physics::without_images;
use re4_rollout::{
    Estimator, Image, ObservedPose, PolicyError, RobosuiteEnv, Rollout, SceneRenderer, Source, Space, Start, rollout,
};
use re4_sim::robosuite::{Placement, Profile, RobosuiteModel, RobosuiteTask};
use re4_stages::testing::{Estimate, Invented, images as rendered_images};
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

/// The data, and the simulators where this process looks for them, too.
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

/// Writes a `poses` artifact with these rows of episode, frame and pose.
pub(crate) fn write_poses(artifacts: &Path, episodes: &Artifact, name: &str, rows: &[(u32, u32, [f64; 7])]) -> PathBuf {
    let recipe = Recipe::new(Stage::TrainPose, 1)
        .config(&json!({ "invented": name }))
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

/// The recorded poses of the object.
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

/// What rollouts did: actions step by step, and who succeeded.
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

/// With an encoder that makes no errors, a policy that looks at decisions alone does the same as one that is told the pose at
/// every step and uses it at decisions alone; and the policy that uses it at every step succeeds as often without.
#[test]
fn an_encoder_without_errors_is_as_good_as_recorded_poses() {
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
        let invented = Invented {
            pipeline: &place.path().join(format!("{policy}-image.toml")),
            overrides: &[],
            artifacts: &artifacts,
            poses: &poses,
        };
        let image = Artifact::open(&invented.roll_out(&truth).unwrap()).unwrap();
        println!("{policy}: {:.1} s from images", start.elapsed().as_secs_f64());
        let (there, seen) = (actions(&state), actions(&image));
        assert_eq!(there.1, seen.1, "{policy}");
        assert!(seen.1.iter().filter(|success| **success).count() >= 4, "{policy}");
        if policy == "paper" {
            assert!(there.0 == seen.0, "paper: the actions differ");
        }
        // One image a decision that depends on the object, and none in between.
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

/// The image that the policy sees of a state is the one that robosuite recorded of it.
#[test]
fn images_are_those_of_the_demonstrations() {
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
            let boxes = looks(mjcf).unwrap().boxes;
            let rows: Vec<usize> = (0..demos.len()).filter(|row| demos[*row] == demo).step_by(9).collect();
            let of_rows: Vec<Vec<f64>> = rows.iter().map(|row| states[*row].clone()).collect();
            let start = Instant::now();
            let drawn = rendered_images(&place.path().join("task.toml"), &place.artifacts(), &boxes, &of_rows).unwrap();
            println!(
                "{task}: {} images in {:.2} s",
                drawn.len(),
                start.elapsed().as_secs_f64()
            );
            for (row, drawn) in rows.iter().zip(&drawn) {
                let recorded = front + row;
                assert_eq!(of_episode[recorded], demo);
                let png = col_binary(&images, "image").unwrap().value(recorded);
                let recorded = image::load_from_memory(png).unwrap().into_rgb8().into_raw();
                assert!(recorded == *drawn, "{task}, demonstration {demo}, row {row}");
            }
        }
    }
}

/// An estimator that has seen enough: it always says the same.
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

/// The policy knows of the object what the estimator says, wherever the object is: with one that always says the same,
/// the whole way to the grasp is the same for a cube that lies elsewhere, to the bit.
#[test]
fn nothing_but_the_estimator_tells_the_policy_where_the_object_is() {
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
    let mjcf = without_images(col_text(&models, "mjcf").unwrap()[0].unwrap()).unwrap();
    let mjcf = with_assets(&mjcf, &simulators.join("robosuite-1.4.1")).unwrap();
    let lift = RobosuiteTask::named("lift").unwrap();
    let placement = Placement::draw(lift, 200_000);
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
    let said = Isometry3::from_parts(
        Translation3::from(Vector3::new(cube[0], cube[1] - 0.02, cube[2])),
        UnitQuaternion::identity(),
    );
    let drawn = with_assets(
        col_text(&models, "mjcf").unwrap()[0].unwrap(),
        &simulators.join("robosuite-1.4.1"),
    )
    .unwrap();
    let drawn_model = RobosuiteModel::compile(&library, lift, Profile::V1_4, &drawn).unwrap();
    let scene_renderer = SceneRenderer::new(drawn, drawn_model.mujoco().clone(), 84);
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
                estimator: Box::new(Always(said)),
            }
        };
        rollout(&factory, &mut env, source, start, 30).unwrap()
    };
    let (one, other) = (roll_out(&here, false), roll_out(&elsewhere, false));
    assert_ne!(one.first.observation.object, other.first.observation.object);
    assert_eq!(one.first.observation.grip_site, other.first.observation.grip_site);
    assert_eq!(one.decisions[0], other.decisions[0]);
    // Until something is touched, every action is the same.
    let same = one
        .steps
        .iter()
        .zip(&other.steps)
        .take_while(|(a, b)| a.action == b.action)
        .count();
    assert!(same >= 15, "{same} steps");
    assert!(one.steps.iter().take(same).all(|step| step.seen == Some(said)));
    // An image is rendered where the pose is asked for, and nowhere else.
    assert!(one.images() >= 1 && one.images() as usize <= one.decisions.len());
    assert!(
        one.steps
            .iter()
            .all(|step| step.asked.object.is_some() == (step.asked.images == 1))
    );
    // And with the recorded pose, they are not.
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

/// Of an index over estimated poses, nothing depends on the recorded ones: not the poses, and not what is left out of it.
#[test]
fn the_index_holds_the_estimated_poses_and_never_the_recorded_ones() {
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
    // Poses that no object ever had.
    let rows: Vec<_> = recorded(&episodes)
        .into_iter()
        .map(|(episode, frame, _)| {
            let turned = UnitQuaternion::from_euler_angles(0.0, 0.0, f64::from(frame)).coords;
            let place = [f64::from(episode), f64::from(frame), 1.0];
            (
                episode,
                frame,
                [place[0], place[1], place[2], turned.x, turned.y, turned.z, turned.w],
            )
        })
        .collect();
    let (toml, artifacts) = (place.path().join("lift.toml"), place.path().join("artifacts"));
    let index_over = |poses: &Path| {
        let invented = Invented {
            pipeline: &toml,
            overrides: &[],
            artifacts: &artifacts,
            poses,
        };
        invented.index()
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
    // Failed grasps show in the fingers, too.
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
    let mut told = String::new();
    let mut refuse = |what: &str, rows: &[(u32, u32, [f64; 7])]| {
        let sentence = index_over(&write_poses(&artifacts, &episodes, what, rows)).unwrap_err();
        writeln!(told, "{what}\n  {sentence}").unwrap();
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
    with_settings!({ filters => filters }, { assert_snapshot!(told) });
}

/// What keeps an image variant from starting, each in one sentence with exit code 2.
#[test]
fn what_cannot_be_seen_is_told_in_one_sentence() {
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
    let mut told = String::new();
    let mut tell = |what: &str, arguments: &str| {
        let sentence = run(&place, &simulators, &format!("{arguments} --quiet")).refused();
        writeln!(told, "{what}\n  {}", sentence.trim_end()).unwrap();
    };
    for command in ["train-pose", "index", "rollout", "run"] {
        tell(&format!("{command}, no images"), &format!("{command} lift.toml"));
    }
    tell("no images at all", "rollout lift.toml --no-images");
    tell("nothing to train", "train-pose state.toml");
    let settings = [
        ("another camera drawn", "ingest.render=[\"robot0_eye_in_hand\"]"),
        ("rule", "segment.rule=\"rigid_motion\""),
        ("check of the object", "index.leave_out=[\"dropped\"]"),
        ("noise", "rollout.noise={translation=0.01}"),
        ("state", "variant=\"state\""),
    ];
    for (what, setting) in settings {
        tell(what, &format!("rollout lift.toml --set {setting}"));
    }
    tell(
        "another camera recorded",
        "rollout recorded.toml --set pose.encoder.camera=\"frontview\"",
    );
    tell(
        "another camera taken",
        "rollout recorded.toml --set ingest.cameras=[\"robot0_eye_in_hand\"]",
    );
    let mut filters = filters();
    filters.push((data.to_str().unwrap(), "[data]"));
    filters.push((simulators.to_str().unwrap(), "[simulators]"));
    let folder = place.path().canonicalize().unwrap();
    filters.push((folder.to_str().unwrap(), "[folder]"));
    filters.push(("episodes/[0-9a-f]+", "episodes/[key]"));
    with_settings!({ filters => filters }, { assert_snapshot!(told) });
}
