"""Policies that act on observations."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native
from ._artifact import Artifact
from ._errors import Re4Error
from ._pipeline import Pipeline, Result

Observation = npt.NDArray[Any] | Mapping[str, Any]


class Policy:
    """A policy with which rollouts were made, for observations of any program: a simulator, a robot, a dataset.

    It is the policy of the rollouts with the same settings and demonstrations: given the observations of a rollout, it returns
    the actions of the rollout, bit for bit. It keeps the state of one episode; :meth:`copy` gives a policy for another episode.

    Push-T, observations (px, rad, world frame with y down):
        * an array of 5 numbers: agent x, y, block x, y, angle; or
        * a mapping with ``agent_pos`` (2,) and one of ``block_pose`` (3,), ``environment_state`` (16,), the corners of the block,
          or ``pixels`` (96, 96, 3) uint8, which a policy from images needs.

        Actions: target position of the agent, shape (2,), px.

    robosuite, observations (m, world frame, quaternions x, y, z, w), a mapping with:
        * ``robot0_eef_pos`` (3,), ``robot0_eef_quat`` (4,), ``robot0_gripper_qpos`` (2,) as in robosuite, and one of
          ``object``, robosuite's vector in the layout of the version with which the demonstrations were recorded,
          ``object_pose`` (7,): position and quaternion, or an image (``pixels`` or a name that ends in ``_image``), (84, 84, 3) uint8.

        Actions: absolute goal of the grip site and command of the gripper, shape (7,): position in m, rotation vector in rad,
        gripper (above 0 closes). ``re4/Lift-v0`` and its like take them with ``control="absolute"``.

    Attributes:
        phase: Part of the policy's loop that the last action belongs to: ``plan``, ``bridge``, ``replay`` or ``home``.
        decision: The last decision: ``step``, ``kind``, ``demo``, ``demo_frame``, ``demo_end`` and the ``reason`` as a sentence.
    """

    def __init__(self, source: Artifact | Pipeline | Result | str | os.PathLike[str]) -> None:
        """Opens the policy of rollouts.

        Args:
            source: A ``rollouts`` artifact, its folder, the result of a stage, or a pipeline, whose stage ``rollout`` is run unless
                its artifact exists. The artifacts from which the rollouts were made have to be in the same artifacts folder.

        Raises:
            Re4Error: If there are no such rollouts, or an artifact from which they were made is missing or damaged.
        """
        if isinstance(source, Pipeline):
            source = source.run("rollout")
        if isinstance(source, Result):
            source = source.artifact
        path = source.path if isinstance(source, Artifact) else source
        self._open(_native.Policy(path))

    def _open(self, native: _native.Policy) -> None:
        self._native = native
        self.kind: str = native.kind
        self.task: str = native.task
        self.observes_images: bool = native.observes_images
        self.phase: str | None = None
        self.decision: dict[str, Any] | None = None
        self._pose_start = 0
        if native.robosuite is not None:
            version = ".".join(map(str, native.robosuite))
            self._pose_start = _native.task_record(self.task, version)["object_pose_start"]

    def __repr__(self) -> str:
        return f"Policy(kind={self.kind!r}, task={self.task!r}, observes_images={self.observes_images})"

    def copy(self) -> Policy:
        """The same policy for another episode at the same time. The demonstrations are shared."""
        other = object.__new__(Policy)
        other._open(self._native.copy())
        return other

    def reset(self, seed: int = 0, *, goal_pose: npt.ArrayLike | None = None) -> None:
        """Begins an episode; the next observation is its first.

        Args:
            seed: Seeds the random numbers of policies that use some. Rollouts use the seed of the scene.
            goal_pose: Push-T: the goal pose (px, px, rad) if it is not the task's.
        """
        goal = None if goal_pose is None else _numbers({"goal_pose": goal_pose}, "goal_pose", 3)
        self._native.reset(seed, goal)
        self.phase = self.decision = None

    def act(self, observation: Observation) -> npt.NDArray[np.float64]:
        """The action for the next control step. To be called once per control step (Push-T: 10 Hz, robosuite: 20 Hz).

        Raises:
            Re4Error: If a part of the observation is missing or has another shape, or the policy has no action.
        """
        if self.task == "pusht":
            agent, block, pixels = _planar(observation, self.observes_images)
            action, phase, decision = self._native.act_plane(agent, block, pixels)
        else:
            eef, fingers, pose, pixels = _spatial(observation, self.observes_images, self._pose_start)
            action, phase, decision = self._native.act_space(eef, fingers, pose, pixels)
        self.phase = phase
        if decision is not None:
            self.decision = decision
        return np.array(action)


def _numbers(observation: Mapping[str, Any], key: str, count: int) -> list[float]:
    """The numbers of one part of an observation."""
    if key not in observation:
        known = ", ".join(map(str, observation)) or "none"
        raise Re4Error(f"the observation has no {key}", f"give it; the keys of the observation are: {known}")
    numbers = np.asarray(observation[key], dtype=np.float64).ravel()
    if len(numbers) != count:
        raise Re4Error(f"{key} of the observation has {len(numbers)} numbers", f"give {count} numbers")
    return numbers.tolist()


def _planar(observation: Observation, images: bool) -> tuple[list[float], list[float] | None, npt.NDArray[np.uint8] | None]:
    """Position of the agent, pose of the block and image of an observation of Push-T."""
    if not isinstance(observation, Mapping):
        numbers = _numbers({"state": observation}, "state", 5)
        observation = {"agent_pos": numbers[:2], "block_pose": numbers[2:]}
    agent = _numbers(observation, "agent_pos", 2)
    if images:
        return agent, None, _image(observation)
    if "block_pose" not in observation and "environment_state" in observation:
        # The first two corners are the ends of the bar's outer edge, whose middle is the origin of the block.
        x0, y0, x1, y1, *_ = _numbers(observation, "environment_state", 16)
        return agent, [(x0 + x1) / 2, (y0 + y1) / 2, float(np.arctan2(y1 - y0, x1 - x0))], None
    return agent, _numbers(observation, "block_pose", 3), None


def _spatial(
    observation: Observation, images: bool, pose_start: int
) -> tuple[list[float], list[float], list[float] | None, npt.NDArray[np.uint8] | None]:
    """Pose of the end effector, positions of the fingers, pose of the object and image of an observation of robosuite."""
    if not isinstance(observation, Mapping):
        raise Re4Error("the observation is no mapping", "give robot0_eef_pos, robot0_eef_quat, robot0_gripper_qpos and object")
    eef = _numbers(observation, "robot0_eef_pos", 3) + _numbers(observation, "robot0_eef_quat", 4)
    fingers = _numbers(observation, "robot0_gripper_qpos", 2)
    if images:
        return eef, fingers, None, _image(observation)
    if "object_pose" in observation:
        return eef, fingers, _numbers(observation, "object_pose", 7), None
    if "object" not in observation:
        _numbers(observation, "object", 7)
    numbers = np.asarray(observation["object"], dtype=np.float64).ravel()
    pose = numbers[pose_start : pose_start + 7].tolist()
    if len(pose) != 7:
        raise Re4Error(f"object of the observation has {len(numbers)} numbers", "give robosuite's vector, or object_pose")
    return eef, fingers, pose, None


def _image(observation: Mapping[str, Any]) -> npt.NDArray[np.uint8]:
    """The image of an observation."""
    names = [key for key in observation if key == "pixels" or str(key).endswith("_image")]
    if len(names) != 1:
        found = f"{len(names)} images" if names else "no image"
        raise Re4Error(f"the observation has {found}", "give one as pixels, for a policy that observes images")
    image = np.ascontiguousarray(observation[names[0]])
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise Re4Error(f"{names[0]} has the shape {image.shape} and the type {image.dtype}", "give uint8 of the shape (height, width, 3)")
    return image
