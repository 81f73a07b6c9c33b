"""Writes HDF5 files whose demonstrations are not numbered consecutively from 0, from data/can-sample.hdf5.

usage: make_gaps.py SAMPLE.hdf5 FOLDER   (needs h5py and numpy)

gaps.hdf5    some demonstrations are missing, as after manual curation; the filter keys still name them
names.hdf5   demonstrations with names other than demo_N; NAMES and names.json map them to the names of the sample
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np

sample, folder = sys.argv[1], Path(sys.argv[2])
LOST = ["demo_0", "demo_3", "demo_5", "demo_13"]
NAMES = {
    "demo1": "demo_4",
    "demo2": "demo_2",
    "demo10": "demo_1",
    "take-7": "demo_6",
    "a_3": "demo_7",
    "b_3": "demo_9",
    "run_99999999999999999999": "demo_12",
    "last": "demo_15",
}

folder.mkdir(exist_ok=True)


def finish(file, source):
    data = file["data"]
    data.attrs["env_args"] = source["data"].attrs["env_args"]
    data.attrs["total"] = sum(int(demo.attrs["num_samples"]) for demo in data.values())


with h5py.File(sample) as source:
    with h5py.File(folder / "gaps.hdf5", "w") as file:
        source.copy("data", file)
        source.copy("mask", file)
        for name in LOST:
            del file[f"data/{name}"]
        finish(file, source)
    with h5py.File(folder / "names.hdf5", "w") as file:
        data = file.create_group("data")
        # Created in another order than that of their numbers, in a file that keeps the order of creation.
        for name in sorted(NAMES, reverse=True):
            source.copy(f"data/{NAMES[name]}", data, name=name)
        file["mask/some"] = np.array(["demo2", "demo10", "take-7", "last"], dtype="S8")
        finish(file, source)
(folder / "names.json").write_text(json.dumps(NAMES))
