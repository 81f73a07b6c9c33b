//! Times Retrieve in SE(3) on one thread, query by query, and compares it with the scan over all frames.
//!
//! ```text
//! cargo run --release -p re4-index --example spatial_retrieve -- [DEMOS]
//! cargo run --release -p re4-index --example spatial_retrieve -- --frames FILE
//! ```
//!
//! The first form generates DEMOS (default 200) demonstrations of picking up an object and carrying it to one place, with 60 to
//! 150 frames each. The second form reads frames from a text file with one frame per line: episode, frame, mode (0 transit, 1
//! transfer), and the poses of the end effector and of the object, each as x y z and the quaternion x y z w.
//!
//! There are two kinds of queries: frames whose end effector and object are perturbed by up to 2 cm and 0.2 rad (`near`), and
//! states that combine the end-effector pose of one frame with the object pose of another (`far`). Both searches use the same
//! prepared frames and stop the evaluation of a frame early when it cannot improve the result. Their answers are compared.
#![expect(clippy::print_stdout, reason = "printing is what this example is for")]

use std::collections::BTreeSet;
use std::error::Error;
use std::hint::black_box;
use std::time::Instant;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_episode::Mode;
use re4_geometry::spatial::{Symmetry, pose_between};
use re4_index::{IndexedSpatialFrame, SpatialIndex, SpatialMetric, SpatialQuery, Stage2};

const QUERIES: usize = 2000;
const HEADER: &str = "symmetry  queries  mode      p50_us  p95_us  demos  frames  scan_p50_us  ratio";
const UP: [f64; 3] = [0.0, 0.0, 1.0];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let mut random = Random(Pcg64::new(1, 31));
    let frames = match words[..] {
        [] => generate(&mut random, 200),
        ["--frames", file] => read(&std::fs::read_to_string(file)?)?,
        [demos] => generate(&mut random, demos.parse()?),
        _ => return Err("give [DEMOS], or --frames FILE".into()),
    };
    let symmetries = [
        ("none", Symmetry::None),
        ("fold 4", Symmetry::Fold { axis: UP, n: 4 }),
        ("full", Symmetry::Full { axis: UP }),
    ];
    println!("{} frames", frames.len());
    println!("{HEADER}");
    for (name, symmetry) in symmetries {
        let metric = SpatialMetric {
            symmetry,
            ..SpatialMetric::default()
        };
        let index = SpatialIndex::build(frames.clone(), metric)?;
        for kind in ["near", "far"] {
            for mode in Mode::ALL {
                measure(&mut random, &index, name, kind, mode)?;
            }
        }
    }
    Ok(())
}

fn measure(
    random: &mut Random,
    index: &SpatialIndex,
    name: &str,
    kind: &str,
    mode: Mode,
) -> Result<(), Box<dyn Error>> {
    let frames: Vec<&IndexedSpatialFrame> = index.frames().iter().filter(|f| f.mode == mode).collect();
    if frames.is_empty() {
        return Ok(());
    }
    let none = BTreeSet::new();
    let (mut fast, mut slow, mut demos, mut evaluated) = (Vec::new(), Vec::new(), 0, 0);
    for _ in 0..QUERIES {
        let one = frames[random.below(frames.len())];
        let other = frames[random.below(frames.len())];
        let (eef, object) = if kind == "near" {
            (random.perturb(&one.eef), random.perturb(&one.object))
        } else {
            (one.eef, other.object)
        };
        let query = SpatialQuery { mode, eef, object };
        let start = Instant::now();
        let (found, statistics) = index.retrieve_counted(black_box(&query), Stage2::Object, &none)?;
        fast.push(start.elapsed().as_secs_f64() * 1e6);
        let start = Instant::now();
        let scanned = index.retrieve_scanning(black_box(&query), Stage2::Object, &none)?;
        slow.push(start.elapsed().as_secs_f64() * 1e6);
        if found != scanned {
            return Err(format!("the answers differ: {found:?}, {scanned:?}").into());
        }
        demos += statistics.demos_evaluated;
        evaluated += statistics.frames_evaluated;
    }
    let (p50, p95, scan) = (
        quantile(&mut fast, 0.5),
        quantile(&mut fast, 0.95),
        quantile(&mut slow, 0.5),
    );
    println!(
        "{name:9} {kind:8} {:8} {p50:7.1} {p95:7.1} {:6.1} {:7.0} {scan:12.1} {:6.1}",
        mode.as_str(),
        f64::from(demos) / QUERIES as f64,
        f64::from(evaluated) / QUERIES as f64,
        scan / p50
    );
    Ok(())
}

fn quantile(values: &mut [f64], fraction: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * fraction) as usize]
}

/// Generates demonstrations along straight paths: above the object, down, up with the object, across to one place, down.
fn generate(random: &mut Random, demos: u32) -> Vec<IndexedSpatialFrame> {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let mut frames = Vec::new();
    for episode in 0..demos {
        let pose = |p: Vector3<f64>, yaw: f64| {
            Isometry3::from_parts(
                Translation3::from(p),
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
            )
        };
        let at = Vector3::new(random.range(-0.15, 0.15), random.range(-0.15, 0.15), 0.82);
        let mut object = pose(at, random.range(-3.1, 3.1));
        let place = pose(Vector3::new(0.25, 0.1, 0.85), random.range(-0.1, 0.1));
        let above = |o: &Isometry3<f64>, height: f64| Isometry3::translation(0.0, 0.0, height) * o * down;
        let home = pose(Vector3::new(-0.1, 0.0, 1.0), 0.0) * down;
        let lifted = Isometry3::translation(0.0, 0.0, 0.15) * object;
        let carried = Isometry3::translation(0.0, 0.0, 0.1) * place;
        let segments = [
            (Mode::Transit, home, above(&object, 0.1)),
            (Mode::Transit, above(&object, 0.1), above(&object, 0.0)),
            (Mode::Transfer, above(&object, 0.0), above(&lifted, 0.0)),
            (Mode::Transfer, above(&lifted, 0.0), above(&carried, 0.0)),
            (Mode::Transfer, above(&carried, 0.0), above(&place, 0.0)),
        ];
        let mut number = 0;
        for (mode, from, to) in segments {
            let count = 12 + random.below(19);
            for i in 0..count {
                let mut eef = pose_between(&from, &to, i as f64 / count as f64);
                eef.translation.vector += Vector3::from_fn(|_, _| random.range(-0.002, 0.002));
                if mode == Mode::Transfer {
                    object = eef * down.inverse();
                }
                frames.push(IndexedSpatialFrame {
                    episode,
                    frame: number,
                    mode,
                    eef,
                    object,
                });
                number += 1;
            }
        }
    }
    frames
}

fn read(text: &str) -> Result<Vec<IndexedSpatialFrame>, Box<dyn Error>> {
    let mut frames = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        let values = line.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>();
        let Ok(&[episode, frame, mode, ref poses @ ..]) = values.as_deref() else {
            return Err(format!("line {number} is not a list of numbers").into());
        };
        let &[ex, ey, ez, ei, ej, ek, ew, x, y, z, i, j, k, w] = poses else {
            return Err(format!("line {number} has {} numbers, not 17", poses.len() + 3).into());
        };
        let pose = |t: [f64; 3], q: [f64; 4]| {
            let [i, j, k, w] = q;
            Isometry3::from_parts(
                Translation3::from(t),
                UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k)),
            )
        };
        frames.push(IndexedSpatialFrame {
            episode: episode as u32,
            frame: frame as u32,
            mode: if mode > 0.0 { Mode::Transfer } else { Mode::Transit },
            eef: pose([ex, ey, ez], [ei, ej, ek, ew]),
            object: pose([x, y, z], [i, j, k, w]),
        });
    }
    Ok(frames)
}

struct Random(Pcg64);

impl Random {
    /// Samples uniformly from `[low, high)`.
    fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Samples uniformly from `0..count`.
    fn below(&mut self, count: usize) -> usize {
        (self.0.next_u64() % count as u64) as usize
    }

    /// Perturbs a pose by up to 2 cm and 0.2 rad along each axis.
    fn perturb(&mut self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        let translation = Vector3::from_fn(|_, _| self.range(-0.02, 0.02));
        let rotation = Vector3::from_fn(|_, _| self.range(-0.2, 0.2));
        Isometry3::from_parts(
            (pose.translation.vector + translation).into(),
            UnitQuaternion::from_scaled_axis(rotation) * pose.rotation,
        )
    }
}
