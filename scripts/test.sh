#!/bin/sh
# Sets up what is missing and passes every check: format, lints, unit, property and end-to-end tests, documentation tests.
# Tests that run Python (the notebook, the report in a browser) run where RE4_PYTHON names its interpreter, as here.
# Tests that simulate Lift, Can and Square find MuJoCo and robosuite's assets where RE4_SIMULATORS names their folder.
# Tests on the human Push-T demonstrations run where RE4_DATA names the folder that holds them, or where they lie in
# ../shared/data; otherwise they say that they are skipped.
set -eu
cd "$(dirname "$0")/.."
scripts/setup.sh
scripts/setup-python.sh
scripts/setup-simulators.sh
RE4_SIMULATORS="${RE4_SIMULATORS:-$PWD/data/simulators}"
export RE4_SIMULATORS
RE4_PYTHON="$PWD/target/python/bin/python"
export RE4_PYTHON
if [ -z "${RE4_DATA:-}" ] && [ -d ../shared/data/pusht ]; then
    RE4_DATA="$(cd ../shared/data && pwd)"
    export RE4_DATA
fi
# Every package of the lock file, also those for other systems: the test of licences reads them all, without the network.
cargo fetch --locked
cargo fmt --all --check
cargo clippy --workspace --all-targets --locked -- -D warnings
cargo test --workspace --locked
