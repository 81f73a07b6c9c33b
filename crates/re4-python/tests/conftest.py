"""Artifacts for the tests: the demo pipeline on the sample in data/, made by the native command."""

import os
from pathlib import Path

import pytest

import re4_pipe

REPOSITORY = Path(__file__).resolve().parents[3]


def pytest_configure() -> None:
    # Sources of pipeline files are in the folder of the sample.
    os.environ["RE4_DATA"] = str(REPOSITORY / "data")


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> re4_pipe.Pipeline:
    """The demo pipeline on few scenes."""
    folder = tmp_path_factory.mktemp("demo")
    few = {"rollout.seeds": "200500..200503", "rollout.max_steps": 80}
    return re4_pipe.Pipeline(REPOSITORY / "pipelines/demo.toml", artifacts=folder / "artifacts", set=few)


@pytest.fixture(scope="session")
def rollouts(demo: re4_pipe.Pipeline) -> re4_pipe.Artifact:
    """Rollouts of the policy re4."""
    return demo.run("rollout").artifact


@pytest.fixture(scope="session")
def can(tmp_path_factory: pytest.TempPathFactory) -> re4_pipe.Pipeline:
    """A pipeline over the demonstrations of Can in data/, which have no simulator states."""
    folder = tmp_path_factory.mktemp("can")
    text = """
task = "can"
variant = "state"

[ingest]
source = "can-sample.hdf5"

[segment]
rule = "gripper_command"

[pose]
source = "recorded"

[index]
"""
    path = folder / "can.toml"
    path.write_text(text)
    return re4_pipe.Pipeline(path, artifacts=folder / "artifacts")


@pytest.fixture
def simulators() -> Path:
    """The folder with MuJoCo and robosuite's meshes; without it, the test is skipped."""
    folder = Path(os.environ.get("RE4_SIMULATORS") or REPOSITORY / "data/simulators")
    if not folder.is_dir():
        pytest.skip("MuJoCo is not installed; run scripts/setup-simulators.sh")
    os.environ["RE4_SIMULATORS"] = str(folder)
    return folder
