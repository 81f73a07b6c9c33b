"""Speed of the Python package beside gym-pusht and scipy, in one run on one machine.

    pip install target/wheels/re4_pipe-*.whl 're4-pipe[gym,polars]' gym-pusht==0.1.8 scipy
    python benches/python_package.py envs                       # 64 environments of Push-T, states only
    RE4_DATA=... python benches/python_package.py retriever     # 10,000 exact queries over the human demonstrations of Push-T
"""

import sys
import tempfile
import time
import warnings

import numpy as np

ENVS = 64
QUERIES = 10_000
REPEATS = 3


def seconds(work, repeats=REPEATS):
    """The shortest of some runs."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def envs() -> None:
    warnings.simplefilter("ignore")
    import gym_pusht  # noqa: F401
    import gymnasium

    import re4_pipe.envs  # noqa: F401

    random = np.random.default_rng(0)
    rates = {}
    cases = [
        ("gym-pusht, sync", "gym_pusht/PushT-v0", "sync", 20, {}),
        ("gym-pusht, async", "gym_pusht/PushT-v0", "async", 20, {}),
        ("re4, one thread", "re4/PushT-v0", None, 1000, {"threads": 1}),
        ("re4, all threads", "re4/PushT-v0", None, 1000, {}),
    ]
    for name, env_id, mode, steps, settings in cases:
        if mode is not None:
            settings = {"obs_type": "state"}
        env = gymnasium.make_vec(env_id, ENVS, vectorization_mode=mode, **settings)
        actions = random.uniform(50, 450, (steps, ENVS, 2)).astype(np.float32)
        env.reset(seed=0)

        def run(env=env, actions=actions) -> None:
            for row in actions:
                env.step(row)

        rates[name] = ENVS * steps / seconds(run)
        env.close()
        print(f"{name}: {rates[name]:,.0f} steps/s", flush=True)
    theirs = max(rates["gym-pusht, sync"], rates["gym-pusht, async"])
    for name in ("re4, one thread", "re4, all threads"):
        print(f"{name}: {rates[name] / theirs:.1f} times the faster form of gym-pusht")


def retriever() -> None:
    from scipy.spatial import cKDTree

    import re4_pipe

    with tempfile.TemporaryDirectory() as folder:
        index = re4_pipe.Pipeline("pipelines/pusht-state.toml", artifacts=folder).run("index").artifact
        rows = index.polars("index").filter(retrievable=True).sort("episode", "frame")
        scales = index.polars("scales")
        ours = re4_pipe.Retriever(index, angle="raw", epsilon=np.inf, threads=1)
        all_threads = re4_pipe.Retriever(index, angle="raw", epsilon=np.inf)
    low, span = scales["minimum"].to_numpy(), (scales["maximum"] - scales["minimum"]).to_numpy()
    states = rows.select("eef_x", "eef_y", "object_x", "object_y", "object_theta").to_numpy()
    states[:, 4] %= 2 * np.pi
    numbers = rows["episode"].to_numpy()
    starts = np.flatnonzero(np.r_[True, numbers[1:] != numbers[:-1]])
    normal = (states - low) / span
    trees = [cKDTree(part) for part in np.split(normal, starts[1:])]
    random = np.random.default_rng(0)
    near = states[random.integers(len(states), size=QUERIES)] + random.uniform(-1, 1, (QUERIES, 5)) * [10, 10, 10, 10, 0.1]
    far = random.uniform(states.min(axis=0), states.max(axis=0), (QUERIES, 5))
    for name, queries in (("near the demonstrations", near), ("anywhere", far)):
        queries[:, 4] %= 2 * np.pi

        def scipy(workers: int, queries=queries):
            """Stage 1: the nearest state of every demonstration; stage 2: the nearest object pose of these."""
            q = (queries - low) / span
            best = np.full(len(q), np.inf)
            frames = np.zeros(len(q), dtype=int)
            for start, tree in zip(starts, trees, strict=True):
                at = tree.query(q, workers=workers)[1] + start
                d_o = np.linalg.norm(normal[at, 2:] - q[:, 2:], axis=1)
                better = d_o < best
                best[better], frames[better] = d_o[better], at[better]
            return frames

        def own(retriever, queries=queries):
            return retriever.retrieve(queries[:, :2], queries[:, 2:])

        answers, expected = own(ours), scipy(1)
        same = (answers.episode == numbers[expected]) & (answers.frame == rows["frame"].to_numpy()[expected])
        assert same.all(), f"{(~same).sum()} answers differ"
        print(f"{name}: {QUERIES} equal answers over {len(states)} frames of {len(starts)} demonstrations")
        for threads, our, workers in (("one thread", ours, 1), ("all threads", all_threads, -1)):
            a, b = seconds(lambda our=our: own(our)), seconds(lambda workers=workers: scipy(workers))
            print(f"  {threads}: {a / QUERIES * 1e6:.1f} us a query, cKDTree {b / QUERIES * 1e6:.1f} us, ratio {b / a:.1f}", flush=True)


if __name__ == "__main__":
    {"envs": envs, "retriever": retriever}[sys.argv[1]]()
