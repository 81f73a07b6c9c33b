"""The gymnasium environments."""

import gzip
import hashlib
import json
import subprocess
import sys
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import REPOSITORY
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import re4_pipe
import re4_pipe.envs

ANSWER = ("observations", "rewards", "terminations", "truncations", "infos")
OBSERVATIONS = ["state", "environment_state_agent_pos", "pixels", "pixels_agent_pos"]


@pytest.mark.parametrize("obs_type", OBSERVATIONS)
def test_push_t_passes_gymnasiums_check(obs_type: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # gym-pusht's actions are pixels, too.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized space.*")
        env = gymnasium.make("re4/PushT-v0", obs_type=obs_type, render_mode="rgb_array")
        check_env(env.unwrapped)


def test_the_id_needs_no_import() -> None:
    code = "import gymnasium; print(gymnasium.make('re4_pipe.envs:re4/PushT-v0').reset(seed=0)[0].shape)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "(5,)\n"


def plain(value: Any) -> Any:
    """A value in the form of the recorded file."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray) and value.dtype == np.uint8:
        return hashlib.sha256(value.tobytes()).hexdigest()
    return np.asarray(value).tolist()


def test_episodes_are_those_of_gym_pusht() -> None:
    """Bit for bit: scenes of seeds and of the states after them, observations, images, rewards, infos."""
    episodes = json.loads(gzip.decompress(Path(__file__).with_name("gym_pusht.json.gz").read_bytes()))["episodes"]
    contacts = 0
    envs: dict[str, gymnasium.Env] = {}
    for episode in episodes:
        # Later episodes of a type continue the random numbers of the earlier ones.
        env = envs.setdefault(episode["obs_type"], gymnasium.make("re4/PushT-v0", obs_type=episode["obs_type"]))
        observation, info = env.reset(**episode["start"])
        assert plain(observation) == episode["first"]
        expected = episode["first_info"]
        assert {**plain(info), "n_contacts": 0} == {**expected, "n_contacts": 0}
        for action, observed, reward, terminated, truncated, expected, points in episode["steps"]:
            observation, own_reward, own_terminated, own_truncated, info = env.step(np.array(action, dtype=np.float32))
            assert plain(observation) == observed
            # The coverage is computed by another algorithm.
            assert own_reward == pytest.approx(reward, abs=1e-12)
            assert info["coverage"] == pytest.approx(expected["coverage"], abs=1e-12)
            assert (own_terminated, own_truncated) == (terminated, truncated)
            for key in ("pos_agent", "vel_agent", "block_pose", "goal_pose", "is_success"):
                assert plain(info[key]) == expected[key], key
            # gym-pusht divides by 1000 steps instead of 10.
            assert info["n_contacts"] == -(-points // 10)
            contacts += info["n_contacts"] > 1
    assert contacts > 10


def test_a_reset_to_a_state_in_the_order_pose_keeps_the_block() -> None:
    env = gymnasium.make("re4/PushT-v0")
    state = [100.0, 100.0, 300.0, 250.0, 2.0]
    kept, _ = env.reset(options={"reset_to_state": state, "reset_order": "pose"})
    np.testing.assert_allclose(kept, state, atol=1e-9)
    moved, _ = env.reset(options={"reset_to_state": state})
    assert np.abs(moved - state).max() > 10
    # Unknown options are accepted, as other programs pass their own.
    env.reset(options={"something": 1})


def test_another_goal_changes_coverage_and_info() -> None:
    env = gymnasium.make("re4/PushT-v0", goal_pose=[300.0, 250.0, 1.0])
    env.reset(options={"reset_to_state": [50.0, 50.0, 300.0, 250.0, 1.0], "reset_order": "pose"})
    _, reward, terminated, _, info = env.step(np.array([50.0, 50.0], dtype=np.float32))
    assert (reward, terminated, info["is_success"]) == (1.0, True, True)
    assert info["goal_pose"].tolist() == [300.0, 250.0, 1.0]


def test_the_limit_of_steps() -> None:
    assert gymnasium.spec("re4/PushT-v0").max_episode_steps == 300
    env = gymnasium.make("re4/PushT-v0", max_episode_steps=3)
    env.reset(seed=0)
    ends = [env.step(np.zeros(2, dtype=np.float32))[3] for _ in range(3)]
    assert ends == [False, False, True]


def test_rendering() -> None:
    env = gymnasium.make("re4/PushT-v0", render_mode="rgb_array")
    env.reset(seed=0)
    image = env.render()
    assert isinstance(image, np.ndarray)
    assert (image.shape, image.dtype) == ((512, 512, 3), np.uint8)
    vector = gymnasium.make_vec("re4/PushT-v0", 3, render_mode="rgb_array")
    vector.reset(seed=0)
    images = vector.render()
    assert images is not None
    assert len(images) == 3
    np.testing.assert_array_equal(images[0], image)


def same(a: Any, b: Any, path: str) -> None:
    """Asserts that observations or infos are equal, with types and masks."""
    if isinstance(a, dict) and isinstance(b, dict):
        assert sorted(a) == sorted(b), path
        for key in a:
            same(a[key], b[key], f"{path}/{key}")
    elif isinstance(a, np.ndarray) and a.dtype == object:
        for number, (one, other) in enumerate(zip(a, b, strict=True)):
            same(one, other, f"{path}/{number}")
    elif a is None:
        assert b is None, path
    else:
        assert np.asarray(a).dtype == np.asarray(b).dtype, path
        np.testing.assert_array_equal(a, b, err_msg=path)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("obs_type", ["state", "pixels_agent_pos"])
def test_the_vector_form_is_that_of_gymnasium(mode: AutoresetMode, obs_type: str) -> None:
    """Observations, rewards, ends and infos are those of SyncVectorEnv over single environments."""
    count, limit, goal = 5, 7, [256.0, 256.0, 0.8]
    settings = {"obs_type": obs_type, "goal_pose": goal}
    own = gymnasium.make_vec("re4/PushT-v0", count, max_episode_steps=limit, autoreset_mode=mode, **settings)
    assert isinstance(own, re4_pipe.envs.PushTVectorEnv)
    assert own.metadata["autoreset_mode"] == mode

    single = partial(gymnasium.make, "re4/PushT-v0", max_episode_steps=limit, **settings)
    other = SyncVectorEnv([single] * count, autoreset_mode=mode)
    assert own.single_observation_space == other.single_observation_space
    assert own.observation_space == other.observation_space
    assert own.action_space == other.action_space
    (observations, infos), (expected, expected_infos) = own.reset(seed=3), other.reset(seed=3)
    same(observations, expected, "obs")
    same(infos, expected_infos, "infos")
    # The second environment starts on its goal and terminates in its first step; its later episodes are truncated like the others.
    on_goal = {"reset_to_state": [50.0, 50.0, *goal], "reset_order": "pose", "reset_mask": np.arange(count) == 1}
    (observations, infos), (expected, expected_infos) = (env.reset(options=dict(on_goal)) for env in (own, other))
    same(observations, expected, "obs")
    same(infos, expected_infos, "infos")
    random = np.random.default_rng(0)
    ends = np.zeros(2, dtype=int)
    for step in range(20):
        actions = random.uniform(50, 450, (count, 2)).astype(np.float32)
        if step == 0:
            actions[1] = [50.0, 50.0]
        answer, expected = own.step(actions), other.step(actions)
        for name, a, b in zip(ANSWER, answer, expected, strict=True):
            same(a, b, f"step {step}: {name}")
        ends += [answer[2].sum(), answer[3].sum()]
    assert ends[0] == 1
    assert ends[1] >= 8


def test_without_automatic_resets_an_ended_environment_is_an_error() -> None:
    env = gymnasium.make_vec("re4/PushT-v0", 2, max_episode_steps=1, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0)
    env.step(np.zeros((2, 2), dtype=np.float32))
    with pytest.raises(re4_pipe.Re4Error, match="environment 0 has ended; reset it"):
        env.step(np.zeros((2, 2), dtype=np.float32))
    env.reset(options={"reset_mask": np.array([True, True])})
    env.step(np.zeros((2, 2), dtype=np.float32))


def test_threads_do_not_change_results() -> None:
    random = np.random.default_rng(0)
    actions = random.uniform(50, 450, (10, 40, 2)).astype(np.float32)
    envs = [gymnasium.make_vec("re4/PushT-v0", 40, threads=threads) for threads in (1, 4)]
    for env in envs:
        env.reset(seed=9)
    for row in actions:
        (a, *_), (b, *_) = (env.step(row) for env in envs)
        np.testing.assert_array_equal(a, b)


def test_observations_are_not_overwritten() -> None:
    env = gymnasium.make_vec("re4/PushT-v0", 2)
    first, _ = env.reset(seed=0)
    kept = first.copy()
    env.step(np.full((2, 2), 400, dtype=np.float32))
    np.testing.assert_array_equal(first, kept)


def test_wrong_settings_are_errors() -> None:
    with pytest.raises(re4_pipe.Re4Error, match="obs_type is 'keypoints'; give one of state, "):
        re4_pipe.envs.PushTEnv(obs_type="keypoints")
    with pytest.raises(re4_pipe.Re4Error, match="render_mode is 'human'"):
        re4_pipe.envs.PushTEnv(render_mode="human")
    env = re4_pipe.envs.PushTEnv()
    env.reset(seed=0)
    with pytest.raises(re4_pipe.Re4Error, match="target_x"):
        env.step(np.array([np.nan, 0.0]))
    vector = re4_pipe.envs.PushTVectorEnv(3)
    vector.reset(seed=0)
    with pytest.raises(re4_pipe.Re4Error, match="environment 1: .*target_y"):
        vector.step(np.array([[1.0, 1.0], [1.0, np.inf], [1.0, 1.0]]))


@pytest.mark.parametrize("task", ["lift", "can", "square"])
def test_robosuite_passes_gymnasiums_check(simulators: Path, task: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # States are not bounded.
        warnings.filterwarnings("ignore", message=".*Box observation space m.*")
        warnings.filterwarnings("ignore", message=".*not within.*")
        check_env(gymnasium.make(f"re4/{task.capitalize()}-v0").unwrapped, skip_render_check=True)


def reference(name: str) -> dict[str, np.ndarray]:
    """A reference of crate re4-sim, which robosuite recorded; see crates/re4-sim/tests/data/robosuite/README.md."""
    with gzip.open(REPOSITORY / f"crates/re4-sim/tests/data/robosuite/{name}.bin.gz") as file:
        header = json.loads(file.readline())
        content = file.read()
    types = {"f64": "<f8", "u32": "<u4", "u8": "u1"}

    def array(of: dict[str, Any]) -> np.ndarray:
        count = int(np.prod(of["shape"]))
        return np.frombuffer(content, types[of["dtype"]], count, of["offset"]).reshape(of["shape"])

    arrays = header["arrays"]
    entries = arrays.items() if isinstance(arrays, dict) else ((of["name"], of) for of in arrays)
    return {name: array(of) for name, of in entries}


@pytest.mark.parametrize("task", ["lift", "can", "square"])
def test_scenes_are_those_of_robosuite(simulators: Path, task: str) -> None:
    placed = reference(f"placement_{task}_1.4.1")
    env = re4_pipe.envs.RobosuiteEnv(task)
    for row in (0, 57, 199):
        env.reset(seed=int(placed["seeds"][row]))
        coordinates = env._sims.native.state(0)[1 : 1 + placed["qpos"].shape[1]]
        np.testing.assert_array_equal(coordinates, placed["qpos"][row])


def test_robosuite_vectors_are_those_of_gymnasium(simulators: Path) -> None:
    count, limit = 3, 4
    for control, size in (("delta", 1.0), ("absolute", 0.2)):
        settings = {"max_episode_steps": limit, "control": control}
        own = gymnasium.make_vec("re4/Lift-v0", count, **settings)
        other = SyncVectorEnv([partial(gymnasium.make, "re4/Lift-v0", **settings)] * count)
        (observations, infos), (expected, expected_infos) = own.reset(seed=3), other.reset(seed=3)
        same(observations, expected, "obs")
        same(infos, expected_infos, "infos")
        random = np.random.default_rng(0)
        for step in range(limit):
            actions = random.uniform(-size, size, (count, 7)).astype(own.action_space.dtype)
            for name, a, b in zip(ANSWER, own.step(actions), other.step(actions), strict=True):
                same(a, b, f"{control} {step}: {name}")


def test_without_a_simulator_the_error_says_how_to_get_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RE4_SIMULATORS", str(tmp_path))
    with pytest.raises(re4_pipe.Re4Error, match="cannot simulate lift: MuJoCo is not in .*; run scripts/setup-simulators"):
        gymnasium.make("re4/Lift-v0")
