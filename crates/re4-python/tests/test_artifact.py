"""Artifacts and their tables."""

import json
import shutil
import subprocess
from pathlib import Path

import polars
import pytest

import re4_pipe


def test_tables_are_the_same_in_every_library(rollouts: re4_pipe.Artifact) -> None:
    assert rollouts.kind == "rollouts"
    assert len(rollouts.key) == 64
    assert list(rollouts) == sorted(rollouts.manifest["tables"])
    for name, table in rollouts.items():
        frame = rollouts.polars(name)
        assert frame.height == table.rows == rollouts.arrow(name).num_rows
        assert frame.equals(polars.from_arrow(rollouts.arrow(name)))
    results = rollouts.pandas("results", ["seed", "steps"])
    assert results.columns.tolist() == ["seed", "steps"]
    assert results["seed"].tolist() == [200500, 200501, 200502]


def test_an_artifact_in_parts_is_one_table(tmp_path: Path) -> None:
    settings = {"rollout.seeds": "300000..301030", "rollout.max_steps": 2}
    path = Path(__file__).resolve().parents[3] / "pipelines/demo.toml"
    many = re4_pipe.Pipeline(path, artifacts=tmp_path, set=settings).run("rollout").artifact
    assert [path.parent.name for path in many["results"].paths] == ["000000", "000001"]
    results = many.polars("results", ["episode", "seed"])
    assert results["episode"].to_list() == list(range(1030))
    assert results.equals(polars.from_arrow(many.arrow("results", ["episode", "seed"])))
    assert many.pandas("results", ["seed"])["seed"].tolist() == list(range(300000, 301030))
    assert len(many.pandas("steps")) == many["steps"].rows


def test_arrow_fields_have_units_and_descriptions(rollouts: re4_pipe.Artifact) -> None:
    field = rollouts.arrow("steps").schema.field("eef_x")
    assert field.metadata[b"unit"] == b"px"
    assert field.metadata[b"frame"] == b"world"
    assert field.metadata[b"description"]


def test_inputs_are_found_beside_the_artifact(rollouts: re4_pipe.Artifact) -> None:
    index = rollouts.input("index")
    assert index.kind == "index"
    assert index.key == rollouts.manifest["inputs"]["index"]
    with pytest.raises(re4_pipe.Re4Error, match="not made from an artifact of kind poses; its inputs are: "):
        rollouts.input("poses")


def test_an_unknown_table_is_an_error(rollouts: re4_pipe.Artifact) -> None:
    with pytest.raises(re4_pipe.Re4Error, match="has no table nonsense; its tables are: budgets, decisions") as error:
        rollouts.polars("nonsense")
    assert error.value.remedy is not None
    assert error.value.remedy.startswith("its tables are")
    assert "nonsense" not in rollouts


def test_errors_have_the_sentence_of_the_command_line(tmp_path: Path) -> None:
    with pytest.raises(re4_pipe.Re4Error) as error:
        re4_pipe.open_artifact(tmp_path / "nothing")
    call = [re4_pipe.command(), "inspect", tmp_path / "nothing"]
    printed = subprocess.run(call, capture_output=True, text=True, check=False).stderr
    assert printed == f"error: {error.value}\n"


def test_damage_is_found(rollouts: re4_pipe.Artifact, tmp_path: Path) -> None:
    copy = shutil.copytree(rollouts.path, tmp_path / "copy")
    path = copy / "results.parquet"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    re4_pipe.open_artifact(copy)
    with pytest.raises(re4_pipe.Re4Error, match=r"results\.parquet"):
        re4_pipe.open_artifact(copy, verify=True)
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["summary"]["rollouts"] = 7
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(re4_pipe.Re4Error, match=r"manifest\.json"):
        re4_pipe.open_artifact(copy)


def test_a_missing_package_is_an_error_with_its_extra(rollouts: re4_pipe.Artifact, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(re4_pipe.Re4Error, match=r"pandas is not installed; pip install 're4-pipe\[pandas\]'"):
        rollouts.pandas("results")
