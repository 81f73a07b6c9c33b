"""The native command, `python -m re4_pipe`, and the import."""

import os
import subprocess
import sys

import pytest

import re4_pipe


def run(*call: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(call, capture_output=True, text=True, check=False)


def test_the_command_and_the_module_have_one_version() -> None:
    answer = f"re4-pipe {re4_pipe.__version__}\n"
    assert run(str(re4_pipe.command()), "--version").stdout == answer
    assert run(sys.executable, "-m", "re4_pipe", "--version").stdout == answer


def test_the_module_passes_on_the_exit_code() -> None:
    wrong = run(sys.executable, "-m", "re4_pipe", "ingest", "there-is-no-such-file.toml")
    assert wrong.returncode == 2
    assert "there-is-no-such-file.toml" in wrong.stderr


def test_the_import_loads_nothing_else() -> None:
    code = "import sys, re4_pipe; print([m for m in ('numpy', 'gymnasium', 'polars', 're4_pipe._native') if m in sys.modules])"
    assert run(sys.executable, "-c", code).stdout == "[]\n"


def test_all_names_exist() -> None:
    assert set(re4_pipe.__all__) <= set(dir(re4_pipe))
    for name in re4_pipe.__all__:
        assert getattr(re4_pipe, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        re4_pipe.nonsense  # noqa: B018


def test_a_missing_command_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: os.PathLike[str]) -> None:
    from re4_pipe import _command

    monkeypatch.setattr(_command, "_folders", list)
    monkeypatch.setattr(_command, "_folders", lambda: [tmp_path])
    monkeypatch.setenv("PATH", "")
    with pytest.raises(re4_pipe.Re4Error, match="not installed; install the wheel"):
        _command.command()


def test_the_stubs_describe_the_extension_module() -> None:
    import ast
    from pathlib import Path

    from re4_pipe import _native

    stubs = ast.parse(Path(_native.__file__).with_name("_native.pyi").read_text())
    described = {"__version__"}
    for entry in stubs.body:
        if isinstance(entry, ast.FunctionDef):
            described.add(entry.name)
        elif isinstance(entry, ast.ClassDef):
            described.add(entry.name)
            methods = {method.name for method in entry.body if isinstance(method, ast.FunctionDef)} - {"__new__"}
            actual = {name for name in dir(getattr(_native, entry.name)) if not name.startswith("_")}
            assert methods == actual, entry.name
    actual = {name for name in dir(_native) if not name.startswith("_")} | {"__version__"}
    assert described == actual - {"__all__"}
