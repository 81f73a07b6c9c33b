"""Writes files in the layouts of MimicGen, LIBERO, robosuite 1.5 with composite controllers, and RoboCasa from demonstrations in
robomimic's layout, and mutated copies of them.

usage: make_relatives.py KIND SOURCE.hdf5 TARGET.hdf5 [--demos N] [--set NAME=VALUE ...] [--mutate NAME]
(needs h5py and numpy)

Layouts follow MimicGen's env_interfaces/robosuite.py, LIBERO's scripts/create_dataset.py, and robosuite 1.5's composite
controllers. Every kind has the numbers of the source, so that what is read can be compared with it:

mimicgen   the same numbers; datagen_info is computed from observations and actions; without rewards, dones, next_obs and /mask
libero     bodies renamed; observations are those after the action; the first 5 rows and the last one are dropped
composite  the world of every demonstration is rotated about the vertical, so actions in the frame of the base stay as they are
robocasa   the same, on a mobile base, with 12 columns of actions
twoarms    a humanoid of DexMimicGen
"""

import argparse
import json
import re

import h5py
import numpy as np

parser = argparse.ArgumentParser()
parser.add_argument("kind")
parser.add_argument("source")
parser.add_argument("target")
parser.add_argument("--demos", type=int, default=5)
parser.add_argument("--set", action="append", default=[])
parser.add_argument("--mutate")
arguments = parser.parse_args()
settings = dict(text.split("=", 1) for text in arguments.set)

STEP = np.array([0.05] * 3 + [0.5] * 3)


def matrices(quaternions):
    """Rotation matrices of quaternions x, y, z, w."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def multiplied(a, b):
    """Products of quaternions x, y, z, w."""
    ax, ay, az, aw = np.moveaxis(a, -1, 0)
    bx, by, bz, bw = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def rotations(vectors):
    """Rotation matrices of rotation vectors."""
    angles = np.linalg.norm(vectors, axis=1, keepdims=True)
    axes = np.divide(vectors, angles, out=np.zeros_like(vectors), where=angles > 0)
    return matrices(np.concatenate([axes * np.sin(angles / 2), np.cos(angles / 2)], axis=1))


def vectors(quaternions):
    """Rotation vectors of quaternions x, y, z, w, as robosuite's quat2axisangle."""
    w = np.clip(quaternions[:, 3:], -1, 1)
    length = np.sqrt(1 - w * w)
    unit = np.divide(quaternions[:, :3], length, out=np.zeros((len(w), 3)), where=length > 0)
    return unit * 2 * np.arccos(w)


def poses(positions, orientations):
    """Homogeneous matrices."""
    result = np.zeros((len(positions), 4, 4))
    result[:, :3, :3] = orientations
    result[:, :3, 3] = positions
    result[:, 3, 3] = 1
    return result


def site_orientations(demo):
    """Orientations of the grip site: the hand's, rotated by -90 degrees about its z."""
    rotation = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return matrices(demo["obs/robot0_eef_quat"][()]) @ rotation


def chosen(source):
    names = sorted((name for name in source["data"] if name.startswith("demo_")), key=lambda name: int(name[5:]))
    return names[: arguments.demos]


def body_position(model, name):
    found = re.search(rf'<body name="{name}" pos="([^"]*)"', model)
    return np.array([float(number) for number in found.group(1).split()])


def compressed(group, name, values):
    group.create_dataset(name, data=values, compression="gzip")


def mimicgen(source, target):
    name = settings.get("name", "square_nut")
    place = settings.get("target", "square_peg")
    data = target.create_group("data")
    env = json.loads(source["data"].attrs["env_args"])
    env["env_name"] = settings.get("env", "Square_D0")
    data.attrs["env_args"] = json.dumps(env, indent=4)
    total = 0
    for number, demo_name in enumerate(chosen(source)):
        old = source[f"data/{demo_name}"]
        frames = len(old["actions"])
        total += frames
        new = data.create_group(demo_name)
        new.attrs["num_samples"] = frames
        actions = old["actions"][()]
        new["actions"] = actions
        for name_ in ("states",):
            if name_ in old and "stateless" not in settings:
                new[name_] = old[name_][()]
        if "model_file" in old.attrs and "stateless" not in settings:
            new.attrs["model_file"] = old.attrs["model_file"]
        for key, values in old["obs"].items():
            if not (key == "object" and "objectless" in settings):
                compressed(new.require_group("obs"), key, values[()])
        positions, site = old["obs/robot0_eef_pos"][()], site_orientations(old)
        info = new.create_group("datagen_info")
        compressed(info, "eef_pose", poses(positions, site))
        motion = np.clip(actions[:, :6], -1, 1) * STEP
        compressed(info, "target_pose", poses(positions + motion[:, :3], rotations(motion[:, 3:]) @ site))
        compressed(info, "gripper_action", actions[:, 6:])
        pose = old["obs/object"][:, :7]
        objects = info.create_group("object_poses")
        compressed(objects, name, poses(pose[:, :3], matrices(pose[:, 3:])))
        peg = np.array([0.23, 0.1, 0.85]) + float(settings.get("spread", 0)) * np.array([number, -number, 0])
        compressed(objects, place, poses(np.tile(peg, (frames, 1)), np.tile(np.eye(3), (frames, 1, 1))))
        if "other" in settings:
            compressed(objects, settings["other"], poses(pose[:, :3] + 0.3, matrices(pose[:, 3:])))
        closed = np.maximum.accumulate(actions[:, 6] > 0).astype(int)
        compressed(info.create_group("subtask_term_signals"), "grasp", closed)
        new["src_demo_inds"] = np.zeros(2, int)
        new["src_demo_labels"] = np.zeros((frames, 1), int)
    data.attrs["total"] = total


BDDL = """(define (problem LIBERO_Tabletop_Manipulation)
  (:domain robosuite)
  (:language put the {moved} on the {place})
    (:regions
      (init_region (:target main_table) (:ranges ((-0.1 0.1 -0.1 0.2))))
    )
  (:fixtures
    main_table - table
  )
  (:objects
    {moved} - thing
    {place} - thing
  )
  (:obj_of_interest
    {moved}
    {place}
  )
  (:init
    (On {moved} main_table_init_region)
  )
  (:goal
    {goal}
  )
)
"""


def libero(source, target):
    moved, place = settings.get("moved", "black_bowl_1"), settings.get("target", "plate_1")
    old_moved, old_place = settings.get("from", "SquareNut"), settings.get("from_target", "peg1")
    data = target.create_group("data")
    env = json.loads(source["data"].attrs["env_args"])
    env["env_name"] = "Libero_Tabletop_Manipulation"
    env["problem_name"] = "libero_tabletop_manipulation"
    env["bddl_file"] = "chiliocosm/bddl_files/libero_goal/task.bddl"
    del env["env_version"]
    data.attrs["env_args"] = json.dumps(env)
    data.attrs["env_name"] = env["env_name"]
    problem = {"problem_name": "libero_tabletop_manipulation", "language_instruction": "put it there"}
    data.attrs["problem_info"] = json.dumps(problem)
    data.attrs["bddl_file_name"] = env["bddl_file"]
    goal = settings.get("goal", "(And (On {moved} {place}))").format(moved=moved, place=place)
    data.attrs["bddl_file_content"] = BDDL.format(moved=moved, place=place, goal=goal)
    data.attrs["macros_image_convention"] = settings.get("convention", "opengl")
    total = 0
    for demo_name in chosen(source):
        old = source[f"data/{demo_name}"]
        frames = len(old["actions"]) - 6
        before, after = slice(5, 5 + frames), slice(6, 6 + frames)
        if "current" in settings:
            after = before
        total += frames
        new = data.create_group(demo_name)
        new.attrs["num_samples"] = frames
        model = old.attrs["model_file"]
        for old_name, new_name in [(old_moved, moved), (old_place, place)]:
            model = model.replace(f'"{old_name}_main"', f'"{new_name}_main"').replace(f'"{old_name}"', f'"{new_name}_main"')
            model = model.replace(f'"{old_name}_joint0"', f'"{new_name}_joint0"')
        new.attrs["model_file"] = model
        new["states"], new["actions"] = old["states"][before], old["actions"][before]
        new.attrs["init_state"] = new["states"][0]
        last = np.zeros(frames, np.uint8)
        last[-1] = 1
        new["rewards"], new["dones"] = last, last
        obs = new.create_group("obs")
        eef, quaternion = old["obs/robot0_eef_pos"][after], old["obs/robot0_eef_quat"][after]
        fingers = old["obs/robot0_gripper_qpos"][after]
        obs["ee_pos"], obs["ee_ori"] = eef, vectors(quaternion)
        obs["ee_states"] = np.concatenate([eef, obs["ee_ori"]], axis=1)
        obs["gripper_states"] = fingers
        new["robot_states"] = np.concatenate([fingers, eef, quaternion], axis=1)
        if "images" in settings:
            # Row 0 of an upright image shows the number of the state, the others are dark.
            images = np.zeros((frames, 16, 16, 3), np.uint8)
            images[:, 0] = (np.arange(frames) + 1)[:, None, None] % 251
            if settings.get("convention", "opengl") == "opengl":
                images = images[:, ::-1]
            obs["agentview_rgb"], obs["eye_in_hand_rgb"] = images, images
    data.attrs["num_demos"] = arguments.demos
    data.attrs["total"] = total


def yaw(angle):
    """The quaternion x, y, z, w of a rotation about the vertical."""
    return np.array([0, 0, np.sin(angle / 2), np.cos(angle / 2)])


def rotated(pose, angle):
    """Poses (position, quaternion x, y, z, w) in a world that is rotated about the vertical."""
    rotation = matrices(yaw(angle)[None])[0]
    quaternions = multiplied(np.broadcast_to(yaw(angle), pose[:, 3:].shape), pose[:, 3:])
    return np.concatenate([pose[:, :3] @ rotation.T, quaternions], axis=1)


def numbers(values):
    return " ".join(f"{value:.17g}" for value in values)


def rotated_states(states, objects, angle, inserted):
    """States of the rotated world; `objects` are the addresses of free joints in qpos, `inserted` the joints before the arm."""
    states = states.copy()
    for address in objects:
        columns = slice(1 + address, 8 + address)
        pose = states[:, columns][:, [0, 1, 2, 4, 5, 6, 3]]
        states[:, columns] = rotated(pose, angle)[:, [0, 1, 2, 6, 3, 4, 5]]
    velocities = 1 + settings_qpos(states.shape[1], len(objects))
    zeros = np.zeros((len(states), inserted))
    parts = [states[:, :1], zeros, states[:, 1:velocities], zeros, states[:, velocities:]]
    return np.concatenate(parts, axis=1)


def settings_qpos(width, free):
    """Length of qpos of a state with `width` numbers: each free joint has one more position than velocities."""
    return (width - 1 + free) // 2


def free_joints(model):
    """Names of the free joints in the order of qpos."""
    return re.findall(r'<joint name="([^"]*)" type="free"', model)


MOBILE = """<body name="mobilebase0_base" pos="{place}" quat="{rotation}">
      <joint name="mobilebase0_joint_mobile_forward" type="slide" axis="1 0 0"/>
      <joint name="mobilebase0_joint_mobile_side" type="slide" axis="0 1 0"/>
      <joint name="mobilebase0_joint_mobile_yaw" type="hinge" axis="0 0 1"/>
      <body name="mobilebase0_support"><joint name="mobilebase0_joint_torso_height" type="slide" axis="0 0 1"/>
    <body name="robot0_base"><site name="robot0_right_center"/>"""


def rotated_model(model, angle, mobile):
    """The model of robosuite 1.5 for the rotated world."""
    found = re.search(r'<body name="robot0_base" pos="([^"]*)">', model)
    position = np.array([float(number) for number in found.group(1).split()])
    x, y, z, w = yaw(angle)
    place = numbers(rotated(np.concatenate([position, [0, 0, 0, 1]])[None], angle)[0, :3])
    quaternion = numbers([w, x, y, z])
    if mobile:
        text = MOBILE.format(place=place, rotation=quaternion)
        end = model.index("</worldbody>")
        # The base is the last child of the world before the objects; its end follows from the nesting.
        start, depth, at = found.start(), 0, found.start()
        for tag in re.finditer(r"<body\b[^>]*?(/?)>|</body>", model[start:end]):
            if tag.group().startswith("</"):
                depth -= 1
            elif tag.group(1) != "/":
                depth += 1
            if depth == 0:
                at = start + tag.end()
                break
        model = model[:at] + "</body></body>" + model[at:]
    else:
        text = f'<body name="robot0_base" pos="{place}" quat="{quaternion}"><site name="robot0_right_center"/>'
    model = model.replace(found.group(), text)
    for old, new in [("gripper0_grip_site", "gripper0_right_grip_site"), ("gripper0_finger", "gripper0_right_finger")]:
        model = model.replace(f'"{old}', f'"{new}')
    return model


def composite(source, target, mobile=False):
    data = target.create_group("data")
    env = json.loads(source["data"].attrs["env_args"])
    env["env_version"] = "1.5.1"
    arm = env["env_kwargs"]["controller_configs"]
    arm["input_type"] = "delta"
    arm["input_ref_frame"] = settings.get("frame", "base")
    arm["gripper"] = {"type": "GRIP"}
    del arm["control_delta"]
    parts = {"right": arm}
    if mobile:
        parts["base"] = {"type": "JOINT_VELOCITY", "interpolation": "null"}
        env["env_name"] = settings.get("env", "PnPCounterToCab")
        env["env_kwargs"]["robots"] = "PandaOmron"
    kind = "HYBRID_MOBILE_BASE" if mobile else "BASIC"
    env["env_kwargs"]["controller_configs"] = {"type": kind, "body_parts": parts}
    data.attrs["env_args"] = json.dumps(env)
    total = 0
    for number, demo_name in enumerate(chosen(source)):
        old = source[f"data/{demo_name}"]
        frames = len(old["actions"])
        total += frames
        angle = float(settings.get("yaw", 1.1)) + (0.9 * number if mobile else 0)
        model = old.attrs["model_file"]
        free = free_joints(model)
        width = old["states"].shape[1]
        first = settings_qpos(width, len(free)) - 7 * len(free)
        addresses = [first + 7 * place for place in range(len(free))]
        new = data.create_group(demo_name)
        new.attrs["num_samples"] = frames
        model = rotated_model(model, angle, mobile)
        if mobile:
            body = settings.get("from", "SquareNut")
            model = model.replace(f'"{body}_main"', '"obj_main"').replace(f'"{body}_joint0"', '"obj_joint0"')
            new.attrs["ep_meta"] = json.dumps({"lang": "pick it up", "layout_id": 1, "style_id": 2, "object_cfgs": []})
        new.attrs["model_file"] = model
        new["states"] = rotated_states(old["states"][()], addresses, angle, 4 if mobile else 0)
        actions = old["actions"][()]
        if settings.get("actions") == "world":
            rotation = matrices(yaw(angle)[None])[0]
            actions = np.concatenate([actions[:, :3] @ rotation.T, actions[:, 3:6] @ rotation.T, actions[:, 6:]], axis=1)
        if mobile:
            base = np.zeros((frames, 5))
            base[:, 4] = -1
            if "driving" in settings and number == 1:
                base[3:9, 4] = 1
            actions = np.concatenate([actions, base], axis=1)
        new["actions"] = actions
        new["rewards"], new["dones"] = old["rewards"][()], old["dones"][()]
        obs = new.create_group("obs")
        eef = np.concatenate([old["obs/robot0_eef_pos"][()], old["obs/robot0_eef_quat"][()]], axis=1)
        eef = rotated(eef, angle)
        obs["robot0_eef_pos"], obs["robot0_eef_quat"] = eef[:, :3], eef[:, 3:]
        obs["robot0_gripper_qpos"] = old["obs/robot0_gripper_qpos"][()]
        thing = old["obs/object"][()]
        pose = rotated(thing[:, :7], angle)
        if mobile:
            obs["obj_pos"], obs["obj_quat"] = pose[:, :3], pose[:, 3:]
            obs["object"] = np.concatenate([pose, np.zeros((frames, 21))], axis=1)
            obs["robot0_base_pos"] = np.zeros((frames, 3))
            obs["robot0_base_quat"] = np.tile(yaw(angle), (frames, 1))
        else:
            # The relative part comes first in robosuite 1.5.
            obs["object"] = np.concatenate([thing[:, 7:], pose], axis=1)
    data.attrs["total"] = total
    if mobile:
        names = chosen(source)
        target["mask/train"] = np.array(names[1:], dtype="S8")


def robocasa(source, target):
    composite(source, target, mobile=True)


def twoarms(source, target):
    data = target.create_group("data")
    env = json.loads(source["data"].attrs["env_args"])
    env["env_version"] = "1.5.1"
    env["env_name"] = settings.get("env", "TwoArmCoffee")
    env["env_kwargs"]["robots"] = ["GR1ArmsOnly"]
    data.attrs["env_args"] = json.dumps(env)
    for demo_name in chosen(source):
        old = source[f"data/{demo_name}"]
        frames = len(old["actions"])
        new = data.create_group(demo_name)
        new.attrs["num_samples"] = frames
        new["actions"] = np.zeros((frames, 24))
        for side in ("right", "left"):
            new[f"obs/robot0_{side}_eef_pos"] = old["obs/robot0_eef_pos"][()]
            new[f"obs/robot0_{side}_eef_quat"] = old["obs/robot0_eef_quat"][()]
            new[f"action_dict/{side}_rel_pos"] = old["actions"][:, :3]


def replaced(file, path, change):
    values = change(file[path][()])
    del file[path]
    file[path] = values


def changed(place, value):
    def change(values):
        values = values.copy()
        values[place] = value
        return values

    return change


MUTATIONS = {
    "object_nan": lambda f: replaced(f, "data/demo_1/datagen_info/object_poses/square_nut", changed((7, 1, 2), np.nan)),
    "object_sheared": lambda f: replaced(f, "data/demo_1/datagen_info/object_poses/square_nut", changed((7, 0, 0), 2.0)),
    "object_short": lambda f: replaced(f, "data/demo_1/datagen_info/object_poses/square_nut", lambda v: v[:-3]),
    "object_flat": lambda f: replaced(f, "data/demo_1/datagen_info/object_poses/square_nut", lambda v: v.reshape(len(v), 16)),
    "object_text": lambda f: replaced(f, "data/demo_1/datagen_info/object_poses/square_nut", lambda v: "poses"),
    "object_missing": lambda f: f.__delitem__("data/demo_1/datagen_info/object_poses/square_nut"),
    "object_moved": lambda f: replaced(f, "data/demo_1/datagen_info/object_poses/square_nut", changed((slice(20, None), 0, 3), 0.5)),
    "object_names_swapped": lambda f: [
        f.move(f"data/{demo}/datagen_info/object_poses/square_peg", f"data/{demo}/datagen_info/object_poses/x")
        or f.move(f"data/{demo}/datagen_info/object_poses/square_nut", f"data/{demo}/datagen_info/object_poses/square_peg")
        or f.move(f"data/{demo}/datagen_info/object_poses/x", f"data/{demo}/datagen_info/object_poses/square_nut")
        for demo in f["data"]
    ],
    "eef_transposed": lambda f: [
        replaced(f, f"data/{demo}/datagen_info/eef_pose", lambda v: np.swapaxes(v, 1, 2)) for demo in f["data"]
    ],
    "eef_elsewhere": lambda f: [
        replaced(f, f"data/{demo}/datagen_info/eef_pose", lambda v: v + np.eye(4)[0][:, None] @ np.eye(4)[3][None] * 0.56)
        for demo in f["data"]
    ],
    "target_shifted": lambda f: replaced(f, "data/demo_1/datagen_info/target_pose", lambda v: np.roll(v, 5, axis=0)),
    "gripper_flipped": lambda f: replaced(f, "data/demo_1/datagen_info/gripper_action", lambda v: -v),
    "group_is_dataset": lambda f: f.__delitem__("data/demo_1/datagen_info")
    or f["data/demo_1"].create_dataset("datagen_info", data=np.zeros(3)),
    "late_nan": lambda f: replaced(f, "data/demo_1/obs/ee_pos", changed((4, 0), np.inf)),
    "late_short": lambda f: replaced(f, "data/demo_1/obs/ee_pos", lambda v: v[:-1]),
    "late_elsewhere": lambda f: replaced(f, "data/demo_1/obs/ee_pos", lambda v: v + [0.66, 0, 0]),
    "late_early": lambda f: replaced(f, "data/demo_1/obs/ee_pos", lambda v: np.concatenate([v[:1], v[:-1]])),
    "bddl_cut": lambda f: f["data"].attrs.__setitem__("bddl_file_content", f["data"].attrs["bddl_file_content"][:200]),
    "no_states": lambda f: f.__delitem__("data/demo_1/states"),
    "no_models": lambda f: [f[f"data/{demo}"].attrs.__delitem__("model_file") for demo in f["data"]],
    "actions_13": lambda f: [
        replaced(f, f"data/{demo}/actions", lambda v: np.concatenate([v, v[:, :1]], axis=1)) for demo in f["data"]
    ],
    "states_short": lambda f: replaced(f, "data/demo_1/states", lambda v: v[:, :-2]),
}

with h5py.File(arguments.source) as source, h5py.File(arguments.target, "w") as target:
    globals()[arguments.kind](source, target)
    if arguments.mutate:
        MUTATIONS[arguments.mutate](target)
