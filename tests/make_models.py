"""Writes HDF5 files of robosuite demonstrations, each with one error in the states or models from which images are rendered.

usage: make_models.py LOW_DIM.hdf5 FOLDER   (needs h5py; the source has states and model_file)
"""

import sys
from pathlib import Path

import h5py

source, folder = sys.argv[1], Path(sys.argv[2])
DEMOS = ["demo_0", "demo_1", "demo_2"]


def write(name, change):
    """Writes a copy of the first demonstrations. `change` gets the group of demo_1."""
    with h5py.File(source) as file, h5py.File(folder / f"{name}.hdf5", "w") as target:
        data = target.create_group("data")
        for demo in DEMOS:
            file.copy(f"data/{demo}", data)
        data.attrs["env_args"] = file["data"].attrs["env_args"]
        data.attrs["total"] = sum(data[demo].attrs["num_samples"] for demo in DEMOS)
        change(data["demo_1"])


def model(old, new):
    def change(demo):
        text = demo.attrs["model_file"]
        assert old in text
        demo.attrs["model_file"] = text.replace(old, new, 1)

    return change


def wide_states(demo):
    states = demo["states"][()]
    del demo["states"]
    demo["states"] = states[:, :-1]


def of_old_robosuite(demo):
    args = demo.parent.attrs["env_args"]
    demo.parent.attrs["env_args"] = args.replace('"1.4.1"', '"1.2.0"')


folder.mkdir(parents=True, exist_ok=True)
write("foreign_asset", model("/robosuite/robosuite/models/", "/suite/models/"))
write("includes_a_file", model("<worldbody>", '<include file="x.xml"/><worldbody>'))
write("missing_asset", model("red-wood.png", "blue-wood.png"))
write("narrow_states", wide_states)
write("no_model", lambda demo: demo.attrs.__delitem__("model_file"))
write("no_states", lambda demo: demo.__delitem__("states"))
write("of_old_robosuite", of_old_robosuite)
write("other_camera", model('camera name="agentview"', 'camera name="behind"'))
write("refused_by_mujoco", model('reflectance="0.01"', 'reflectance="much"'))
