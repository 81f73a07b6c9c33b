//! The program `re4-pipe`; everything it does is in the library beside it, so that tests and fuzzers reach its readers.

use std::process::ExitCode;

fn main() -> ExitCode {
    re4_pipe::main()
}
