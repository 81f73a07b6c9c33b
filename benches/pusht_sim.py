"""Times gym-pusht and re4-sim on the same actions, one process and one thread each, and prints the ratio.

Needs gym-pusht 0.1.8 and cargo. Run: python benches/pusht_sim.py [repetitions]
Both run the 40 episodes of crates/re4-sim/tests/data/reference_trace.bin (300 control steps each) and compute the coverage after
every step. Runs alternate, and the medians are compared.
"""

import pathlib
import statistics
import struct
import subprocess
import sys
import time

import gym_pusht.envs.pusht
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parent.parent
TRACE = ROOT / "crates/re4-sim/tests/data/reference_trace.bin"


def read_trace() -> tuple[np.ndarray, np.ndarray]:
    """Scenes [E, 5] and actions [E, S, 2]; make_reference_trace.py describes the layout."""
    data = TRACE.read_bytes()
    (length,) = struct.unpack_from("<I", data, 8)
    episodes, steps, _ = struct.unpack_from("<III", data, 12 + length)
    at = 24 + length
    scenes = np.frombuffer(data, "<f8", episodes * 5, at).reshape(episodes, 5)
    at += episodes * (5 + 7) * 8
    actions = np.frombuffer(data, "<f4", episodes * steps * 2, at).reshape(episodes, steps, 2)
    return scenes, actions.astype(np.float64)


def time_gym_pusht(scenes: np.ndarray, actions: np.ndarray) -> tuple[float, float]:
    """Steps per second, and the mean coverage."""
    env = gym_pusht.envs.pusht.PushTEnv(obs_type="state")
    total = 0.0
    start = time.perf_counter()
    for scene, targets in zip(scenes, actions):
        env.reset(options={"reset_to_state": scene})
        for target in targets:
            total += env.step(target)[4]["coverage"]
    seconds = time.perf_counter() - start
    count = actions.shape[0] * actions.shape[1]
    return count / seconds, total / count


def time_re4_sim() -> tuple[float, float]:
    """Steps per second over 20 rounds of the trace, and the mean coverage."""
    command = ["cargo", "run", "--release", "--quiet", "-p", "re4-sim", "--example", "throughput", "20"]
    output = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    values = dict(line.split(" ", 1) for line in output.splitlines())
    return float(values["steps_per_second"]), float(values["mean_coverage"])


def main() -> None:
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    scenes, actions = read_trace()
    ours, theirs = [], []
    for _ in range(repetitions):
        speed, mean = time_gym_pusht(scenes, actions)
        theirs.append(speed)
        speed, our_mean = time_re4_sim()
        ours.append(speed)
        if abs(mean - our_mean) > 1e-9:
            sys.exit(f"the simulations differ: mean coverage {mean} and {our_mean}")
    for name, speeds in (("gym-pusht", theirs), ("re4-sim", ours)):
        print(f"{name:10} {statistics.median(speeds):10,.0f} steps/s  (of {', '.join(f'{s:,.0f}' for s in sorted(speeds))})")
    print(f"ratio      {statistics.median(ours) / statistics.median(theirs):10.1f}")


if __name__ == "__main__":
    main()
