"""Unpacks the files of a wheel that simulations need.

    python3 scripts/unpack_simulator.py WHEEL FOLDER

From a wheel of `mujoco`: `libmujoco.so` and `include/`. From a wheel of `robosuite`: the files below `models/assets/` to which the
scenes of Lift, Can and Square with the Panda arm refer. Also unpacks the licences of the wheel. Runs on Python 3.7 and newer,
without any package.
"""

import fnmatch
import pathlib
import shutil
import sys
import zipfile

# The files to which the three scenes refer, below `robosuite/models/assets/`.
ASSETS = [
    "grippers/meshes/panda_gripper/finger.stl",
    "grippers/meshes/panda_gripper/finger_longer.stl",
    "grippers/meshes/panda_gripper/finger_vis.stl",
    "grippers/meshes/panda_gripper/hand.stl",
    "grippers/meshes/panda_gripper/hand_vis.stl",
    "mounts/meshes/rethink_mount/pedestal.stl",
    "objects/meshes/bread.stl",
    "objects/meshes/can.msh",
    "objects/meshes/can.stl",
    "objects/meshes/cereal.msh",
    "objects/meshes/cereal.stl",
    "objects/meshes/milk.msh",
    "objects/meshes/milk.stl",
    "robots/panda/meshes/link[0-7].stl",
    "robots/panda/obj_meshes/link[0-7]_vis/link[0-7]_vis*.obj",
    "textures/brass-ambra.png",
    "textures/bread.png",
    "textures/ceramic.png",
    "textures/cereal.png",
    "textures/dark-wood.png",
    "textures/light-gray-floor-tile.png",
    "textures/light-gray-plaster.png",
    "textures/light-wood.png",
    "textures/red-wood.png",
    "textures/soda.png",
    "textures/steel-brushed.png",
    "textures/steel-scratched.png",
    "textures/wood-tiles.png",
]
# Scenes refer to textures as `arenas/../textures/…`. The system resolves such a path only if the folder before `..` exists.
EMPTY_FOLDERS = ["arenas"]
# robosuite 1.5 has the same mesh in another folder. All other files of its three scenes equal those of 1.4.1, except for comments
# in the arm's `.obj` files.
COPIES = {"mounts/meshes/rethink_mount/pedestal.stl": "bases/meshes/rethink_mount/pedestal.stl"}


def target_of(name):
    """The target path of the wheel's file `name`, or None if it is not needed."""
    parts = name.split("/")
    if parts[0].endswith(".dist-info"):
        return parts[-1] if parts[-1].startswith("LICENSE") else None
    if parts[0] == "mujoco":
        if name.startswith("mujoco/libmujoco.so."):
            return "libmujoco.so"
        return "/".join(parts[1:]) if name.startswith("mujoco/include/") else None
    prefix = "robosuite/models/assets/"
    asset = name[len(prefix) :] if name.startswith(prefix) else ""
    wanted = any(fnmatch.fnmatchcase(asset, pattern) for pattern in ASSETS)
    return f"models/assets/{asset}" if wanted else None


def main(wheel, folder):
    folder = pathlib.Path(folder)
    unpacked = 0
    with zipfile.ZipFile(wheel) as archive:
        for name in archive.namelist():
            target = target_of(name)
            if target is None or name.endswith("/"):
                continue
            path = folder / target
            path.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(name) as source, open(path, "wb") as copy:
                shutil.copyfileobj(source, copy)
            unpacked += 1
    assets = folder / "models" / "assets"
    if assets.is_dir():
        for empty in EMPTY_FOLDERS:
            (assets / empty).mkdir()
        for source, copy in COPIES.items():
            (assets / copy).parent.mkdir(parents=True)
            shutil.copyfile(assets / source, assets / copy)
    if unpacked == 0:
        sys.exit(f"unpack_simulator: {wheel} contains none of the needed files")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
