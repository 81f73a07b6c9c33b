"""Executes a notebook from top to bottom, in its own folder, and fails if a cell fails.

    python run_notebook.py NOTEBOOK.ipynb [EXECUTED.ipynb]

The notebook with its outputs is written to the second path. If a cell fails, it is printed with its error, and the exit code is 1.
"""

import os
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from traitlets.config import Config


def main() -> int:
    path = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as scratch:
        # Without the user's history and settings.
        os.environ.update(IPYTHONDIR=scratch, JUPYTER_RUNTIME_DIR=scratch, JUPYTER_CONFIG_DIR=scratch)
        notebook = nbformat.read(path, as_version=4)
        # The kernel communicates through sockets in its own folder, because ports could be in use by another run.
        config = Config({"KernelManager": {"transport": "ipc", "ip": f"{scratch}/kernel"}})
        where = {"metadata": {"path": path.parent}}
        # All outputs of a cell have to arrive, also on a busy machine. By default, outputs after 4 seconds are dropped silently.
        patience = dict(timeout=1800, startup_timeout=600, iopub_timeout=600, raise_on_iopub_timeout=True)
        client = NotebookClient(notebook, config=config, kernel_name="python3", resources=where, **patience)
        try:
            client.execute()
        except CellExecutionError as error:
            print(error, file=sys.stderr)
            return 1
        finally:
            if len(sys.argv) > 2:
                nbformat.write(notebook, sys.argv[2])
    return 0


if __name__ == "__main__":
    sys.exit(main())
