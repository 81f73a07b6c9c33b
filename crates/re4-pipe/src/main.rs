//! The program `re4-pipe`: staged batch jobs from robot demonstrations to explainable imitation policies.
//!
//! This crate holds arguments, printing and exit codes; what stages do is in `re4-stages`. Exit codes: 0 done, 1 a gate
//! failed, 2 the user's or the machine's fault.

mod arguments;
mod commands;
mod console;
mod log;
mod output;
mod terminal;

use std::process::ExitCode;

use clap::Parser as _;
use re4_stages::answer;

use crate::arguments::{Arguments, Command};

/// Reads the command line, does the work, prints, and answers with the exit code.
fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) if is_help(&error) => error.exit(),
        Err(error) => {
            console::print_usage_error(&error);
            return ExitCode::from(2);
        }
    };
    // The worker's standard error is for its last words.
    if !matches!(arguments.command, Command::IngestWorker) {
        log::start(arguments.verbose);
    }
    let json = arguments.command.common().is_some_and(|common| common.json);
    let outcome = match arguments.command {
        Command::Ingest(arguments) => commands::run::ingest(&arguments),
        Command::Segment(arguments) => commands::run::segment(&arguments),
        Command::Audit(arguments) => commands::audit::audit(&arguments),
        Command::TrainPose(arguments) => commands::run::train_pose(&arguments),
        Command::Index(arguments) => commands::run::index(&arguments),
        Command::Scenes(arguments) => commands::run::scenes(&arguments),
        Command::Rollout(arguments) => commands::run::rollout(&arguments),
        Command::Run(arguments) => commands::run::run(&arguments),
        Command::Replay(arguments) => commands::run::replay(&arguments),
        Command::Video(arguments) => commands::video::video(&arguments),
        Command::Verify(arguments) => commands::verify::verify(&arguments),
        Command::Inspect(arguments) => commands::inspect::inspect(&arguments),
        Command::Report(arguments) => commands::report::report(&arguments),
        Command::Fetch(arguments) => commands::fetch::fetch(&arguments),
        Command::Doctor(arguments) => commands::doctor::doctor(&arguments),
        Command::Schemas(arguments) => commands::schemas::schemas(&arguments),
        Command::Reference(arguments) => commands::schemas::reference(&arguments),
        Command::IngestWorker => re4_stages::serve_ingest().map(|()| commands::Outcome::Done),
    };
    match outcome {
        Ok(_) if !answer() => loop {
            // The watchdog ends the process: it has removed what was not published.
            std::thread::park();
        },
        Ok(commands::Outcome::Done) => ExitCode::SUCCESS,
        Ok(commands::Outcome::GateFailed) => ExitCode::from(1),
        Err(error) => {
            if answer() {
                console::print_error(&error, json);
                ExitCode::from(2)
            } else {
                // The watchdog ends the process.
                loop {
                    std::thread::park();
                }
            }
        }
    }
}

/// Help and version are asked for, or shown where a subcommand is missing; they are printed as they are.
fn is_help(error: &clap::Error) -> bool {
    use clap::error::ErrorKind::{DisplayHelp, DisplayHelpOnMissingArgumentOrSubcommand, DisplayVersion};
    matches!(
        error.kind(),
        DisplayHelp | DisplayHelpOnMissingArgumentOrSubcommand | DisplayVersion
    )
}
