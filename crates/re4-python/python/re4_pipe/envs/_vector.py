"""What the native vector environments share: resets, the limit of steps, and the modes of automatic resets."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from re4_pipe._errors import Re4Error

Infos = dict[str, Any]


class NativeVectorEnv(VectorEnv[Any, Any, Any]):
    """A vector of simulations that one native object steps.

    Observations, rewards, ends and infos are those of ``gymnasium.vector.SyncVectorEnv`` over the single environments with the same
    seeds and actions, in every mode of automatic resets.
    """

    def __init__(
        self,
        num_envs: int,
        single_observation_space: gymnasium.Space[Any],
        single_action_space: gymnasium.Space[Any],
        max_episode_steps: int | None,
        autoreset_mode: AutoresetMode | str,
    ) -> None:
        super().__init__()
        if num_envs < 1:
            raise Re4Error(f"num_envs is {num_envs}", "give 1 or more")
        self.num_envs = num_envs
        self.single_observation_space = single_observation_space
        self.single_action_space = single_action_space
        self.observation_space = batch_space(single_observation_space, num_envs)
        self.action_space = batch_space(single_action_space, num_envs)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        # make_vec passes the limit of the registration; as in make, -1 is no limit.
        self.max_episode_steps = None if max_episode_steps == -1 else max_episode_steps
        self._randoms: list[np.random.Generator | None] = [None] * num_envs
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._ended = np.zeros(num_envs, dtype=np.bool_)

    @abstractmethod
    def _begin(self, which: npt.NDArray[np.int64], seeds: list[int | None], options: Infos) -> None:
        """Resets some simulations. `seeds` are those that a user gave, `_random` the generators of the environments."""

    @abstractmethod
    def _advance(self, actions: Any, active: npt.NDArray[np.bool_]) -> None:
        """Steps the active simulations."""

    @abstractmethod
    def _observe(self) -> tuple[Any, npt.NDArray[np.float64], npt.NDArray[np.bool_], Infos, Infos]:
        """Observations, rewards and terminations of all simulations, infos of all, and infos only of those that were stepped."""

    def _random(self, number: int) -> np.random.Generator:
        generator = self._randoms[number]
        if generator is None:
            generator = self._randoms[number] = seeding.np_random()[0]
        return generator

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: Infos | None = None) -> tuple[Any, Infos]:
        """Resets all environments, or those in the boolean array ``options["reset_mask"]``.

        Args:
            seed: A seed for each environment; an int seeds them with ``seed``, ``seed + 1``, ...
            options: As for the single environment.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        which = np.arange(self.num_envs) if mask is None else np.flatnonzero(_checked(mask, self.num_envs))
        if seed is None or isinstance(seed, (int, np.integer)):
            seeds = [None if seed is None else int(seed) + number for number in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"there are {len(seeds)} seeds for {self.num_envs} environments")
        chosen = [seeds[number] for number in which]
        for number, one in zip(which, chosen, strict=True):
            if one is not None:
                self._randoms[number] = seeding.np_random(one)[0]
        self._begin(which, chosen, options)
        self._steps[which] = 0
        self._ended[which] = False
        observations, _, _, infos, _ = self._observe()
        reset = np.zeros(self.num_envs, dtype=np.bool_)
        reset[which] = True
        return observations, _masked(infos, reset)

    def step(self, actions: Any) -> tuple[Any, npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], Infos]:
        """Executes one control step of every environment."""
        if self.autoreset_mode == AutoresetMode.DISABLED and self._ended.any():
            raise Re4Error(
                f"environment {int(np.argmax(self._ended))} has ended",
                'reset it with options={"reset_mask": ...}, or choose another autoreset_mode',
            )
        resetting = self._ended.copy() if self.autoreset_mode == AutoresetMode.NEXT_STEP else np.zeros_like(self._ended)
        active = ~resetting
        self._advance(actions, active)
        if resetting.any():
            self._restart(resetting)
        self._steps += active
        observations, rewards, terminations, common, stepped = self._observe()
        rewards = np.where(active, rewards, 0.0)
        terminations = terminations & active
        limit = self.max_episode_steps
        truncations = (self._steps >= limit) & active if limit is not None else np.zeros_like(active)
        infos = {**_masked(common, np.ones_like(active)), **_masked(stepped, active)}
        self._ended = terminations | truncations
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._ended.any():
            observations, infos = self._restart_at_once(observations, common, stepped)
        return observations, rewards, terminations, truncations, infos

    def _restart(self, mask: npt.NDArray[np.bool_]) -> None:
        """Resets environments without a seed."""
        which = np.flatnonzero(mask)
        self._begin(which, [None] * len(which), {})
        self._steps[which] = 0

    def _restart_at_once(self, final: Any, common: Infos, stepped: Infos) -> tuple[Any, Infos]:
        """Resets the environments that have ended in the step in which they ended."""
        ended = self._ended.copy()
        final_info = {**_masked(common, ended), **_masked(stepped, ended)}
        final_obs = np.full(self.num_envs, fill_value=None, dtype=object)
        for number in np.flatnonzero(ended):
            final_obs[number] = _one(final, int(number))
        self._restart(ended)
        self._ended[:] = False
        observations, _, _, after, _ = self._observe()
        infos = {**_masked(after, np.ones_like(ended)), **_masked(stepped, ~ended)}
        infos.update(final_obs=final_obs, _final_obs=ended, final_info=final_info, _final_info=ended.copy())
        return observations, infos


def _checked(mask: Any, count: int) -> npt.NDArray[np.bool_]:
    if not isinstance(mask, np.ndarray) or mask.shape != (count,) or mask.dtype != np.bool_ or not mask.any():
        raise ValueError(f'options["reset_mask"] has to be a boolean array of the shape ({count},) with a true entry')
    return mask


def _masked(infos: Infos, mask: npt.NDArray[np.bool_]) -> Infos:
    """Infos with the masks of the environments that have them; no infos if none has. Elsewhere they are zeros."""
    if not mask.any():
        return {}
    result: Infos = {}
    for key, values in infos.items():
        shaped = mask.reshape(-1, *[1] * (values.ndim - 1))
        result[key], result[f"_{key}"] = np.where(shaped, values, np.zeros_like(values)), mask.copy()
    return result


def _one(observations: Any, number: int) -> Any:
    """The observation of one environment."""
    if isinstance(observations, dict):
        return {key: deepcopy(values[number]) for key, values in observations.items()}
    return observations[number].copy()
