#!/bin/sh
# Runs one test program for cargo with a time limit, so that a hanging test does not block the following ones: after RE4_TEST_LIMIT
# seconds (default 2700), the program and all processes that it started are killed. Its output goes to a log in RE4_TEST_LOGS. The
# output of passed tests is removed from the log at the end, except for messages about skipped tests. In RE4_TEST_LOGS,
#   results   gets a line `seconds exit-code package/program`
#   failed    gets a line `package/program test` for each failed test, and for each program that was killed or crashed
#   skipped   gets a line `package/program test: reason` for each skipped test
set -u
limit="${RE4_TEST_LIMIT:-2700}"
logs="${RE4_TEST_LOGS:-}"
# Listing tests runs none of them, and without a folder for logs nothing is recorded.
case " $* " in *' --list '*) exec "$@" ;; esac
if [ -z "$logs" ]; then
    exec timeout --kill-after=60 "$limit" "$@"
fi

# cargo runs test programs in the folder of their package.
name="$(basename "$PWD")/$(basename "$1" | sed 's/-[0-9a-f]\{16\}$//')"
log="$logs/$(echo "$name" | tr / .).log"
start="$(date +%s)"
# The program runs in its own process group, so that its child processes are killed with it, and interrupts are passed on. The shell
# makes background commands ignore interrupts, which would break tests of interrupts.
timeout --kill-after=60 "$limit" env --default-signal=INT,QUIT "$@" --show-output >"$log" 2>&1 &
running=$!
trap 'kill -TERM "$running" 2>/dev/null' INT TERM HUP
wait "$running"
code=$?
while kill -0 "$running" 2>/dev/null; do
    wait "$running"
    code=$?
done
seconds=$(($(date +%s) - start))

awk '/^successes:$/ { quiet = 1 } /^(failures:$|test result: )/ { quiet = 0 } !quiet' "$log"
echo "$seconds $code $name" >>"$logs/results"
awk -v name="$name" '
    /^---- .* stdout ----$/ { test = $2 }
    /^skipped/ { print name " " test ": " $0 }
' "$log" | sort -u >>"$logs/skipped"
if [ "$code" -ne 0 ]; then
    {
        sed -n "s|^test \(.*\) \.\.\. FAILED\$|$name \1|p" "$log"
        case "$code" in
            101) ;;
            124 | 137)
                # Probably the tests that were running, because tests start in the order of their names.
                "$1" --list 2>/dev/null | sed -n 's/: test$//p' | while read -r test; do
                    grep -qF "test $test ... " "$log" || echo "$test"
                done | head -n "${RUST_TEST_THREADS:-$(nproc)}" | tr '\n' ' ' |
                    sed "s|^|$name was ended after $seconds s; not done: |; s| \$|\n|"
                ;;
            *) echo "$name ended with code $code, not with a failed test" ;;
        esac
    } | tee -a "$logs/failed"
fi
exit "$code"
