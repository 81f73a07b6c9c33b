//! Proofs on the real files and on changed copies of them.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test may stop where it fails")]

mod common;

use common::{Demo, TASKS, scripted};
use re4_robosuite::conventions::{Conventions, DemoArrays, Settings};

fn arrays(demos: &[Demo]) -> Vec<DemoArrays<'_>> {
    demos.iter().map(Demo::arrays).collect()
}
fn alone(demos: &[Demo]) -> Vec<DemoArrays<'_>> {
    demos.iter().map(Demo::arrays_alone).collect()
}

#[test]
fn probe() {
    for task in TASKS {
        for file in ["low_dim.hdf5", "low_dim_abs.hdf5"] {
            let Some(source) = scripted(task, file) else { return };
            let demos = source.demos(10);
            for arrays in [arrays(&demos), alone(&demos)] {
                match Conventions::detect(&arrays, &source.env, &Settings::default()) {
                    Ok((c, proofs)) => {
                        println!("{task} {file} {c:?}");
                        for p in proofs {
                            println!("   {} {} {:?} {:?} {:?}", p.convention, p.value, p.evidence.frames, p.evidence.candidates, p.warning);
                        }
                        for a in &arrays {
                            println!("{:?}", c.check(a));
                        }
                    }
                    Err(e) => println!("{task} {file} {e}"),
                }
            }
        }
    }
}
