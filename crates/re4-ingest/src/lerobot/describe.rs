//! What a LeRobot dataset is.

use std::path::Path;

use re4_lerobot::{Cameras, Dataset, Kind, LerobotError, Version};

use super::arm::ArmLayout;
use super::keys::{LerobotKeys, cameras};
use super::opened::error_of;
use crate::describe::{Description, counted};
use crate::error::IngestError;
use crate::left_out::OnBad;
use crate::pusht::{PushtOptions, from_lerobot};
use crate::source::Stop;

/// Features that every dataset has.
const COUNTS: [&str; 5] = ["timestamp", "frame_index", "episode_index", "index", "task_index"];

/// Opens a dataset as ingest does, with all cameras, and finds out which task it fits.
///
/// # Errors
/// All faults of the dataset, in one error.
pub fn describe(path: &Path, stop: Stop<'_>) -> Result<Description, IngestError> {
    let mut about = Description::default();
    let dataset = match Dataset::open(path, &Cameras::All, stop) {
        Err(error) if error.faults.iter().all(|fault| fault.kind == Kind::Unsupported) => {
            // Its numbers may be read all the same.
            let dataset = Dataset::open(path, &Cameras::none(), stop).map_err(error_of)?;
            about.notes.extend(error.faults.iter().map(re4_fault::Remedy::sentence));
            dataset
        }
        opened => opened.map_err(error_of)?,
    };
    facts(&dataset, &mut about).map_err(error_of)?;
    about.notes.extend(dataset.notes().iter().cloned());
    let keys = LerobotKeys::default();
    if from_lerobot::fits(&dataset, &keys) {
        pusht(&dataset, &keys, stop, &mut about)?;
    } else {
        arm(&dataset, &keys, &mut about);
    }
    Ok(about)
}

fn facts(dataset: &Dataset, about: &mut Description) -> Result<(), LerobotError> {
    let summary = dataset.summary()?;
    let version = match dataset.info().version {
        Version::V2 => "v2",
        Version::V3 => "v3",
    };
    let stated = dataset.info().stated_version.as_str();
    let version = if stated.starts_with(version) { stated } else { version };
    about.format = format!("LeRobot {version}");
    if let Some(robot) = summary.robot {
        about.fact("robot", robot);
    }
    about.fact("rate", format!("{} frames per second", summary.fps));
    let (shortest, longest) = summary.lengths;
    about.fact(
        "episodes",
        format!(
            "{} with {} frames, {shortest} to {longest} each",
            summary.episodes, summary.frames
        ),
    );
    for (name, range) in &dataset.info().splits {
        about.fact(
            "split",
            format!("{name}: episodes {} to {}", range.start, range.end.saturating_sub(1)),
        );
    }
    for task in summary.tasks {
        about.fact("task", task);
    }
    let counts = |feature: &&String| COUNTS.iter().any(|name| feature.starts_with(&format!("{name}:")));
    for feature in summary.features.iter().filter(|feature| !counts(feature)) {
        about.fact("feature", feature.as_str());
    }
    for camera in summary.cameras {
        about.fact(
            "camera",
            format!(
                "{}: {} x {} pixels, {}",
                camera.name, camera.width, camera.height, camera.stored
            ),
        );
    }
    Ok(())
}

/// What can be done with a dataset whose features are those of Push-T.
fn pusht(dataset: &Dataset, keys: &LerobotKeys, stop: Stop<'_>, about: &mut Description) -> Result<(), IngestError> {
    about.task = Some("pusht".to_owned());
    let options = PushtOptions {
        on_bad: OnBad::LeaveOut,
        stop,
        ..PushtOptions::default()
    };
    let all: Vec<usize> = (0..dataset.episodes().len()).collect();
    let (reading, conventions) = match from_lerobot::read(dataset, &all, keys, &options) {
        Ok(read) => read,
        Err(error) if error.fault.ends_reading() => return Err(error),
        Err(error) => {
            let missing = error.fault.to_string();
            match ArmLayout::of(dataset.info(), keys) {
                Ok(layout) => about.only_as_arm(layout.has_gripper(), &[], &missing),
                Err(_) => about.cannot_be_used(&missing),
            }
            return Ok(());
        }
    };
    for row in &conventions {
        let unit = if &*row.unit == "1" { "" } else { " px" };
        let residual = match (row.residual, row.threshold) {
            (Some(value), Some(limit)) => format!(", residual {value:.1e}{unit}, at most {limit}{unit}"),
            _ => String::new(),
        };
        about.fact(
            "convention",
            format!("{} = {}{residual}", row.convention.0, row.value.0),
        );
    }
    about.notes.extend(
        reading
            .left_out
            .iter()
            .map(|left| format!("{}: {}", left.demo, left.why)),
    );
    about
        .notes
        .extend(reading.warnings.iter().map(|warning| warning.message.clone()));
    let poses = reading.episodes.recorded.block;
    let images = !dataset.cameras().is_empty();
    match ArmLayout::of(dataset.info(), keys) {
        _ if poses => about.can("audit", "all checks"),
        Ok(layout) if !layout.has_gripper() => about.can(
            "audit",
            "task = \"arm\", segment.rule = \"always_transit\"; the checks that do not need the poses of the block, which are not recorded",
        ),
        _ => about.cannot(&["audit"], "the poses of the block are not recorded"),
    }
    about.can("segment", "segment.rule = \"always_transit\"");
    let state = "variant = \"state\" and pose.source = \"recorded\"";
    let image = "variant = \"image\" and pose.source = \"log_polar\"";
    for command in ["index", "rollout"] {
        match (poses, images) {
            (true, true) => about.can(command, format!("{state}, or {image}")),
            (true, false) => about.can(command, format!("{state}; from images, recorded images are missing")),
            (false, true) => about.can(
                command,
                format!("{image}; from states, the block's corners or poses are missing"),
            ),
            (false, false) => about.cannot(&[command], "neither poses of the block nor images are recorded"),
        }
    }
    Ok(())
}

/// What can be done with a dataset of an arm.
fn arm(dataset: &Dataset, keys: &LerobotKeys, about: &mut Description) {
    let (layout, more) = match ArmLayout::of(dataset.info(), keys) {
        Ok(layout) => (layout, Vec::new()),
        Err(fault) => {
            let Some((arm, layout)) = ArmLayout::of_first_arm(dataset.info(), keys) else {
                about.cannot_be_used(&fault.to_string());
                return;
            };
            about.notes.push(fault.to_string());
            (layout, vec![format!("ingest.lerobot.arm = \"{arm}\"")])
        }
    };
    about.task = Some("arm".to_owned());
    layout.describe(about);
    about.only_as_arm(
        layout.has_gripper(),
        &more,
        "the pose of the object that is moved is not recorded",
    );
    if !layout.has_gripper() {
        about.notes.push(
            "no element has the name of a gripper; if there is one, set ingest.lerobot.gripper or ingest.lerobot.gripper_command, and segment.rule = \"gripper\""
                .to_owned(),
        );
    }
    let count = cameras(dataset.info()).len();
    if count > 0 {
        about.fact("images", format!("{} may be ingested", counted(count, "camera")));
    }
}
