//! What a Push-T store is.

use super::reader::{PushtOptions, PushtReader};
use crate::describe::{Description, counted};
use crate::error::IngestError;
use crate::left_out::OnBad;
use crate::selection::Selection;
use crate::source::Stop;

/// Reads the numbers of a store as ingest does.
///
/// # Errors
/// A file cannot be read or changed, or `stop` returned true.
pub fn describe(reader: &PushtReader, stop: Stop<'_>) -> Result<Description, IngestError> {
    let info = reader.info();
    let mut about = Description {
        format: info.format,
        task: Some("pusht".to_owned()),
        ..Description::default()
    };
    let lengths: Vec<usize> = reader.episode_ranges().iter().map(ExactSizeIterator::len).collect();
    let (shortest, longest) = (lengths.iter().min(), lengths.iter().max());
    about.fact(
        "episodes",
        format!(
            "{} with {}, {} to {} each",
            lengths.len(),
            counted(reader.frame_count(), "frame"),
            shortest.unwrap_or(&0),
            longest.unwrap_or(&0)
        ),
    );
    for feature in info.features {
        about.fact("array", feature);
    }
    if let Some([height, width, _]) = reader.image_shape() {
        about.fact("images", format!("{width} x {height} pixels"));
    }
    let options = PushtOptions {
        on_bad: OnBad::LeaveOut,
        stop,
        ..PushtOptions::default()
    };
    let reading = match reader.read(&Selection::All, &options) {
        Ok(reading) => reading,
        Err(error) if error.fault.ends_reading() => return Err(error),
        Err(error) => {
            about.cannot_be_used(&error.fault.to_string());
            return Ok(about);
        }
    };
    about.notes.extend(
        reading
            .left_out
            .iter()
            .map(|left| format!("{}: {}", left.demo, left.why)),
    );
    about
        .notes
        .extend(reading.warnings.iter().map(|warning| warning.message.clone()));
    about.can("audit", "all checks");
    about.can("segment", "segment.rule = \"always_transit\"");
    let state = "variant = \"state\" and pose.source = \"recorded\"";
    let image = "variant = \"image\" and pose.source = \"log_polar\"";
    for command in ["index", "rollout"] {
        if reader.has_images() {
            about.can(command, format!("{state}, or {image}"));
        } else {
            about.can(command, format!("{state}, or {image} with ingest.render = [\"image\"]"));
        }
    }
    Ok(about)
}
