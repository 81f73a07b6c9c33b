//! The worker process: what the hidden subcommand does.

use std::io::{BufRead as _, BufReader, Read as _};
use std::time::Duration;

use anyhow::{Context as _, Result};
use nix::sys::resource::{Resource, setrlimit};
use re4_artifact::Store;
use re4_fault::{OrFault as _, fault};

use super::message::{Message, send};
use super::worker::{self, Format, Work};
use super::{describe, hdf5, helper, lerobot, several};
use crate::addresses::local_store;
use crate::interrupt::Interrupt;
use crate::notes::fault_of;
use crate::parts::Partly;

/// How long a worker may take to stop by itself after its parent has closed the worker's standard input.
const GRACE: Duration = Duration::from_millis(400);

/// Maximum length of a request that a worker reads, in bytes. It lists the files of a LeRobot dataset, about 150 bytes each; datasets of
/// version 2 have several files per episode.
const MAX_REQUEST: u64 = 256 << 20;

/// The worker process: reads its request from standard input, makes and publishes the artifact, and reports to its parent on
/// standard output.
///
/// # Errors
/// If the request cannot be read or the store cannot be opened. Later errors are reported to the parent.
pub fn serve_ingest() -> Result<()> {
    let mut input = BufReader::new(std::io::stdin());
    let mut line = String::new();
    input
        .by_ref()
        .take(MAX_REQUEST)
        .read_line(&mut line)
        .context("cannot read the request")?;
    let work: Work = serde_json::from_str(&line)
        .or_fault(|| fault!("ingest-worker is an internal command"; "use re4-pipe ingest"))?;
    let work = match work {
        Work::Render(setup) => return helper::serve(&setup, input),
        work => work,
    };
    // The limits are a safeguard against damaged files. If the system refuses them, the sizes in the file are still checked.
    let memory = worker::memory(&work);
    let _ = setrlimit(Resource::RLIMIT_DATA, memory, memory);
    let _ = setrlimit(Resource::RLIMIT_CORE, 0, 0);
    let store = match &work {
        Work::Ingest(request) => {
            // Connects this process with the object store of which the folder is the cache.
            local_store(&request.address)?;
            Some(Store::open(&request.artifacts)?)
        }
        _ => None,
    };
    let interrupt = Interrupt::listen_with_report(store.as_ref(), |fault| send(&Message::failed(&fault)));
    let stop = interrupt.clone();
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut input, &mut std::io::sink());
        stop.request();
        std::thread::sleep(GRACE);
        // Kept until the process has ended, so that nothing more is published.
        let _publication = store.as_ref().map(Store::abandon);
        #[allow(clippy::exit, reason = "the parent has ended, and the thread may be stuck in C code")]
        std::process::exit(2);
    });
    let message = match serve(&work, &interrupt) {
        Ok(message) => message,
        Err(error) => match error.downcast::<Partly>() {
            Ok(partly) => Message::Partly(partly),
            Err(error) => Message::failed(&fault_of(&error)),
        },
    };
    send(&message);
    Ok(())
}

fn serve(work: &Work, interrupt: &Interrupt) -> Result<Message> {
    let request = match work {
        Work::Ingest(request) => request,
        Work::Describe(question) => return describe::serve(question, interrupt).map(Message::Described),
        Work::Render(_) => return Err(fault!("a helper does not read datasets"; "use re4-pipe ingest").into()),
    };
    rayon::ThreadPoolBuilder::new()
        .num_threads(request.threads)
        .build_global()
        .or_fault(|| fault!("cannot start {} worker threads", request.threads; "give a smaller --jobs"))?;
    match &request.format {
        Format::Hdf5(hdf5) => hdf5::serve(request, hdf5, interrupt),
        Format::Several(members) => several::serve(request, members, interrupt),
        Format::Lerobot(files) => lerobot::serve(request, files.as_ref(), interrupt),
    }
}
