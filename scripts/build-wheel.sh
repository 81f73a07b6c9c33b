#!/bin/sh
# Builds the Python wheel of re4-pipe for Linux on x86-64, and prints its path: target/wheels/re4_pipe-*.whl. It holds the native
# command without the subcommand query, whose engine would triple its size, and with its own HDF5 library, so it needs no libraries
# but those of C and C++. HDF5 is compiled by cmake, which is installed into target/wheel-tools if it is missing. Needs Python 3.11.
set -eu
cd "$(dirname "$0")/.."
scripts/setup.sh

if ! command -v cmake >/dev/null 2>&1; then
    tools="$PWD/target/wheel-tools"
    if [ ! -x "$tools/bin/cmake" ]; then
        python3 -m venv "$tools"
        "$tools/bin/python" -m pip install --quiet --disable-pip-version-check --no-input cmake==4.4.5
    fi
    PATH="$tools/bin:$PATH"
    export PATH
fi

mkdir -p target
work="$(mktemp -d target/wheel-work.XXXXXX)"
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT TERM
python3 scripts/wheel_profile.py > "$work/profile.toml"
# One call for both, so that they share the dependencies with the same features.
cargo build --config "$work/profile.toml" --profile wheel --locked -p re4-pipe -p re4-python --no-default-features \
    --features re4-pipe/static-hdf5,re4-python/static-hdf5 >&2
for file in re4-pipe libre4_python.so; do
    strip -o "$work/$file" "target/wheel/$file"
done
python3 scripts/third_party.py > "$work/notices.txt"
python3 crates/re4-python/pack_wheel.py "$work/re4-pipe" "$work/libre4_python.so" target/wheels "$work/notices.txt"
