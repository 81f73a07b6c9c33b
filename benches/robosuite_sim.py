"""Times robosuite and re4-sim on the same actions, one process and one thread each, and prints the ratio for every task.

    rs14/bin/python benches/robosuite_sim.py [repetitions]

Run it with the Python of either environment that tests/robosuite_reference.py describes; it needs cargo. Both sides execute the 60
absolute actions of the committed trace of that version from its first state, without cameras, repeatedly. Only policy steps are
timed, not resets. Runs alternate, and the medians are compared.
"""

import json
import os
import pathlib
import statistics
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

import robosuite_reference as reference  # noqa: E402  (before numpy: it sets the number of threads)
import numpy as np  # noqa: E402

DATA = ROOT / "crates/re4-sim/tests/data/robosuite"
EPISODES = 5


def rate_of_robosuite(env, arrays) -> float:
    spent = 0.0
    for _ in range(EPISODES):
        # A soft reset keeps the model that was loaded from the trace.
        env.deterministic_reset = True
        env.reset()
        env.deterministic_reset = False
        reference.set_state(env, arrays["initial_state"])
        reference.controller_of(env).update(force=True)
        start = time.perf_counter()
        for action in arrays["actions"]:
            env.step(action)
        spent += time.perf_counter() - start
    return EPISODES * len(arrays["actions"]) / spent


def rate_of_re4(binary: pathlib.Path, trace: pathlib.Path) -> float:
    """`robosuite_rate TRACE EPISODES` executes the trace's actions and prints {"steps_per_s": …}."""
    result = subprocess.run([binary, trace, str(EPISODES)], check=True, capture_output=True, text=True, cwd=ROOT)
    return json.loads(result.stdout)["steps_per_s"]


def main(repetitions: int) -> None:
    build = ["cargo", "build", "--release", "--locked", "-q", "-p", "re4-sim", "--example", "robosuite_rate"]
    subprocess.run(build, check=True, cwd=ROOT)
    binary = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release/examples/robosuite_rate"
    version = reference.robosuite.__version__
    print(f"policy steps per second, robosuite {version} on MuJoCo {reference.mujoco.__version__}, medians of {repetitions} runs")
    for task in reference.TASKS:
        path = DATA / f"trace_{task}_{version}_absolute.bin.gz"
        header, arrays = reference.read(path)
        env, _ = reference.make(task, "absolute")
        env.reset_from_xml_string(reference.with_own_assets(header["xml"]))
        rate_of_robosuite(env, arrays)  # compiles what numba compiles
        theirs, ours = [], []
        for _ in range(repetitions):
            theirs.append(rate_of_robosuite(env, arrays))
            ours.append(rate_of_re4(binary, path))
        env.close()
        spread = lambda rates: f"{statistics.median(rates):7.0f} ({min(rates):.0f}-{max(rates):.0f})"  # noqa: E731
        ratio = np.median(ours) / np.median(theirs)
        print(f"{task:7} robosuite {spread(theirs)}   re4-sim {spread(ours)}   {ratio:.1f} times", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
