"""Executes a notebook from top to bottom, in its own folder, and fails where a cell fails.

    python run_notebook.py NOTEBOOK.ipynb [EXECUTED.ipynb]

The second path gets the notebook with its outputs. The first cell that fails is printed with its error; exit code 1.
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
        # Neither history nor settings of whoever runs it.
        os.environ.update(IPYTHONDIR=scratch, JUPYTER_RUNTIME_DIR=scratch, JUPYTER_CONFIG_DIR=scratch)
        notebook = nbformat.read(path, as_version=4)
        # Talks to the kernel through sockets in a folder of its own: ports could be taken by another run.
        config = Config({"KernelManager": {"transport": "ipc", "ip": f"{scratch}/kernel"}})
        where = {"metadata": {"path": path.parent}}
        # Whatever a cell draws has to arrive, on a busy machine, too: by default what comes after 4 seconds is left out in silence.
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
