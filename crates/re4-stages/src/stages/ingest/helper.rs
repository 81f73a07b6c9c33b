//! Helper processes of a worker that renders images.
//!
//! Threads of one process cannot render at the same time with Mesa's software renderer: it rasterises only one scene per process at
//! a time, and threads that share display lists also wait for each other. Therefore each additional rendering thread of a worker
//! passes its demonstrations to a process of its own. The helper stores the images in the spool.
//!
//! Helpers only save time. If a helper cannot be started, crashes or cannot render a demonstration, the worker renders it itself,
//! and reports the error if there is one.

use std::io::{BufRead, BufReader, Write as _};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use anyhow::{Context as _, Result};
use re4_sim::robosuite::Profile;
use serde::{Deserialize, Serialize};
use tracing::info;

use super::rendered::{Job, compile, render_demo};
use super::spool::Spool;
use super::worker::{SUBCOMMAND, Work};
use crate::inputs::simulators;
use crate::interrupt::Interrupt;

/// Longest time after which a thread that waits for its helper notices an interrupt.
const TICK: Duration = Duration::from_millis(50);

/// What all demonstrations of a helper have in common.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Setup {
    pub(super) profile: Profile,
    /// The model of one of the demonstrations. The others differ from it only in the sizes of boxes.
    pub(super) mjcf: String,
    pub(super) spool: Spool,
}

/// A message of a helper, one JSON value per line.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Reply {
    /// It has rendered one more image.
    Image,
    /// The images of the demonstration are in the spool.
    Stored,
    /// It cannot render the demonstration.
    Failed,
}

/// How the rendering of a demonstration by a helper ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome {
    Stored,
    Interrupted,
    /// The helper cannot be used any more. It has reported this number of images of the demonstration.
    Failed(usize),
}

/// A running helper. Dropping it ends the process.
pub(super) struct Helper {
    child: Child,
    jobs: ChildStdin,
    replies: Receiver<Reply>,
}

impl Helper {
    /// Starts a helper. It inherits the environment of the worker, which contains the settings of OpenGL.
    pub(super) fn start(setup: &Setup) -> Result<Self> {
        let mut child = Command::new(std::env::current_exe()?)
            .arg(SUBCOMMAND)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        info!(process = child.id(), "helper started to render");
        let (pipes, (sender, replies)) = (child.stdin.take().zip(child.stdout.take()), channel());
        let (jobs, output) = pipes.context("the helper has no pipes")?;
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                // Lines of libraries are skipped.
                if let Ok(reply) = serde_json::from_str(&line)
                    && sender.send(reply).is_err()
                {
                    break;
                }
            }
        });
        let mut helper = Self { child, jobs, replies };
        helper.send(&Work::Render(setup.clone()))?;
        Ok(helper)
    }

    fn send(&mut self, message: &impl Serialize) -> Result<()> {
        let mut line = serde_json::to_vec(message)?;
        line.push(b'\n');
        self.jobs.write_all(&line)?;
        Ok(self.jobs.flush()?)
    }

    /// Lets the helper render a demonstration, and calls `done` for every image.
    pub(super) fn render(&mut self, job: &Job, interrupt: &Interrupt, done: &impl Fn(usize)) -> Outcome {
        let mut images = 0;
        if self.send(job).is_err() {
            return Outcome::Failed(images);
        }
        loop {
            match self.replies.recv_timeout(TICK) {
                Ok(Reply::Image) => {
                    images += 1;
                    done(1);
                }
                Ok(Reply::Stored) => return Outcome::Stored,
                Ok(Reply::Failed) | Err(RecvTimeoutError::Disconnected) => return Outcome::Failed(images),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if interrupt.requested() {
                return Outcome::Interrupted;
            }
        }
    }
}

impl Drop for Helper {
    fn drop(&mut self) {
        // If it has ended already, there is nothing to kill.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The helper process: renders the demonstrations that it reads from its standard input, until the worker ends.
pub(super) fn serve(setup: &Setup, input: impl BufRead + Send + 'static) -> Result<()> {
    let (sender, jobs) = channel();
    std::thread::spawn(move || {
        for line in input.lines().map_while(Result::ok) {
            // A job that cannot be parsed, for example because of a state that is not a number, is refused.
            if sender.send(serde_json::from_str::<Job>(&line).ok()).is_err() {
                break;
            }
        }
        #[allow(
            clippy::exit,
            reason = "the worker has ended, and the main thread may be in MuJoCo's code"
        )]
        std::process::exit(2);
    });
    let library = simulators::library(setup.profile)?;
    let model = compile(&library, &setup.mjcf)?;
    let (mut renderer, interrupt) = (None, Interrupt::default());
    for job in jobs {
        let done = |_| reply(&Reply::Image);
        let stored = job.map(|job| render_demo(&job, &model, &mut renderer, &setup.spool, &interrupt, &done));
        reply(&if matches!(stored, Some(Ok(()))) {
            Reply::Stored
        } else {
            Reply::Failed
        });
    }
    Ok(())
}

fn reply(reply: &Reply) {
    if let Ok(text) = serde_json::to_string(reply) {
        let mut output = std::io::stdout().lock();
        // If the worker has ended, this process is about to end, too.
        let _ = writeln!(output, "{text}").and_then(|()| output.flush());
    }
}
