#!/bin/sh
# Installs moto's server, which simulates S3 for the tests of object stores, into a virtual environment in target/moto with the packages
# that tests/moto-requirements.txt pins. An up-to-date environment is not changed. Needs scripts/setup-python.sh.
set -eu
cd "$(dirname "$0")/.."
environment=target/moto
stamp="$environment/requirements.sha256"
wanted="$(sha256sum <tests/moto-requirements.txt)"
if [ -x "$environment/bin/moto_server" ] && [ -e "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ]; then
    exit 0
fi
if [ ! -x target/python/bin/python ]; then
    echo "setup-moto: there is no target/python/bin/python; run scripts/setup-python.sh first" >&2
    exit 2
fi
echo "setup-moto: installing the packages of tests/moto-requirements.txt into $environment" >&2
rm -rf "$environment"
target/python/bin/python -m venv "$environment"
"$environment/bin/python" -m pip install --quiet --no-compile --disable-pip-version-check --no-input -r tests/moto-requirements.txt
# Written last, so that an interrupted setup is repeated.
echo "$wanted" > "$stamp"
