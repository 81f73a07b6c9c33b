#!/bin/sh
# Installs what the build needs and this machine lacks: a C toolchain and the physics library Chipmunk, from Debian.
set -eu

if ! command -v cargo >/dev/null 2>&1; then
    echo "setup: Rust 1.95 or newer is needed and cargo is not on the PATH; install it with rustup and run this again" >&2
    exit 2
fi

missing=""
command -v cc >/dev/null 2>&1 || missing="$missing gcc libc6-dev"
[ -e /usr/include/chipmunk/chipmunk.h ] || missing="$missing libchipmunk-dev"
[ -n "$missing" ] || exit 0

if ! command -v apt-get >/dev/null 2>&1; then
    echo "setup: please install the equivalents of these Debian packages and run this again:$missing" >&2
    exit 2
fi
run=""
if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null 2>&1 || { echo "setup: run as root once, or install:$missing" >&2; exit 2; }
    run=sudo
fi
echo "setup: installing$missing" >&2
$run apt-get update -q >/dev/null
# shellcheck disable=SC2086 # a list of package names
DEBIAN_FRONTEND=noninteractive $run apt-get install -y -q --no-install-recommends $missing >/dev/null
