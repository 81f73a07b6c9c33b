#!/bin/sh
# Runs every benchmark against its named rival and prints the figures of docs/results/performance.md.
# usage: RE4_DATA=<folder with pusht/pusht_cchi_v7_replay.zarr> benches/run.sh
set -eu
cd "$(dirname "$0")/.."
: "${RE4_DATA:?name the folder that holds pusht/pusht_cchi_v7_replay.zarr}"
scripts/setup.sh
dataset="$RE4_DATA/pusht/pusht_cchi_v7_replay.zarr"
venv="${VENV:-target/bench-venv}"
[ -x "$venv/bin/python" ] || python3 -m venv "$venv"
"$venv/bin/pip" install -q gym-pusht==0.1.8 zarr==2.18.7 "numcodecs<0.16" scipy polars pyarrow

echo "== simulator: control steps a second, against gym-pusht"
"$venv/bin/python" benches/pusht_sim.py 5
echo "== ingest: all images as bytes, against zarr-python"
"$venv/bin/python" benches/ingest_rate.py "$dataset" 5
echo "== retrieve: against numpy and scipy"
"$venv/bin/python" benches/retrieve.py "$dataset"
cargo build --release -q -p re4-pipe
echo "== poses from images: against OpenCV and numpy"
"$venv/bin/python" benches/poses.py "$dataset"
echo "== queries over 10,000 artifacts: against polars and pyarrow in Python, which read only the tables"
"$venv/bin/python" benches/query_rate.py
echo "== stages, whole commands"
artifacts="$(mktemp -d)"
trap 'rm -rf "$artifacts"' EXIT
target/release/re4-pipe run pipelines/pusht-state.toml --artifacts "$artifacts"
echo "== the same pipeline again"
target/release/re4-pipe run pipelines/pusht-state.toml --artifacts "$artifacts" --json
