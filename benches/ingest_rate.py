"""Times reading all images of a Push-T dataset as bytes with re4-ingest and zarr-python, alternating in one run.

usage: ingest_rate.py DATASET [ROUNDS]   (needs zarr 2 and numpy; builds the example `decode_rate` with cargo)

Both decode every chunk of data/img, convert float32 to uint8 and sum the bytes; the sums have to agree. Rounds alternate, so
that other load on the machine affects both. CPU seconds are given, too, because other load hardly changes them (those of
re4-ingest include reading and hashing the rest of the dataset). Prints one JSON object.
"""

import json
import os
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import zarr

dataset = sys.argv[1]
rounds = int(sys.argv[2]) if len(sys.argv) > 2 else 5
root = Path(__file__).resolve().parent.parent
build = ["cargo", "build", "--quiet", "--release", "-p", "re4-ingest", "--example", "decode_rate"]
subprocess.run(build, cwd=root, check=True)
target = Path(os.environ.get("CARGO_TARGET_DIR", root / "target"))
binary = target / "release" / "examples" / "decode_rate"


def cpu(who):
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


def zarr_python():
    img = zarr.open(dataset, "r")["data/img"]
    start = time.perf_counter()
    total = 0
    for first in range(0, img.shape[0], img.chunks[0]):
        block = img[first : first + img.chunks[0]].astype(np.uint8)
        total += int(block.sum(dtype=np.uint64))
    return time.perf_counter() - start, total


def re4_ingest():
    report = json.loads(subprocess.run([binary, dataset, "1"], check=True, capture_output=True, text=True).stdout)
    return report["images_s"], report["image_sum"]


times = {"re4_ingest": [], "zarr_python": []}
cpu_times = {"re4_ingest": [], "zarr_python": []}
for _ in range(rounds):
    before = cpu(resource.RUSAGE_CHILDREN)
    ours, our_sum = re4_ingest()
    cpu_times["re4_ingest"].append(cpu(resource.RUSAGE_CHILDREN) - before)
    before = cpu(resource.RUSAGE_SELF)
    theirs, their_sum = zarr_python()
    cpu_times["zarr_python"].append(cpu(resource.RUSAGE_SELF) - before)
    assert our_sum == their_sum, (our_sum, their_sum)
    times["re4_ingest"].append(ours)
    times["zarr_python"].append(theirs)

array = zarr.open(dataset, "r")["data/img"]
best = {name: min(values) for name, values in times.items()}
median = {name: statistics.median(values) for name, values in times.items()}
print(
    json.dumps(
        {
            "decoded_gb": array.nbytes / 1e9,
            "rounds": rounds,
            "cores": os.cpu_count(),
            "best_s": best,
            "median_s": median,
            "best_cpu_s": {name: min(values) for name, values in cpu_times.items()},
            "load_average": os.getloadavg()[0],
            "decoded_gb_per_s": {name: array.nbytes / 1e9 / value for name, value in best.items()},
            "ratio_best": best["zarr_python"] / best["re4_ingest"],
            "ratio_median": median["zarr_python"] / median["re4_ingest"],
        },
        indent=2,
    )
)
