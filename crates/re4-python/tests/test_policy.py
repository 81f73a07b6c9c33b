"""Policies act as in the rollouts of their artifact."""

import os
import shutil
from pathlib import Path

import gymnasium
import numpy as np
import polars
import pytest
from conftest import REPOSITORY

import re4_pipe
import re4_pipe.envs

PLANAR = ["re4", "paper", "re2", "nearest", "gpi", "vinn", "alt", "diffusion", "flow"]


def scene(seed: int) -> list[float]:
    """The state that the seed scheme of Diffusion Policy requests: agent x, y, block x, y in px, angle in rad."""
    random = np.random.RandomState(seed)
    positions = [random.randint(low, high) for low, high in ((50, 450), (50, 450), (100, 400), (100, 400))]
    return [*map(float, positions), random.randn() * 2 * np.pi - np.pi]


def pl_seed(seed: int) -> polars.Expr:
    return polars.col("seed") == seed


@pytest.mark.parametrize("kind", PLANAR)
def test_actions_are_those_of_the_rollouts(demo: re4_pipe.Pipeline, kind: str) -> None:
    settings = {"policy.kind": kind, "rollout.max_steps": 60}
    if kind in ("diffusion", "flow"):
        settings |= {"policy.training.steps": 20, "policy.training.batch": 8, "rollout.max_steps": 20}
    rollouts = demo.run("rollout", set=settings).artifact
    policy = re4_pipe.Policy(rollouts)
    assert (policy.kind, policy.task, policy.observes_images) == (kind, "pusht", False)
    results, steps = rollouts.polars("results"), rollouts.polars("steps")
    env = gymnasium.make("re4/PushT-v0")
    for seed, success in results.select("seed", "success").iter_rows():
        observation, _ = env.reset(options={"reset_to_state": scene(seed)})
        policy.reset(seed)
        terminated = False
        for row in steps.filter(pl_seed(seed)).sort("step").iter_rows(named=True):
            action = policy.act(observation)
            assert action.tolist() == [row["action_x"], row["action_y"]], f"step {row['step']}"
            assert policy.phase == row["phase"]
            observation, _, terminated, _, _ = env.step(action)
        assert terminated == success
        assert policy.decision is not None
        assert policy.decision["reason"] == rollouts.polars("decisions").filter(pl_seed(seed))["reason"][-1]


def test_observations_in_other_forms_give_the_same_actions(rollouts: re4_pipe.Artifact) -> None:
    state = gymnasium.make("re4/PushT-v0")
    corners = gymnasium.make("re4/PushT-v0", obs_type="environment_state_agent_pos")
    by_state, by_mapping, by_corners = (re4_pipe.Policy(rollouts) for _ in range(3))
    observation, _ = state.reset(seed=200_000)
    other, _ = corners.reset(seed=200_000)
    for _ in range(30):
        action = by_state.act(observation)
        mapping = {"agent_pos": observation[:2], "block_pose": observation[2:]}
        np.testing.assert_array_equal(by_mapping.act(mapping), action)
        np.testing.assert_allclose(by_corners.act(other), action, atol=1e-6)
        observation, *_ = state.step(action)
        other, *_ = corners.step(action)


def test_copies_have_episodes_of_their_own(rollouts: re4_pipe.Artifact) -> None:
    policy = re4_pipe.Policy(rollouts)
    other = policy.copy()
    first, second = [100.0, 100.0, 200.0, 300.0, 1.0], [400.0, 300.0, 250.0, 150.0, 4.0]
    alone = [re4_pipe.Policy(rollouts).act(np.array(state)).tolist() for state in (first, second)]
    assert [policy.act(np.array(first)).tolist(), other.act(np.array(second)).tolist()] == alone
    policy.reset()
    assert policy.act(np.array(second)).tolist() == alone[1]


def test_another_goal_moves_the_whole_problem(rollouts: re4_pipe.Artifact) -> None:
    """With the goal moved by a translation, and the scene with it, the action is moved in the same way."""
    policy, moved = re4_pipe.Policy(rollouts), re4_pipe.Policy(rollouts)
    state = np.array([200.0, 300.0, 260.0, 240.0, 1.0])
    shift = np.array([20.0, -30.0])
    moved.reset(goal_pose=[256 + shift[0], 256 + shift[1], np.pi / 4])
    there = state + np.array([*shift, *shift, 0.0])
    np.testing.assert_allclose(moved.act(there), policy.act(state) + shift, atol=1e-9)


def test_images_are_estimated(tmp_path: Path) -> None:
    few = {"rollout.seeds": "200500..200501", "rollout.max_steps": 12}
    pipeline = re4_pipe.Pipeline(REPOSITORY / "pipelines/demo-image.toml", artifacts=tmp_path, set=few)
    policy = re4_pipe.Policy(pipeline)
    assert policy.observes_images
    rollouts = pipeline.run("rollout").artifact
    env = gymnasium.make("re4/PushT-v0", obs_type="pixels_agent_pos")
    observation, _ = env.reset(options={"reset_to_state": scene(200500)})
    policy.reset(200500)
    for row in rollouts.polars("steps").sort("step").iter_rows(named=True):
        action = policy.act(observation)
        assert action.tolist() == [row["action_x"], row["action_y"]]
        observation, *_ = env.step(action)
    with pytest.raises(re4_pipe.Re4Error, match="no image; give one as pixels"):
        policy.act({"agent_pos": [1.0, 2.0]})


def test_wrong_observations_are_errors(rollouts: re4_pipe.Artifact) -> None:
    policy = re4_pipe.Policy(rollouts)
    with pytest.raises(re4_pipe.Re4Error, match="state of the observation has 4 numbers; give 5"):
        policy.act(np.zeros(4))
    with pytest.raises(re4_pipe.Re4Error, match="no block_pose; give it; the keys of the observation are: agent_pos"):
        policy.act({"agent_pos": [1.0, 2.0]})
    with pytest.raises(re4_pipe.Re4Error, match="kind index; give the folder of a rollouts"):
        re4_pipe.Policy(rollouts.input("index"))


def test_a_missing_input_is_an_error(rollouts: re4_pipe.Artifact, tmp_path: Path) -> None:
    copy = shutil.copytree(rollouts.path, tmp_path / "rollouts" / rollouts.path.name)
    with pytest.raises(re4_pipe.Re4Error, match="is missing; run the pipeline again, or copy"):
        re4_pipe.Policy(copy)


@pytest.mark.parametrize(("task", "kind"), [("can", "re4"), ("lift", "gpi")])
def test_robosuite_actions_are_those_of_the_rollouts(simulators: Path, tmp_path: Path, task: str, kind: str) -> None:
    data = Path(os.environ.get("RE4_TEST_DATA", ""))
    if not (data / "robomimic-scripted").is_dir():
        pytest.skip("the scripted demonstrations are not there")
    source = data / f"robomimic-scripted/{task}/low_dim.hdf5"
    few = {"ingest.source": str(source), "ingest.select": {"first": 10}, "policy.kind": kind}
    few |= {"rollout.seeds": "201000..201002", "rollout.max_steps": 60}
    pipeline = re4_pipe.Pipeline(REPOSITORY / f"pipelines/{task}-state.toml", artifacts=tmp_path, set=few)
    rollouts = pipeline.run("rollout").artifact
    policy = re4_pipe.Policy(rollouts)
    assert (policy.kind, policy.task) == (kind, task)
    env = gymnasium.make(f"re4/{task.capitalize()}-v0", control="absolute", demonstrations=rollouts.input("episodes"))
    names = ["action_x", "action_y", "action_z", "action_rx", "action_ry", "action_rz", "gripper"]
    for seed in (201000, 201001):
        recorded = rollouts.polars("steps").filter(pl_seed(seed)).sort("step")
        observation, _ = env.reset(seed=seed)
        policy.reset(seed)
        for row in recorded.iter_rows(named=True):
            action = policy.act(observation)
            assert action.tolist() == [row[name] for name in names], f"step {row['step']}"
            observation, *_ = env.step(action)
