"""Uses robosuite to make the references against which the native simulation of its tasks is tested.

Each pair of versions needs its own virtual environment:

    python3 -m venv rs14 && rs14/bin/pip install robosuite==1.4.1 mujoco==2.3.7 'numpy<2' h5py
    python3 -m venv rs15 && rs15/bin/pip install robosuite==1.5.1 mujoco==3.2.7 'numpy<2' h5py

The committed files come from these commands (OUT is crates/re4-sim/tests/data/robosuite, DATA has the folders lift, can
and square with low_dim.hdf5 and low_dim_abs.hdf5):

    rs14/bin/python tests/robosuite_reference.py trace OUT          # and with rs15
    rs14/bin/python tests/robosuite_reference.py placement OUT      # and with rs15
    rs14/bin/python tests/robosuite_reference.py states OUT DATA
    rs14/bin/python tests/robosuite_reference.py replay OUT DATA

A new task gets one file, with a trace, initial states of seeds and success verdicts. NAME is the name in pipeline files; GRASP is
the grasp position in the object's frame and the distance that the object falls after its reset; INSIDE is a position of the
object at which the task succeeds. All are in metres:

    rs14/bin/python tests/robosuite_reference.py task OUT NAME ENVIRONMENT OBJECT GRASP INSIDE

`crates/re4-sim/tests/data/robosuite/README.md` describes the files.
"""

import gzip
import hashlib
import json
import logging
import os
import pathlib
import re
import struct
import sys
import time
import warnings
import xml.etree.ElementTree as ElementTree

# One thread: several do not help with matrices of 7 x 7, and are slow on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
warnings.filterwarnings("ignore")
logging.disable(logging.CRITICAL)

import mujoco  # noqa: E402
import numpy as np  # noqa: E402
import robosuite  # noqa: E402

TASKS = {"lift": "Lift", "can": "PickPlaceCan", "square": "NutAssemblySquare"}
OBJECT = {"lift": ("cube_joint0", "cube_main"), "can": ("Can_joint0", "Can_main"), "square": ("SquareNut_joint0", "SquareNut_main")}
# Grasp position in the object's frame, and the distance that the object falls after its reset, in metres.
GRASP = {"square": [0.054, 0, 0, 0.06]}
ASSETS = os.path.dirname(robosuite.__file__)
OLD = robosuite.__version__.startswith("1.4")
POLICY_STEPS = 60
SUBSTEPS = 25


def make(task, control):
    """An environment without cameras; `control` is "delta" or "absolute"."""
    part = {
        "type": "OSC_POSE",
        "input_max": 1,
        "input_min": -1,
        "output_max": [0.05, 0.05, 0.05, 0.5, 0.5, 0.5],
        "output_min": [-0.05, -0.05, -0.05, -0.5, -0.5, -0.5],
        "kp": 150,
        "impedance_mode": "fixed",
        "kp_limits": [0, 300],
        "position_limits": None,
        "orientation_limits": None,
        "uncouple_pos_ori": True,
        "interpolation": None,
        "ramp_ratio": 0.2,
    }
    if OLD:
        part.update(damping=1, damping_limits=[0, 10], control_delta=control == "delta")
        controller = part
    else:
        part.update(damping_ratio=1, damping_ratio_limits=[0, 10], input_type=control)
        part.update(input_ref_frame="base" if control == "delta" else "world", gripper={"type": "GRIP"})
        controller = {"type": "BASIC", "body_parts": {"right": part}}
    env = robosuite.make(
        TASKS[task],
        robots="Panda",
        controller_configs=controller,
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        use_object_obs=True,
        ignore_done=True,
        control_freq=20,
        reward_shaping=False,
    )
    return env, part


def controller_of(env):
    robot = env.robots[0]
    return robot.controller if OLD else robot.part_controllers["right"]


def with_own_assets(xml):
    """Replaces asset paths, up to the last path element `robosuite`, by those of this robosuite."""
    return re.sub(r'file="(?:[^"]*/)?robosuite/', f'file="{ASSETS}/', xml)


def with_relative_assets(xml):
    return re.sub(r'file="[^"]*/robosuite/', 'file="robosuite/', xml)


def set_state(env, state):
    env.sim.set_state_from_flattened(state)
    env.sim.forward()


def observation(observations):
    names = ["robot0_eef_pos", "robot0_eef_quat", "robot0_gripper_qpos", "object"]
    values = [observations["object-state" if name == "object" else name] for name in names]
    if not OLD:
        names.append("robot0_eef_quat_site")
        values.append(observations["robot0_eef_quat_site"])
    return dict(zip(names, [np.array(value, dtype=float) for value in values]))


def write(path, header, arrays):
    """Writes one line of JSON and the arrays, compressed. The file is written atomically."""
    names = {"float64": "f64", "uint8": "u8", "uint32": "u32"}
    offset, described, raw = 0, [], []
    for name, array in arrays.items():
        array = np.ascontiguousarray(array)
        if array.dtype == bool:
            array = array.astype(np.uint8)
        data = array.astype(array.dtype.newbyteorder("<")).tobytes()
        described.append({"name": name, "dtype": names[array.dtype.name], "shape": list(array.shape), "offset": offset})
        offset += len(data)
        raw.append(data)
    header = dict(header, robosuite=robosuite.__version__, mujoco=mujoco.__version__, arrays=described)
    content = json.dumps(header).encode() + b"\n" + b"".join(raw)
    temporary = path.with_suffix(".tmp")
    # Without a time stamp, so that the same run gives the same bytes.
    temporary.write_bytes(gzip.compress(content, 9, mtime=0))
    temporary.rename(path)
    print(path, path.stat().st_size, flush=True)


def read(path):
    content = gzip.decompress(path.read_bytes())
    line, data = content.split(b"\n", 1)
    header = json.loads(line)
    arrays = {}
    for array in header.pop("arrays"):
        dtype = {"f64": "<f8", "u8": "u1", "u32": "<u4"}[array["dtype"]]
        count = int(np.prod(array["shape"]))
        arrays[array["name"]] = np.frombuffer(data, dtype, count, array["offset"]).reshape(array["shape"]).copy()
    return header, arrays


# ---------------------------------------------------------------------------------------------------------------- traces


def axis_angle(matrix):
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(matrix).ravel())
    vector = np.zeros(3)
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector


def rotation_matrix(axis, angle):
    matrix, quaternion = np.zeros(9), np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, np.array(axis, dtype=float), angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def scripted_action(control, step, site, orientation, start, grasp):
    """Moves above the object, down to it, closes and lifts. The end effector rotates on the way, in delta mode only in some steps."""
    over = grasp + [0, 0, 0.1]
    if step < 24:
        goal = start + (over - start) * min(1.0, (step + 1) / 20)
    elif step < 44:
        goal = over + (grasp - over) * min(1.0, (step - 23) / 16)
    elif step < 50:
        goal = grasp
    else:
        goal = grasp + [0, 0, 0.012 * (step - 49)]
    gripper = -1.0 if step < 44 else 1.0
    if control == "absolute":
        phase = min(1.0, step / 30)
        rotation = rotation_matrix([0, 0, 1], 0.5 * phase) @ rotation_matrix([1, 0, 0], 0.08 * np.sin(0.2 * step)) @ orientation
        return np.concatenate([goal, axis_angle(rotation), [gripper]])
    # Includes values above 1, which the controller clips, and steps without rotation, in which 1.4 keeps its goal orientation.
    move = (goal - site) / 0.05
    angles = np.array([0.05 * np.sin(0.3 * step), 0.0, 0.15]) if step % 7 < 4 and step < 40 else np.zeros(3)
    return np.concatenate([move, angles, [gripper]])


def robot_touches(env):
    """Whether a body of the robot is in contact in the last simulation step."""
    model, data = env.sim.model._model, env.sim.data._data
    bodies = {model.geom_bodyid[geom] for contact in data.contact[: data.ncon] for geom in (contact.geom1, contact.geom2)}
    return any(model.body(body).name.startswith(("robot0", "gripper0")) for body in bodies)


def trace(task, control, out):
    header, arrays, _ = traced(task, control)
    write(out / f"trace_{task}_{robosuite.__version__}_{control}.bin.gz", header, arrays)


def traced(task, control):
    """Header and arrays of a trace, and the environment after it."""
    env, part = make(task, control)
    np.random.seed(11)
    env.reset()
    state = env.sim.get_state().flatten()
    xml = with_relative_assets(env.sim.model.get_xml())
    # Both simulations use the XML file, whose numbers have six digits, and not robosuite's model in memory.
    env.reset_from_xml_string(with_own_assets(xml))
    set_state(env, state)
    controller = controller_of(env)
    controller.update(force=True)
    data, names = env.sim.data, env.sim.model
    grip = names.site_name2id("gripper0_grip_site" if OLD else "gripper0_right_grip_site")
    site = lambda: np.array(data.site_xpos[grip])  # noqa: E731
    orientation = np.array(data.site_xmat[grip]).reshape(3, 3)
    body = names.body_name2id(OBJECT[task][1])
    start, target = site(), np.array(data.body_xpos[body])
    *handle, fall = GRASP.get(task, [0, 0, 0, 0])
    grasp = target + (np.array(data.body_xmat[body]).reshape(3, 3) @ handle - [0, 0, fall])

    warmstart = np.array(data._data.qacc_warmstart)
    rows = {"ctrl": [], "forwards": []}
    unclipped = 0.0
    first_contact = None
    calls = {"forward": 0}
    forward, name = env.sim.forward, "step" if OLD else "step2"
    step_of_simulator = getattr(env.sim, name)

    def counted():
        calls["forward"] += 1
        forward()

    def stepped():
        nonlocal unclipped, first_contact
        if first_contact is None and robot_touches(env):
            first_contact = len(actions)
        rows["ctrl"].append(np.array(data.ctrl))
        rows["forwards"].append(calls["forward"])
        unclipped = max(unclipped, np.abs(controller.torques - data.ctrl[:7]).max())
        calls["forward"] = 0
        step_of_simulator()

    env.sim.forward = counted
    setattr(env.sim, name, stepped)

    first = observation(env._get_observations(force_update=True))
    qpos, qvel, success = [np.array(data.qpos)], [np.array(data.qvel)], [env._check_success()]
    observed = {name: [value] for name, value in first.items()}
    actions = []
    for step in range(POLICY_STEPS):
        action = scripted_action(control, step, site(), orientation, start, grasp)
        result = env.step(action)
        for name, value in observation(result[0]).items():
            observed[name].append(value)
        actions.append(action)
        qpos.append(np.array(data.qpos))
        qvel.append(np.array(data.qvel))
        success.append(env._check_success())
    env.sim.forward = forward
    setattr(env.sim, name, step_of_simulator)
    shaped = {name: np.array(value).reshape(POLICY_STEPS, SUBSTEPS, -1) for name, value in rows.items()}
    arrays = {
        "initial_state": state,
        "q_init": np.array(controller.initial_joint),
        "qacc_warmstart": warmstart,
        "actions": np.array(actions),
        "qpos": np.array(qpos),
        "qvel": np.array(qvel),
        "ctrl": shaped["ctrl"],
        "forwards": shaped["forwards"][..., 0].astype(np.uint8),
        "success": np.array(success),
    }
    arrays.update({name: np.array(value) for name, value in observed.items()})
    header = {
        "task": TASKS[task],
        "control": control,
        "policy_steps": POLICY_STEPS,
        "sim_steps_per_policy_step": SUBSTEPS,
        "reset": "reset_from_xml_string, set_state_from_flattened, forward, controller.update(force=True)",
        "forced_updates": 2,
        "steps_before_contact": first_contact,
        "torque_clipped_by": unclipped,
        "controller": part,
        "xml": xml,
    }
    moved = np.abs(np.array(data.body_xpos[body]) - target)
    print(f"{task} {control}: object moved {moved}, success {success[-1]}, torque clipped by {unclipped}")
    return header, arrays, env


def traces(out):
    for task in TASKS:
        trace(task, "absolute", out)
    trace("lift", "delta", out)


# ------------------------------------------------------------------------------------------------------------- placement

PLACEMENT_SEEDS = list(range(150)) + list(range(100000, 100040)) + [2**31 - 1, 2**31, 2**32 - 1] + list(range(200000, 200007))


def without_images(xml):
    """The model without textures and without the arm's visual meshes, which have no collisions. It compiles seven times as fast."""
    root = ElementTree.fromstring(xml)
    assets = root.find("asset")
    for texture in assets.findall("texture"):
        assets.remove(texture)
    for material in assets.findall("material"):
        material.attrib.pop("texture", None)
    for geom in root.iter("geom"):
        if geom.get("group") == "1" and geom.get("mesh", "").startswith("robot0_"):
            del geom.attrib["mesh"]
            geom.attrib.update(type="sphere", size="0.001", mass="0")
    used = {geom.get("mesh") for geom in root.iter("geom")}
    for mesh in assets.findall("mesh"):
        if mesh.get("name") not in used:
            assets.remove(mesh)
    return ElementTree.tostring(root, encoding="unicode")


def sampled(env, task, seed):
    """The random numbers of a hard reset, in their order, without building the model."""
    np.random.seed(seed)
    numbers = []
    if task == "lift":
        from robosuite.models.objects import BoxObject

        cube = BoxObject(name="cube", size_min=[0.020] * 3, size_max=[0.022] * 3)
        numbers += list(cube.size)
        env.placement_initializer.reset()
        env.placement_initializer.add_objects(cube)
    numbers += list(np.array(env.robots[0].init_qpos) + np.random.randn(7) * 0.02)
    for position, quaternion, body in env.placement_initializer.sample().values():
        if body.name == OBJECT[task][0].split("_")[0]:
            numbers += list(position) + list(quaternion)
    return numbers


def placement(out):
    for task in TASKS:
        header, arrays = placed(task)
        write(out / f"placement_{task}_{robosuite.__version__}.bin.gz", dict(header, task=TASKS[task]), arrays)


def placed(task):
    """Initial states of seeds: the fields of the header, and the arrays."""
    env, _ = make(task, "delta")
    env.set_xml_processor(without_images)
    digest = hashlib.sha256()
    for seed in range(10000):
        numbers = sampled(env, task, seed)
        digest.update(struct.pack(f"<{len(numbers)}d", *numbers))
    qpos, sizes = [], []
    for seed in PLACEMENT_SEEDS:
        np.random.seed(seed)
        env.reset()
        qpos.append(np.array(env.sim.data.qpos))
        if task == "lift":
            sizes.append(env.cube.size)
    header = {
        "seeded": "np.random.seed(seed), then env.reset() with a hard reset",
        "sha256_of_10000": digest.hexdigest(),
        "hashed": "seeds 0 to 9999: cube half sizes (Lift), arm joint positions, position and quaternion (wxyz) of the task's "
        "object; little-endian f64",
    }
    arrays = {"seeds": np.array(PLACEMENT_SEEDS, dtype=np.uint32), "qpos": np.array(qpos)}
    if sizes:
        arrays["cube_size"] = np.array(sizes)
    return header, arrays


# ---------------------------------------------------------------------------------------------------------------- states


def demos_of(file):
    return sorted(file["data"], key=lambda name: int(name.split("_")[1]))


def load_model(env, xml, loaded):
    """robomimic's reset_to, without its first reset, which has no lasting effect. The same file is not compiled twice."""
    if xml == loaded:
        # The rest of reset_from_xml_string after compiling the file.
        env.deterministic_reset = True
        env.reset()
        env.deterministic_reset = False
    else:
        env.reset_from_xml_string(with_own_assets(xml))
    env.sim.reset()


def constructed(task, eef):
    """Positions of the task's object on both sides of every boundary of its success rule, for an end effector at `eef`."""
    tiny = [-1e-3, -1e-6, -1e-9, 0.0, 1e-9, 1e-6, 1e-3]
    if task == "lift":
        return [[0.01, 0.02, 0.84 + d] for d in tiny] + [[-0.02, 0.0, 0.8 + 0.04 + d] for d in tiny]
    if task == "can":
        inside, low, high = [0.2, 0.4, 0.86], [0.1, 0.28, 0.8], [0.295, 0.525, 0.9]
    else:
        inside, low, high = [0.23, 0.1, 0.85], [0.2, 0.07, None], [0.26, 0.13, 0.87]
    places = []
    for axis in range(3):
        for edge in (low[axis], high[axis]):
            if edge is not None:
                places += [inside[:axis] + [edge + d] + inside[axis + 1 :] for d in tiny]
    # The distance between grip site and object at which 1 - tanh(10 d) < 0.6 changes.
    reach = np.arctanh(0.4) / 10
    for direction in ([1, 0, 0], [0, -1, 0], [0, 0, -1], [0.6, 0, -0.8]):
        places += [list(eef + (reach + d) * np.array(direction)) for d in tiny]
    return places


def states(out, data):
    import h5py

    for task in TASKS:
        env, _ = make(task, "delta")
        joint, body = OBJECT[task]
        file = h5py.File(data / task / "low_dim.hdf5")
        demos, stride = (demos_of(file)[::5], 2) if task == "lift" else (demos_of(file), 20)
        rows = {name: [] for name in ["demo", "frame", "moved", "position", "success"]}
        observed, loaded = {}, None

        def record(demo, frame, position):
            rows["demo"].append(int(demo.split("_")[1]))
            rows["frame"].append(frame)
            rows["moved"].append(position is not None)
            rows["position"].append([0.0, 0.0, 0.0] if position is None else position)
            for name, value in observation(env._get_observations(force_update=True)).items():
                observed.setdefault(name, []).append(value)
            rows["success"].append(env._check_success())

        for index, demo in enumerate(demos):
            group = file["data"][demo]
            xml = group.attrs["model_file"]
            if xml != loaded:
                load_model(env, xml, loaded)
                loaded = xml
            recorded = group["states"][:]
            frames = list(range(0, len(recorded), stride))
            for frame in frames + ([len(recorded) - 1] if frames[-1] != len(recorded) - 1 else []):
                set_state(env, recorded[frame])
                record(demo, frame, None)
            if index % (len(demos) // 8) == 0:
                # Frames with the end effector far away, at the object, and at the end of the demonstration.
                for frame in (0, len(recorded) // 2, len(recorded) - 1):
                    set_state(env, recorded[frame])
                    eef = np.array(env.sim.data.site_xpos[env.sim.model.site_name2id("gripper0_grip_site")])
                    for position in constructed(task, eef):
                        set_state(env, recorded[frame])
                        address = env.sim.model.get_joint_qpos_addr(joint)[0]
                        env.sim.data.qpos[address : address + 3] = position
                        env.sim.forward()
                        record(demo, frame, list(position))
        arrays = {
            "demo": np.array(rows["demo"], dtype=np.uint32),
            "frame": np.array(rows["frame"], dtype=np.uint32),
            "moved": np.array(rows["moved"]),
            "position": np.array(rows["position"], dtype=float),
            "success": np.array(rows["success"], dtype=bool),
        }
        arrays.update({name: np.array(value) for name, value in observed.items()})
        moved = arrays["moved"]
        print(f"{task}: {len(moved)} states, {moved.sum()} constructed, success {arrays['success'].sum()}, "
              f"of the constructed {arrays['success'][moved].sum()}")
        write(out / f"states_{task}_{robosuite.__version__}.bin.gz", {"task": TASKS[task], "joint": joint, "body": body}, arrays)


# ---------------------------------------------------------------------------------------------------------------- replay

COLUMNS = "dataset,actions,demo,steps,success,first_success,success_at_end,object_divergence_m,object_divergence_end_m"
FILES = {"delta": "low_dim.hdf5", "absolute": "low_dim_abs.hdf5"}


def play(env, task, group, loaded):
    """Replays a demonstration's actions from its first state. Returns a row of the table."""
    load_model(env, group.attrs["model_file"], loaded)
    recorded = group["states"][:]
    set_state(env, recorded[0])
    address = env.sim.model.get_joint_qpos_addr(OBJECT[task][0])[0]
    place = slice(address, address + 3)
    first, maximum, last, done = None, 0.0, 0.0, False
    for index, action in enumerate(group["actions"][:]):
        env.step(action)
        done = bool(env._check_success())
        if done and first is None:
            first = index
        if index + 1 < len(recorded):
            last = np.linalg.norm(np.array(env.sim.data.qpos[place]) - recorded[index + 1][1:][place])
            maximum = max(maximum, last)
    return [len(recorded), int(first is not None), "" if first is None else first, int(done), f"{maximum:.9f}", f"{last:.9f}"]


def replay(out, data):
    """Replays all demonstrations. Existing rows of the table are kept, so that an interrupted run can continue."""
    import h5py

    path = out / "replay_python.csv"
    rows = {}
    if path.exists():
        for line in path.read_text().splitlines()[1:]:
            task, actions, demo, *rest = line.split(",")
            rows[list(TASKS).index(task), list(FILES).index(actions), int(demo)] = rest
    # Demonstrations with absolute actions come first.
    for demos, task, actions in [
        (range(60), "can", "delta"),
        (range(60), "square", "delta"),
        (range(60), "can", "absolute"),
        (range(60), "square", "absolute"),
        (range(200), "lift", "delta"),
        (range(200), "lift", "absolute"),
        (range(200), "can", "delta"),
        (range(200), "square", "delta"),
    ]:
        key = lambda demo: (list(TASKS).index(task), list(FILES).index(actions), demo)  # noqa: E731
        missing = [demo for demo in demos if key(demo) not in rows]
        if not missing:
            continue
        env, _ = make(task, actions)
        # Observations are not used, so they are not computed.
        env._update_observables = lambda force=False: None
        file = h5py.File(data / task / FILES[actions])
        loaded, began = None, time.time()
        for demo in missing:
            group = file["data"][f"demo_{demo}"]
            rows[key(demo)] = play(env, task, group, loaded)
            loaded = group.attrs["model_file"]
            lines = [COLUMNS]
            for (task_index, actions_index, number), row in sorted(rows.items()):
                names = [list(TASKS)[task_index], list(FILES)[actions_index], number]
                lines.append(",".join(map(str, names + row)))
            temporary = path.with_suffix(".tmp")
            temporary.write_text("\n".join(lines) + "\n")
            temporary.rename(path)
        steps = sum(int(rows[key(demo)][0]) for demo in missing)
        succeeded = sum(int(rows[key(demo)][1]) for demo in missing)
        rate = steps / (time.time() - began)
        print(f"{task} {actions}: {succeeded} of {len(missing)}, {rate:.0f} steps/s", flush=True)


# ------------------------------------------------------------------------------------------------------------------ task


def edges(succeeds, inside):
    """Positions on both sides of every boundary of a success rule, on lines from a position inside."""
    found = []
    for direction in [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1], [0.6, -0.8, 0], [0, 0.6, 0.8]]:
        at = lambda distance: np.array(inside) + distance * np.array(direction)  # noqa: E731
        beyond = next((step * 0.005 for step in range(1, 100) if not succeeds(at(step * 0.005))), None)
        if beyond is None:
            continue
        within = beyond - 0.005
        while beyond - within > 1e-12:
            middle = (within + beyond) / 2
            within, beyond = (middle, beyond) if succeeds(at(middle)) else (within, middle)
        found += [at(beyond + d) for d in [-1e-3, -1e-6, -1e-9, 0.0, 1e-9, 1e-6, 1e-3]]
    return found


def reach(env, goal):
    """Sets the arm so that the grip site is at a position, without regard to collisions."""
    model, data = env.sim.model._model, env.sim.data._data
    grip = env.sim.model.site_name2id("gripper0_grip_site" if OLD else "gripper0_right_grip_site")
    joints = [model.joint(f"robot0_joint{i}") for i in range(1, 8)]
    jacobian = np.zeros((3, model.nv))
    for _ in range(200):
        env.sim.forward()
        mujoco.mj_jacSite(model, data, jacobian, None, grip)
        arm = jacobian[:, [joint.dofadr[0] for joint in joints]]
        move = arm.T @ np.linalg.solve(arm @ arm.T + 1e-4 * np.eye(3), goal - data.site_xpos[grip])
        for joint, angle in zip(joints, move):
            data.qpos[joint.qposadr[0]] += angle
    env.sim.forward()
    assert np.linalg.norm(data.site_xpos[grip] - goal) < 1e-3, "the arm cannot reach the position"


def verdicts(env, task, inside):
    """Success verdicts of the environment near every boundary of its rule, with the end effector far from the object and near it."""
    address = env.sim.model.get_joint_qpos_addr(OBJECT[task][0])[0]

    def succeeds(position):
        env.sim.data.qpos[address : address + 3] = position
        env.sim.forward()
        return bool(env._check_success())

    hands, rows = [], {"hand": [], "position": [], "verdict": []}
    for offset in ([0.0, 0.0, 0.2], [0.03, 0.0, 0.035], [0.0, -0.046, 0.0]):
        reach(env, np.array(inside) + offset)
        hands.append(env.sim.get_state().flatten())
        assert succeeds(inside), f"the task does not succeed at {inside} with the end effector {offset} from it"
        for position in edges(succeeds, inside):
            rows["hand"].append(len(hands) - 1)
            rows["position"].append(position)
            rows["verdict"].append(succeeds(position))
    print(f"{task}: {len(rows['verdict'])} verdicts, {sum(rows['verdict'])} successes")
    return {
        "hands": np.array(hands),
        "moved_hand": np.array(rows["hand"], dtype=np.uint32),
        "moved_to": np.array(rows["position"]),
        "moved_success": np.array(rows["verdict"], dtype=bool),
    }


def task(out, name, environment, obj, grasp, inside):
    name, obj = str(name), str(obj)
    numbers = lambda text: [float(number) for number in str(text).split(",")]  # noqa: E731
    TASKS[name], OBJECT[name], GRASP[name] = str(environment), (f"{obj}_joint0", f"{obj}_main"), numbers(grasp)
    header, arrays, env = traced(name, "absolute")
    arrays.update(verdicts(env, name, numbers(inside)))
    of_seeds, states = placed(name)
    arrays["placed"] = states.pop("qpos")
    write(out / f"trace_{name}_{robosuite.__version__}_absolute.bin.gz", dict(of_seeds, **header), dict(arrays, **states))


if __name__ == "__main__":
    commands = {"task": task, "trace": traces, "placement": placement, "states": states, "replay": replay}
    if len(sys.argv) < 3 or sys.argv[1] not in commands:
        sys.exit(__doc__)
    paths = [pathlib.Path(argument) for argument in sys.argv[2:]]
    paths[0].mkdir(parents=True, exist_ok=True)
    commands[sys.argv[1]](*paths)
