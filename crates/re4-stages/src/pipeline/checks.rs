//! Checks settings for values that have the right type but are out of range or contradict each other.

use anyhow::Result;
use re4_encoder::loss::GROUP;
use re4_encoder::{EncoderConfig, KEYPOINT_CHANNELS, Network};
use re4_fault::{Fault, bail, ensure};
use re4_robosuite::conventions::Settings as Conventions;
use re4_rollout::Disturbed;
use re4_scenes::ScenesConfig;
use re4_segment::{AnchorAt, Rule};
use re4_sim::{GOAL_MARGIN, WALL_FACES, depth_in_walls};
use re4_task::{Domain, RobosuiteTask};

use super::{Goal, IngestSection, Pipeline, PoseSection, PoseSource, RolloutSection, Task, Variant};

/// Refuses settings with which a stage could not work, such as zero steps or waypoints with no distance between them.
///
/// # Errors
/// Names the first such setting and the values that are allowed.
pub(crate) fn check(pipeline: &Pipeline) -> Result<()> {
    pipeline.audit.check()?;
    ensure!(
        pipeline.policy.is_none() || pipeline.rollout.is_some(),
        "the pipeline file has a table [policy] but no table [rollout]";
        "add [rollout], or remove [policy]"
    );
    match pipeline.task.domain() {
        Domain::Plane => {}
        Domain::Space => return check_robosuite(pipeline),
        Domain::Arm => return check_arm(pipeline),
    }
    check_planar(pipeline)?;
    let Some(rollout) = &pipeline.rollout else {
        ensure!(
            pipeline.scenes.is_none(),
            "the pipeline file has a table [scenes] but no table [rollout]";
            "add [rollout], or remove [scenes]"
        );
        return Ok(());
    };
    check_rollout(pipeline, rollout)?;
    check_conditions(pipeline, rollout, "px", 100.0)?;
    match (&pipeline.scenes, &rollout.seeds) {
        (Some(scenes), None) => check_scenes(scenes),
        (None, Some(_)) => Ok(()),
        (Some(_), Some(_)) => {
            bail!("rollout.seeds and a table [scenes] both define where rollouts start"; "remove one of them")
        }
        (None, None) => {
            bail!("no start scenes are given"; "give rollout.seeds, such as \"500..600\", or a table [scenes]")
        }
    }
}

/// Checks of the audit that depend on the recorded object pose.
const ABOUT_THE_OBJECT: [&str; 8] = [
    "discontinuity_object",
    "dropped",
    "duplicate",
    "early_release",
    "frozen",
    "non_rigid_rotation",
    "non_rigid_transfer",
    "pushed_in_transit",
];

/// What the stages after the audit need and a dataset without an object does not have.
const NO_OBJECT: &str = "task is \"arm\", which has neither object poses nor a simulation";

/// Checks a pipeline of an arm without an object.
fn check_arm(pipeline: &Pipeline) -> Result<()> {
    let ingest = &pipeline.ingest;
    let foreign = [
        ("object", ingest.object.is_some()),
        ("env_args", ingest.env_args.is_some()),
        ("compare", ingest.compare.is_some()),
        ("conventions", ingest.conventions != Conventions::default()),
        ("pusht", !ingest.pusht.is_default()),
        ("render", !ingest.render.is_empty()),
    ];
    if let Some((key, _)) = foreign.iter().find(|(_, there)| *there) {
        bail!("ingest.{key} does not apply to the task \"arm\", which has neither an object nor a simulation"; "remove it");
    }
    ensure!(
        ingest.images || ingest.cameras.is_none(),
        "ingest.images is false, but ingest.cameras names cameras";
        "remove one of them"
    );
    if let Err(why) = ingest.arm.check() {
        bail!("ingest.arm.{why}");
    }
    ensure!(
        matches!(pipeline.segment.rule, Rule::Gripper | Rule::AlwaysTransit),
        "segment.rule is \"{}\", which needs an object or a two-finger gripper of known size", pipeline.segment.rule.as_str();
        "set it to \"gripper\" for the task \"arm\""
    );
    let tables = [
        ("variant", pipeline.variant.is_some()),
        ("[pose]", pipeline.pose.is_some()),
        ("[index]", pipeline.index.is_some()),
        ("[scenes]", pipeline.scenes.is_some()),
        ("[rollout]", pipeline.rollout.is_some()),
    ];
    match tables.iter().find(|(_, there)| *there) {
        Some((table, _)) => bail!(
            "{NO_OBJECT}, but the pipeline file has {table}";
            "remove it and stop at the audit, or set task to a task with an object, such as \"can\""
        ),
        None => Ok(()),
    }
}

/// Checks a pipeline of a robosuite task.
fn check_robosuite(pipeline: &Pipeline) -> Result<()> {
    let ingest = &pipeline.ingest;
    ensure!(ingest.pusht.is_default(), "ingest.pusht applies only to Push-T"; "remove it");
    ensure!(
        ingest.arm.is_default(),
        "ingest.arm applies only to the task \"arm\"";
        "remove it, or set task = \"arm\""
    );
    ensure!(
        pipeline.segment.rule != Rule::Gripper,
        "segment.rule is \"gripper\", which is the rule of the task \"arm\"";
        "set it to \"grasp\", which reads the fingers of a robosuite gripper"
    );
    ensure!(
        ingest.object.is_none() || pipeline.task == Task::Robosuite,
        "ingest.object is given, but the task already defines the object";
        "remove it, or set task = \"robosuite\""
    );
    ensure!(
        ingest.images || ingest.cameras.is_none(),
        "ingest.images is false, but ingest.cameras names cameras";
        "remove one of them"
    );
    ensure!(
        renders_own(pipeline),
        "ingest.render names the camera \"image\", which only Push-T has";
        "use \"agentview\" or \"robot0_eye_in_hand\""
    );
    ensure!(
        ingest.render.is_empty() || ingest.cameras.is_none(),
        "ingest.cameras selects recorded images, but ingest.render requests rendered ones";
        "remove one of them"
    );
    check_render(ingest)?;
    ensure!(pipeline.scenes.is_none(), "the table [scenes] applies only to Push-T"; "remove it, and give rollout.seeds");
    check_spatial_pose(pipeline)?;
    let Some(rollout) = &pipeline.rollout else {
        return Ok(());
    };
    ensure!(
        pipeline.task != Task::Robosuite,
        "{}, or remove the table [rollout]",
        RobosuiteTask::known()
    );
    check_rollout(pipeline, rollout)?;
    ensure!(rollout.seeds.is_some(), "no start scenes are given"; "give rollout.seeds, such as \"500..600\"");
    check_conditions(pipeline, rollout, "m", 1.0)
}

/// Checks the conditions of rollouts. Lengths are in `unit` and at most `longest`.
fn check_conditions(pipeline: &Pipeline, rollout: &RolloutSection, unit: &str, longest: f64) -> Result<()> {
    ensure!(
        pipeline.variant != Some(Variant::Image) || rollout.noise.is_none(),
        "variant is \"image\", but rollout.noise adds errors to recorded poses only";
        "remove rollout.noise"
    );
    if let Some(noise) = &rollout.noise {
        standard_deviation("rollout.noise.translation", noise.translation, unit, longest)?;
        standard_deviation("rollout.noise.rotation", noise.rotation, "rad", std::f64::consts::PI)?;
    }
    between("rollout.latency", rollout.latency, 0, OLDEST)?;
    if let Some(disturbance) = &rollout.disturbance {
        let [first, last] = disturbance.steps;
        ensure!(
            first <= last && last < rollout.max_steps,
            "rollout.disturbance.steps is [{first}, {last}], and an episode has the steps 0 to {}", rollout.max_steps - 1;
            "give the first and the last of these steps before which the disturbance may happen"
        );
        padding(
            "rollout.disturbance.translation",
            disturbance.translation,
            unit,
            longest,
        )?;
        padding(
            "rollout.disturbance.rotation",
            disturbance.rotation,
            "rad",
            std::f64::consts::PI,
        )?;
        ensure!(
            pipeline.task.is_planar() || disturbance.kind == Disturbed::Object,
            "rollout.disturbance.kind disturbs a pusher, which only Push-T has";
            "set it to \"object\""
        );
    }
    if let Some(Goal::Fixed(goal)) = rollout.goal {
        let depth = depth_in_walls(goal);
        let [low, high] = WALL_FACES;
        ensure!(
            goal.x.is_finite() && goal.y.is_finite() && goal.theta.is_finite() && depth == 0.0,
            "rollout.goal is [{}, {}, {}], where the block would reach {depth:.1} px into a wall", goal.x, goal.y, goal.theta;
            "give a pose with the whole block between {low} and {high} px; random goals are {GOAL_MARGIN} px away from the walls"
        );
    }
    Ok(())
}

/// Maximum age of observations in control steps.
const OLDEST: u32 = 10;

/// Checks the settings of rollouts that all tasks have.
fn check_rollout(pipeline: &Pipeline, rollout: &RolloutSection) -> Result<()> {
    pipeline.index()?;
    pipeline.pose()?;
    ensure!(
        pipeline.variant.is_some(),
        "the pipeline file does not define what the policy observes";
        "give variant = \"state\" or variant = \"image\""
    );
    between("rollout.max_steps", rollout.max_steps, 1, LONGEST)?;
    if let Err(error) = pipeline.policy()?.check(pipeline.variant == Some(Variant::Image)) {
        return Err(Fault::of(&error).at("policy.").into());
    }
    Ok(())
}

/// The poses that the policy observes and those that are indexed have to come from the same source.
fn check_spatial_pose(pipeline: &Pipeline) -> Result<()> {
    let Some(pose) = &pipeline.pose else {
        return Ok(());
    };
    ensure!(
        pose.encoder.is_none() || pose.source == PoseSource::Encoder,
        "the table [pose.encoder] applies only to pose.source = \"encoder\"";
        "remove it, or set pose.source = \"encoder\""
    );
    if let Some(encoder) = &pose.encoder {
        check_settings(encoder)?;
    }
    match (pipeline.variant, pose.source) {
        (_, PoseSource::LogPolar) => bail!(
            "pose.source is \"log_polar\", which works only for Push-T";
            "set it to \"encoder\" or \"recorded\""
        ),
        (Some(Variant::State), PoseSource::Encoder) => bail!(
            "variant is \"state\", but pose.source is \"encoder\"";
            "set variant = \"image\", or pose.source = \"recorded\""
        ),
        (Some(Variant::Image), PoseSource::Recorded) => bail!(
            "variant is \"image\", but pose.source is \"recorded\"";
            "set pose.source = \"encoder\", which estimates poses from images"
        ),
        (_, PoseSource::Encoder) => check_encoder(pipeline, &pose.encoder().camera),
        _ => Ok(()),
    }
}

/// Maximum width of the network, which has sixteen times the weights of ResNet-18.
const WIDEST: u32 = 256;

/// Maximum number of epochs, and of steps per epoch.
const MOST_STEPS: u32 = 1_000_000;

/// Maximum batch size in images. Each image takes some megabytes of intermediate results.
const LARGEST_BATCH: u32 = 4096;

fn check_settings(encoder: &EncoderConfig) -> Result<()> {
    let count = |name: &str, value: usize, minimum: u32, most: u32| {
        between(name, u32::try_from(value).unwrap_or(u32::MAX), minimum, most)
    };
    count("pose.encoder.width", encoder.width, 1, WIDEST)?;
    ensure!(
        encoder.network != Network::Keypoints || encoder.width.is_multiple_of(KEYPOINT_CHANNELS),
        "pose.encoder.width is {}", encoder.width;
        "give a multiple of {KEYPOINT_CHANNELS} for the network \"keypoints\""
    );
    ensure!(
        encoder.weights.is_none() || encoder.network == Network::Resnet18,
        "pose.encoder.weights are those of a ResNet-18, but pose.encoder.network is \"keypoints\"";
        "remove pose.encoder.weights, or set pose.encoder.network = \"resnet18\""
    );
    count("pose.encoder.crops", encoder.crops, 1, 5)?;
    count("pose.encoder.held_images", encoder.held_images, 0, 2)?;
    count("pose.encoder.batch", encoder.batch, GROUP as u32, LARGEST_BATCH)?;
    ensure!(
        encoder.batch.is_multiple_of(GROUP),
        "pose.encoder.batch is {}", encoder.batch;
        "give a multiple of {GROUP}, because batches consist of groups of two demonstrations with four images each"
    );
    between("pose.encoder.epochs", encoder.epochs, 1, MOST_STEPS)?;
    if let Some(steps) = encoder.steps {
        between("pose.encoder.steps", steps, 1, MOST_STEPS)?;
    }
    ensure!(
        encoder.learning_rate > 0.0,
        "pose.encoder.learning_rate is {}", encoder.learning_rate;
        "give a number above 0"
    );
    ensure!(
        (0.0..=0.5).contains(&encoder.held_out),
        "pose.encoder.held_out is {}", encoder.held_out;
        "give a fraction from 0 to 0.5"
    );
    let losses = &encoder.losses;
    ensure!(
        (0.0..=1.0).contains(&losses.absolute_held),
        "pose.encoder.losses.absolute_held is {}", losses.absolute_held;
        "give a fraction from 0 to 1"
    );
    for (name, value) in [
        ("weight_decay", encoder.weight_decay),
        ("radius", encoder.radius),
        ("losses.absolute", losses.absolute),
        ("losses.relative", losses.relative),
        ("losses.cross", losses.cross),
        ("losses.relative_held", losses.relative_held),
        ("losses.relative_before", losses.relative_before),
        ("losses.translation", losses.translation),
        ("losses.rotation", losses.rotation),
        ("brightness", encoder.brightness),
    ] {
        not_negative(&format!("pose.encoder.{name}"), value)?;
    }
    Ok(())
}

/// Checks a pipeline with an encoder. It needs images, and no other part of the pipeline may read recorded object poses, because
/// the results would then not be those of a policy from images.
fn check_encoder(pipeline: &Pipeline, camera: &str) -> Result<()> {
    let ingest = &pipeline.ingest;
    ensure!(
        ingest.images,
        "pose.source is \"encoder\", but ingest.images is false";
        "remove ingest.images"
    );
    ensure!(
        ingest.render.is_empty() || ingest.render.iter().any(|rendered| rendered.name() == camera),
        "pose.encoder.camera is {camera:?}, but ingest.render does not render that camera";
        "set ingest.render = [{camera:?}]"
    );
    if let Some(cameras) = &ingest.cameras {
        ensure!(
            cameras.iter().any(|taken| taken == camera),
            "pose.encoder.camera is {camera:?}, but ingest.cameras does not name that camera";
            "add it to ingest.cameras"
        );
    }
    ensure!(
        matches!(pipeline.segment.rule, Rule::GripperCommand | Rule::Grasp),
        "pose.source is \"encoder\", but segment.rule reads recorded object poses";
        "set segment.rule = \"gripper_command\""
    );
    let gripper = pipeline.segment.gripper.as_ref();
    ensure!(
        gripper.is_none_or(|gripper| gripper.anchor == AnchorAt::FirstTransfer),
        "pose.source is \"encoder\", but segment.gripper.anchor reads recorded object poses";
        "remove segment.gripper.anchor, or set segment.rule = \"grasp\""
    );
    let leave_out = pipeline
        .index
        .as_ref()
        .map_or(&[] as &[String], |index| &index.leave_out);
    match leave_out
        .iter()
        .find(|check| ABOUT_THE_OBJECT.contains(&check.as_str()))
    {
        Some(check) => bail!(
            "pose.source is \"encoder\", but index.leave_out names the check {check:?}, which reads recorded object poses";
            "remove the check (missed_grasp and lost_grasp are allowed: they are then detected from the fingers only)"
        ),
        None => Ok(()),
    }
}

/// Whether the task has all cameras that are to be rendered.
fn renders_own(pipeline: &Pipeline) -> bool {
    let own = pipeline.task.cameras();
    pipeline.ingest.render.iter().all(|camera| own.contains(camera))
}

fn check_render(ingest: &IngestSection) -> Result<()> {
    let repeated = (1..ingest.render.len()).any(|i| ingest.render[..i].contains(&ingest.render[i]));
    ensure!(!repeated, "ingest.render names a camera twice"; "name each once");
    ensure!(
        ingest.images || ingest.render.is_empty(),
        "ingest.images is false, but ingest.render names a camera";
        "remove one of them"
    );
    Ok(())
}

/// Checks a pipeline of Push-T.
fn check_planar(pipeline: &Pipeline) -> Result<()> {
    ensure!(
        !pipeline.segment.rule.needs_gripper() && pipeline.segment.gripper.is_none(),
        "Push-T has no gripper";
        "set segment.rule to \"always_transit\" or \"rigid_motion\", and remove segment.gripper"
    );
    let ingest = &pipeline.ingest;
    let foreign = [
        ("object", ingest.object.is_some()),
        ("env_args", ingest.env_args.is_some()),
        ("compare", ingest.compare.is_some()),
        ("cameras", ingest.cameras.is_some()),
        ("conventions", ingest.conventions != Conventions::default()),
    ];
    if let Some((key, _)) = foreign.iter().find(|(_, there)| *there) {
        bail!("ingest.{key} applies only to robosuite tasks"; "remove it");
    }
    ensure!(ingest.arm.is_default(), "ingest.arm applies only to the task \"arm\""; "remove it");
    if let Err(why) = ingest.pusht.check() {
        bail!("ingest.pusht.{why}");
    }
    ensure!(
        renders_own(pipeline),
        "ingest.render names a camera of robosuite tasks";
        "use \"image\", the only camera of Push-T"
    );
    check_render(ingest)?;
    if let Some(index) = &pipeline.index {
        at_least_one("index.longest_chunk", u64::from(index.longest_chunk))?;
        ensure!(index.leave_out.is_empty(), "index.leave_out applies only to robosuite tasks"; "remove it");
        ensure!(index.trim.is_empty(), "index.trim applies only to robosuite tasks"; "remove it");
    }
    match (&pipeline.pose, pipeline.variant) {
        (Some(pose), Some(variant)) => check_variant(pipeline, pose, variant),
        _ => Ok(()),
    }
}

/// The poses that the policy observes and those that are indexed have to come from the same source.
fn check_variant(pipeline: &Pipeline, pose: &PoseSection, variant: Variant) -> Result<()> {
    let ingest = &pipeline.ingest;
    match (variant, pose.source) {
        (_, PoseSource::Encoder) => bail!(
            "pose.source is \"encoder\", which works only for robosuite tasks";
            "set it to \"log_polar\" or \"recorded\""
        ),
        (Variant::State, PoseSource::Recorded) => Ok(()),
        (Variant::Image, PoseSource::LogPolar) => {
            ensure!(
                ingest.images,
                "variant is \"image\", but ingest.images is false";
                "remove ingest.images"
            );
            // The other rules read the recorded object pose.
            ensure!(
                pipeline.segment.rule == Rule::AlwaysTransit,
                "variant is \"image\", but segment.rule reads recorded object poses";
                "set segment.rule = \"always_transit\""
            );
            ensure!(
                pose.goal.iter().all(|number| number.is_finite()),
                "pose.goal is {:?}", pose.goal;
                "give x, y and theta as finite numbers"
            );
            Ok(())
        }
        (Variant::State, PoseSource::LogPolar) => bail!(
            "variant is \"state\", but pose.source is \"log_polar\"";
            "set variant = \"image\", or pose.source = \"recorded\""
        ),
        (Variant::Image, PoseSource::Recorded) => bail!(
            "variant is \"image\", but pose.source is \"recorded\"";
            "set pose.source = \"log_polar\", which estimates poses from images"
        ),
    }
}

/// Maximum length of an episode in control steps, nearly three hours of control. Bounded because a rollout keeps its steps in
/// memory.
const LONGEST: u32 = 100_000;

/// Maximum resolution of the grid. A finer one would only make the table of candidates fill the memory.
const FINEST: u32 = 200;

/// Maximum number of poses, and of pusher positions per pose.
const MOST: u32 = 1000;

fn check_scenes(scenes: &ScenesConfig) -> Result<()> {
    between("scenes.grid", scenes.grid, 2, FINEST)?;
    between("scenes.poses", scenes.poses, 1, MOST)?;
    between("scenes.pushers", scenes.pushers, 1, MOST)?;
    padding("scenes.padding_position", scenes.padding_position, "px", 512.0)?;
    padding(
        "scenes.padding_angle",
        scenes.padding_angle,
        "rad",
        std::f64::consts::TAU,
    )?;
    not_negative("scenes.separation", scenes.separation)?;
    not_negative("scenes.clearance", scenes.clearance)
}

fn between(name: &str, value: u32, minimum: u32, maximum: u32) -> Result<()> {
    ensure!((minimum..=maximum).contains(&value), "{name} is {value}"; "give {minimum} to {maximum}");
    Ok(())
}

/// Checks a padding. A negative one would exclude demonstrated poses; a larger one than `most` would leave the simulator's
/// workspace or cover angles more than once.
fn padding(name: &str, value: f64, unit: &str, most: f64) -> Result<()> {
    ensure!((0.0..=most).contains(&value), "{name} is {value} {unit}"; "give 0 to {most:.2}");
    Ok(())
}

/// Checks a standard deviation. A larger one than `most` would place the object far outside the workspace.
fn standard_deviation(name: &str, value: f64, unit: &str, most: f64) -> Result<()> {
    ensure!((0.0..=most).contains(&value), "{name} is {value} {unit}"; "give 0 to {most:.2}");
    Ok(())
}

fn at_least_one(name: &str, value: u64) -> Result<()> {
    ensure!(value >= 1, "{name} is {value}"; "give 1 or more");
    Ok(())
}

fn not_negative(name: &str, value: f64) -> Result<()> {
    ensure!(value >= 0.0, "{name} is {value}"; "give 0 or more");
    Ok(())
}
