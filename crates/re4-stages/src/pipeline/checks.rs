//! Values that fit their type and still make no sense.

use anyhow::Result;
use re4_encoder::EncoderConfig;
use re4_encoder::loss::GROUP;
use re4_fault::{Fault, bail, ensure};
use re4_robosuite::conventions::Settings as Conventions;
use re4_scenes::ScenesConfig;
use re4_segment::Rule;
use re4_task::RobosuiteTask;

use super::{IngestSection, Pipeline, PoseSection, PoseSource, RolloutSection, Task, Variant};

/// Refuses settings under which a stage could not do its work: no steps at all, waypoints with no distance between them.
///
/// # Errors
/// The first such setting, with the values that it can have.
pub(crate) fn check(pipeline: &Pipeline) -> Result<()> {
    pipeline.audit.check()?;
    ensure!(
        pipeline.policy.is_none() || pipeline.rollout.is_some(),
        "there is a table [policy] and none [rollout] that would roll it out";
        "leave it out"
    );
    if !pipeline.task.is_planar() {
        return check_robosuite(pipeline);
    }
    check_planar(pipeline)?;
    let Some(rollout) = &pipeline.rollout else {
        ensure!(
            pipeline.scenes.is_none(),
            "there is a table [scenes] and none [rollout] that would start from it";
            "leave it out"
        );
        return Ok(());
    };
    check_rollout(pipeline, rollout)?;
    match (&pipeline.scenes, &rollout.seeds) {
        (Some(scenes), None) => check_scenes(scenes),
        (None, Some(_)) => Ok(()),
        (Some(_), Some(_)) => {
            bail!("both rollout.seeds and a table [scenes] say where rollouts start"; "leave one of the two out")
        }
        (None, None) => {
            bail!("nothing says where rollouts start"; "give rollout.seeds, such as \"500..600\", or a table [scenes]")
        }
    }
}

/// Checks of the audit that say something of the recorded object pose and nothing without it.
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

/// What robosuite's tasks need, and what they do not have.
fn check_robosuite(pipeline: &Pipeline) -> Result<()> {
    let ingest = &pipeline.ingest;
    ensure!(ingest.pusht.is_default(), "ingest.pusht belongs to Push-T"; "leave it out");
    ensure!(
        ingest.object.is_none() || pipeline.task == Task::Robosuite,
        "ingest.object is given and the task says which object it is";
        "leave it out, or set task = \"robosuite\""
    );
    ensure!(
        ingest.images || ingest.cameras.is_none(),
        "ingest.images is false and ingest.cameras names cameras";
        "leave one of the two out"
    );
    ensure!(
        renders_own(pipeline),
        "ingest.render names the camera \"image\", which is Push-T's";
        "robosuite's are \"agentview\" and \"robot0_eye_in_hand\""
    );
    ensure!(
        ingest.render.is_empty() || ingest.cameras.is_none(),
        "ingest.cameras chooses recorded images and ingest.render has images drawn";
        "leave one of the two out"
    );
    check_render(ingest)?;
    ensure!(pipeline.scenes.is_none(), "the table [scenes] is for Push-T"; "leave it out, and give rollout.seeds");
    check_spatial_pose(pipeline)?;
    let Some(rollout) = &pipeline.rollout else {
        return Ok(());
    };
    ensure!(
        pipeline.task != Task::Robosuite,
        "{}, or leave the table [rollout] out",
        RobosuiteTask::known()
    );
    ensure!(
        pipeline.variant != Some(Variant::Image) || rollout.noise.is_none(),
        "variant is \"image\" and rollout.noise gives errors to recorded poses";
        "leave it out"
    );
    check_rollout(pipeline, rollout)?;
    ensure!(rollout.seeds.is_some(), "nothing says where rollouts start"; "give rollout.seeds, such as \"500..600\"");
    if let Some(noise) = &rollout.noise {
        standard_deviation("rollout.noise.translation", noise.translation, "m", 1.0)?;
        standard_deviation("rollout.noise.rotation", noise.rotation, "rad", std::f64::consts::PI)?;
    }
    Ok(())
}

/// What rollouts of every task need.
fn check_rollout(pipeline: &Pipeline, rollout: &RolloutSection) -> Result<()> {
    pipeline.index()?;
    pipeline.pose()?;
    ensure!(
        pipeline.variant.is_some(),
        "nothing says what the policy observes";
        "give variant = \"state\" or variant = \"image\""
    );
    between("rollout.max_steps", rollout.max_steps, 1, LONGEST)?;
    if let Err(error) = pipeline.policy()?.check(pipeline.variant == Some(Variant::Image)) {
        return Err(Fault::of(&error).at("policy.").into());
    }
    Ok(())
}

/// What the policy sees and what is indexed have to come from the same source.
fn check_spatial_pose(pipeline: &Pipeline) -> Result<()> {
    let Some(pose) = &pipeline.pose else {
        return Ok(());
    };
    ensure!(
        pose.encoder.is_none() || pose.source == PoseSource::Encoder,
        "the table [pose.encoder] is for pose.source = \"encoder\"";
        "leave it out, or set pose.source to it"
    );
    if let Some(encoder) = &pose.encoder {
        check_settings(encoder)?;
    }
    match (pipeline.variant, pose.source) {
        (_, PoseSource::LogPolar) => bail!(
            "pose.source is \"log_polar\", which reads Push-T's images";
            "set it to \"encoder\", or to \"recorded\""
        ),
        (Some(Variant::State), PoseSource::Encoder) => bail!(
            "variant is \"state\" and pose.source is \"encoder\"";
            "poses from images belong to variant = \"image\""
        ),
        (Some(Variant::Image), PoseSource::Recorded) => bail!(
            "variant is \"image\" and pose.source is \"recorded\"";
            "what images show is estimated, so set pose.source = \"encoder\""
        ),
        (_, PoseSource::Encoder) => check_encoder(pipeline, &pose.encoder().camera),
        _ => Ok(()),
    }
}

/// Widest network: sixteen times the weights of ResNet-18.
const WIDEST: u32 = 256;

/// Most epochs, and most steps of one.
const MOST_STEPS: u32 = 1_000_000;

/// Largest batch, in images: what is computed with them is some megabytes each.
const LARGEST_BATCH: u32 = 4096;

fn check_settings(encoder: &EncoderConfig) -> Result<()> {
    let count = |name: &str, value: usize, minimum: u32, most: u32| {
        between(name, u32::try_from(value).unwrap_or(u32::MAX), minimum, most)
    };
    count("pose.encoder.width", encoder.width, 1, WIDEST)?;
    count("pose.encoder.batch", encoder.batch, GROUP as u32, LARGEST_BATCH)?;
    ensure!(
        encoder.batch.is_multiple_of(GROUP),
        "pose.encoder.batch is {}", encoder.batch;
        "give a multiple of {GROUP}: groups of two demonstrations with four images each"
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
        "it is a fraction, from 0 to 0.5"
    );
    let losses = &encoder.losses;
    ensure!(
        (0.0..=1.0).contains(&losses.absolute_held),
        "pose.encoder.losses.absolute_held is {}", losses.absolute_held;
        "it is a fraction, from 0 to 1"
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
    ] {
        not_negative(&format!("pose.encoder.{name}"), value)?;
    }
    Ok(())
}

/// An encoder needs images, and nothing beside it may read recorded object poses.
fn check_encoder(pipeline: &Pipeline, camera: &str) -> Result<()> {
    let ingest = &pipeline.ingest;
    ensure!(
        ingest.images,
        "pose.source is \"encoder\" and ingest.images is false, so there would be no images";
        "leave it out"
    );
    ensure!(
        ingest.render.is_empty() || ingest.render.iter().any(|drawn| drawn.name() == camera),
        "pose.encoder.camera is {camera:?}, of which ingest.render draws no images";
        "set ingest.render = [{camera:?}]"
    );
    if let Some(cameras) = &ingest.cameras {
        ensure!(
            cameras.iter().any(|taken| taken == camera),
            "pose.encoder.camera is {camera:?}, whose images ingest.cameras leaves out";
            "name it there"
        );
    }
    ensure!(
        pipeline.segment.rule == Rule::GripperCommand,
        "pose.source is \"encoder\" and segment.rule reads recorded object poses";
        "set it to \"gripper_command\""
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
            "index.leave_out names the check {check:?}, which reads recorded object poses, and pose.source is \"encoder\"";
            "leave it out (missed_grasp and lost_grasp are then found by the fingers alone)"
        ),
        None => Ok(()),
    }
}

/// Whether the cameras to be rendered are the task's.
fn renders_own(pipeline: &Pipeline) -> bool {
    let own = pipeline.task.cameras();
    pipeline.ingest.render.iter().all(|camera| own.contains(camera))
}

fn check_render(ingest: &IngestSection) -> Result<()> {
    let repeated = (1..ingest.render.len()).any(|i| ingest.render[..i].contains(&ingest.render[i]));
    ensure!(!repeated, "ingest.render names a camera twice"; "name each once");
    ensure!(
        ingest.images || ingest.render.is_empty(),
        "ingest.images is false and ingest.render names a camera";
        "leave one of the two out"
    );
    Ok(())
}

/// What Push-T needs, and what it does not have.
fn check_planar(pipeline: &Pipeline) -> Result<()> {
    ensure!(
        pipeline.segment.rule != Rule::GripperCommand && pipeline.segment.gripper.is_none(),
        "Push-T has no gripper";
        "set segment.rule to \"always_transit\" or \"rigid_motion\", and leave segment.gripper out"
    );
    let ingest = &pipeline.ingest;
    let foreign = [
        ("filter", ingest.filter.is_some()),
        ("object", ingest.object.is_some()),
        ("env_args", ingest.env_args.is_some()),
        ("compare", ingest.compare.is_some()),
        ("cameras", ingest.cameras.is_some()),
        ("conventions", ingest.conventions != Conventions::default()),
    ];
    if let Some((key, _)) = foreign.iter().find(|(_, there)| *there) {
        bail!("ingest.{key} belongs to robosuite's tasks"; "leave it out");
    }
    if let Err(why) = ingest.pusht.check() {
        bail!("ingest.pusht.{why}");
    }
    ensure!(
        renders_own(pipeline),
        "ingest.render names a camera of robosuite's tasks";
        "Push-T's only one is \"image\""
    );
    check_render(ingest)?;
    if let Some(index) = &pipeline.index {
        at_least_one("index.longest_chunk", u64::from(index.longest_chunk))?;
        ensure!(index.leave_out.is_empty(), "index.leave_out belongs to robosuite's tasks"; "leave it out");
    }
    match (&pipeline.pose, pipeline.variant) {
        (Some(pose), Some(variant)) => check_variant(pipeline, pose, variant),
        _ => Ok(()),
    }
}

/// What the policy sees and what is indexed have to come from the same source.
fn check_variant(pipeline: &Pipeline, pose: &PoseSection, variant: Variant) -> Result<()> {
    let ingest = &pipeline.ingest;
    match (variant, pose.source) {
        (_, PoseSource::Encoder) => bail!(
            "pose.source is \"encoder\", which is trained on robosuite's tasks";
            "set it to \"log_polar\", or to \"recorded\""
        ),
        (Variant::State, PoseSource::Recorded) => Ok(()),
        (Variant::Image, PoseSource::LogPolar) => {
            ensure!(
                ingest.images,
                "variant is \"image\" and ingest.images is false, so there would be no images";
                "leave it out"
            );
            // Other rules look at the recorded pose of the object.
            ensure!(
                pipeline.segment.rule == Rule::AlwaysTransit,
                "variant is \"image\" and segment.rule reads recorded object poses";
                "set it to \"always_transit\""
            );
            ensure!(
                pose.goal.iter().all(|number| number.is_finite()),
                "pose.goal is {:?}", pose.goal;
                "give x, y and theta as finite numbers"
            );
            Ok(())
        }
        (Variant::State, PoseSource::LogPolar) => bail!(
            "variant is \"state\" and pose.source is \"log_polar\"";
            "poses from images belong to variant = \"image\""
        ),
        (Variant::Image, PoseSource::Recorded) => bail!(
            "variant is \"image\" and pose.source is \"recorded\"";
            "what images show is estimated, so set pose.source = \"log_polar\""
        ),
    }
}

/// Longest episode, nearly three hours of control: a rollout keeps its steps in memory.
const LONGEST: u32 = 100_000;

/// Finest grid: beyond it the table of candidates would fill the memory for nothing.
const FINEST: u32 = 200;

/// Most poses, and most pushers at each.
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

fn between(name: &str, value: u32, minimum: u32, most: u32) -> Result<()> {
    ensure!((minimum..=most).contains(&value), "{name} is {value}"; "give {minimum} to {most}");
    Ok(())
}

/// Less would cut demonstrated poses off, more would leave the plane of the simulator or go round more than once.
fn padding(name: &str, value: f64, unit: &str, most: f64) -> Result<()> {
    ensure!((0.0..=most).contains(&value), "{name} is {value} {unit}"; "give 0 to {most:.2}");
    Ok(())
}

/// More would put the object where nothing is.
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
