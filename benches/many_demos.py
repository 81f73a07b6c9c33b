#!/usr/bin/env python3
"""Writes a made-up dataset of very many demonstrations, for measuring how the program scales.

    benches/many_demos.py SOURCE.hdf5 COUNT OUT [--frames N] [--files N] [--jobs N]
    re4-pipe audit pipelines/lift-audit.toml --set ingest.source=OUT --set ingest.conventions.eef_orientation=grip_site

SOURCE has demonstrations of robosuite's Lift in robomimic's layout. Demonstration k of the new dataset is a copy of demonstration
k modulo their number, changed in three ways: the whole scene is turned about the vertical by up to 0.3 rad and moved by up to 0.2 m,
and the arm starts up to 3 cm from where it did and reaches its recorded path within 16 frames. The actions are changed accordingly.
The first copies are changed, too, so no two demonstrations are alike. Demonstration k depends on SOURCE, k and --frames only, not on
COUNT. With --frames N, only the last N frames of each demonstration are used.

Without --files, OUT is one HDF5 file. With --files N, OUT is a folder of N files 00000.hdf5, 00001.hdf5, ..., each with the same number
of demonstrations (the first ones have one more if N does not divide COUNT), numbered through; --jobs writes several files at a time.
Memory does not grow with COUNT. Prints frames, bytes, seconds and peak memory. Needs h5py.
"""

import argparse
import multiprocessing
import os
import resource
import time

import h5py
import numpy as np

# Numbers are sampled for this many demonstrations at a time.
BLOCK = 1000
# Frames after which the arm is on its recorded path.
RAMP = 16
# Metres of commanded motion for an action of 1.
UNIT = 0.05
OBSERVATIONS = ["robot0_eef_pos", "robot0_eef_quat", "robot0_eef_vel_ang", "robot0_gripper_qpos", "object"]


def turned(quaternions, turn):
    """Quaternions (x, y, z, w) after a rotation by the quaternion `turn` = (0, 0, z, w) about the vertical."""
    z, w = turn
    x2, y2, z2, w2 = quaternions.T
    return np.stack([w * x2 - z * y2, w * y2 + z * x2, w * z2 + z * w2, w * w2 - z * z2], axis=1)


def changed(demo, angle, move, start):
    """The arrays of a demonstration after the three changes."""
    cos, sin = np.cos(angle), np.sin(angle)
    matrix = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    half = (np.sin(0.5 * angle), np.cos(0.5 * angle))
    frames = len(demo["actions"])
    # The offset of the arm falls to 0 along a cosine, whose derivative has no jump.
    phase = np.minimum(np.arange(frames + 1) / RAMP, 1.0)
    weight = 0.5 + 0.5 * np.cos(np.pi * phase)
    offset = weight[:-1, None] * start
    actions = demo["actions"].copy()
    actions[:, :3] = actions[:, :3] @ matrix.T + np.diff(weight)[:, None] * start / UNIT
    np.clip(actions[:, :3], -1.0, 1.0, out=actions[:, :3])
    actions[:, 3:6] = actions[:, 3:6] @ matrix.T
    eef = demo["robot0_eef_pos"] @ matrix.T + move + offset
    cube = demo["object"].copy()
    cube[:, :3] = cube[:, :3] @ matrix.T + move
    cube[:, 3:7] = turned(cube[:, 3:7], half)
    cube[:, 7:10] = cube[:, 7:10] @ matrix.T + np.sign(demo["sense"]) * offset
    return {
        "actions": actions,
        "rewards": demo["rewards"],
        "dones": demo["dones"],
        "robot0_eef_pos": eef,
        "robot0_eef_quat": turned(demo["robot0_eef_quat"], half),
        "robot0_eef_vel_ang": demo["robot0_eef_vel_ang"] @ matrix.T,
        "robot0_gripper_qpos": demo["robot0_gripper_qpos"],
        "object": cube,
    }


def read(path, frames):
    """The last frames of the demonstrations of SOURCE, and the attributes of its group `data`."""
    with h5py.File(path) as source:
        demos = []
        for group in source["data"].values():
            demo = {name: group[name][-frames:] for name in ["actions", "rewards", "dones"]}
            demo |= {name: group["obs"][name][-frames:] for name in OBSERVATIONS}
            # The last three numbers of `object` are either the arm's position relative to the cube, or the reverse.
            apart = demo["robot0_eef_pos"] - demo["object"][:, :3]
            demo["sense"] = np.sum(apart * demo["object"][:, 7:10])
            demos.append(demo)
        return demos, dict(source["data"].attrs)


class Numbers:
    """The random numbers of every demonstration, sampled in blocks."""

    def __init__(self):
        self.block = None

    def of(self, number):
        """Angle, move and offset of the start."""
        block, place = divmod(number, BLOCK)
        if self.block != block:
            self.block = block
            self.values = np.random.default_rng([7, block]).uniform(-1.0, 1.0, (BLOCK, 6))
        angle, x, y, *start = self.values[place]
        return 0.3 * angle, np.array([0.2 * x, 0.2 * y, 0.0]), 0.03 * np.array(start)


def write(task):
    """Writes one file with the demonstrations `first` to `end`; returns its frames."""
    source, frames, path, first, end = task
    demos, attributes = read(source, frames)
    numbers = Numbers()
    total = 0
    with h5py.File(path, "w", libver="earliest") as file:
        data = file.create_group("data")
        data.attrs.update({name: value for name, value in attributes.items() if name != "total"})
        kinds = {np.dtype(kind): h5py.h5t.py_create(np.dtype(kind)) for kind in ("f8", "i8")}
        scalar, count_kind = h5py.h5s.create(h5py.h5s.SCALAR), kinds[np.dtype("i8")]
        spaces = {}

        def put(group, name, values):
            shape = values.shape
            if shape not in spaces:
                spaces[shape] = h5py.h5s.create_simple(shape)
            values = np.ascontiguousarray(values)
            dataset = h5py.h5d.create(group, name.encode(), kinds[values.dtype], spaces[shape])
            dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, values)

        for number in range(first, end):
            demo = changed(demos[number % len(demos)], *numbers.of(number))
            group = h5py.h5g.create(data.id, f"demo_{number}".encode())
            frames = len(demo["actions"])
            attribute = h5py.h5a.create(group, b"num_samples", count_kind, scalar)
            attribute.write(np.array(frames, dtype="i8"))
            observations = h5py.h5g.create(group, b"obs")
            for name, values in demo.items():
                put(observations if name in OBSERVATIONS else group, name, values)
            total += frames
        data.attrs["total"] = total
    return total


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("source")
    parser.add_argument("count", type=int)
    parser.add_argument("out")
    parser.add_argument("--frames", type=int, default=0)
    parser.add_argument("--files", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    begin = time.perf_counter()
    files = arguments.files or 1
    if arguments.files:
        os.makedirs(arguments.out)
    bounds = [arguments.count // files * file + min(file, arguments.count % files) for file in range(files + 1)]
    paths = [os.path.join(arguments.out, f"{file:05}.hdf5") for file in range(files)]
    if not arguments.files:
        paths = [arguments.out]
    tasks = [(arguments.source, arguments.frames, path, *bounds[file : file + 2]) for file, path in enumerate(paths)]
    if arguments.jobs > 1:
        with multiprocessing.Pool(arguments.jobs) as pool:
            frames = sum(pool.imap(write, tasks))
    else:
        frames = sum(map(write, tasks))
    size = sum(os.path.getsize(path) for path in paths)
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    seconds = time.perf_counter() - begin
    print(
        f"{arguments.count} demonstrations, {frames} frames, {size / 1e9:.3f} GB in {len(paths)} file(s): "
        f"{seconds:.1f} s, peak memory {peak / 1024:.0f} MiB of one process"
    )


if __name__ == "__main__":
    main()
