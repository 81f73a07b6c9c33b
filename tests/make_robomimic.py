"""Writes HDF5 files with one error each, and files with images, from the first demonstrations of data/can-sample.hdf5.

usage: make_robomimic.py SAMPLE.hdf5 FOLDER   (needs h5py and numpy)
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np

sample, folder = sys.argv[1], Path(sys.argv[2])
DEMOS = ["demo_0", "demo_1", "demo_2"]


def copy(name):
    """A copy of the first demonstrations, open for changes."""
    target = h5py.File(folder / f"{name}.hdf5", "w")
    with h5py.File(sample) as source:
        data = target.create_group("data")
        for demo in DEMOS:
            source.copy(f"data/{demo}", data)
        data.attrs["env_args"] = source["data"].attrs["env_args"]
        data.attrs["total"] = sum(source[f"data/{demo}"].attrs["num_samples"] for demo in DEMOS)
    target["mask/train"] = np.array(DEMOS[:2], dtype="S8")
    target["mask/valid"] = np.array(DEMOS[2:], dtype="S8")
    return target


def replace(file, path, values, **how):
    del file[path]
    file.create_dataset(path, data=values, **how)


def fault(change):
    with copy(change.__name__) as file:
        change(file)


def compressed(file):
    for demo in DEMOS:
        for path in ["actions", "obs/object", "obs/robot0_eef_pos", "dones"]:
            values = file[f"data/{demo}/{path}"][()]
            replace(file, f"data/{demo}/{path}", values, compression="gzip", shuffle=True)


def single_precision(file):
    for demo in DEMOS:
        replace(file, f"data/{demo}/actions", file[f"data/{demo}/actions"][()].astype(np.float32))


def big_endian(file):
    replace(file, "data/demo_1/actions", file["data/demo_1/actions"][()].astype(">f8"))


def integer_and_bool_flags(file):
    replace(file, "data/demo_0/dones", file["data/demo_0/dones"][()].astype(bool))
    replace(file, "data/demo_1/dones", file["data/demo_1/dones"][()].astype(np.uint8))
    replace(file, "data/demo_2/rewards", file["data/demo_2/rewards"][()].astype(np.int32))


def negative_zeros(file):
    for demo in DEMOS:
        rewards = file[f"data/{demo}/rewards"]
        rewards[...] = np.where(rewards[()] == 0.0, -0.0, rewards[()])


def duplicate(file):
    del file["data/demo_2"]
    file.copy("data/demo_0", "data/demo_2")
    file["data"].attrs["total"] = sum(file[f"data/{demo}"].attrs["num_samples"] for demo in DEMOS)


def no_env_args(file):
    del file["data"].attrs["env_args"]


def env_args_no_json(file):
    file["data"].attrs["env_args"] = "{robosuite}"


def other_task(file):
    args = json.loads(file["data"].attrs["env_args"])
    file["data"].attrs["env_args"] = json.dumps({**args, "env_name": "Lift"})


def two_robots(file):
    args = json.loads(file["data"].attrs["env_args"])
    args["env_kwargs"]["robots"] = ["Panda", "Panda"]
    file["data"].attrs["env_args"] = json.dumps(args)


def nan_actions(file):
    file["data/demo_1/actions"][10:13, 2] = np.nan


def infinite_reward(file):
    file["data/demo_1/rewards"][3] = np.inf


def actions_out_of_range(file):
    file["data/demo_1/actions"][5, 0] = 1.7


def short_actions(file):
    replace(file, "data/demo_1/actions", file["data/demo_1/actions"][()][:-5])


def wrong_num_samples(file):
    file["data/demo_1"].attrs["num_samples"] += 7


def wrong_total(file):
    file["data"].attrs["total"] += 1


def empty_demo(file):
    del file["data/demo_1"]
    file.create_group("data/demo_1")


def no_frames(file):
    for path in ["actions", "rewards", "dones"] + [f"obs/{name}" for name in file["data/demo_1/obs"]]:
        replace(file, f"data/demo_1/{path}", file[f"data/demo_1/{path}"][()][:0])


def narrow_object(file):
    for demo in DEMOS:
        replace(file, f"data/{demo}/obs/object", file[f"data/{demo}/obs/object"][()][:, :13])


def no_eef(file):
    del file["data/demo_2/obs/robot0_eef_pos"]


def no_object(file):
    for demo in DEMOS:
        del file[f"data/{demo}/obs/object"]


def text_actions(file):
    replace(file, "data/demo_0/actions", file["data/demo_0/actions"][()].astype("S24"))


def six_actions(file):
    replace(file, "data/demo_0/actions", file["data/demo_0/actions"][()][:, :6])


def quaternion_too_long(file):
    file["data/demo_1/obs/robot0_eef_quat"][...] *= 1.3


def object_quaternion_too_short(file):
    file["data/demo_2/obs/object"][20, 3:7] *= 0.5


def permuted_layout(file):
    for demo in DEMOS:
        rows = file[f"data/{demo}/obs/object"]
        rows[...] = rows[()][:, [7, 8, 9, 10, 11, 12, 13, 0, 1, 2, 3, 4, 5, 6]]


def scalar_part_first(file):
    for demo in DEMOS:
        rows = file[f"data/{demo}/obs/robot0_eef_quat"]
        rows[...] = rows[()][:, [3, 0, 1, 2]]


def other_gripper_sign(file):
    for demo in DEMOS:
        file[f"data/{demo}/actions"][:, 6] *= -1


def flag_of_two(file):
    file["data/demo_0/dones"][4] = 2


def filter_of_nobody(file):
    replace(file, "mask/train", np.array(["demo_0", "demo_77"], dtype="S8"))


def a_group_for_a_dataset(file):
    del file["data/demo_0/actions"]
    file.create_group("data/demo_0/actions")


def a_link_to_another_file(file):
    del file["data/demo_1"]
    file["data/demo_1"] = h5py.ExternalLink("compressed.hdf5", "data/demo_1")


def numbers_in_another_file(file):
    values = file["data/demo_1/rewards"][()]
    raw = str(folder.parent / "rewards.bin")
    replace(file, "data/demo_1/rewards", values, external=[(raw, 0, values.nbytes)])


def a_virtual_dataset(file):
    length = len(file["data/demo_1/rewards"])
    del file["data/demo_1/rewards"]
    layout = h5py.VirtualLayout(shape=(length,), dtype=np.float64)
    layout[:] = h5py.VirtualSource("compressed.hdf5", "data/demo_1/rewards", shape=(length,))
    file["data/demo_1"].create_virtual_dataset("rewards", layout)


def a_name_of_two_lines(file):
    file.move("data/demo_1", "data/demo_1\nand more")


def no_data(file):
    del file["data"]


def images(file, shape=(12, 16, 3), dtype=np.uint8, **how):
    noise = np.random.default_rng(7)
    for demo in DEMOS:
        frames = file[f"data/{demo}"].attrs["num_samples"]
        for camera in ["agentview", "robot0_eye_in_hand"]:
            values = noise.integers(0, 256, (frames, *shape)).astype(dtype)
            file.create_dataset(f"data/{demo}/obs/{camera}_image", data=values, **how)


def images_contiguous(file):
    images(file)


def images_chunked(file):
    images(file, chunks=(7, 5, 9, 2), compression="gzip")


def images_grey(file):
    images(file, shape=(12, 16, 1))


def images_float(file):
    images(file, dtype=np.float32)


def main():
    folder.mkdir(parents=True, exist_ok=True)
    for change in [value for name, value in globals().items() if callable(value) and name not in OWN]:
        fault(change)
    whole = (folder / "compressed.hdf5").read_bytes()
    (folder / "cut_off.hdf5").write_bytes(whole[: len(whole) * 6 // 10])
    (folder / "text.hdf5").write_text("robomimic\n")
    (folder / "nothing.hdf5").write_bytes(b"")
    (folder / "folder.hdf5").mkdir(exist_ok=True)


OWN = {"copy", "replace", "fault", "main", "images", "Path", "OWN"}
main()
