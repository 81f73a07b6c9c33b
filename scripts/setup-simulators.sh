#!/bin/sh
# Installs the requirements for simulating Lift, Can and Square to data/simulators: MuJoCo's C library in the versions of robosuite
# 1.4.1 and 1.5.1, and the meshes and textures of robosuite's scenes. Also installs OSMesa from Debian, which renders without a
# display. Up-to-date parts are not changed. Downloads about 205 MB, of which 65 MB are kept.
set -eu
cd "$(dirname "$0")/.."
folder=data/simulators
wheels=scripts/simulators.txt

if [ "$(uname -s) $(uname -m)" != "Linux x86_64" ]; then
    echo "setup-simulators: the libraries are for Linux on x86_64, this is $(uname -s) on $(uname -m)" >&2
    exit 2
fi

has_pip() {
    "$1" -m pip --version >/dev/null 2>&1
}

missing=""
PATH="$PATH:/usr/sbin:/sbin" ldconfig -p | grep -q 'libOSMesa\.so' || missing="$missing libosmesa6"

# The requirements that a folder was made from; a folder made from other ones is replaced.
stamp_of() {
    { echo "$1"; cat scripts/unpack_simulator.py; } | sha256sum | cut -d' ' -f1
}
outdated=""
while read -r requirement options; do
    case "$requirement" in ''|'#'*) continue ;; esac
    made="$folder/$(echo "$requirement" | sed 's/==/-/')"
    if [ "$(cat "$made/STAMP" 2>/dev/null)" != "$(stamp_of "$requirement $options")" ]; then
        outdated="$outdated $requirement"
    fi
done < "$wheels"

if [ -n "$outdated" ]; then
    has_pip python3 || has_pip /usr/bin/python3 || missing="$missing python3 python3-pip"
fi
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086 # a list of package names
    scripts/install-debian.sh setup-simulators $missing
fi
[ -n "$outdated" ] || exit 0

python=""
for candidate in python3 /usr/bin/python3; do
    if [ -z "$python" ] && has_pip "$candidate"; then python="$candidate"; fi
done
if [ -z "$python" ]; then
    echo "setup-simulators: Python 3 with its module pip is needed; install it and run this again" >&2
    exit 2
fi

mkdir -p "$folder"
work="$(mktemp -d "$folder/.setup.XXXXXX")"
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT TERM
for requirement in $outdated; do
    name="$(echo "$requirement" | sed 's/==/-/')"
    line="$(grep "^$requirement " "$wheels")"
    echo "setup-simulators: fetching $requirement" >&2
    echo "$line" > "$work/requirement.txt"
    mkdir "$work/wheel" "$work/$name"
    # Downloads the wheel with this hash independent of the local Python version, since Python does not run any of it.
    "$python" -m pip download --quiet --disable-pip-version-check --no-input --no-deps --require-hashes \
        --only-binary=:all: --platform manylinux2014_x86_64 --python-version 3.11 --implementation cp \
        --dest "$work/wheel" -r "$work/requirement.txt"
    "$python" scripts/unpack_simulator.py "$work"/wheel/*.whl "$work/$name"
    stamp_of "$line" > "$work/$name/STAMP"
    chmod -R a+rX "$work/$name"
    # Replaced atomically: the old folder is removed only when the new one is complete.
    if [ -e "$folder/$name" ]; then mv "$folder/$name" "$work/old"; fi
    mv "$work/$name" "$folder/$name"
    rm -rf "$work/wheel" "$work/old"
done
