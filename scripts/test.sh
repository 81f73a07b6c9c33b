#!/bin/sh
# Sets up what is missing and runs every check: format, unit, property and end-to-end tests, documentation tests, lints. All of
# them run, whichever fail; at the end stands what failed and what was skipped, and the exit code is 1 where anything failed.
# scripts/test-environment.sh says what the tests need, scripts/run-test-program.sh what becomes of one that hangs. Logs of all
# test programs are in target/test-logs.
set -eu
cd "$(dirname "$0")/.."
started="$(date +%s)"
failed=""

# check WHAT COMMAND...: runs it, and goes on where it fails.
check() {
    what="$1"
    shift
    echo "test.sh: $what: $*" >&2
    "$@" || failed="$failed
  $what"
}

# Without these nothing can be built.
scripts/setup.sh
# Every package of the lock file, also those for other systems: the test of licences reads them all, without the network.
cargo fetch --locked
check "setting up Python" scripts/setup-python.sh
check "setting up the simulators" scripts/setup-simulators.sh
. scripts/test-environment.sh
RE4_TEST_LOGS="$PWD/target/test-logs"
export RE4_TEST_LOGS

check "format" cargo fmt --all --check
# shellcheck disable=SC2086 # a list of arguments
check "tests" run_tests $ALL_TESTS
check "documentation tests" cargo test --workspace --locked --no-fail-fast --doc
check "lints" cargo clippy --workspace --all-targets --locked -- -D warnings

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
