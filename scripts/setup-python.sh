#!/bin/sh
# Installs Python and browser requirements of the tests: missing Debian packages, and a virtual environment in target/python with
# the packages that tests/requirements.txt pins. An up-to-date environment is not changed.
set -eu
cd "$(dirname "$0")/.."
environment=target/python
stamp="$environment/requirements.sha256"

# Whether this is Python 3.11 or newer with support for virtual environments.
fits() {
    "$1" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1
}

missing=""
command -v chromium >/dev/null 2>&1 || missing="$missing chromium"
command -v chromedriver >/dev/null 2>&1 || missing="$missing chromium-driver"
wanted="$(cat notebooks/requirements.txt tests/requirements.txt | sha256sum)"
made=no
if [ -x "$environment/bin/python" ] && [ -e "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ]; then
    made=yes
fi
if [ "$made" = no ]; then
    fits python3 || fits /usr/bin/python3 || missing="$missing python3 python3-venv"
fi
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086 # a list of package names
    scripts/install-debian.sh setup-python $missing
fi
[ "$made" = no ] || exit 0

base=""
for candidate in python3 /usr/bin/python3; do
    if [ -z "$base" ] && fits "$candidate"; then base="$candidate"; fi
done
if [ -z "$base" ]; then
    echo "setup-python: Python 3.11 or newer with its module venv is needed; install it and run this again" >&2
    exit 2
fi
echo "setup-python: installing the packages of tests/requirements.txt into $environment" >&2
rm -rf "$environment"
"$base" -m venv "$environment"
"$environment/bin/python" -m pip install --quiet --no-compile --disable-pip-version-check --no-input -r tests/requirements.txt
# What the wheel of the Python package needs in a clean environment, which a test makes without a network.
"$environment/bin/python" -m pip download --quiet --disable-pip-version-check --no-input --no-deps --dest "$environment/wheels" \
    "$(grep '^numpy==' notebooks/requirements.txt)"
# Written last, so that an interrupted setup is repeated.
echo "$wanted" > "$stamp"
