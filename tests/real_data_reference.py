"""Prints the reference with which tests/real_data.rs compares an ingest of the human Push-T demonstrations.

Reads the dataset with zarr-python: python tests/real_data_reference.py <folder>/pusht/pusht_cchi_v7_replay.zarr
(zarr 2.18 with numcodecs, numpy). One line per column: name, SHA-256 of its values as little-endian float32, sum in
float64. The line `images` has the SHA-256 of every 50th image as bytes, row by row.
"""

import hashlib
import math
import sys

import numpy as np
import zarr

root = zarr.open(sys.argv[1], "r")
ends = root["meta/episode_ends"][:]
print("frames", ends[-1])
print("episodes", len(ends), hashlib.sha256(ends.astype("<u4").tobytes()).hexdigest())


def column(name, values):
    values = np.ascontiguousarray(values, dtype="<f4")
    print(name, hashlib.sha256(values.tobytes()).hexdigest(), repr(math.fsum(values.astype("f8"))))


state = root["data/state"][:]
for i, name in enumerate(["eef_x", "eef_y", "object_x", "object_y", "object_theta"]):
    column(name, state[:, i])
action = root["data/action"][:]
for i, name in enumerate(["action_x", "action_y"]):
    column(name, action[:, i])
column("contacts", root["data/n_contacts"][:, 0])
keypoint = root["data/keypoint"][:]
for i in range(keypoint.shape[1]):
    for j, axis in enumerate("xy"):
        column(f"keypoint_{i}_{axis}", keypoint[:, i, j])

images = hashlib.sha256()
for i in range(0, int(ends[-1]), 50):
    image = root["data/img"][i]
    assert (image == image.astype("u1")).all()
    images.update(np.ascontiguousarray(image, dtype="u1").tobytes())
print("images", images.hexdigest())
