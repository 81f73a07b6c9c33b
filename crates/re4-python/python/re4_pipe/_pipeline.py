"""Runs the stages of a pipeline file by the native command."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from ._artifact import Artifact
from ._command import command
from ._errors import Re4Error

STAGES = ("ingest", "segment", "audit", "train-encoder", "train-pose", "index", "train", "scenes", "rollout", "run", "replay")

# Exit code of the command after Ctrl-C or SIGTERM. It ends by the signal itself only if this arrives before the command listens.
INTERRUPTED = 75


@dataclass(frozen=True)
class Result:
    """What a stage answered.

    Attributes:
        answer: The JSON answer of the command.
        passed: False if a check failed, such as ``--fail-on`` of ``audit``.
    """

    answer: dict[str, Any]
    passed: bool = True

    @property
    def artifact(self) -> Artifact:
        """The artifact of the stage that was run; of ``run``, that of the last stage."""
        for entry in (self.answer, *_nested(self.answer)):
            if isinstance(entry.get("artifact"), str):
                return Artifact(entry["artifact"])
        raise Re4Error("the command named no artifact")

    @property
    def summary(self) -> dict[str, Any]:
        """Figures that summarise the artifact."""
        return self.artifact.summary

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Warnings of all stages that ran."""
        return self.answer.get("warnings", [])


def _nested(answer: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [value for value in answer.values() if isinstance(value, dict)]


class Pipeline:
    """A pipeline file and where its artifacts are.

    Example:
        >>> pipeline = Pipeline("pipelines/demo.toml")
        >>> result = pipeline.run("rollout", set={"rollout.seeds": "500..520"}, progress=print)
        >>> result.artifact.polars("results")
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        artifacts: str | os.PathLike[str] = "artifacts",
        set: Mapping[str, Any] | None = None,
        jobs: int | None = None,
    ) -> None:
        """Describes the runs of a pipeline file; nothing is run or read.

        Args:
            path: The pipeline file.
            artifacts: Folder of the artifacts.
            set: Settings that override those of the file, by their path: ``{"policy.kind": "paper"}``.
            jobs: Number of threads; None for one per processor. Results do not depend on it.
        """
        self.path = Path(path)
        self.artifacts = Path(artifacts)
        self.overrides = dict(set or {})
        self.jobs = jobs

    def __repr__(self) -> str:
        return f"Pipeline({str(self.path)!r}, artifacts={str(self.artifacts)!r})"

    def run(
        self,
        stage: str = "run",
        *arguments: str,
        set: Mapping[str, Any] | None = None,
        progress: Callable[[str], object] | None = None,
    ) -> Result:
        """Runs a stage, and the stages before it whose artifacts do not exist.

        An interrupt (Ctrl-C, or the interrupt of a notebook) ends the stage; no unfinished artifact remains. So does a signal that
        another program sends to the command.

        Args:
            stage: A stage: ``ingest``, ``segment``, ``audit``, ``train-encoder``, ``train-pose``, ``index``, ``train``,
                ``scenes``, ``rollout``, ``replay``, or ``run`` for the whole pipeline.
            arguments: Further arguments of the command, such as ``"--fail-on", "error"``.
            set: Settings that override those of the file and of this object.
            progress: Called with every line that the command prints about its progress, in this thread.

        Raises:
            Re4Error: If the command refuses the input. It has the message and the remedy of the command.
            KeyboardInterrupt: If the run was interrupted.
        """
        if stage not in STAGES:
            raise Re4Error(f"there is no stage {stage!r}", f"give one of {', '.join(STAGES)}")
        call: list[str] = [str(command()), stage, str(self.path), "--json", "--artifacts", str(self.artifacts)]
        for name, value in {**self.overrides, **(set or {})}.items():
            call += ["--set", f"{name}={_toml(value)}"]
        if self.jobs is not None:
            call += ["--jobs", str(self.jobs)]
        code, output, notes = _communicate([*call, *arguments], progress)
        try:
            answer = json.loads(output)
        except ValueError:
            answer = {}
        if code not in (0, 1) or "error" in answer:
            raise Re4Error(answer.get("error") or _last_line(notes, code), answer.get("remedy"))
        return Result(answer, passed=code == 0)


def _toml(value: Any) -> str:
    """A value as TOML: a boolean, number, string, list or table."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(str(name))} = {_toml(entry)}" for name, entry in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(entry) for entry in value) + "]"
    if isinstance(value, (bool, int, float)):
        return json.dumps(value)
    return json.dumps(str(value), ensure_ascii=False)


def _last_line(notes: Sequence[str], code: int) -> str:
    last = notes[-1] if notes else f"the command ended with code {code}"
    return last.removeprefix("error: ")


def _communicate(call: Sequence[str], progress: Callable[[str], object] | None) -> tuple[int, str, list[str]]:
    """Runs a command and returns its exit code, its standard output and the lines of its standard error."""
    # In its own group of processes, the command does not receive the Ctrl-C of a terminal, so it receives exactly one interrupt,
    # from here, whatever interrupted Python.
    child = subprocess.Popen(
        call, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    lines: queue.SimpleQueue[tuple[bool, str] | None] = queue.SimpleQueue()
    readers = [
        threading.Thread(target=_read, args=(stream, is_note, lines), daemon=True)
        for is_note, stream in ((False, child.stdout), (True, child.stderr))
    ]
    output: list[str] = []
    notes: list[str] = []
    try:
        for reader in readers:
            reader.start()
        open_streams = len(readers)
        while open_streams:
            try:
                # The limit lets this thread handle an interrupt that the system delivered to another one.
                item = lines.get(timeout=0.1)
            except queue.Empty:
                continue
            if item is None:
                open_streams -= 1
                continue
            is_note, line = item
            if not is_note:
                output.append(line)
                continue
            notes.append(line.rstrip("\n"))
            if progress is not None:
                progress(notes[-1])
        code = child.wait()
    except BaseException:
        _stop(child)
        raise
    if code in (INTERRUPTED, -signal.SIGINT, -signal.SIGTERM):
        raise KeyboardInterrupt
    return code, "".join(output), notes


def _read(stream: IO[str], is_note: bool, into: queue.SimpleQueue[tuple[bool, str] | None]) -> None:
    """Passes on the lines of a stream; None is its end."""
    with stream:
        for line in stream:
            into.put((is_note, line))
    into.put(None)


def _stop(child: subprocess.Popen[str]) -> None:
    """Interrupts a command, which removes its unfinished output, and waits for its end."""
    if child.poll() is None:
        child.send_signal(signal.SIGINT)
        try:
            # The command ends itself within a second.
            child.wait(timeout=30)
        except (subprocess.TimeoutExpired, KeyboardInterrupt):
            child.kill()
            child.wait()
