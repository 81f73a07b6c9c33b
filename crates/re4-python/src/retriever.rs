//! Retrieve for arrays of queries.

use std::path::PathBuf;

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use rayon::prelude::*;
use re4_artifact::Artifact;
use re4_episode::Mode;
use re4_fault::{OrFault as _, fault};
use re4_geometry::spatial::Symmetry;
use re4_geometry::{Point2, Pose2};
use re4_index::{
    AngleMetric, IndexRow, IndexedFrame, IndexedSpatialFrame, Normalization, PlanarState, Query, RetrievalIndex,
    SpatialIndex, SpatialMetric, SpatialQuery, SpatialState, Stage2,
};
use re4_policy::read_scales;

use crate::arrays::{pose, rows};
use crate::errors::raised;
use crate::threads::Threads;

/// Number of queries that a thread takes at a time.
const CHUNK: usize = 64;

/// The mode with this code: 0 transit, 1 transfer.
fn mode(code: u8) -> anyhow::Result<Mode> {
    Mode::ALL
        .get(usize::from(code))
        .copied()
        .or_fault(|| fault!("there is no mode {code}"; "give 0 for transit or 1 for transfer"))
}

/// The answers to queries, as columns.
type Answers<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
);

/// Demonstration, frame, `d_q` and `d_o` of every answer. Without an answer, numbers are -1 and distances are not a number.
fn columns<'py>(py: Python<'py>, answers: &[Option<(u32, u32, f64, f64)>]) -> Answers<'py> {
    let whole = |of: fn(&(u32, u32, f64, f64)) -> u32| {
        PyArray1::from_iter(
            py,
            answers
                .iter()
                .map(|answer| answer.as_ref().map_or(-1, |a| i64::from(of(a)))),
        )
    };
    let real = |of: fn(&(u32, u32, f64, f64)) -> f64| {
        PyArray1::from_iter(py, answers.iter().map(|answer| answer.as_ref().map_or(f64::NAN, of)))
    };
    (whole(|a| a.0), whole(|a| a.1), real(|a| a.2), real(|a| a.3))
}

/// Answers all queries without the interpreter's lock.
fn answer<'py>(
    py: Python<'py>,
    threads: &Threads,
    count: usize,
    one: impl Fn(usize) -> anyhow::Result<Option<(u32, u32, f64, f64)>> + Sync,
) -> PyResult<Answers<'py>> {
    let answers: anyhow::Result<Vec<_>> = py.detach(|| {
        if threads.count() == 1 {
            return (0..count).map(&one).collect();
        }
        threads.run(|| (0..count).into_par_iter().with_min_len(CHUNK).map(&one).collect())
    });
    Ok(columns(py, &answers.map_err(raised)?))
}

/// The exact index over the planar frames of an `index` artifact.
#[pyclass(module = "re4_pipe._native", frozen)]
pub(crate) struct PlaneIndex {
    index: RetrievalIndex,
    threads: Threads,
}

#[pymethods]
impl PlaneIndex {
    /// Opens the artifact in `folder`. `periodic`: whether angles are compared modulo 2 pi.
    #[new]
    fn new(py: Python<'_>, folder: PathBuf, periodic: bool, threads: usize) -> PyResult<Self> {
        let angle = if periodic {
            AngleMetric::Periodic
        } else {
            AngleMetric::Raw
        };
        let open = || -> anyhow::Result<RetrievalIndex> {
            let artifact = Artifact::open(&folder)?;
            let rows = artifact.read::<IndexRow<PlanarState>>()?.into_iter();
            let frames = rows
                .filter(|row| row.retrievable.unwrap_or(true))
                .map(|row| IndexedFrame {
                    episode: row.episode,
                    frame: row.frame,
                    mode: row.mode,
                    eef: row.state.eef,
                    object: row.state.object,
                });
            let ranges = read_scales(&artifact)?;
            Ok(RetrievalIndex::with_normalization(
                frames.collect(),
                Normalization { ranges, angle },
            )?)
        };
        Ok(Self {
            index: py.detach(open).map_err(raised)?,
            threads: Threads::new(threads),
        })
    }

    /// Number of frames that can be retrieved.
    #[getter]
    fn frames(&self) -> usize {
        self.index.frames().len()
    }

    /// Retrieves a frame for every query: position of the end effector and pose of the object in the world frame, px and rad.
    fn retrieve<'py>(
        &self,
        py: Python<'py>,
        modes: PyReadonlyArray1<'_, u8>,
        eef: PyReadonlyArray2<'_, f64>,
        object: PyReadonlyArray2<'_, f64>,
        epsilon: f64,
    ) -> PyResult<Answers<'py>> {
        let (modes, eef, object) = (
            modes.as_slice()?,
            rows::<2>(&eef, "eef")?,
            rows::<3>(&object, "object")?,
        );
        let index = &self.index;
        answer(py, &self.threads, modes.len(), |at| {
            let ([x, y], [object_x, object_y, theta]) = (eef[at], object[at]);
            let query = Query {
                mode: mode(modes[at])?,
                eef: Point2::new(x, y),
                object: Pose2::new(object_x, object_y, theta),
            };
            let found = index.retrieve(&query, epsilon)?;
            Ok(found.map(|found| (found.episode, found.frame, found.d_q, found.d_o)))
        })
    }
}

/// The exact index over the frames in SE(3) of an `index` artifact.
#[pyclass(module = "re4_pipe._native", frozen)]
pub(crate) struct SpaceIndex {
    index: SpatialIndex,
    threads: Threads,
}

#[pymethods]
impl SpaceIndex {
    /// Opens the artifact in `folder`. `scales`: translation in m and rotation in rad that contribute a distance of 1. `weights`:
    /// those of the object pose and of the end-effector pose in `d_q`. `symmetry`: as JSON.
    #[new]
    fn new(
        py: Python<'_>,
        folder: PathBuf,
        scales: [f64; 2],
        weights: [f64; 2],
        symmetry: &str,
        threads: usize,
    ) -> PyResult<Self> {
        let open = || -> anyhow::Result<SpatialIndex> {
            let symmetry: Symmetry = serde_json::from_str(symmetry).or_fault(|| {
                fault!("the symmetry {symmetry} is not one"; "give None, or a table such as {{\"kind\": \"full\", \"axis\": [0, 0, 1]}}")
            })?;
            let rows = Artifact::open(&folder)?.read::<IndexRow<SpatialState>>()?.into_iter();
            let frames = rows
                .filter(|row| row.retrievable.unwrap_or(true))
                .map(|row| IndexedSpatialFrame {
                    episode: row.episode,
                    frame: row.frame,
                    mode: row.mode,
                    eef: row.state.eef,
                    object: row.state.object,
                });
            let metric = SpatialMetric {
                translation_scale: scales[0],
                rotation_scale: scales[1],
                object_weight: weights[0],
                eef_weight: weights[1],
                symmetry,
            };
            Ok(SpatialIndex::build(frames.collect(), metric)?)
        };
        Ok(Self {
            index: py.detach(open).map_err(raised)?,
            threads: Threads::new(threads),
        })
    }

    /// Number of frames that can be retrieved.
    #[getter]
    fn frames(&self) -> usize {
        self.index.frames().len()
    }

    /// Retrieves a frame for every query: poses of the grip site and of the object in the world frame, as position in m and
    /// quaternion (x, y, z, w). `by_state`: whether stage 2 ranks demonstrations by `d_q` instead of `d_o`.
    fn retrieve<'py>(
        &self,
        py: Python<'py>,
        modes: PyReadonlyArray1<'_, u8>,
        eef: PyReadonlyArray2<'_, f64>,
        object: PyReadonlyArray2<'_, f64>,
        by_state: bool,
    ) -> PyResult<Answers<'py>> {
        let (modes, eef, object) = (
            modes.as_slice()?,
            rows::<7>(&eef, "eef")?,
            rows::<7>(&object, "object")?,
        );
        let (index, none) = (&self.index, std::collections::BTreeSet::new());
        let stage2 = if by_state { Stage2::State } else { Stage2::Object };
        answer(py, &self.threads, modes.len(), |at| {
            let query = SpatialQuery {
                mode: mode(modes[at])?,
                eef: pose(&eef[at]),
                object: pose(&object[at]),
            };
            let found = index.retrieve(&query, stage2, &none)?;
            Ok(found.map(|found| (found.episode, found.frame, found.distances.d_q, found.distances.d_o)))
        })
    }
}
