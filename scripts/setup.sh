#!/bin/sh
# Installs missing requirements of the build from Debian: a C toolchain, the physics library Chipmunk and the HDF5 library.
set -eu
cd "$(dirname "$0")/.."

if ! command -v cargo >/dev/null 2>&1; then
    echo "setup: Rust 1.95 or newer is needed and cargo is not on the PATH; install it with rustup and run this again" >&2
    exit 2
fi

missing=""
command -v cc >/dev/null 2>&1 || missing="$missing gcc libc6-dev"
[ -e /usr/include/chipmunk/chipmunk.h ] || missing="$missing libchipmunk-dev"
# The build finds HDF5 with pkg-config.
command -v pkg-config >/dev/null 2>&1 || missing="$missing pkg-config"
pkg-config --exists hdf5 2>/dev/null || missing="$missing libhdf5-dev"
[ -n "$missing" ] || exit 0
# shellcheck disable=SC2086 # a list of package names
exec scripts/install-debian.sh setup $missing
