#!/bin/sh
# Runs the tests N times under a load that keeps all processors and the disk busy, and counts the failures of each test.
#
#   scripts/repeat-tests.sh N [cargo's arguments, as in -p re4-pipe kill::]
#
# RE4_LOAD is the number of busy loops (default: one per processor; 0: no load). Logs are in target/repeated-tests.
set -eu
cd "$(dirname "$0")/.."
case "${1:-}" in
    '' | *[!0-9]* | 0) echo "usage: scripts/repeat-tests.sh N [arguments of cargo test]" >&2; exit 2 ;;
esac
times="$1"
shift
. scripts/test-environment.sh
# shellcheck disable=SC2086 # a list of arguments
[ $# -gt 0 ] || set -- $ALL_TESTS
folder="$PWD/target/repeated-tests"
rm -rf "$folder"
mkdir -p "$folder"
RE4_TEST_LOGS="$folder/build"
export RE4_TEST_LOGS
run_tests --no-run "$@" >"$folder/build.log" 2>&1 || { cat "$folder/build.log" >&2; exit 1; }

load=""
scratch="$folder/scratch"
mkdir "$scratch"
finish() {
    # shellcheck disable=SC2086 # a list of process numbers
    [ -z "$load" ] || kill $load 2>/dev/null || true
    rm -rf "$scratch"
}
trap finish EXIT
trap 'exit 130' INT TERM HUP
loops="${RE4_LOAD:-$(nproc)}"
for _ in $(seq "$loops"); do
    (while :; do :; done) &
    load="$load $!"
done
if [ "$loops" -gt 0 ]; then
    # Writes 64 MiB repeatedly, each time synced to the disk.
    (while [ -d "$scratch" ]; do dd if=/dev/zero of="$scratch/load" bs=1M count=64 conv=fsync 2>/dev/null || true; done) &
    load="$load $!"
fi

bad=0
for run in $(seq "$times"); do
    RE4_TEST_LOGS="$folder/$run"
    start="$(date +%s)"
    code=0
    run_tests "$@" >"$folder/$run.log" 2>&1 || code=$?
    passed="$(sed -n 's/^test result: .* \([0-9]*\) passed; .*/\1/p' "$folder/$run.log" | awk '{ sum += $1 } END { print sum + 0 }')"
    echo "run $run of $times: $passed passed, $(cat "$RE4_TEST_LOGS/failed" 2>/dev/null | wc -l) failed, exit code $code, $(($(date +%s) - start)) s"
    if [ "$code" -ne 0 ]; then
        bad=$((bad + 1))
        [ -s "$RE4_TEST_LOGS/failed" ] || echo "cargo itself, see $folder/$run.log" >"$RE4_TEST_LOGS/failed"
    fi
done
echo "$((times - bad)) of $times runs without a failure, beside $loops busy loops"
cat "$folder"/*/failed 2>/dev/null | sort | uniq -c | sort -rn
[ "$bad" -eq 0 ]
