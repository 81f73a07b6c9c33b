"""Writes the models of robosuite 1.4.1 that the environments simulate, from the reference traces of crate re4-sim.

    python3 make_models.py

A trace is one line of JSON, whose entry `xml` is the model that robosuite wrote, and arrays. Paths of assets begin with `robosuite/`.
"""

import gzip
import json
from pathlib import Path

HERE = Path(__file__).resolve().parent
TRACES = HERE / "../re4-sim/tests/data/robosuite"


def main() -> None:
    for task in ("lift", "can", "square"):
        with gzip.open(TRACES / f"trace_{task}_1.4.1_absolute.bin.gz") as file:
            text = json.loads(file.readline())["xml"]
        path = HERE / f"python/re4_pipe/models/{task}.xml.gz"
        # Without a time, so that the same model gives the same bytes.
        path.write_bytes(gzip.compress(text.encode(), compresslevel=9, mtime=0))
        print(path.name, len(text), path.stat().st_size)


if __name__ == "__main__":
    main()
