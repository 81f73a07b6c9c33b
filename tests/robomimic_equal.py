"""Compares an `episodes` artifact of a robosuite task bit for bit with what h5py reads from its HDF5 file.

usage: robomimic_equal.py ARTIFACT SOURCE.hdf5   (needs h5py, numpy, polars and pillow)

Every recorded column is compared as 64-bit patterns, so that the signs of zeros and quaternions matter; images are compared as
pixels. Prints one line with the numbers of equal values and images. Exits with code 1 and names the first difference.
"""

import io
import sys
from pathlib import Path

import h5py
import numpy as np
import polars as pl
from PIL import Image

artifact, source = Path(sys.argv[1]), sys.argv[2]
tables = {path.stem: pl.read_parquet(path) for path in artifact.glob("*.parquet")}
frames = tables["frames"]
conventions = dict(zip(tables["conventions"]["convention"], tables["conventions"]["value"]))
demos = tables["demos"]["demo"].to_list()
lengths = tables["episodes"]["frames"].to_list()
assert conventions["poses"] == "observations", "only poses from observations can be compared"

# Columns of the object vector with its pose, and columns of the actions by their kind.
pose = 7 if conventions.get("object_layout") == "relative_first" else 0
kind = "delta" if conventions["action_kind"] == "delta" else "goal"
assert conventions["eef_quaternion"] == conventions["object_quaternion"] == "xyzw", "columns are in another order"
# Values that the dataset has in another frame or with another sign are in the columns `raw_*`.
eef = "raw_eef" if conventions["eef_orientation"] == "hand_body" else "eef"
gripper = "raw_gripper" if conventions["gripper_sign"] == "positive_opens" else "gripper"
RECORDED = {
    "obs/robot0_eef_pos": ["eef_x", "eef_y", "eef_z"],
    "obs/robot0_eef_quat": [f"{eef}_{part}" for part in ["qx", "qy", "qz", "qw"]],
    "obs/robot0_gripper_qpos": ["finger_0", "finger_1"],
    "obs/object": ["object_x", "object_y", "object_z", "object_qx", "object_qy", "object_qz", "object_qw"],
    "actions": [f"{kind}_{axis}" for axis in ["x", "y", "z", "rx", "ry", "rz"]] + [gripper],
    "rewards": ["reward"],
}
numbers = images = 0


def same(ours, theirs, what):
    """Counts equal numbers, and exits at the first that differs in any bit."""
    global numbers
    ours = np.ascontiguousarray(ours, dtype=np.float64).view(np.uint64)
    theirs = np.ascontiguousarray(theirs, dtype=np.float64).view(np.uint64)
    if ours.shape != theirs.shape or not np.array_equal(ours, theirs):
        sys.exit(f"{what} differs")
    numbers += ours.size


def has_invalid(values, valid):
    """Whether some values are invalid; ingest then leaves the array out."""
    return not valid(values).all()


def number(name):
    return int(name.rsplit("_", 1)[1])


with h5py.File(source) as file:
    data = file["data"]
    masks = {key: {name.decode() for name in file["mask"][key]} for key in file.get("mask", [])}
    assert demos == sorted(demos, key=number), "not in numeric order"
    start = 0
    for episode, (demo, length) in enumerate(zip(demos, lengths)):
        group = data[demo]
        rows = frames[start : start + length]
        assert length == group["actions"].shape[0] and (rows["episode"] == episode).all()
        assert rows["frame"].to_list() == list(range(length))
        for dataset, columns in RECORDED.items():
            if dataset not in group or (dataset == "rewards" and has_invalid(group[dataset][()], np.isfinite)):
                assert rows[columns[0]].null_count() == length
                continue
            theirs = group[dataset][()].reshape(length, -1)
            theirs = theirs[:, pose : pose + 7] if dataset == "obs/object" else theirs
            same(rows.select(columns).to_numpy(), theirs, f"{demo}/{dataset}")
        if "dones" in group and has_invalid(group["dones"][()], lambda flags: np.isin(flags, [0, 1])):
            assert rows["done"].null_count() == length
        elif "dones" in group:
            same(rows["done"].to_numpy(), group["dones"][()], f"{demo}/dones")
        if "states" in group:
            states = tables["states"][start : start + length]
            assert (states["episode"] == episode).all()
            same(np.array(states["state"].to_list()), group["states"][()], f"{demo}/states")
        model = tables["demos"]["model"][episode]
        if "model_file" in group.attrs:
            assert tables["models"]["mjcf"][model] == group.attrs["model_file"], f"{demo}: model_file differs"
        else:
            assert model is None
        listed = ",".join(sorted(key for key, names in masks.items() if demo in names))
        assert tables["demos"]["filter_keys"][episode] == listed, f"{demo}: filter keys differ"
        start += length
    assert start == len(frames)
    if "images" in tables:
        images = tables["images"]
        row = 0
        for camera in sorted(images["camera"].unique().to_list()):
            for episode, (demo, length) in enumerate(zip(demos, lengths)):
                theirs = data[demo][f"obs/{camera}_image"][()]
                for frame in range(length):
                    place, step, name, png = images.row(row)
                    assert (name, place, step) == (camera, episode, frame), f"image {row} is out of order"
                    if not np.array_equal(np.asarray(Image.open(io.BytesIO(png))), theirs[frame]):
                        sys.exit(f"{demo}, {camera}, frame {frame} differs")
                    row += 1
        assert row == len(images)
        images = row
print(f"{len(demos)} demonstrations, {numbers} numbers and {images} images are equal")
