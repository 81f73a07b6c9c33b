"""Prints the tables of Lift, Can and Square in docs/results/robosuite.md, in Markdown.

Needs the scripted demonstrations (RE4_DATA), the simulators (scripts/setup-simulators.sh) and the release build:

    cargo build --release -p re4-pipe
    RE4_DATA=... [TASKS="lift can"] python3 benches/robosuite_results.py [main|demos|noise|steps|replay ...]

With everything it takes about an hour on two cores. Nothing here tunes anything: settings come from the presets, which were tuned on seeds from 200000 up; the tables are
reported on seeds 500-599 and 100000-100299. `paper` and `re2` index every frame, also those that lead to a failed grasp.
"""

import json
import os
import subprocess
import sys
import tempfile

BINARY = os.environ.get("RE4_PIPE", "target/release/re4-pipe")
TASKS = os.environ.get("TASKS", "lift can square").split()
FAST = ["--set", "rollout.fidelity=fast"]
FIFTY = ["--seeds", "500..550"]
EVERY_FRAME = ["--set", "index.leave_out=[]"]


def run(command, task, arguments, artifacts):
    line = [BINARY, command, f"pipelines/{task}-state.toml", "--json", "--quiet", "--artifacts", artifacts, *arguments]
    return json.loads(subprocess.run(line, check=True, capture_output=True, text=True).stdout)


def rollout(task, arguments, artifacts):
    result = run("rollout", task, arguments, artifacts)
    rate = result["metrics"]["success_rate"]
    return result, f"{rate['value']:.2f} [{rate['low']:.3f}, {rate['high']:.3f}]"


def settings(preset, *changes):
    arguments = ["--policy", preset]
    for change in changes:
        arguments += ["--set", change]
    return arguments


def main(artifacts):
    print("\n| task | policy | simulation | seeds | success rate, 95 % interval | median steps | lost grasps |\n|---|---|---|---|---|---|---|")
    rows = [("re4", [], "500..600", "robosuite")]
    rows += [(policy, EVERY_FRAME, "500..600", "fast") for policy in ("paper", "re2")]
    rows += [("re4", [], "100000..100300", "fast")]
    for task in TASKS:
        for policy, more, seeds, fidelity in rows:
            arguments = [*settings(policy, f"rollout.fidelity={fidelity}"), *more, "--seeds", seeds]
            result, rate = rollout(task, arguments, artifacts)
            steps, losses = result["median_steps_of_successes"], result["losses"]
            print(f"| {task} | `{policy}` | {fidelity} | {seeds} | {rate} | {steps:g} | {losses} |", flush=True)


def demos(artifacts):
    counts = [5, 10, 20, 50, 200]
    print("\n| task | policy | " + " | ".join(str(count) for count in counts) + " |\n|---|---|" + "---|" * len(counts))
    for task in TASKS:
        for policy, more in (("re4", []), ("re2", EVERY_FRAME)):
            cells = []
            for count in counts:
                select = ["--set", f"ingest.select={{first={count}}}"]
                arguments = [*settings(policy), *FAST, *more, *select, *FIFTY]
                cells.append(rollout(task, arguments, artifacts)[1])
            print(f"| {task} | `{policy}` | {' | '.join(cells)} |", flush=True)


def noise(artifacts):
    levels = [0, 2, 5, 10]
    print("\n| task | policy | " + " | ".join(f"{level} mm, {level}°" for level in levels) + " |\n|---|---|" + "---|" * 4)
    for task in TASKS:
        for policy, more in (("re4", []),):
            cells = []
            for level in levels:
                radians = level * 3.141592653589793 / 180
                errors = ["--set", f"rollout.noise={{translation={level / 1000},rotation={radians}}}"]
                arguments = [*settings(policy), *FAST, *more, *errors, *FIFTY]
                cells.append(rollout(task, arguments, artifacts)[1])
            print(f"| {task} | `{policy}` | {' | '.join(cells)} |", flush=True)


STEPS = [
    ("`re4`", settings("re4")),
    ("without Reframe", settings("re4", "policy.reframe.enabled=false")),
    ("without the bridge", settings("re4", "policy.replan.enabled=false")),
    ("recorded goals in transfer (`verbatim`)", settings("re4", "policy.reframe.transfer=verbatim")),
    ("without symmetry", settings("re4", 'rollout.symmetry={kind="none"}')),
    ("every frame indexed", settings("re4", "index.leave_out=[]")),
    ("without bans", settings("re4", "policy.recovery.ban=false")),
]


def steps(artifacts):
    print("\n| setting, 20 demonstrations | Lift | Can | Square |\n|---|---|---|---|")
    few = ["--set", "ingest.select={first=20}"]
    for label, arguments in STEPS:
        cells = [rollout(task, [*arguments, *few, *FAST, *FIFTY], artifacts)[1] for task in TASKS]
        print(f"| {label} | {' | '.join(cells)} |", flush=True)


def replay(artifacts):
    print("\n| task | actions | successes | largest deviation of the object in each demonstration: median, 99th percentile, maximum, mm |\n|---|---|---|---|")
    for task in TASKS:
        for file in ("low_dim.hdf5", "low_dim_abs.hdf5"):
            result = run("replay", task, ["--set", f"ingest.source=robomimic-scripted/{task}/{file}"], artifacts)
            for kind in ("delta", "absolute"):
                of = result["summary"][kind]
                origin = "recorded" if result["summary"]["recorded_actions"] == kind else "converted"
                astray = ", ".join(f"{1e3 * of['object_max_m'][part]:.3f}" for part in ("p50", "p99", "max"))
                print(f"| {task} | {kind}, {origin} | {of['successes']} of {of['replays']} | {astray} |", flush=True)


if __name__ == "__main__":
    tables = {"main": main, "demos": demos, "noise": noise, "steps": steps, "replay": replay}
    with tempfile.TemporaryDirectory() as folder:
        for name in sys.argv[1:] or tables:
            tables[name](folder)
