"""Writes files with peculiarities of public datasets and converters that once were read incorrectly or refused without need. They
are made from the first demonstrations of data/can-sample.hdf5.

usage: make_foreign.py SAMPLE.hdf5 FOLDER   (needs h5py and numpy)
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np

sample, folder = sys.argv[1], Path(sys.argv[2])
DEMOS = ["demo_0", "demo_1", "demo_2", "demo_3"]


def hdf5(change):
    """Writes a copy of the first demonstrations with a change; the file is named after the function."""
    target = folder / f"{change.__name__}.hdf5"
    with h5py.File(sample) as source, h5py.File(target, "w") as file:
        data = file.create_group("data")
        for demo in DEMOS:
            source.copy(f"data/{demo}", data)
        data.attrs["env_args"] = source["data"].attrs["env_args"]
        data.attrs["total"] = sum(int(data[demo].attrs["num_samples"]) for demo in DEMOS)
        change(file)


def demos(file):
    return [file["data"][name] for name in sorted(file["data"])]


def env_args(file):
    return json.loads(file["data"].attrs["env_args"])


@hdf5
def control(file):
    pass


@hdf5
def names_without_underscore(file):
    for number, demo in enumerate(DEMOS):
        file.move(f"data/{demo}", f"data/demo{[1, 2, 10, 11][number]}")


@hdf5
def numbers_with_gaps(file):
    for demo, name in [("demo_3", "demo_6"), ("demo_2", "demo_4")]:
        file.move(f"data/{demo}", f"data/{name}")


@hdf5
def deltas_in_metres(file):
    scale = np.array([0.05] * 3 + [0.5] * 3 + [1.0])
    for demo in demos(file):
        demo["actions"][...] = demo["actions"][...] * scale


@hdf5
def gripper_zero_one(file):
    for demo in demos(file):
        demo["actions"][:, 6] = (demo["actions"][:, 6] > 0).astype(float)


@hdf5
def rows_that_were_never_written(file):
    demo = file["data/demo_2"]
    rows = len(demo["actions"])
    demo.visititems(lambda _, item: item.__setitem__(slice(rows - 27, None), 0) if isinstance(item, h5py.Dataset) else None)


@hdf5
def stale_total(file):
    file["data"].attrs["total"] = 12345


@hdf5
def members_that_are_no_demonstrations(file):
    file["data"].create_group("stats")["mean"] = np.zeros(3)
    file["data/language"] = "put the can into the bin"


@hdf5
def json_as_python_writes_it(file):
    text = env_args(file)
    text["env_kwargs"]["reward_scale"] = float("inf")
    text["env_kwargs"]["noise"] = float("nan")
    file["data"].attrs["env_args"] = json.dumps(text, indent=4)


@hdf5
def one_bad_demonstration(file):
    file["data/demo_1/actions"][4, 2] = np.nan
    file["data/demo_3/obs/robot0_eef_quat"][...] *= 1.3


@hdf5
def counts_as_arrays(file):
    for demo in demos(file):
        demo.attrs["num_samples"] = np.array([demo.attrs["num_samples"]])
