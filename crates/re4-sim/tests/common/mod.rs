//! Reads the reference trace; `tests/data/make_reference_trace.py` describes the layout.
#![allow(
    clippy::expect_used,
    clippy::panic,
    reason = "only tests and examples read the trace, and they may panic"
)]

use std::path::{Path, PathBuf};

use re4_geometry::{Point2, Pose2};
use re4_sim::{PushTObservation, Scene};

/// Agent x, y, agent velocity x, y, block x, y, theta.
pub(crate) type State = [f64; 7];

pub(crate) struct Trace {
    pub(crate) versions: String,
    pub(crate) stride: usize,
    pub(crate) episodes: Vec<Episode>,
}

pub(crate) struct Episode {
    pub(crate) scene: Scene,
    pub(crate) first: State,
    pub(crate) steps: Vec<TraceStep>,
}

pub(crate) struct TraceStep {
    pub(crate) action: Point2,
    pub(crate) contact_points: u32,
    pub(crate) coverage: f64,
    pub(crate) hash: u64,
    /// Stored only for every `stride`-th step.
    pub(crate) state: Option<State>,
}

pub(crate) fn path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/reference_trace.bin")
}

pub(crate) fn state_of(observation: &PushTObservation) -> State {
    let (agent, velocity, block) = (observation.agent, observation.agent_velocity, observation.block);
    [agent.x, agent.y, velocity.x, velocity.y, block.x, block.y, block.theta]
}

/// FNV-1a over the little-endian bytes.
pub(crate) fn hash_of(state: &State) -> u64 {
    state
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        })
}

struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let (head, tail) = self.0.split_first_chunk().expect("the trace is cut short");
        self.0 = tail;
        *head
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.bytes())
    }

    fn u32(&mut self) -> usize {
        u32::from_le_bytes(self.bytes()) as usize
    }

    fn list<T>(&mut self, n: usize, mut one: impl FnMut(&mut Self) -> T) -> Vec<T> {
        (0..n).map(|_| one(self)).collect()
    }
}

pub(crate) fn read(path: &Path) -> Trace {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("cannot read {}: {error}", path.display()));
    let mut r = Reader(&bytes);
    assert_eq!(&r.bytes::<8>(), b"PUSHT-T1");
    let length = r.u32();
    let text = r.list(length, |r| r.bytes::<1>()[0]);
    let versions = String::from_utf8(text).expect("the versions are UTF-8");
    let (n, steps, stride) = (r.u32(), r.u32(), r.u32());
    let scenes = r.list(n, |r| [(); 5].map(|()| r.f64()));
    let firsts = r.list(n, |r| [(); 7].map(|()| r.f64()));
    let actions = r.list(n * steps, |r| {
        [(); 2].map(|()| f64::from(f32::from_le_bytes(r.bytes())))
    });
    let contacts = r.list(n * steps, |r| u32::from(r.bytes::<1>()[0]));
    let coverage = r.list(n * steps, Reader::f64);
    let hashes = r.list(n * steps, |r| u64::from_le_bytes(r.bytes()));
    let states = r.list(n * (steps / stride), |r| [(); 7].map(|()| r.f64()));
    assert!(r.0.is_empty(), "the trace is too long");
    let episodes = (0..n)
        .map(|e| Episode {
            scene: Scene {
                agent: Point2::new(scenes[e][0], scenes[e][1]),
                block: Pose2::new(scenes[e][2], scenes[e][3], scenes[e][4]),
            },
            first: firsts[e],
            steps: (0..steps)
                .map(|s| TraceStep {
                    action: actions[e * steps + s].into(),
                    contact_points: contacts[e * steps + s],
                    coverage: coverage[e * steps + s],
                    hash: hashes[e * steps + s],
                    state: ((s + 1) % stride == 0).then(|| states[e * (steps / stride) + s / stride]),
                })
                .collect(),
        })
        .collect();
    Trace {
        versions,
        stride,
        episodes,
    }
}
