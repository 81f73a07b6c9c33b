//! The program `re4-pipe`: from robot demonstrations to explainable imitation policies.
//!
//! This crate parses arguments, prints results and sets the exit code. The stages are implemented in `re4-stages`. Exit codes: 0
//! success, 1 a check failed, 2 an error of the input or the machine, 3 parts of an artifact are missing, 75 interrupted.

mod arguments;
mod commands;
mod console;
mod log;
mod output;
mod terminal;

use std::process::ExitCode;

use clap::Parser as _;
use re4_stages::{Partly, TRY_AGAIN, answer, was_interrupted};

use crate::arguments::{Arguments, Command};

/// Exit code if parts of an artifact are missing.
const PARTS_MISSING: u8 = 3;

/// Parses the command line, runs the command, prints errors and returns the exit code.
fn main() -> ExitCode {
    let mut arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) if is_help(&error) => error.exit(),
        Err(error) => {
            console::print_usage_error(&error);
            return ExitCode::from(2);
        }
    };
    // The standard error of the worker contains only its final error, which the parent process reads.
    if !matches!(arguments.command, Command::IngestWorker) {
        log::start(arguments.verbose);
    }
    let json = arguments.command.common().is_some_and(|common| common.json);
    if let Err(error) = arguments.command.use_local_folders() {
        console::print_error(&error, json);
        return ExitCode::from(2);
    }
    let outcome = match arguments.command {
        Command::Ingest(arguments) => commands::run::ingest(&arguments),
        Command::Segment(arguments) => commands::run::segment(&arguments),
        Command::Observe(arguments) => commands::run::observe(&arguments),
        Command::Audit(arguments) => commands::audit::audit(&arguments),
        Command::TrainEncoder(arguments) => commands::run::train_encoder(&arguments),
        Command::TrainPose(arguments) => commands::run::train_pose(&arguments),
        Command::Train(arguments) => commands::run::train(&arguments),
        Command::Index(arguments) => commands::run::index(&arguments),
        Command::Scenes(arguments) => commands::run::scenes(&arguments),
        Command::Rollout(arguments) => commands::run::rollout(&arguments),
        Command::Run(arguments) => commands::run::run(&arguments),
        Command::Merge(arguments) => commands::plan::merge(&arguments),
        Command::Plan(arguments) => commands::plan::plan(&arguments),
        Command::Status(arguments) => commands::plan::status(&arguments),
        Command::Curate(arguments) => commands::curate::curate(&arguments),
        Command::Influence(arguments) => commands::influence::influence(&arguments),
        Command::Compare(arguments) => commands::compare::compare(&arguments),
        Command::Replay(arguments) => commands::run::replay(&arguments),
        Command::Video(arguments) => commands::video::video(&arguments),
        Command::Verify(arguments) => commands::verify::verify(&arguments),
        Command::Inspect(arguments) => commands::inspect::inspect(&arguments),
        #[cfg(feature = "query")]
        Command::Query(arguments) => commands::query::query(&arguments),
        Command::Report(arguments) => commands::report::report(&arguments),
        Command::Export(arguments) => commands::export::export(&arguments),
        Command::Fetch(arguments) => commands::fetch::fetch(&arguments),
        Command::Doctor(arguments) => commands::doctor::doctor(&arguments),
        Command::Schemas(arguments) => commands::schemas::schemas(&arguments),
        Command::Reference(arguments) => commands::schemas::reference(&arguments),
        Command::IngestWorker => re4_stages::serve_ingest().map(|()| commands::Outcome::Done),
    };
    match outcome {
        Ok(_) if !answer() => loop {
            // The user interrupted the command. The watchdog prints the error and ends the process.
            std::thread::park();
        },
        Ok(commands::Outcome::Done) => ExitCode::SUCCESS,
        Ok(commands::Outcome::GateFailed) => ExitCode::from(1),
        Err(error) => {
            if answer() {
                match error.downcast_ref::<Partly>() {
                    Some(partly) if !partly.is_missing() => return console::print_share(partly, json),
                    Some(_) => {
                        console::print_error(&error, json);
                        return ExitCode::from(PARTS_MISSING);
                    }
                    None => console::print_error(&error, json),
                }
                ExitCode::from(if was_interrupted() { TRY_AGAIN } else { 2 })
            } else {
                // The watchdog prints the error and ends the process.
                loop {
                    std::thread::park();
                }
            }
        }
    }
}

/// Whether the parser's result is not an error in the arguments but the help or the version, which clap prints itself.
fn is_help(error: &clap::Error) -> bool {
    use clap::error::ErrorKind::{DisplayHelp, DisplayHelpOnMissingArgumentOrSubcommand, DisplayVersion};
    matches!(
        error.kind(),
        DisplayHelp | DisplayHelpOnMissingArgumentOrSubcommand | DisplayVersion
    )
}
