#!/bin/sh
# Installs missing requirements, builds re4-pipe and runs the demo pipeline on the sample in data/. Writes the page demo.html and
# prints a score table.
set -eu
cd "$(dirname "$0")/.."
scripts/setup.sh
cargo build --release --locked -p re4-pipe
exec target/release/re4-pipe run pipelines/demo.toml --report demo.html "$@"
