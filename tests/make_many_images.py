"""Writes a robomimic HDF5 file with many demonstrations with images: those of another file, and short copies of the frames around
their grasps.

usage: make_many_images.py IMAGES.hdf5 TARGET.hdf5 COUNT   (needs h5py and numpy)
"""

import sys

import h5py
import numpy as np

images, target, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
CAMERA = "agentview_image"


def copied(source, target, frames, keep):
    """Copies the frames of all arrays of a group, of which `keep` is true."""
    for name, item in source.items():
        if isinstance(item, h5py.Group):
            copied(item, target.create_group(name), frames, keep)
        elif keep(name):
            target.create_dataset(name, data=item[frames])
    target.attrs.update(source.attrs)


with h5py.File(images) as source, h5py.File(target, "w") as file:
    data = file.create_group("data")
    names = sorted(source["data"], key=lambda name: int(name.split("_")[1]))
    total = 0
    for number in range(count):
        demo = source["data"][names[number % len(names)]]
        # The gripper command of Lift closes once, or again after a miss; the last time carries the cube.
        grasp = np.flatnonzero(np.diff(np.sign(demo["actions"][:, -1])) > 0)[-1] + 1
        frames = slice(grasp - 2 - number // len(names) % 4, grasp + 3)
        # Conventions are proven from longer motions.
        if number < len(names):
            frames = slice(0, len(demo["actions"]))
        own = data.create_group(f"demo_{number}")
        copied(demo, own, frames, lambda name: not name.endswith("_image") or name == CAMERA)
        own.attrs["num_samples"] = frames.stop - frames.start
        total += frames.stop - frames.start
    data.attrs.update(source["data"].attrs)
    data.attrs["total"] = total
