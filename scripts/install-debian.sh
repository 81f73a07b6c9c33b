#!/bin/sh
# Installs Debian packages, as root or with sudo. Arguments: the name of the calling script, for messages, and the packages.
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
# A machine that was just started may be installing updates, so this waits for locks and retries failed downloads of the lists.
for left in 5 4 3 2 1 0; do
    if $run apt-get -o DPkg::Lock::Timeout=600 update -q >/dev/null; then
        break
    elif [ "$left" -eq 0 ]; then
        echo "$asker: apt-get update fails; fix that and run this again" >&2
        exit 2
    fi
    sleep 10
done
# sudo drops the caller's environment, so the variable is set after it.
$run env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=600 install -y -q --no-install-recommends "$@" >/dev/null
