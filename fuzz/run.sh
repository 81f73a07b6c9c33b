#!/bin/sh
# Fuzzes all readers of untrusted bytes one after another: fuzz/run.sh [SECONDS] [TARGET...], 600 seconds each by default. It starts
# from the kept inputs in fuzz/corpus, which do not change. New inputs are written to fuzz/target/corpus; inputs that crash, hang or
# need too much memory to fuzz/artifacts. fuzz/run.sh merge TARGET... replaces the kept inputs by the smallest set of old and new
# ones that has the same coverage.
set -eu
cd "$(dirname "$0")/.."
scripts/setup.sh
if ! cargo fuzz --version >/dev/null 2>&1; then
    echo "fuzz: cargo-fuzz is needed; install it with: cargo install --locked cargo-fuzz" >&2
    exit 2
fi
command -v c++ >/dev/null 2>&1 || scripts/install-debian.sh fuzz g++

seconds=600
merge=no
case "${1:-}" in
    merge) merge=yes; shift ;;
    [0-9]*) seconds="$1"; shift ;;
esac
[ $# -gt 0 ] || set -- zarr zip hdf5 artifact pipeline

# Files of an input are kept in memory if the system has such a folder.
temporary="$(mktemp -d -p "$([ -w /dev/shm ] && echo /dev/shm || echo "${TMPDIR:-/tmp}")" re4-fuzz.XXXXXX)"
trap 'rm -rf "$temporary"' EXIT
trap 'exit 130' INT TERM
TMPDIR="$temporary"
# One worker thread, so that coverage depends only on the input.
RAYON_NUM_THREADS=1
export TMPDIR RAYON_NUM_THREADS

for target in "$@"; do
    found="fuzz/target/corpus/$target"
    kept="fuzz/corpus/$target"
    mkdir -p "$found" "$kept"
    # With the stable compiler and without sanitizers, which need nightly: there is no unsafe code to check here.
    if [ "$merge" = yes ]; then
        new="fuzz/target/merged/$target"
        rm -rf "$new"
        mkdir -p "$new"
        cargo fuzz run --sanitizer none "$target" "$new" "$kept" "$found" -- -set_cover_merge=1 -use_counters=0 -timeout=10 -rss_limit_mb=2048
        rm -rf "$kept"
        mv "$new" "$kept"
        continue
    fi
    echo "fuzz: $target for $seconds s" >&2
    cargo fuzz run --sanitizer none "$target" "$found" "$kept" -- -max_total_time="$seconds" -timeout=2 \
        -rss_limit_mb=2048 -max_len=16384 -dict="fuzz/dictionaries/$target.dict" -print_final_stats=1
done
