#!/bin/sh
# Installs missing requirements and runs all checks: format, unit, property and end-to-end tests, documentation tests, lints. All
# checks run even if some fail. At the end it prints what failed and what was skipped; the exit code is 1 if anything failed.
# scripts/test-environment.sh lists the requirements of the tests, scripts/run-test-program.sh handles hanging tests. Logs of all
# test programs are in target/test-logs.
set -eu
cd "$(dirname "$0")/.."
started="$(date +%s)"
failed=""

# check WHAT COMMAND...: runs a command, and continues if it fails.
check() {
    what="$1"
    shift
    echo "test.sh: $what: $*" >&2
    "$@" || failed="$failed
  $what"
}

# Nothing can be built without these, so their failure ends the script.
scripts/setup.sh
# Fetches all packages of the lock file, including those for other systems, because the test of licences reads them offline.
cargo fetch --locked
check "setting up Python" scripts/setup-python.sh
check "setting up the server that simulates S3" scripts/setup-moto.sh
check "setting up the simulators" scripts/setup-simulators.sh
check "setting up Slurm and GlusterFS" scripts/setup-engines.sh
. scripts/test-environment.sh
RE4_TEST_LOGS="$PWD/target/test-logs"
export RE4_TEST_LOGS

check "format" cargo fmt --all --check
# shellcheck disable=SC2086 # a list of arguments
check "tests" run_tests $ALL_TESTS
# The feature is off by default, so the tests above are those of a program without it.
check "tests with object stores" cargo test --workspace --locked --features re4-pipe/object-store --test it object_store::
check "documentation tests" cargo test --workspace --locked --no-fail-fast --doc
check "lints" cargo clippy --workspace --all-targets --locked -- -D warnings
check "lints with object stores" cargo clippy --workspace --all-targets --locked --features re4-pipe/object-store -- -D warnings

{
    echo
    if [ -s "$RE4_TEST_LOGS/skipped" ]; then
        echo "Skipped, or parts of them:"
        sed 's/^/  /' "$RE4_TEST_LOGS/skipped"
    fi
    echo "Longest: $(sort -rn "$RE4_TEST_LOGS/results" 2>/dev/null | head -5 | awk '{ printf "%s%s %s s", (NR > 1 ? ", " : ""), $3, $1 }')"
    echo "test.sh: $(cat "$RE4_TEST_LOGS/results" 2>/dev/null | wc -l) test programs, all in all $(($(date +%s) - started)) s"
    if [ -n "$failed" ]; then
        echo "test.sh: failed:$failed"
        [ ! -s "$RE4_TEST_LOGS/failed" ] || sed 's/^/    /' "$RE4_TEST_LOGS/failed"
    else
        echo "test.sh: all passed"
    fi
} >&2
[ -z "$failed" ]
