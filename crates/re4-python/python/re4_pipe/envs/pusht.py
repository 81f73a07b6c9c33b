"""Push-T as gymnasium environments, with the conventions of gym-pusht."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from re4_pipe import _native
from re4_pipe._errors import Re4Error

from ._vector import Infos, NativeVectorEnv

OBSERVATIONS = ("state", "environment_state_agent_pos", "pixels", "pixels_agent_pos")
SUCCESS_COVERAGE = 0.95
GOAL = (256.0, 256.0, np.pi / 4)
METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}


def _observation_space(obs_type: str) -> spaces.Space[Any]:
    agent = spaces.Box(0.0, 512.0, (2,), np.float64)
    pixels = spaces.Box(0, 255, (96, 96, 3), np.uint8)
    known: dict[str, spaces.Space[Any]] = {
        "state": spaces.Box(np.zeros(5), np.array([512, 512, 512, 512, 2 * np.pi]), dtype=np.float64),
        "environment_state_agent_pos": spaces.Dict({"environment_state": spaces.Box(0.0, 512.0, (16,), np.float64), "agent_pos": agent}),
        "pixels": pixels,
        "pixels_agent_pos": spaces.Dict({"pixels": pixels, "agent_pos": agent}),
    }
    if obs_type not in known:
        raise Re4Error(f"obs_type is {obs_type!r}", f"give one of {', '.join(OBSERVATIONS)}")
    return known[obs_type]


def _action_space() -> spaces.Box:
    return spaces.Box(0.0, 512.0, (2,), np.float32)


def _check_render_mode(render_mode: str | None) -> None:
    if render_mode not in (None, "rgb_array"):
        raise Re4Error(f"render_mode is {render_mode!r}", "give None or rgb_array")


class _Sims:
    """Simulations with their observations and infos, one row for each."""

    def __init__(self, count: int, obs_type: str, threads: int, goal_pose: npt.ArrayLike | None) -> None:
        self.native = _native.PushTSims(count, threads)
        self.obs_type = obs_type
        self.goal = np.array(GOAL if goal_pose is None else goal_pose, dtype=np.float64)
        if self.goal.shape != (3,):
            raise Re4Error(f"goal_pose has the shape {self.goal.shape}", "give x, y and the angle")
        if goal_pose is not None:
            self.native.set_goal(self.goal.tolist())

    def begin(self, which: npt.NDArray[np.int64], randoms: Sequence[np.random.Generator], options: Infos) -> None:
        state = options.get("reset_to_state")
        if state is None:
            states = np.array([_scene(random) for random in randoms]).reshape(-1, 5)
        else:
            given = np.asarray(state, dtype=np.float64)
            if given.shape not in ((5,), (len(which), 5)):
                raise Re4Error(f"reset_to_state has the shape {given.shape}", "give agent x, y, block x, y and angle")
            states = np.ascontiguousarray(np.broadcast_to(given, (len(which), 5)))
        self.native.reset(which, states, options.get("reset_order", "legacy") == "legacy")

    def observe(self) -> tuple[Any, npt.NDArray[np.float64], npt.NDArray[np.bool_], Infos, Infos]:
        state, velocity, block, coverage, contacts, success = self.native.outcome()
        agent = state[:, :2].copy()
        observations: Any = state
        if self.obs_type == "environment_state_agent_pos":
            observations = {"agent_pos": agent, "environment_state": self.native.corners()}
        elif self.obs_type == "pixels":
            observations = self.native.images(False)
        elif self.obs_type == "pixels_agent_pos":
            observations = {"agent_pos": agent, "pixels": self.native.images(False)}
        infos: Infos = {
            "pos_agent": agent.copy(),
            "vel_agent": velocity,
            "block_pose": block,
            "goal_pose": np.tile(self.goal, (len(state), 1)),
            "n_contacts": contacts,
            "is_success": success,
        }
        rewards = np.clip(coverage / SUCCESS_COVERAGE, 0.0, 1.0)
        return observations, rewards, success, infos, {"coverage": coverage}


def _scene(random: np.random.Generator) -> list[float]:
    """A scene, sampled as in gym-pusht: agent x, y, block x, y in px, angle in rad."""
    positions = [random.integers(low, high) for low, high in ((50, 450), (50, 450), (100, 400), (100, 400))]
    return [*map(float, positions), random.uniform(-np.pi, np.pi)]


class PushTEnv(gymnasium.Env[Any, Any]):
    """Push-T: a disc, the agent, pushes a T-shaped block onto its goal. Pixels of a window of 512 x 512, y down; radians.

    Scenes, states, rewards and images are bit for bit those of gym-pusht 0.1.8 (``gym_pusht/PushT-v0``) for the same seeds and
    actions; the environment differs in these points:

    * ``info["n_contacts"]`` is the mean number of contact points in a physics step, rounded up. gym-pusht divides by the wrong
      number of steps, so it is 0 or 1 there.
    * ``render()`` returns the canvas of 512 x 512 pixels without a mark at the last action. There is no window.
    * The size of observed images is fixed at 96 x 96; ``block_cog`` and ``damping`` are not settings.
    * ``info["is_success"]`` is false and ``info["coverage"]`` absent after a reset, as in gym-pusht.

    Actions: target position of the agent, Box(0, 512, (2,)).

    Observations by ``obs_type``:
        * ``state``: agent x, y, block x, y, block angle in [0, 2 pi).
        * ``environment_state_agent_pos``: ``environment_state`` (16,), the eight corners of the block, and ``agent_pos`` (2,).
        * ``pixels``: (96, 96, 3) uint8.
        * ``pixels_agent_pos``: ``pixels`` and ``agent_pos``.

    Reward: ``min(coverage / 0.95, 1)``, where coverage is the fraction of the goal that the block covers. An episode terminates
    when the coverage is above 0.95.

    ``reset(options=...)``: ``reset_to_state`` (agent x, y, block x, y, angle) starts from a state; ``reset_order``: ``"legacy"``, as
    in gym-pusht, moves the block when it sets the angle, ``"pose"`` does not. Other options are ignored.
    """

    metadata = METADATA

    def __init__(self, obs_type: str = "state", render_mode: str | None = None, *, goal_pose: npt.ArrayLike | None = None) -> None:
        """Creates the simulation.

        Args:
            obs_type: ``state``, ``environment_state_agent_pos``, ``pixels`` or ``pixels_agent_pos``.
            render_mode: None or ``rgb_array``.
            goal_pose: Another goal pose of the block: px, px, rad.
        """
        _check_render_mode(render_mode)
        self.observation_space = _observation_space(obs_type)
        self.action_space = _action_space()
        self.render_mode = render_mode
        self._sims = _Sims(1, obs_type, 1, goal_pose)

    def reset(self, *, seed: int | None = None, options: Infos | None = None) -> tuple[Any, Infos]:
        """Starts an episode; see the class for the options."""
        super().reset(seed=seed)
        self._sims.begin(np.zeros(1, dtype=np.int64), [self.np_random], options or {})
        observations, _, _, infos, _ = self._sims.observe()
        return _single(observations), _single_info(infos)

    def step(self, action: npt.NDArray[Any]) -> tuple[Any, float, bool, bool, Infos]:
        """Executes a control step of 0.1 s."""
        actions = np.ascontiguousarray(action, dtype=np.float64).reshape(1, 2)
        self._sims.native.step(actions, np.ones(1, dtype=np.bool_))
        observations, rewards, terminated, infos, stepped = self._sims.observe()
        info = _single_info({**infos, **stepped})
        return _single(observations), float(rewards[0]), bool(terminated[0]), False, info

    def render(self) -> npt.NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The canvas, (512, 512, 3) uint8; None without ``render_mode="rgb_array"``."""
        return self._sims.native.images(True)[0] if self.render_mode == "rgb_array" else None


class PushTVectorEnv(NativeVectorEnv):
    """Native vector form of :class:`PushTEnv`: one call steps all environments."""

    metadata = METADATA

    def __init__(
        self,
        num_envs: int = 1,
        obs_type: str = "state",
        render_mode: str | None = None,
        *,
        goal_pose: npt.ArrayLike | None = None,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
    ) -> None:
        """Creates the simulations.

        Args:
            num_envs: Number of environments.
            obs_type: As for :class:`PushTEnv`.
            render_mode: None or ``rgb_array``.
            goal_pose: As for :class:`PushTEnv`.
            max_episode_steps: Number of steps after which an episode is truncated; None for no limit.
            autoreset_mode: ``NextStep``, ``SameStep`` or ``Disabled``.
            threads: Number of threads; 0 for one per processor. Results do not depend on it.
        """
        _check_render_mode(render_mode)
        space = _observation_space(obs_type)
        super().__init__(num_envs, space, _action_space(), max_episode_steps, autoreset_mode)
        self.render_mode = render_mode
        self._sims = _Sims(num_envs, obs_type, threads, goal_pose)

    def _begin(self, which: npt.NDArray[np.int64], seeds: list[int | None], options: Infos) -> None:
        self._sims.begin(which, [self._random(int(number)) for number in which], options)

    def _advance(self, actions: Any, active: npt.NDArray[np.bool_]) -> None:
        self._sims.native.step(np.ascontiguousarray(actions, dtype=np.float64), active)

    def _observe(self) -> tuple[Any, npt.NDArray[np.float64], npt.NDArray[np.bool_], Infos, Infos]:
        return self._sims.observe()

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """The canvases of all environments; None without ``render_mode="rgb_array"``."""
        return tuple(self._sims.native.images(True)) if self.render_mode == "rgb_array" else None


def _single(observations: Any) -> Any:
    if isinstance(observations, dict):
        return {key: values[0] for key, values in observations.items()}
    return observations[0]


def _single_info(infos: Infos) -> Infos:
    """The infos of the only simulation: numbers as Python's, arrays as numpy's."""
    return {key: values[0].item() if values.ndim == 1 else values[0] for key, values in infos.items()}
