"""robosuite's tasks Lift, Can and Square as gymnasium environments."""

from __future__ import annotations

import gzip
import os
from importlib import resources
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from re4_pipe import _native
from re4_pipe._artifact import Artifact
from re4_pipe._errors import Re4Error

from ._vector import Infos, NativeVectorEnv

CONTROLS = ("delta", "absolute")
METADATA: dict[str, Any] = {"render_modes": [], "render_fps": 20}

# The version of robosuite that wrote the models in the folder `models`.
VERSION = "1.4.1"


def _model(task: str, demonstrations: Artifact | str | os.PathLike[str] | None) -> tuple[str, str]:
    """The version of robosuite and the text of the model."""
    if demonstrations is None:
        packed = resources.files("re4_pipe") / "models" / f"{task}.xml.gz"
        if not packed.is_file():
            raise Re4Error(f"the package has no model of the task {task!r}", "give an episodes artifact as demonstrations")
        return VERSION, gzip.decompress(packed.read_bytes()).decode()
    artifact = demonstrations if isinstance(demonstrations, Artifact) else Artifact(demonstrations)
    version = (artifact.manifest.get("source") or {}).get("robosuite_version")
    if "models" not in artifact or version is None:
        raise Re4Error(f"{artifact.path} has no models of robosuite", "give an episodes artifact of robosuite demonstrations")
    return version, artifact.polars("models", ["mjcf"])["mjcf"][0]


class _Sims:
    """Simulations with their observations and infos, one row for each."""

    def __init__(
        self,
        count: int,
        task: str,
        control: str,
        fidelity: str,
        demonstrations: Artifact | str | os.PathLike[str] | None,
        threads: int,
    ) -> None:
        for name, value, known in [("control", control, CONTROLS), ("fidelity", fidelity, ("robosuite", "fast"))]:
            if value not in known:
                raise Re4Error(f"{name} is {value!r}", f"give one of {', '.join(known)}")
        self.absolute = control == "absolute"
        version, text = _model(task, demonstrations)
        self.record = _native.task_record(task, version)
        self.native = _native.RobosuiteSims(task, version, text, fidelity == "fast", count, threads)

    def observation_space(self) -> spaces.Dict:
        sizes = {
            "object": self.record["object_columns"],
            "robot0_eef_pos": 3,
            "robot0_eef_quat": 4,
            "robot0_gripper_qpos": 2,
        }
        return spaces.Dict({key: spaces.Box(-np.inf, np.inf, (size,), np.float64) for key, size in sizes.items()})

    def action_space(self) -> spaces.Box:
        if not self.absolute:
            return spaces.Box(-1.0, 1.0, (7,), np.float32)
        # The hand's reach and every rotation vector.
        limits = np.array([2.0, 2.0, 2.0, 2 * np.pi, 2 * np.pi, 2 * np.pi, 1.0])
        return spaces.Box(-limits, limits, dtype=np.float64)

    def begin(self, which: npt.NDArray[np.int64], seeds: list[int | None], randoms: list[np.random.Generator]) -> None:
        chosen = [int(random.integers(2**32)) if seed is None else seed % 2**32 for seed, random in zip(seeds, randoms, strict=True)]
        self.native.reset(which, np.array(chosen, dtype=np.int64))

    def observe(self) -> tuple[Any, npt.NDArray[np.float64], npt.NDArray[np.bool_], Infos, Infos]:
        position, quaternion, fingers, object_state, success = self.native.outcome()
        start = self.record["object_pose_start"]
        observations = {
            "object": object_state,
            "robot0_eef_pos": position,
            "robot0_eef_quat": quaternion,
            "robot0_gripper_qpos": fingers,
        }
        infos = {"is_success": success, "object_pose": object_state[:, start : start + 7].copy()}
        return observations, success.astype(np.float64), success, infos, {}


class RobosuiteEnv(gymnasium.Env[Any, Any]):
    """A task of robosuite with one Panda arm. Metres and radians, world frame with z up, quaternions x, y, z, w.

    States are bit for bit those of robosuite 1.4.1 on MuJoCo 2.3.7, or 1.5.1 on 3.2.7, under the same controls. The simulator is
    MuJoCo's own library, which is loaded when the environment is created: from ``RE4_SIMULATORS`` or ``data/simulators``, filled by
    ``scripts/setup-simulators.sh``. ``re4-pipe doctor`` lists what is missing.

    Actions, 7 numbers; the last one closes the gripper if it is above 0 and opens it if it is below:
        * ``control="delta"``: robosuite's: translation and rotation vector in units of 0.05 m and 0.5 rad, limited to [-1, 1].
        * ``control="absolute"``: goal of the grip site: position in m and rotation vector in rad, as :class:`re4_pipe.Policy` returns.

    Observations: ``robot0_eef_pos`` (3,), ``robot0_eef_quat`` (4,) of the hand, ``robot0_gripper_qpos`` (2,), and ``object`` in
    robosuite's layout of the version. As in robosuite, poses after a step are those of 2 ms before its end.

    Reward: 1 if the task's own success rule is satisfied, which terminates the episode, otherwise 0. ``info`` has ``is_success`` and
    ``object_pose`` (7,).

    ``reset(seed=s)`` gives the scene of robosuite after ``np.random.seed(s)``. Without a seed, the scene is that of a random seed.
    Options are ignored.
    """

    metadata = METADATA

    def __init__(
        self,
        task: str,
        control: str = "delta",
        *,
        fidelity: str = "robosuite",
        demonstrations: Artifact | str | os.PathLike[str] | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Creates the simulation.

        Args:
            task: ``lift``, ``can`` or ``square``.
            control: ``delta`` or ``absolute``.
            fidelity: ``robosuite`` is bit-exact, ``fast`` is three times as fast.
            demonstrations: An ``episodes`` artifact whose model is simulated; None for the package's model of robosuite 1.4.1.
            render_mode: None.

        Raises:
            Re4Error: If MuJoCo or robosuite's meshes are not installed.
        """
        if render_mode is not None:
            raise Re4Error(f"render_mode is {render_mode!r}", "give None: these environments render no images")
        self._sims = _Sims(1, task, control, fidelity, demonstrations, 1)
        self.observation_space = self._sims.observation_space()
        self.action_space = self._sims.action_space()

    def reset(self, *, seed: int | None = None, options: Infos | None = None) -> tuple[Any, Infos]:
        """Starts an episode."""
        super().reset(seed=seed)
        self._sims.begin(np.zeros(1, dtype=np.int64), [seed], [self.np_random])
        observations, _, _, infos, _ = self._sims.observe()
        return {key: values[0] for key, values in observations.items()}, _single_info(infos)

    def step(self, action: npt.NDArray[Any]) -> tuple[Any, float, bool, bool, Infos]:
        """Executes a control step of 0.05 s."""
        actions = np.ascontiguousarray(action, dtype=np.float64).reshape(1, 7)
        self._sims.native.step(actions, np.ones(1, dtype=np.bool_), self._sims.absolute)
        observations, rewards, terminated, infos, _ = self._sims.observe()
        observation = {key: values[0] for key, values in observations.items()}
        return observation, float(rewards[0]), bool(terminated[0]), False, _single_info(infos)


class RobosuiteVectorEnv(NativeVectorEnv):
    """Native vector form of :class:`RobosuiteEnv`: one call steps all environments."""

    metadata = METADATA

    def __init__(
        self,
        num_envs: int = 1,
        task: str = "lift",
        control: str = "delta",
        *,
        fidelity: str = "robosuite",
        demonstrations: Artifact | str | os.PathLike[str] | None = None,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
    ) -> None:
        """Creates the simulations; arguments are as for :class:`RobosuiteEnv` and :class:`re4_pipe.envs.PushTVectorEnv`."""
        if render_mode is not None:
            raise Re4Error(f"render_mode is {render_mode!r}", "give None: these environments render no images")
        self._sims = _Sims(num_envs, task, control, fidelity, demonstrations, threads)
        spaces_of = (self._sims.observation_space(), self._sims.action_space())
        super().__init__(num_envs, *spaces_of, max_episode_steps, autoreset_mode)

    def _begin(self, which: npt.NDArray[np.int64], seeds: list[int | None], options: Infos) -> None:
        self._sims.begin(which, seeds, [self._random(int(number)) for number in which])

    def _advance(self, actions: Any, active: npt.NDArray[np.bool_]) -> None:
        self._sims.native.step(np.ascontiguousarray(actions, dtype=np.float64), active, self._sims.absolute)

    def _observe(self) -> tuple[Any, npt.NDArray[np.float64], npt.NDArray[np.bool_], Infos, Infos]:
        return self._sims.observe()


def _single_info(infos: Infos) -> Infos:
    return {key: values[0].item() if values.ndim == 1 else values[0] for key, values in infos.items()}
