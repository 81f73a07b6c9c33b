#!/bin/sh
# Builds the Python wheel of re4-pipe for Linux on x86-64, and prints its path: target/wheels/re4_pipe-*.whl. It holds the native
# command without the subcommand query, whose engine would triple its size, and with its own HDF5 library, so it needs no libraries
# but those of C and C++. The wheel is compressed by zopfli, whose output is smaller than that of zlib, and HDF5 is compiled by cmake;
# both are installed into target/wheel-tools, cmake only if it is missing. Needs Python 3.11.
set -eu
cd "$(dirname "$0")/.."
scripts/setup.sh

tools="$PWD/target/wheel-tools"
install() {
    "$tools/bin/python" -m pip install --quiet --disable-pip-version-check --no-input "$1"
}
[ -x "$tools/bin/python" ] || python3 -m venv "$tools"
"$tools/bin/python" -c 'import zopfli' 2>/dev/null || install zopfli==0.4.3
if ! command -v cmake >/dev/null 2>&1; then
    [ -x "$tools/bin/cmake" ] || install cmake==4.4.5
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
"$tools/bin/python" crates/re4-python/pack_wheel.py "$work/re4-pipe" "$work/libre4_python.so" target/wheels "$work/notices.txt"
