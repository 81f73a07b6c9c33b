"""Times `re4-pipe ingest` on robomimic low-dim files, and h5py reading the same arrays, in one run.

usage: robomimic_ingest.py FILE.hdf5=TASK... [--rounds N] [--artifacts FOLDER] [--program PROGRAM]   (needs h5py, numpy)

For re4-pipe, the whole command is timed: start, hashing, reading, proving conventions, writing, publishing and verifying. For h5py,
only reading the same datasets is timed, in a running process with the file open. Rounds alternate, so that other load on the
machine affects both; the median is given. Rates are bytes of the file per second. Prints one JSON object per file, and one for all
files.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import h5py

root = Path(__file__).resolve().parent.parent
parser = argparse.ArgumentParser()
parser.add_argument("files", nargs="+")
parser.add_argument("--rounds", type=int, default=7)
parser.add_argument("--artifacts", default=None)
parser.add_argument("--program", default=str(root / "target" / "release" / "re4-pipe"))
arguments = parser.parse_args()

DATASETS = [
    "actions",
    "rewards",
    "dones",
    "states",
    "obs/object",
    "obs/robot0_eef_pos",
    "obs/robot0_eef_quat",
    "obs/robot0_gripper_qpos",
]


def ours(path, task, folder):
    """Seconds and peak memory (MiB, of the larger process) of one ingest into an empty folder."""
    pipeline = folder / "pipeline.toml"
    pipeline.write_text(f'task = "{task}"\n[ingest]\nsource = "{path}"\n[segment]\n')
    artifacts = folder / "artifacts"
    shutil.rmtree(artifacts, ignore_errors=True)
    command = [arguments.program, "ingest", str(pipeline), "--quiet", "--json", "--artifacts", str(artifacts)]
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - start
    assert status == 0, status
    return seconds, usage.ru_maxrss / 1024


def theirs(path):
    """Seconds of reading the same arrays and models with h5py."""
    with h5py.File(path) as file:
        start = time.perf_counter()
        for demo in file["data"].values():
            for name in DATASETS:
                if name in demo:
                    demo[name][()]
            demo.attrs.get("model_file")
        return time.perf_counter() - start


totals = {"ours": 0.0, "h5py": 0.0, "bytes": 0}
memory = 0.0
with tempfile.TemporaryDirectory(dir=arguments.artifacts) as folder:
    for argument in arguments.files:
        path, task = argument.rsplit("=", 1)
        path = os.path.abspath(path)
        size = os.path.getsize(path)
        rounds = []
        for _ in range(arguments.rounds + 1):
            seconds, peak = ours(path, task, Path(folder))
            rounds.append((seconds, theirs(path)))
            memory = max(memory, peak)
        # The first round fills the caches.
        medians = [statistics.median(column) for column in zip(*rounds[1:])]
        totals["ours"] += medians[0]
        totals["h5py"] += medians[1]
        totals["bytes"] += size
        print(
            json.dumps(
                {
                    "file": "/".join(Path(path).parts[-2:]),
                    "mb": round(size / 1e6, 1),
                    "ours_ms": round(medians[0] * 1e3, 1),
                    "h5py_ms": round(medians[1] * 1e3, 1),
                    "ours_gb_s": round(size / medians[0] / 1e9, 3),
                    "h5py_gb_s": round(size / medians[1] / 1e9, 3),
                    "times_faster": round(medians[1] / medians[0], 2),
                    "fastest_ours_ms": round(min(seconds for seconds, _ in rounds) * 1e3, 1),
                }
            )
        )
print(
    json.dumps(
        {
            "all": len(arguments.files),
            "ours_gb_s": round(totals["bytes"] / totals["ours"] / 1e9, 3),
            "h5py_gb_s": round(totals["bytes"] / totals["h5py"] / 1e9, 3),
            "times_faster": round(totals["h5py"] / totals["ours"], 2),
            "peak_rss_mib": round(memory, 1),
            "rounds": arguments.rounds,
        }
    )
)
