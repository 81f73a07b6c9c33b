"""Replays the actions of native rollouts open-loop in robosuite, from the same seeds, and counts the successes.

    rs14/bin/python benches/robosuite_rollouts.py TASK steps.parquet [rollouts] [plain|robomimic]

TASK is lift, can or square. Run it with the Python of either environment that tests/robosuite_reference.py describes, after
`pip install 'pyarrow<20'`. The table has the columns seed, step, action_x, action_y, action_z (goal of the grip site, world frame,
m), action_rx, action_ry, action_rz (its rotation vector, rad), gripper (-1 opens, 1 closes). The episode of a seed starts after
`np.random.seed(seed); env.reset()` (plain), or after robomimic's `reset_to` to that state, on the model read back from its own
XML (robomimic). Success at any step counts.
"""

import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "tests"))

import numpy as np  # noqa: E402
import pyarrow.parquet  # noqa: E402
import robosuite_reference as reference  # noqa: E402

COLUMNS = ["action_x", "action_y", "action_z", "action_rx", "action_ry", "action_rz", "gripper"]


def reset(env, seed: int, how: str) -> None:
    np.random.seed(seed)
    env.reset()
    if how == "robomimic":
        state, xml = env.sim.get_state().flatten(), env.sim.model.get_xml()
        env.reset_from_xml_string(xml)
        env.sim.reset()
        reference.set_state(env, state)


def main(task: str, path: str, rollouts: str = "20", how: str = "plain") -> None:
    table = pyarrow.parquet.read_table(path, columns=["seed", "step", *COLUMNS])
    columns = {name: table[name].to_numpy() for name in table.column_names}
    env, _ = reference.make(task, "absolute")
    seeds = np.unique(columns["seed"])[: int(rollouts)]
    succeeded = 0
    for seed in seeds:
        rows = np.flatnonzero(columns["seed"] == seed)
        rows = rows[np.argsort(columns["step"][rows])]
        reset(env, int(seed), how)
        success = None
        for step, row in enumerate(rows):
            env.step(np.array([columns[name][row] for name in COLUMNS], dtype=float))
            if env._check_success():
                success = step
                break
        succeeded += success is not None
        print(f"seed {seed}: {'success at step ' + str(success) if success is not None else 'NO success'} of {len(rows)}", flush=True)
    print(f"{task}: {succeeded} of {len(seeds)} succeed in robosuite {reference.robosuite.__version__} ({how} reset)")


if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1] not in reference.TASKS:
        sys.exit(__doc__)
    main(*sys.argv[1:])
