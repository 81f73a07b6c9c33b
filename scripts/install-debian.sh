#!/bin/sh
# Installs Debian packages, as root or with sudo. The arguments: who asks, for its messages, and the packages.
set -eu
asker="$1"
shift

if ! command -v apt-get >/dev/null 2>&1; then
    echo "$asker: please install the equivalents of these Debian packages and run this again: $*" >&2
    exit 2
fi
run=""
if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null 2>&1 || { echo "$asker: run as root once, or install: $*" >&2; exit 2; }
    run=sudo
fi
echo "$asker: installing $*" >&2
$run apt-get update -q >/dev/null
# sudo drops the caller's environment, so the variable is set behind it.
$run env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "$@" >/dev/null
