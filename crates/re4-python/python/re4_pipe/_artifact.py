"""Artifacts: folders of Parquet tables with a manifest."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ._errors import Re4Error

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow


@dataclass(frozen=True)
class Table:
    """A table of an artifact."""

    name: str
    """Name in the manifest."""
    path: Path
    """The Parquet file; the first one if the artifact is in parts."""
    rows: int
    """Number of rows."""
    schema_version: int
    """Version of the columns, which ``docs/reference/tables.md`` describes."""
    paths: tuple[Path, ...] = ()
    """The Parquet files in the order of the rows. There are several if the artifact is in parts."""


class Artifact(Mapping[str, Table]):
    """An artifact of a stage. As a mapping, it has the tables by their names, in alphabetical order.

    Attributes:
        path: The folder.
        manifest: The content of ``manifest.json``.
    """

    def __init__(self, path: str | os.PathLike[str], *, verify: bool = False) -> None:
        """Opens the artifact in a folder.

        Args:
            path: The folder.
            verify: Whether to compare every byte of the tables with the hashes in the manifest.

        Raises:
            Re4Error: If the folder is no artifact, is damaged, or was written by a newer version.
        """
        from . import _native

        self.path = Path(path)
        self.manifest: dict[str, Any] = json.loads(_native.manifest(self.path, verify))

    @property
    def kind(self) -> str:
        """Kind of artifact: ``episodes``, ``modes``, ``audit``, ``index``, ``rollouts``, ..."""
        return self.manifest["artifact"]

    @property
    def key(self) -> str:
        """Hash of everything that determined the bytes of the artifact, 64 hexadecimal digits."""
        return self.manifest["key"]

    @property
    def config(self) -> dict[str, Any]:
        """Configuration of the stage."""
        return self.manifest["config"]

    @property
    def summary(self) -> dict[str, Any]:
        """Figures that summarise the content."""
        return self.manifest["summary"]

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Warnings of the stage, each with ``code`` and ``message``."""
        return self.manifest["warnings"]

    def __getitem__(self, name: str) -> Table:
        try:
            entry = self.manifest["tables"][name]
        except KeyError:
            known = ", ".join(self) or "none"
            raise Re4Error(f"{self.path} has no table {name}", f"its tables are: {known}") from None
        parts = [f"parts/{part['part']}/" for part in entry.get("parts", [])] or [""]
        paths = tuple(self.path / f"{part}{entry['file']}" for part in parts)
        return Table(name, paths[0], entry["rows"], entry["schema_version"], paths)

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self.manifest["tables"]))

    def __len__(self) -> int:
        return len(self.manifest["tables"])

    def __contains__(self, name: object) -> bool:
        return name in self.manifest["tables"]

    def __repr__(self) -> str:
        return f"Artifact({str(self.path)!r}, kind={self.kind!r}, tables={list(self)})"

    def polars(self, table: str, columns: list[str] | None = None) -> polars.DataFrame:
        """A table as a polars DataFrame. Needs the package polars (``pip install re4-pipe[polars]``).

        ``polars.scan_parquet(artifact[table].paths)`` reads it lazily.
        """
        return _needed("polars").read_parquet(list(self[table].paths), columns=columns)

    def arrow(self, table: str, columns: list[str] | None = None) -> pyarrow.Table:
        """A table as a pyarrow Table, with descriptions, units and frames of reference in the metadata of its fields.

        Needs the package pyarrow (``pip install re4-pipe[arrow]``).
        """
        arrow = _needed("pyarrow")
        read = import_module("pyarrow.parquet").read_table
        tables = [read(path, columns=columns) for path in self[table].paths]
        return tables[0] if len(tables) == 1 else arrow.concat_tables(tables).unify_dictionaries()

    def pandas(self, table: str, columns: list[str] | None = None) -> pandas.DataFrame:
        """A table as a pandas DataFrame. Needs the packages pandas and pyarrow (``pip install re4-pipe[pandas]``)."""
        _needed("pandas")
        return self.arrow(table, columns).to_pandas()

    def input(self, kind: str) -> Artifact:
        """The artifact of a kind from which this one was made, in the same artifacts folder.

        Raises:
            Re4Error: If this artifact was not made from one, or it is missing.
        """
        keys: dict[str, str] = self.manifest["inputs"]
        if kind not in keys:
            known = ", ".join(sorted(keys)) or "none"
            raise Re4Error(f"{self.path} was not made from an artifact of kind {kind}", f"its inputs are: {known}")
        return Artifact(self.path.absolute().parent.parent / kind / keys[kind][:16])


def _needed(package: str) -> Any:
    try:
        return import_module(package)
    except ImportError as error:
        extra = {"pyarrow": "arrow"}.get(package, package)
        raise Re4Error(f"the Python package {package} is not installed", f"pip install 're4-pipe[{extra}]'") from error


def open_artifact(path: str | os.PathLike[str], *, verify: bool = False) -> Artifact:
    """Opens the artifact in a folder, such as ``artifacts/rollouts/0123456789abcdef``.

    Args:
        path: The folder.
        verify: Whether to compare every byte of the tables with the hashes in the manifest.

    Raises:
        Re4Error: If the folder is no artifact, is damaged, or was written by a newer version.
    """
    return Artifact(path, verify=verify)
