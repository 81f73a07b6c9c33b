"""Runs of the native command."""

import os
import signal
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import pytest

import re4_pipe


def test_a_run_reports_its_progress_and_is_skipped_the_second_time(demo: re4_pipe.Pipeline, tmp_path: Path) -> None:
    pipeline = re4_pipe.Pipeline(demo.path, artifacts=tmp_path, set=demo.overrides, jobs=1)
    lines: list[str] = []
    first = pipeline.run("index", progress=lines.append)
    assert first.passed
    assert first.artifact.kind == "index"
    assert [word for line in lines if (word := line.split()[0]) != "warning"] == ["ingest", "segment", "index"]
    again: list[str] = []
    assert pipeline.run("index", progress=again.append).artifact.key == first.artifact.key
    assert sum("unchanged, skipped" in line for line in again) == 3


def test_settings_override_the_file(demo: re4_pipe.Pipeline) -> None:
    result = demo.run("rollout", set={"policy.kind": "paper", "rollout.max_steps": 3})
    assert result.artifact.config["policy"]["kind"] == "paper"
    assert result.artifact.polars("results")["steps"].to_list() == [3, 3, 3]
    assert result.summary["rollouts"] == 3


def test_every_kind_of_value_is_passed_on() -> None:
    from re4_pipe._pipeline import _toml

    assert _toml({"a b": [1, 2.5, True], "c": 'say "x"'}) == '{"a b" = [1, 2.5, true], "c" = "say \\"x\\""}'


def test_an_error_has_message_and_remedy(demo: re4_pipe.Pipeline) -> None:
    with pytest.raises(re4_pipe.Re4Error) as error:
        demo.run("rollout", set={"policy.kind": "re5"})
    assert "re5" in error.value.message
    assert error.value.remedy
    assert str(error.value) == f"{error.value.message}; {error.value.remedy}"
    with pytest.raises(re4_pipe.Re4Error, match="there is no stage 'rollouts'; give one of ingest"):
        demo.run("rollouts")
    with pytest.raises(re4_pipe.Re4Error, match="--nonsense"):
        demo.run("rollout", "--nonsense")


def test_a_failed_check_is_an_answer(can: re4_pipe.Pipeline) -> None:
    result = can.run("audit", "--fail-on", "error")
    assert not result.passed
    assert result.artifact.polars("findings").height > 0


def test_an_interrupt_ends_the_command_and_leaves_no_unfinished_artifact(demo: re4_pipe.Pipeline, tmp_path: Path) -> None:
    pipeline = re4_pipe.Pipeline(demo.path, artifacts=tmp_path, jobs=1)
    begun = threading.Event()

    def interrupt() -> None:
        begun.wait()
        # The rollouts take seconds; the signal arrives after their unfinished folder exists.
        while not list(tmp_path.glob(".tmp-*")) and not list(tmp_path.glob("rollouts/*")):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()

    def progress(line: str) -> None:
        if line.split()[0] == "index":
            begun.set()

    # A process that a shell starts in the background ignores interrupts, and so would Python.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            pipeline.run("rollout", set={"rollout.seeds": "200500..210000"}, progress=progress)
    finally:
        signal.signal(signal.SIGINT, before)
    thread.join()
    assert not (tmp_path / "rollouts").exists()
    assert not list(tmp_path.glob(".tmp-*"))
    assert len(list((tmp_path / "index").iterdir())) == 1


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_command_is_an_interrupt(
    demo: re4_pipe.Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sent: signal.Signals
) -> None:
    children: list[subprocess.Popen[str]] = []
    start = subprocess.Popen

    def popen(*arguments: Any, **settings: Any) -> subprocess.Popen[str]:
        children.append(start(*arguments, **settings))
        return children[-1]

    monkeypatch.setattr(subprocess, "Popen", popen)

    def progress(line: str) -> None:
        if line.split()[0] == "index":
            children[0].send_signal(sent)

    pipeline = re4_pipe.Pipeline(demo.path, artifacts=tmp_path, jobs=1)
    with pytest.raises(KeyboardInterrupt):
        pipeline.run("rollout", set={"rollout.seeds": "200500..210000"}, progress=progress)
    assert children[0].returncode == 75
    assert not (tmp_path / "rollouts").exists()


def test_an_error_of_the_callback_ends_the_command(demo: re4_pipe.Pipeline, tmp_path: Path) -> None:
    def progress(line: str) -> None:
        raise RuntimeError(line)

    with pytest.raises(RuntimeError, match="ingest"):
        re4_pipe.Pipeline(demo.path, artifacts=tmp_path).run("rollout", progress=progress)
