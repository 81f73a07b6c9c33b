"""Splits a robomimic HDF5 file into several, and writes copies of one of them that differ in how they were recorded.

usage: make_split.py MANY.hdf5 FOLDER   (needs h5py and numpy)

FOLDER/split has a.hdf5, b.hdf5 and c.hdf5 with the demonstrations of MANY.hdf5 in order; each numbers its own from 0. FOLDER/other has
changed copies of b.hdf5, each named after what differs.
"""

import json
import shutil
import sys
from pathlib import Path

import h5py
import numpy as np

# The first file has fewer demonstrations than conventions are proven on. Parts of 256 end within files.
ENDS = [7, 301]

many, folder = Path(sys.argv[1]), Path(sys.argv[2])


def change(name, edit):
    path = folder / "other" / f"{name}.hdf5"
    shutil.copy(folder / "split" / "b.hdf5", path)
    with h5py.File(path, "r+") as file:
        edit(file)


def environment(edit):
    def change(file):
        args = json.loads(file["data"].attrs["env_args"])
        edit(args)
        file["data"].attrs["env_args"] = json.dumps(args)

    return change


def flip_gripper(file):
    for demo in file["data"].values():
        demo["actions"][:, 6] = -demo["actions"][:, 6]


def add_camera(file):
    for demo in file["data"].values():
        demo["obs"].create_dataset("agentview_image", data=np.zeros((len(demo["actions"]), 8, 8, 3), np.uint8))


def spoil(file):
    file["data/demo_3/actions"][2, 0] = np.nan


(folder / "split").mkdir()
(folder / "other").mkdir()
with h5py.File(many) as source:
    names = sorted(source["data"], key=lambda name: int(name.split("_")[1]))
    bounds = [0, *ENDS, len(names)]
    for letter, start, end in zip("abc", bounds, bounds[1:]):
        with h5py.File(folder / "split" / f"{letter}.hdf5", "w") as target:
            data = target.create_group("data")
            data.attrs["env_args"] = source["data"].attrs["env_args"]
            for number, name in enumerate(names[start:end]):
                source.copy(f"data/{name}", data, name=f"demo_{number}")
            data.attrs["total"] = sum(demo.attrs["num_samples"] for demo in data.values())
            if letter != "c":
                chosen = np.array([b"demo_1", b"demo_2"])
                target.create_group("mask").create_dataset("some", data=chosen)
change("version", environment(lambda args: args.update(env_version="1.2.0")))
change("controller", environment(lambda args: args["env_kwargs"]["controller_configs"].update(kp=77)))
change("gripper", flip_gripper)
change("camera", add_camera)
change("nan", spoil)
(folder / "other" / "cut.hdf5").write_bytes((folder / "split" / "b.hdf5").read_bytes()[:3000])
