#!/bin/sh
# Fuzzes every reader of foreign bytes, one after another: fuzz/run.sh [SECONDS] [TARGET...], 600 seconds each by default.
# What is found goes to fuzz/target/corpus, inputs that crash, hang or take too much memory to fuzz/artifacts; the kept inputs
# in fuzz/corpus are where it starts from, and stay as they are. fuzz/run.sh merge TARGET... makes them anew: the fewest of
# both that reach all that any of them reaches.
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

# Files of an input lie in memory where the system has such a folder.
temporary="$(mktemp -d -p "$([ -w /dev/shm ] && echo /dev/shm || echo "${TMPDIR:-/tmp}")" re4-fuzz.XXXXXX)"
trap 'rm -rf "$temporary"' EXIT
trap 'exit 130' INT TERM
TMPDIR="$temporary"
# One thread of work: coverage then follows from the input alone.
RAYON_NUM_THREADS=1
export TMPDIR RAYON_NUM_THREADS

for target in "$@"; do
    found="fuzz/target/corpus/$target"
    kept="fuzz/corpus/$target"
    mkdir -p "$found" "$kept"
    # Of the compiler's stable release: the sanitizers need another one, and there is no unsafe code here to watch.
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
