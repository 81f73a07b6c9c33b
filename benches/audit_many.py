#!/usr/bin/env python3
"""Writes a made-up dataset of many demonstrations, for measuring the audit.

    benches/audit_many.py SOURCE.hdf5 COUNT OUT.hdf5
    /usr/bin/time -v re4-pipe segment pipelines/lift-audit.toml --jobs 1 --set ingest.source=OUT.hdf5 \
        --set ingest.conventions.eef_orientation=grip_site

Repeats the demonstrations of SOURCE (robomimic's layout, task Lift). From the second repetition on, each is moved horizontally by up to
20 cm, so that no two have the same path. Needs h5py.
"""

import sys

import h5py
import numpy as np

source, count, out = h5py.File(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
rng = np.random.default_rng(0)
arrays = ["actions", "rewards", "dones"]
arrays += [f"obs/robot0_{name}" for name in ("eef_pos", "eef_quat", "eef_vel_ang", "gripper_qpos")] + ["obs/object"]
demos = [{name: group[name][:] for name in arrays} for group in source["data"].values()]
with h5py.File(out, "w", libver="earliest") as file:
    data = file.create_group("data")
    data.attrs.update(source["data"].attrs)
    total = 0
    for number in range(count):
        demo = demos[number % len(demos)]
        offset = np.append(rng.uniform(-0.2, 0.2, 2), 0.0) if number >= len(demos) else np.zeros(3)
        group = data.create_group(f"demo_{number}")
        group.attrs["num_samples"] = len(demo["actions"])
        total += len(demo["actions"])
        for name, values in demo.items():
            moved = values.copy()
            if name in ("obs/robot0_eef_pos", "obs/object"):
                moved[:, :3] += offset
            group.create_dataset(name, data=moved)
    data.attrs["total"] = total
print(total, "frames")
