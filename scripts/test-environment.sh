# Settings of the scripts that run tests. They source this file with `.` in the top folder of the repository.
#
# Tests that run Python (notebooks, reports in a browser) need its interpreter in RE4_PYTHON, which is set here.
# Tests on Ray run if RE4_RAY is a Python that has ray, or if scripts/setup-engines.sh ray has made one.
# Tests of object stores need moto's server in RE4_MOTO, which is set here; otherwise they report that they are skipped.
# Tests that simulate Lift, Can and Square find MuJoCo and robosuite's assets in the folder RE4_SIMULATORS.
# Tests on the human Push-T demonstrations need them in the folder RE4_DATA or in ../shared/data; otherwise they report that they are
# skipped.
RE4_SIMULATORS="${RE4_SIMULATORS:-$PWD/data/simulators}"
export RE4_SIMULATORS
if [ -z "${RE4_PYTHON:-}" ] && [ -x target/python/bin/python ]; then
    RE4_PYTHON="$PWD/target/python/bin/python"
fi
[ -z "${RE4_PYTHON:-}" ] || export RE4_PYTHON
if [ -z "${RE4_RAY:-}" ] && [ -x target/ray/bin/python ]; then
    RE4_RAY="$PWD/target/ray/bin/python"
fi
[ -z "${RE4_RAY:-}" ] || export RE4_RAY
if [ -z "${RE4_MOTO:-}" ] && [ -x target/moto/bin/moto_server ]; then
    RE4_MOTO="$PWD/target/moto/bin/moto_server"
fi
[ -z "${RE4_MOTO:-}" ] || export RE4_MOTO
if [ -z "${RE4_DATA:-}" ] && [ -d ../shared/data/pusht ]; then
    RE4_DATA="$(cd ../shared/data && pwd)"
    export RE4_DATA
fi
# The servers of the tests are on this machine and must not be reached through a proxy.
no_proxy="${no_proxy:+$no_proxy,}127.0.0.1,localhost"
NO_PROXY="${NO_PROXY:+$NO_PROXY,}127.0.0.1,localhost"
export no_proxy NO_PROXY
# Tests start programs and browsers, which need memory and threads, so the number of concurrent tests is limited on large machines.
if [ -z "${RUST_TEST_THREADS:-}" ] && [ "$(nproc)" -gt 8 ]; then
    export RUST_TEST_THREADS=8
fi

# Arguments of cargo for all tests except documentation tests.
ALL_TESTS="--workspace --lib --bins --tests"

# Runs tests, each test program under scripts/run-test-program.sh, which writes its records to the folder $RE4_TEST_LOGS. The
# arguments select the tests and are passed to cargo.
run_tests() {
    rm -rf "$RE4_TEST_LOGS"
    mkdir -p "$RE4_TEST_LOGS"
    host="$(rustc -vV | sed -n 's/^host: //p')"
    cargo test --locked --no-fail-fast --config "target.'$host'.runner = ['$PWD/scripts/run-test-program.sh']" "$@"
}
