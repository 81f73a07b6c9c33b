#!/bin/sh
# Installs what the tests of clusters need: Slurm and MUNGE (13 MB) and GlusterFS (36 MB) from Debian, and with the argument `ray` also
# Ray, in a virtual environment in target/ray (285 MB).
set -eu
cd "$(dirname "$0")/.."

missing=""
command -v slurmctld >/dev/null 2>&1 || missing="$missing slurmctld"
command -v slurmd >/dev/null 2>&1 || missing="$missing slurmd"
command -v sbatch >/dev/null 2>&1 || missing="$missing slurm-client"
command -v munged >/dev/null 2>&1 || missing="$missing munge"
command -v glusterfsd >/dev/null 2>&1 || missing="$missing glusterfs-server"
command -v glusterfs >/dev/null 2>&1 || missing="$missing glusterfs-client"
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086 # a list of package names
    scripts/install-debian.sh setup-engines $missing
fi
[ "${1:-}" = ray ] || exit 0
if ! target/ray/bin/python -c 'import ray' >/dev/null 2>&1; then
    echo "setup-engines: installing Ray into target/ray" >&2
    python3 -m venv --clear target/ray
    target/ray/bin/python -m pip install --quiet --no-compile --disable-pip-version-check --no-input "ray==2.60.0"
fi
