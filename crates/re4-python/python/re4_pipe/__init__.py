"""Robot demonstrations, policies by retrieval, and simulators.

The package holds the command ``re4-pipe`` and gives access to its results:

* :func:`open_artifact` opens an artifact; its tables become polars, pyarrow or pandas tables.
* :class:`Pipeline` runs the stages of a pipeline file.
* :class:`Retriever` answers batches of exact queries of an index.
* :class:`Policy` acts on observations as in the rollouts of an artifact.
* ``re4_pipe.envs`` has gymnasium environments: importing it registers ``re4/PushT-v0``, ``re4/Lift-v0``, ``re4/Can-v0`` and
  ``re4/Square-v0``.

Importing the package imports nothing else, not even numpy; each name is loaded when it is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._artifact import Artifact, Table, open_artifact
    from ._command import command
    from ._errors import Re4Error
    from ._native import __version__
    from ._pipeline import Pipeline, Result
    from ._policy import Policy
    from ._retriever import Retrieved, Retriever

__all__ = [
    "Artifact",
    "Pipeline",
    "Policy",
    "Re4Error",
    "Result",
    "Retrieved",
    "Retriever",
    "Table",
    "__version__",
    "command",
    "open_artifact",
]

_MODULES = {
    "Artifact": "_artifact",
    "Pipeline": "_pipeline",
    "Policy": "_policy",
    "Re4Error": "_errors",
    "Result": "_pipeline",
    "Retrieved": "_retriever",
    "Retriever": "_retriever",
    "Table": "_artifact",
    "__version__": "_native",
    "command": "_command",
    "open_artifact": "_artifact",
}


def __getattr__(name: str) -> Any:
    module = _MODULES.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"{__name__}.{module}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
