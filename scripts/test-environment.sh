# What the scripts that run tests have in common; they read it with `.`, in the top folder of the repository.
#
# Tests that run Python (the notebook, the report in a browser) run where RE4_PYTHON names its interpreter, as here.
# Tests that simulate Lift, Can and Square find MuJoCo and robosuite's assets where RE4_SIMULATORS names their folder.
# Tests on the human Push-T demonstrations run where RE4_DATA names the folder that holds them, or where they lie in
# ../shared/data; otherwise they say that they are skipped.
RE4_SIMULATORS="${RE4_SIMULATORS:-$PWD/data/simulators}"
export RE4_SIMULATORS
if [ -z "${RE4_PYTHON:-}" ] && [ -x target/python/bin/python ]; then
    RE4_PYTHON="$PWD/target/python/bin/python"
fi
[ -z "${RE4_PYTHON:-}" ] || export RE4_PYTHON
if [ -z "${RE4_DATA:-}" ] && [ -d ../shared/data/pusht ]; then
    RE4_DATA="$(cd ../shared/data && pwd)"
    export RE4_DATA
fi
# The tests' own servers are on this machine, where no proxy leads to.
no_proxy="${no_proxy:+$no_proxy,}127.0.0.1,localhost"
NO_PROXY="${NO_PROXY:+$NO_PROXY,}127.0.0.1,localhost"
export no_proxy NO_PROXY
# Tests start programs, and browsers, with memory and threads of their own: not as many at once as a large machine has processors.
if [ -z "${RUST_TEST_THREADS:-}" ] && [ "$(nproc)" -gt 8 ]; then
    export RUST_TEST_THREADS=8
fi

# What all tests are to cargo, but for those in documentation.
ALL_TESTS="--workspace --lib --bins --tests"

# Runs tests, each test program under scripts/run-test-program.sh, which leaves its notes in the folder $RE4_TEST_LOGS. The
# arguments are cargo's and say which tests.
run_tests() {
    rm -rf "$RE4_TEST_LOGS"
    mkdir -p "$RE4_TEST_LOGS"
    host="$(rustc -vV | sed -n 's/^host: //p')"
    cargo test --locked --no-fail-fast --config "target.'$host'.runner = ['$PWD/scripts/run-test-program.sh']" "$@"
}
