"""Finds the native command."""

from __future__ import annotations

import os
import shutil
import sysconfig
from pathlib import Path

from ._errors import Re4Error

NAME = "re4-pipe"


def _folders() -> list[Path]:
    """Where installers put scripts: the environment's folder, the user's, and that of ``pip install --target``."""
    user = "osx_framework_user" if sysconfig.get_config_var("PYTHONFRAMEWORK") else f"{os.name}_user"
    here = Path(__file__).resolve().parent.parent
    return [Path(sysconfig.get_path("scripts")), Path(sysconfig.get_path("scripts", user)), here / "bin"]


def command() -> Path:
    """The path of the command ``re4-pipe`` that was installed with this package, otherwise the one on the ``PATH``.

    Raises:
        Re4Error: If there is none.
    """
    # With `pip install --target`, the command beside the package is the one that belongs to it.
    *scripts, beside = _folders()
    for folder in [beside, *scripts]:
        path = folder / NAME
        if path.is_file() and os.access(path, os.X_OK):
            return path
    found = shutil.which(NAME)
    if found is None:
        raise Re4Error("the command re4-pipe is not installed", "install the wheel of re4-pipe again")
    return Path(found)
