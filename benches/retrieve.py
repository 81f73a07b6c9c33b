"""Times Retrieve against numpy and scipy on the same queries, one thread each, and prints the ratios.

Needs numpy, scipy, zarr (2.x) and cargo. Run: python benches/retrieve.py [DATASET]
DATASET is the Push-T replay dataset; without it, pusht/pusht_cchi_v7_replay.zarr in the folder RE4_DATA, else in data/.

The Rust example `retrieve_bench` makes the queries, answers them and writes both to files. The same queries are answered here by
  numpy     the two-stage scan over normalised columns; gives the same answer, which is checked frame by frame;
  kd1       scipy's cKDTree over normalised object poses, nearest neighbour, one call per query; a different, easier problem;
  kd_batch  the same with all queries in one call, which avoids Python's overhead per call.
Times are medians in microseconds per query (kd_batch: the mean); ratios are relative to Rust's median.
"""

import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
import scipy
import zarr
from scipy.spatial import cKDTree

ROOT = pathlib.Path(__file__).resolve().parent.parent
CHECKED = 500


def dataset_path() -> pathlib.Path:
    if len(sys.argv) > 1:
        return pathlib.Path(sys.argv[1]).resolve()
    return (pathlib.Path(os.environ.get("RE4_DATA", ROOT / "data")) / "pusht/pusht_cchi_v7_replay.zarr").resolve()


class Columns:
    """Min-max-normalised states of all demonstrations."""

    def __init__(self, states: np.ndarray, ends: np.ndarray, periodic: bool) -> None:
        states = states.astype(np.float64)
        states[:, 4] = np.mod(states[:, 4], 2 * np.pi)
        self.low, self.span = states.min(0), np.ptp(states, axis=0)
        self.columns = np.ascontiguousarray(((states - self.low) / self.span).T)
        self.starts = np.concatenate([[0], ends[:-1]])
        self.lengths = np.diff(ends, prepend=0)
        self.period = 2 * np.pi / self.span[4] if periodic else np.inf

    def normalized(self, queries: np.ndarray) -> np.ndarray:
        queries = queries.copy()
        queries[:, 4] = np.mod(queries[:, 4], 2 * np.pi)
        return (queries - self.low) / self.span

    def retrieve(self, q: np.ndarray, epsilon: float) -> tuple[int, int, float, float]:
        """Episode, frame, d_q and d_o for a normalised query."""
        eef_x, eef_y, x, y, theta = self.columns
        angle = np.abs(q[4] - theta)
        angle = np.minimum(angle, np.abs(self.period - angle))
        d_o = (q[2] - x) ** 2 + (q[3] - y) ** 2 + angle**2
        d_q = (q[0] - eef_x) ** 2 + (q[1] - eef_y) ** 2 + d_o
        if np.isfinite(epsilon):
            minimum = np.minimum.reduceat(d_o, self.starts)
            limit = np.maximum((np.sqrt(minimum) + epsilon) ** 2, minimum)
            d_q = np.where(d_o <= np.repeat(limit, self.lengths), d_q, np.inf)
        nearest = np.minimum.reduceat(d_q, self.starts)
        hits = np.flatnonzero(d_q == np.repeat(nearest, self.lengths))
        frames = hits[np.searchsorted(hits, self.starts)]
        episode = int(np.argmin(d_o[frames]))
        frame = frames[episode]
        return episode, int(frame - self.starts[episode]), float(np.sqrt(d_q[frame])), float(np.sqrt(d_o[frame]))


def time_each(function, items) -> tuple[list, float]:
    answers, times = [], []
    for item in items:
        begin = time.perf_counter()
        answers.append(function(item))
        times.append(time.perf_counter() - begin)
    return answers, statistics.median(times) * 1e6


def run_rust(dataset: pathlib.Path, folder: str) -> dict[tuple[str, str, str], float]:
    """Medians by (angle, epsilon, kind of queries). Queries and answers are written to the folder."""
    command = ["cargo", "run", "--release", "--quiet", "-p", "re4-index", "--example", "retrieve_bench", "--"]
    output = subprocess.run(
        [*command, dataset, "--dump", folder], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    rows = [line.split() for line in output.splitlines() if line.startswith(("periodic ", "raw "))]
    return {(row[0], row[1], row[2]): float(row[3]) for row in rows}


def main() -> None:
    dataset = dataset_path()
    group = zarr.open(str(dataset), mode="r")
    states, ends = group["data/state"][:], group["meta/episode_ends"][:]
    print(f"{dataset.name}: {len(states)} frames, {len(ends)} episodes; numpy {np.__version__}, scipy {scipy.__version__}")
    print("angle     epsilon  queries     rust_us  numpy_us   ratio   kd1_us   ratio  kd_batch_us   ratio")
    differing = 0
    with tempfile.TemporaryDirectory() as folder:
        medians = run_rust(dataset, folder)
        for (angle, epsilon, kind), rust in medians.items():
            columns = Columns(states, ends, angle == "periodic")
            rows = np.fromfile(f"{folder}/{kind}.f64", "<f8").reshape(-1, 5)
            expected = np.fromfile(f"{folder}/{kind}-{angle}-{epsilon}.f64", "<f8").reshape(-1, 4)
            queries = columns.normalized(rows)
            answers, scan = time_each(lambda q: columns.retrieve(q, float(epsilon)), queries[:CHECKED])
            for ours, theirs in zip(expected, answers):
                same = tuple(ours[:2]) == theirs[:2] and np.allclose(ours[2:], theirs[2:], rtol=0, atol=1e-12)
                differing += not same
            poses = columns.columns[2:].T.copy()
            box = [0, 0, columns.period] if angle == "periodic" else None
            tree = cKDTree(poses, boxsize=box)
            wanted = queries[:, 2:].copy()
            _, single = time_each(lambda q: tree.query(q, workers=1), wanted[:CHECKED])
            begin = time.perf_counter()
            tree.query(wanted, workers=1)
            batch = (time.perf_counter() - begin) / len(wanted) * 1e6
            print(
                f"{angle:<9} {epsilon:<8} {kind:<10} {rust:>8.2f} {scan:>9.1f} {scan / rust:>7.1f} {single:>8.1f}"
                f" {single / rust:>7.1f} {batch:>12.2f} {batch / rust:>7.1f}"
            )
    print(f"answers of rust and numpy that differ: {differing} of {CHECKED * len(medians)}")
    sys.exit(1 if differing else 0)


if __name__ == "__main__":
    main()
