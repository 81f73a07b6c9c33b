//! Prints what a LeRobot dataset is: `lerobot_inspect PATH [--check] [--decode] [--planes]`.
//!
//! `--check` reads the numbers of all episodes, `--decode` also all images, and prints the time that this takes. `--planes` prints the
//! SHA-256 of all decoded planes (luma, blue, red, frame by frame) of each video, to compare them with those of another decoder.

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a program of the command line")]

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use re4_fault::Remedy as _;
use re4_lerobot::{Cameras, Dataset, Fault, LerobotError};
use sha2::{Digest as _, Sha256};

fn inspect(path: &std::path::Path, check: bool, decode: bool) -> Result<usize, LerobotError> {
    let dataset = Dataset::open(path, &Cameras::All, &|| false)?;
    print!("{}", dataset.summary()?);
    let mut faults = 0;
    let all = || 0..dataset.episodes().len();
    if check || decode {
        let start = Instant::now();
        dataset.read(all(), &|| false, |_, frames| {
            if let Err(found) = frames {
                faults += found.count();
                eprintln!("{found}");
            }
            Ok::<(), LerobotError>(())
        })?;
        println!(
            "checked   the numbers of {} frames in {:.3} s",
            dataset.frames(),
            start.elapsed().as_secs_f64()
        );
    }
    for camera in dataset.cameras().iter().filter(|_| decode) {
        let start = Instant::now();
        let (mut images, mut sum) = (0, 0_u64);
        dataset.images(camera, all(), &|| false, |block| {
            match block {
                Ok(block) => {
                    images += block.count;
                    sum = block
                        .bytes
                        .iter()
                        .fold(sum, |sum, &byte| sum.wrapping_add(u64::from(byte)));
                }
                Err((episode, found)) => {
                    faults += found.count();
                    eprintln!("episode {episode}: {found}");
                }
            }
            Ok::<(), LerobotError>(())
        })?;
        let seconds = start.elapsed().as_secs_f64();
        println!("decoded   {images} images of {camera} in {seconds:.4} s, sum of bytes {sum}");
    }
    Ok(faults)
}

/// Prints the hash of each video.
fn planes(path: &std::path::Path) -> Result<(), LerobotError> {
    let dataset = Dataset::open(path, &Cameras::All, &|| false)?;
    for camera in dataset.cameras() {
        for episode in 0..dataset.episodes().len() {
            let Ok((video, 0)) = dataset.video(camera, episode) else {
                // Images in tables, or an episode that does not begin a file.
                continue;
            };
            let mut hash = Sha256::new();
            let decoded = video.decode(0..video.frames(), &|| false, |_, planes| {
                for plane in [&planes.y, &planes.u, &planes.v] {
                    hash.update(plane);
                }
                Ok::<(), Fault>(())
            });
            match decoded {
                Ok(()) => {
                    for byte in hash.finalize() {
                        print!("{byte:02x}");
                    }
                    println!("  {}", video.name());
                }
                Err(fault) => eprintln!("{}", fault.sentence()),
            }
        }
    }
    Ok(())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let flag = |name: &str| arguments.iter().any(|argument| argument == name);
    let Some(path) = arguments.iter().find(|argument| !argument.starts_with("--")) else {
        eprintln!("lerobot_inspect PATH [--check] [--decode] [--planes]");
        return ExitCode::from(2);
    };
    if flag("--planes") {
        if let Err(error) = planes(&PathBuf::from(path)) {
            eprintln!("{}", error.faults);
            return ExitCode::from(2);
        }
        return ExitCode::SUCCESS;
    }
    match inspect(&PathBuf::from(path), flag("--check"), flag("--decode")) {
        Ok(0) => ExitCode::SUCCESS,
        Ok(_) => ExitCode::from(1),
        Err(error) => {
            eprintln!("{}", error.sentence());
            for fault in error.faults.iter().skip(1) {
                eprintln!("also: {}", fault.sentence());
            }
            ExitCode::from(2)
        }
    }
}
