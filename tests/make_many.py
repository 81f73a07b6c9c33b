"""Writes robomimic HDF5 files with many demonstrations, copies of those of data/can-sample.hdf5 with other lengths.

usage: make_many.py SAMPLE.hdf5 FOLDER COUNT   (needs h5py and numpy)

many.hdf5 has COUNT demonstrations. some_bad.hdf5 is a copy in which those of BAD cannot be used, and without_bad.hdf5 one without them.
"""

import shutil
import sys
from pathlib import Path

import h5py
import numpy as np

# In two parts of 256 demonstrations.
BAD = [3, 4, 300]

sample, folder, count = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])


def shortened(group, frames):
    """Cuts all arrays of a demonstration to its first frames."""
    for name, item in list(group.items()):
        if isinstance(item, h5py.Group):
            shortened(item, frames)
        else:
            values = item[:frames]
            del group[name]
            group.create_dataset(name, data=values)


with h5py.File(sample) as source, h5py.File(folder / "many.hdf5", "w") as target:
    data = target.create_group("data")
    names = sorted(source["data"], key=lambda name: int(name.split("_")[1]))
    total = 0
    for number in range(count):
        name = names[number % len(names)]
        source.copy(f"data/{name}", data, name=f"demo_{number}")
        demo = data[f"demo_{number}"]
        frames = len(demo["actions"]) - number // len(names) % 11
        if frames < len(demo["actions"]):
            shortened(demo, frames)
        demo.attrs["num_samples"] = frames
        total += frames
    data.attrs["env_args"] = source["data"].attrs["env_args"]
    data.attrs["total"] = total

for name in ["some_bad", "without_bad"]:
    shutil.copy(folder / "many.hdf5", folder / f"{name}.hdf5")
with h5py.File(folder / "some_bad.hdf5", "r+") as file:
    for number in BAD:
        actions = file[f"data/demo_{number}/actions"]
        actions[2, 0] = np.nan
with h5py.File(folder / "without_bad.hdf5", "r+") as file:
    for number in BAD:
        file["data"].attrs["total"] -= file[f"data/demo_{number}"].attrs["num_samples"]
        del file[f"data/demo_{number}"]
