//! Reads the numeric arrays of a Push-T dataset and writes them again: `copy_episodes DATASET OUTPUT`.
//!
//! `tests/fixtures/compare_stores.py` compares the two with zarr-python.

use std::path::Path;

use re4_ingest::Selection;
use re4_ingest::pusht::{PushtReader, PushtWriter, RecordedEpisode};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dataset, output] = arguments.as_slice() else {
        return Err("usage: copy_episodes DATASET OUTPUT".into());
    };
    let (episodes, _) = PushtReader::open(Path::new(dataset))?.read_episodes(&Selection::All)?;
    let recorded: Vec<RecordedEpisode> = episodes.planar_episodes().iter().map(RecordedEpisode::from).collect();
    PushtWriter::write(Path::new(output), &recorded)?;
    Ok(())
}
