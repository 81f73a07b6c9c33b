#!/bin/sh
# Runs one test program for cargo, so that a test that hangs does not hang the tests behind it: ends it, with all that it
# started, after RE4_TEST_LIMIT seconds (2700 by default). All that it prints goes to a log below RE4_TEST_LOGS; in the end what
# tests that passed printed is left out, but for the words of tests that were skipped. In RE4_TEST_LOGS
#   results   gets a line `seconds exit-code package/program`
#   failed    gets a line `package/program test` for each test that failed, and for each program that was ended or fell over
#   skipped   gets a line `package/program test: why` for each test that says so
set -u
limit="${RE4_TEST_LIMIT:-2700}"
logs="${RE4_TEST_LOGS:-}"
# Lists of tests are no tests, and without a folder for logs there is nothing to note.
case " $* " in *' --list '*) exec "$@" ;; esac
if [ -z "$logs" ]; then
    exec timeout --kill-after=60 "$limit" "$@"
fi

# cargo runs test programs in the folder of their package.
name="$(basename "$PWD")/$(basename "$1" | sed 's/-[0-9a-f]\{16\}$//')"
log="$logs/$(echo "$name" | tr / .).log"
start="$(date +%s)"
# In a group of its own, so that what it started ends with it; an interrupt is handed on. The shell has commands in the background
# ignore interrupts, which is none of the tests' business.
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
                # Those that were running, in all likelihood: tests begin in the order of their names.
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
