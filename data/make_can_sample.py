#!/usr/bin/env python3
"""Writes can-sample.hdf5: synthetic pick-and-place demonstrations in robomimic's low-dim layout, with known errors.

Nothing is simulated: an end effector follows waypoints; the can moves with it while the fingers clamp it, and falls when they do
not. The file defines what an audit has to find; FAULTS maps demonstrations to their errors.

    python data/make_can_sample.py data/can-sample.hdf5

Needs h5py and numpy. Same bytes on every run with the same versions of both.
"""

import json
import sys

import h5py
import numpy as np

# Demonstrations with errors. All others have none.
FAULTS = {
    3: "missed",  # the fingers close next to the can, then grasp it at the second attempt
    5: "lost",  # the can slips out of the gripper during the transfer
    6: "pushed",  # the open gripper pushes the can before it grasps it
    8: "early",  # the can is released before the goal
    10: "never",  # the end effector moves to the can and leaves without closing
    11: "flicker",  # a single command to open during the transfer
    13: "frozen",  # the same state is recorded repeatedly
    14: "saturated",  # the actions are at their limit most of the time
    16: "duplicate",  # a copy of demo_2
    18: "teleport",  # frames are missing, so the end effector jumps
}
DEMOS = 19
VALID = ["demo_4", "demo_17"]

STEP_S = 0.05  # control step
FOLLOWED = 0.3  # fraction of the distance to its goal that the end effector moves in a step
OUTPUT_MAX = (0.05, 0.5)  # motion for an action of 1: metres, radians
FINGER_TRAVEL = 0.04  # of each finger
RAMP = 0.25  # change of the gripper opening per step, from -1 (open) to 1 (closed)
CAN_RADIUS = 0.025
FLOOR = 0.86  # height of the origin of the standing can
GRAVITY = 9.81


def multiply(a, b):
    """Product of two quaternions, x y z w."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return np.array(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )


def conjugate(q):
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def rotate(q, v):
    return multiply(multiply(q, np.append(v, 0.0)), conjugate(q))[:3]


def from_rotation_vector(r):
    angle = np.linalg.norm(r)
    if angle < 1e-12:
        return np.array([0.0, 0.0, 0.0, 1.0])
    return np.append(r / angle * np.sin(angle / 2), np.cos(angle / 2))


class Scene:
    """An end effector, two fingers and a can, and their recorded frames."""

    def __init__(self, random, can):
        self.random = random
        self.hand = np.array([-0.02, -0.08, 0.96]) + random.uniform(-0.012, 0.012, 3)
        self.yaw = random.uniform(-0.05, 0.05)  # rotation of the end effector about the vertical
        self.tilt = random.uniform(-0.02, 0.02, 2)
        self.can = np.append(can, FLOOR)
        self.can_rotation = from_rotation_vector(np.array([0.0, 0.0, random.uniform(-3.0, 3.0)]))
        self.grip = 0.0  # -1 open, 1 closed
        self.finger = FINGER_TRAVEL / 2
        self.held = None  # the can in the end effector's frame
        self.fall = 0.0  # speed
        self.velocity = np.zeros(3)
        self.slippery = False
        self.rows = []

    def attitude(self):
        """Orientation of the end effector, which points down."""
        down = np.array([1.0, 0.0, 0.0, 0.0])
        lean = from_rotation_vector(np.array([self.tilt[0], self.tilt[1], self.yaw]))
        return multiply(lean, down)

    def record(self, command, follow_can=None, step=None):
        """Makes one control step: records the state, then moves."""
        before, before_rotation = self.hand.copy(), self.attitude()
        row = {
            "eef": before,
            "quat": before_rotation,
            "fingers": np.array([self.finger, -self.finger]),
            "can": self.can.copy(),
            "can_quat": self.can_rotation.copy(),
        }
        step = np.zeros(3) if step is None else step
        self.hand = self.hand + step
        self.tilt = 0.97 * self.tilt + self.random.normal(0.0, 0.0006, 2)
        self.yaw += self.random.normal(0.0, 0.0015)
        relative = multiply(self.attitude(), conjugate(before_rotation))
        relative = relative * np.sign(relative[3])
        rotation = 2.0 * relative[:3] / max(relative[3], 1e-9)
        scale = [FOLLOWED * limit for limit in OUTPUT_MAX]
        row["action"] = np.clip(np.concatenate([step / scale[0], rotation / scale[1], [command]]), -1.0, 1.0)
        row["rotation"] = rotation
        self.rows.append(row)
        self.grip = float(np.clip(self.grip + RAMP * command, -1.0, 1.0))
        target = FINGER_TRAVEL / 2 * (1.0 - self.grip)
        near = np.linalg.norm(self.can[:2] - self.hand[:2]) < 0.012 and abs(self.can[2] - self.hand[2]) < 0.03
        clamps = (near or self.held is not None) and not self.slippery and target < CAN_RADIUS
        self.finger = CAN_RADIUS if clamps and self.finger >= CAN_RADIUS - 1e-12 else target
        if clamps and self.finger == CAN_RADIUS:
            if self.held is None:
                inverse = conjugate(self.attitude())
                self.held = (rotate(inverse, self.can - self.hand), multiply(inverse, self.can_rotation))
            self.can = self.hand + rotate(self.attitude(), self.held[0])
            self.can_rotation = multiply(self.attitude(), self.held[1])
            self.fall = 0.0
        else:
            self.held = None
            if self.can[2] > FLOOR:
                self.can[2] = max(FLOOR, self.can[2] - (self.fall + GRAVITY * STEP_S / 2) * STEP_S)
                self.fall += GRAVITY * STEP_S
            if follow_can is not None:
                self.can[:2] = self.can[:2] + follow_can

    def towards(self, goal, fastest):
        wanted = goal - self.hand
        distance = np.linalg.norm(wanted)
        wanted = wanted / max(distance, 1e-12) * min(fastest, 0.3 * distance)
        self.velocity = 0.4 * self.velocity + 0.6 * wanted
        return self.velocity + self.random.normal(0.0, 0.00025, 3)

    def go(self, goal, command, fastest=0.0135, near=0.004, limit=60, bang=False):
        """Moves to a goal. With bang, every axis is driven at its limit."""
        for _ in range(limit):
            if np.linalg.norm(goal - self.hand) < near:
                return
            step = self.towards(goal, fastest)
            if bang:
                limit_step = FOLLOWED * OUTPUT_MAX[0]
                step = np.where(np.abs(goal - self.hand) > 0.5 * limit_step, np.sign(goal - self.hand) * limit_step, 0.0)
            self.record(command, step=step)

    def wait(self, command, frames):
        for _ in range(frames):
            self.record(command, step=self.random.normal(0.0, 0.0003, 3))


def demonstration(seed, fault):
    random = np.random.RandomState(seed)
    can = np.array([0.06, -0.14]) + random.uniform(-0.03, 0.03, 2)
    goal = np.array([0.15, 0.32]) + random.uniform(-0.02, 0.02, 2)
    scene = Scene(random, can)
    bang = fault == "saturated"
    scene.wait(-1.0, 3 + random.randint(3))

    above = lambda position, height: np.append(position, height)
    grasp_height = 0.874 + random.uniform(-0.003, 0.003)
    offset = random.uniform(-0.0006, 0.0006, 2)
    if fault == "missed":
        beside = can + np.array([0.075, 0.0])
        scene.go(above(beside, 0.91), -1.0, near=0.012)
        scene.go(above(beside, grasp_height), -1.0)
        scene.wait(1.0, 10)
        scene.go(above(beside, 0.92), 1.0)
        scene.wait(-1.0, 3)
    if fault == "pushed":
        side = can + np.array([-0.07, 0.0])
        scene.go(above(side, 0.91), -1.0, near=0.012)
        scene.go(above(side, grasp_height), -1.0)
        for _ in range(6):
            scene.record(-1.0, follow_can=np.array([0.008, 0.0]), step=np.array([0.008, 0.0, 0.0]))
        can = scene.can[:2].copy()
        scene.go(above(scene.hand[:2], 0.93), -1.0)
    scene.go(above(can + offset, 0.92), -1.0, near=0.014, bang=bang)
    scene.go(above(can + offset, grasp_height), -1.0, near=0.0025)
    if fault == "never":
        scene.wait(-1.0, 12)
        scene.go(above(can, 0.98), -1.0)
        scene.go(above(goal, 0.98), -1.0)
        return scene.rows
    scene.wait(1.0, 8)
    scene.go(above(can, 0.96), 1.0, near=0.015, bang=bang)
    if fault == "lost":
        scene.go(above(0.5 * (can + goal), 0.98), 1.0)
        scene.slippery = True
    if fault == "early":
        goal = 0.6 * can + 0.4 * goal
    if fault == "flicker":
        scene.go(above(0.5 * (can + goal), 0.98), 1.0)
        scene.record(-1.0, step=scene.towards(above(goal, 0.98), 0.0135))
    if fault == "frozen":
        scene.go(above(0.5 * (can + goal), 0.98), 1.0)
        for _ in range(14):
            scene.rows.append(dict(scene.rows[-1]))
    scene.go(above(goal, 0.98), 1.0, near=0.014, bang=bang)
    if fault != "early":
        scene.go(above(goal, grasp_height + 0.01), 1.0, near=0.004)
    scene.wait(-1.0, 6)
    scene.go(above(goal, 0.95), -1.0, near=0.014, bang=bang)
    rows = scene.rows
    if fault == "teleport":
        # In the approach, where the end effector is fast and does not hold the can.
        rows = rows[:6] + rows[13:]
    return rows


def columns(rows):
    column = lambda name: np.array([row[name] for row in rows])
    eef, quat, can, can_quat = column("eef"), column("quat"), column("can"), column("can_quat")
    inverse = [conjugate(q) for q in quat]
    seen = np.array([rotate(i, c - e) for i, c, e in zip(inverse, can, eef)])
    seen_quat = np.array([multiply(i, q) for i, q in zip(inverse, can_quat)])
    turning = column("rotation") / STEP_S
    turning[1:] = 0.5 * (turning[1:] + turning[:-1])
    in_bin = (np.abs(can[:, 0] - 0.1975) < 0.0975) & (np.abs(can[:, 1] - 0.4025) < 0.1225) & (can[:, 2] < 0.9)
    success = in_bin & (np.linalg.norm(eef - can, axis=1) > 0.0424)
    done = success.astype(np.int64)
    done[-1] = 1
    return {
        "actions": column("action"),
        "rewards": success.astype(np.float64),
        "dones": done,
        "obs/object": np.hstack([can, can_quat, seen, seen_quat]),
        "obs/robot0_eef_pos": eef,
        "obs/robot0_eef_quat": quat,
        "obs/robot0_eef_vel_ang": turning,
        "obs/robot0_gripper_qpos": column("fingers"),
    }


ENVIRONMENT = {
    "env_name": "PickPlaceCan",
    "env_version": "1.4.1",
    "type": 1,
    "env_kwargs": {
        "robots": ["Panda"],
        "control_freq": 20,
        "controller_configs": {
            "type": "OSC_POSE",
            "input_max": 1,
            "input_min": -1,
            "output_max": [0.05, 0.05, 0.05, 0.5, 0.5, 0.5],
            "output_min": [-0.05, -0.05, -0.05, -0.5, -0.5, -0.5],
            "kp": 150,
            "damping": 1,
            "impedance_mode": "fixed",
            "kp_limits": [0, 300],
            "damping_limits": [0, 10],
            "position_limits": None,
            "orientation_limits": None,
            "uncouple_pos_ori": True,
            "control_delta": True,
            "interpolation": None,
            "ramp_ratio": 0.2,
        },
        "has_renderer": False,
        "has_offscreen_renderer": False,
        "ignore_done": True,
        "use_object_obs": True,
        "use_camera_obs": False,
        "reward_shaping": False,
    },
}


def main():
    if len(sys.argv) != 2:
        sys.exit("usage: make_can_sample.py OUT.hdf5")
    with h5py.File(sys.argv[1], "w", libver="earliest") as file:
        data = file.create_group("data")
        total = 0
        for number in range(DEMOS):
            fault = FAULTS.get(number)
            seed = 400000 + (2 if fault == "duplicate" else number)
            table = columns(demonstration(seed, None if fault == "duplicate" else fault))
            demo = data.create_group(f"demo_{number}")
            for name, values in table.items():
                demo.create_dataset(name, data=values, track_times=False)
            samples = len(table["actions"])
            demo.attrs["num_samples"] = np.int64(samples)
            total += samples
        data.attrs["total"] = np.int64(total)
        data.attrs["env_args"] = json.dumps(ENVIRONMENT, indent=4)
        names = [f"demo_{number}" for number in range(DEMOS)]
        mask = file.create_group("mask")
        mask.create_dataset("train", data=np.array([n for n in names if n not in VALID], dtype="S8"), track_times=False)
        mask.create_dataset("valid", data=np.array(VALID, dtype="S8"), track_times=False)


main()
