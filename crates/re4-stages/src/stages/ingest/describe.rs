//! What a dataset is, found out with the readers of ingest: HDF5 files and LeRobot datasets in a worker process.

use std::path::Path;

use anyhow::Result;
use re4_ingest::lerobot::LerobotDataset;
use re4_ingest::pusht::PushtReader;
use re4_ingest::robomimic::{Access, DemoChoice, RobomimicReader, RobomimicSource, Sources, files_of};
use re4_ingest::{DemoSource as _, Description, Fault, IngestError, lerobot, pusht, robomimic};

use super::several;
use super::worker::{self, Question, Reader};
use crate::interrupt::Interrupt;
use crate::notes::Notes;

/// Name of the command in messages about an interruption.
const COMMAND: &str = "inspect";

/// Describes a dataset; `None` if there is none of a known format at the path.
///
/// # Errors
/// The same as those of ingest.
pub fn describe(path: &Path, interrupt: &Interrupt, notes: &Notes) -> Result<Option<Description>> {
    let ask = |reader: Reader| {
        let question = Question {
            source: path.to_owned(),
            reader,
            cautious: false,
        };
        worker::described(question, interrupt, &notes.progress(0, COMMAND)).map(Some)
    };
    if LerobotDataset::probe(path) {
        return ask(Reader::Lerobot);
    }
    if RobomimicSource::probe(path) {
        return ask(Reader::Hdf5);
    }
    if path.is_dir() && super::is_of_files(path) {
        // Other folders may have no HDF5 files.
        let files = files_of(path).unwrap_or_default();
        if let Some(first) = files.first() {
            let mut about = describe(first, interrupt, notes)?;
            if let Some(about) = &mut about {
                about.notes.extend(several::note(&files));
            }
            return Ok(about);
        }
    }
    let zarr = [".zgroup", "zarr.json"].iter().any(|name| path.join(name).is_file());
    let zip = path.is_file() && path.extension().is_some_and(|end| end.eq_ignore_ascii_case("zip"));
    if !zarr && !zip {
        return Ok(None);
    }
    let stop = || interrupt.requested();
    let described = PushtReader::open_for(path, true, &stop).and_then(|reader| pusht::describe(&reader, &stop));
    described.map(Some).map_err(|error| or_interrupted(error, interrupt))
}

/// In the worker.
pub(super) fn serve(question: &Question, interrupt: &Interrupt) -> Result<Description> {
    let stop = || interrupt.requested();
    let described = match question.reader {
        Reader::Lerobot => lerobot::describe(&question.source, &stop),
        Reader::Hdf5 => {
            let choice = DemoChoice {
                cautious: question.cautious,
                ..DemoChoice::default()
            };
            Sources::open(&question.source)
                .and_then(|sources| RobomimicReader::open(&sources, &choice, Access::Library, None))
                .and_then(|reader| robomimic::describe(&reader))
        }
    };
    described.map_err(|error| or_interrupted(error, interrupt))
}

/// An interrupted reader returns [`Fault::Stopped`], for which the message about the interruption is returned instead.
fn or_interrupted(error: IngestError, interrupt: &Interrupt) -> anyhow::Error {
    match *error.fault {
        Fault::Stopped => interrupt.check(COMMAND).err().unwrap_or_else(|| error.into()),
        _ => error.into(),
    }
}
