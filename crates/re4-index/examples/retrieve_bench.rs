//! Times planar Retrieve on one thread, query by query, and compares it with the linear scan.
//!
//! ```text
//! cargo run --release -p re4-index --example retrieve_bench -- DATASET [--dump FOLDER]
//! cargo run --release -p re4-index --example retrieve_bench -- --growth [LARGEST]
//! ```
//!
//! The first form uses the Push-T replay dataset and three kinds of queries: frames of the dataset (`on_data`), frames perturbed
//! by up to 10 pixels and 0.1 rad (`near_data`, typical for a policy), and states sampled uniformly from the whole range
//! (`off_data`). `--dump` writes the queries and answers as rows of little-endian f64 for comparison with other programs.
//!
//! The second form generates random-walk demonstrations of 125 frames that end near one goal, with 10^4 up to LARGEST frames
//! (default 10^6; 10^7 takes half a minute and 2 GiB of memory).
//!
//! `retrieve_linear` follows the definition literally and normalises every frame for every query, which is part of its measured
//! time.
#![expect(clippy::print_stdout, reason = "printing is what this example is for")]

use std::error::Error;
use std::fs;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};
use re4_index::{AngleMetric, IndexError, IndexedFrame, Normalization, Query, RetrievalIndex, retrieve_linear};
use re4_ingest::Selection;
use re4_ingest::pusht::PushtReader;

const QUERIES: usize = 4000;
const LINEAR_QUERIES: usize = 200;
const EPSILONS: [f64; 2] = [0.1, f64::INFINITY];
const METRICS: [(&str, AngleMetric); 2] = [("periodic", AngleMetric::Periodic), ("raw", AngleMetric::Raw)];
const KINDS: [&str; 3] = ["on_data", "near_data", "off_data"];
const HEADER: &str = "angle     epsilon  queries    p50_us  p95_us  p99_us  demos  frames  linear_p50_us";

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["--growth"] => growth(1_000_000),
        ["--growth", largest] => growth(largest.parse()?),
        [dataset] => on_dataset(Path::new(dataset), None),
        [dataset, "--dump", folder] => on_dataset(Path::new(dataset), Some(Path::new(folder))),
        _ => Err("give DATASET [--dump FOLDER], or --growth [LARGEST]".into()),
    }
}

fn on_dataset(dataset: &Path, dump: Option<&Path>) -> Result<(), Box<dyn Error>> {
    let (episodes, _) = PushtReader::open(dataset)?.read_episodes(&Selection::All)?;
    let frames: Vec<IndexedFrame> = episodes
        .planar_episodes()
        .iter()
        .flat_map(|episode| {
            episode.frames.iter().zip(0..).map(|(frame, number)| IndexedFrame {
                episode: episode.source,
                frame: number,
                mode: Mode::Transit,
                eef: frame.eef,
                object: frame.object,
            })
        })
        .collect();
    if let Some(folder) = dump {
        fs::create_dir_all(folder)?;
        let rows = frames.iter().flat_map(|f| {
            [f64::from(f.episode), f64::from(f.frame)]
                .into_iter()
                .chain(coordinates(f.eef, f.object))
        });
        write(&folder.join("frames.f64"), rows)?;
    }
    println!("{HEADER}");
    for (name, metric) in METRICS {
        let begin = Instant::now();
        let index = RetrievalIndex::build(frames.clone(), metric)?;
        let built = begin.elapsed();
        for kind in KINDS {
            let queries = queries(kind, index.frames(), index.normalization(), QUERIES);
            if let Some(folder) = dump {
                let rows = queries.iter().flat_map(|q| coordinates(q.eef, q.object));
                write(&folder.join(format!("{kind}.f64")), rows)?;
            }
            for epsilon in EPSILONS {
                let times = Times::measure(&index, &queries, epsilon, LINEAR_QUERIES)?;
                println!("{name:<9} {epsilon:<8} {kind:<9} {times}");
                if let Some(folder) = dump {
                    let mut rows = Vec::with_capacity(4 * queries.len());
                    for query in &queries {
                        let answer = index.retrieve(query, epsilon)?.ok_or("no frame of the mode")?;
                        rows.extend([
                            f64::from(answer.episode),
                            f64::from(answer.frame),
                            answer.d_q,
                            answer.d_o,
                        ]);
                    }
                    write(&folder.join(format!("{kind}-{name}-{epsilon}.f64")), rows)?;
                }
            }
        }
        println!(
            "{name}: {} frames, built in {:.2} ms",
            frames.len(),
            built.as_secs_f64() * 1e3
        );
    }
    Ok(())
}

fn growth(largest: usize) -> Result<(), Box<dyn Error>> {
    println!("frames    build_ms  {HEADER}");
    let mut count = 10_000;
    while count <= largest {
        let frames = random_walks(count);
        let begin = Instant::now();
        let index = RetrievalIndex::build(frames, AngleMetric::Periodic)?;
        let built = begin.elapsed();
        for kind in KINDS {
            let queries = queries(kind, index.frames(), index.normalization(), 2000);
            let linear = (20_000_000 / count).clamp(4, 100);
            for epsilon in EPSILONS {
                let times = Times::measure(&index, &queries, epsilon, linear)?;
                let build = built.as_secs_f64() * 1e3;
                println!("{count:<9} {build:<9.1} periodic  {epsilon:<8} {kind:<9} {times}");
            }
        }
        count *= 10;
    }
    Ok(())
}

/// Times in microseconds per query, and the mean number of evaluated demonstrations and frames.
struct Times {
    percentiles: [f64; 3],
    demos: f64,
    frames: f64,
    linear: f64,
}

impl Times {
    fn measure(index: &RetrievalIndex, queries: &[Query], epsilon: f64, linear: usize) -> Result<Self, IndexError> {
        let mut statistics = (0.0, 0.0);
        for query in queries {
            let cost = index.retrieve_counted(query, epsilon)?.1;
            statistics.0 += f64::from(cost.demos_evaluated);
            statistics.1 += f64::from(cost.frames_evaluated);
        }
        let mut indexed = Vec::with_capacity(queries.len());
        for query in queries {
            let begin = Instant::now();
            black_box(index.retrieve(black_box(query), epsilon)?);
            indexed.push(begin.elapsed().as_secs_f64() * 1e6);
        }
        let mut scanned = Vec::with_capacity(linear);
        for query in queries.iter().step_by((queries.len() / linear).max(1)) {
            let begin = Instant::now();
            black_box(retrieve_linear(
                index.frames(),
                index.normalization(),
                black_box(query),
                epsilon,
            )?);
            scanned.push(begin.elapsed().as_secs_f64() * 1e6);
        }
        indexed.sort_by(f64::total_cmp);
        scanned.sort_by(f64::total_cmp);
        let at = |times: &[f64], fraction: f64| times[((times.len() - 1) as f64 * fraction).round() as usize];
        Ok(Self {
            percentiles: [0.5, 0.95, 0.99].map(|fraction| at(&indexed, fraction)),
            demos: statistics.0 / queries.len() as f64,
            frames: statistics.1 / queries.len() as f64,
            linear: at(&scanned, 0.5),
        })
    }
}

impl std::fmt::Display for Times {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [p50, p95, p99] = self.percentiles;
        write!(
            f,
            "{p50:>7.2} {p95:>7.2} {p99:>7.2} {:>6.1} {:>7.1} {:>14.1}",
            self.demos, self.frames, self.linear
        )
    }
}

/// Generates the queries of one kind, deterministically for the same frames.
fn queries(kind: &str, frames: &[IndexedFrame], normalization: &Normalization, count: usize) -> Vec<Query> {
    let mut random = Pcg64::new(7, 11);
    (0..count)
        .map(|_| {
            let frame = &frames[(random.next_u64() % frames.len() as u64) as usize];
            let near = coordinates(frame.eef, frame.object);
            let amplitude = [10.0, 10.0, 10.0, 10.0, 0.1];
            let q: [f64; 5] = std::array::from_fn(|i| match kind {
                "on_data" => near[i],
                "near_data" => near[i] + amplitude[i] * (2.0 * unit(&mut random) - 1.0),
                _ => normalization.ranges[i].minimum + unit(&mut random) * normalization.ranges[i].span(),
            });
            Query {
                mode: Mode::Transit,
                eef: Point2::new(q[0], q[1]),
                object: Pose2::new(q[2], q[3], q[4]),
            }
        })
        .collect()
}

/// Generates demonstrations of 125 frames. The object drifts from a random start to one goal, and the end effector moves randomly
/// near it.
fn random_walks(count: usize) -> Vec<IndexedFrame> {
    let mut random = Pcg64::new(3, 5);
    let mut frames = Vec::with_capacity(count);
    let goal = [256.0, 256.0, std::f64::consts::FRAC_PI_4];
    for episode in 0..count.div_ceil(125) as u32 {
        let start = [
            100.0 + 300.0 * unit(&mut random),
            100.0 + 300.0 * unit(&mut random),
            goal[2] + std::f64::consts::PI * (2.0 * unit(&mut random) - 1.0),
        ];
        let mut drift = [0.0; 3];
        let mut eef_offset = [0.0; 2];
        for number in 0..125 {
            let done = f64::from(number) / 124.0;
            let mut object = [0.0; 3];
            for (i, size) in [6.0, 6.0, 0.06].into_iter().enumerate() {
                drift[i] = 0.95 * drift[i] + size * (2.0 * unit(&mut random) - 1.0);
                object[i] = start[i] * (1.0 - done) + goal[i] * done + drift[i];
            }
            for offset in &mut eef_offset {
                *offset = 0.97 * *offset + 30.0 * (2.0 * unit(&mut random) - 1.0);
            }
            frames.push(IndexedFrame {
                episode,
                frame: number,
                mode: Mode::Transit,
                eef: Point2::new(object[0] + eef_offset[0], object[1] + eef_offset[1]),
                object: Pose2::new(object[0], object[1], object[2]),
            });
        }
    }
    frames.truncate(count);
    frames
}

fn coordinates(eef: Point2, object: Pose2) -> [f64; 5] {
    [eef.x, eef.y, object.x, object.y, object.theta]
}

fn write(path: &Path, values: impl IntoIterator<Item = f64>) -> std::io::Result<()> {
    fs::write(path, values.into_iter().flat_map(f64::to_le_bytes).collect::<Vec<u8>>())
}

/// Samples a uniform number in `[0, 1)` with 53 random bits.
fn unit(random: &mut Pcg64) -> f64 {
    (random.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}
