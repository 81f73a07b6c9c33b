//! What an HDF5 file of demonstrations is.

use re4_robosuite::conventions::{ActionKind, RobosuiteTask};

use super::arm::ArmSource;
use super::interpret::{Interpreter, Reading};
use super::reader::RobomimicReader;
use crate::demos::Info;
use crate::describe::{Description, counted};
use crate::error::IngestError;

/// Demonstrations that are read to find one with a model.
const LOOKED_AT: usize = 3;

/// Proves the conventions of an opened file as ingest does.
///
/// # Errors
/// The file cannot be read or changed.
pub fn describe(reader: &RobomimicReader) -> Result<Description, IngestError> {
    let info = reader.describe(Info::default())?;
    let mut about = Description {
        format: info.format,
        ..Description::default()
    };
    let env = reader.environment(None);
    if let Ok(env) = &env {
        about.fact("environment", env.env_name.clone());
        if let Some(rate) = env.control_freq {
            about.fact("rate", format!("{rate} frames per second"));
        }
    }
    about.fact("demonstrations", info.demonstrations.to_string());
    for filter in &info.filter_keys {
        about.fact("filter", filter.clone());
    }
    for feature in info.features {
        about.fact("dataset", feature);
    }
    let cameras = reader.cameras(None)?;
    for camera in &cameras {
        about.fact("camera", camera.clone());
    }
    about
        .notes
        .extend(reader.warnings().iter().map(|warning| warning.message.clone()));
    let task = env.ok().and_then(|env| RobosuiteTask::of_environment(&env.env_name));
    about.task = Some(task.map_or("robosuite", |task| task.name).to_owned());
    let reading = Reading {
        task,
        object: None,
        env_args: None,
        conventions: re4_robosuite::conventions::Settings::default(),
    };
    let (interpreter, left) = match Interpreter::learn(reader, &reading) {
        Ok(learned) => learned,
        Err(error) if error.needs_library() || error.fault.ends_reading() => return Err(error),
        Err(error) => {
            let missing = error.fault.to_string();
            match ArmSource::probe(reader)? {
                Some((gripper, more)) => about.only_as_arm(gripper, &more, &missing),
                None => about.cannot_be_used(&missing),
            }
            return Ok(about);
        }
    };
    let actions = match interpreter.action_kind() {
        ActionKind::Delta => "delta",
        ActionKind::Absolute => "absolute",
    };
    about.fact("actions", actions);
    for row in interpreter.conventions() {
        about.fact(
            "convention",
            format!("{} = {} ({})", row.convention.0, row.value.0, row.basis.0),
        );
    }
    about.notes.extend(interpreter.warnings().iter().cloned());
    about.notes.extend(left.iter().map(|left| left.why.clone()));
    about.can("audit", "all checks");
    about.can("segment", "segment.rule = \"grasp\"");
    about.can("index", "variant = \"state\" and pose.source = \"recorded\"");
    let images = if cameras.is_empty() {
        "from images, render them with ingest.render".to_owned()
    } else {
        format!(
            "from images, pose.source = \"encoder\" with {}",
            counted(cameras.len(), "camera")
        )
    };
    let model = |demo| reader.read(demo).ok().map(|demo| demo.model.is_some());
    let has_models = reader.demos().iter().take(LOOKED_AT).find_map(model) == Some(true);
    match task {
        None => about.cannot(&["rollout"], &RobosuiteTask::known()),
        Some(_) if !has_models => about.cannot(
            &["rollout"],
            "the demonstrations have no attribute model_file, from which the scenes are built",
        ),
        Some(_) => about.can("rollout", format!("variant = \"state\"; {images}")),
    }
    Ok(about)
}
