"""Prints the score tables of docs/results/pusht.md, in Markdown.

Needs the human demonstrations (RE4_DATA) and the release build:

    cargo build --release -p re4-pipe
    RE4_DATA=... python3 benches/results.py [five|main|image|poses|observations|paper|re4|protocol ...]

Nothing here tunes anything: settings come from the presets, which were tuned on seeds from 200000 up; the tables are
reported on seeds 500-599 and 100000-100299, and on the scenes of the sparse-observation experiment.
"""

import json
import subprocess
import sys
import tempfile

BINARY = "target/release/re4-pipe"
SEEDS = {"100": "500..600", "300": "100000..100300", "400": "500..600,100000..100300"}


def rollout(pipeline, arguments, artifacts):
    without_images = [] if pipeline in (IMAGE, FIVE_IMAGE, SPARSE_IMAGE, OBSERVATIONS_IMAGE) else ["--no-images"]
    command = [BINARY, "rollout", pipeline, "--json", "--quiet", "--artifacts", artifacts, *without_images, *arguments]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def cell(metric):
    return f"{metric['value']:.3f} [{metric['low']:.3f}, {metric['high']:.3f}]"


def print_table(title, rows, seeds, artifacts):
    print(f"\n{title}\n")
    print("| setting | seeds | scaled score | raw coverage | IoU | success rate |")
    print("|---|---|---|---|---|---|")
    for label, pipeline, arguments in rows:
        for name in seeds:
            result = rollout(pipeline, [*arguments, "--seeds", SEEDS[name]], artifacts)
            metrics = result["metrics"]
            cells = [cell(metrics[key]) for key in ("score_scaled_mean", "coverage_raw_mean", "iou_mean", "success_rate")]
            print(f"| {label} | {SEEDS[name]} | {' | '.join(cells)} |", flush=True)


def change(preset, *settings):
    arguments = ["--policy", preset]
    for setting in settings:
        table = "rollout" if setting.startswith(("max_steps", "reset", "seed_scheme")) else "policy"
        arguments += ["--set", f"{table}.{setting}"]
    return arguments


STATE = "pipelines/pusht-state.toml"
FIVE = "pipelines/pusht-five-demos.toml"
SPARSE = "pipelines/pusht-sparse-demos.toml"
OBSERVATIONS = "pipelines/pusht-sparse-observations.toml"
IMAGE = "pipelines/pusht-image.toml"
FIVE_IMAGE = "pipelines/pusht-five-demos-image.toml"
SPARSE_IMAGE = "pipelines/pusht-sparse-demos-image.toml"
OBSERVATIONS_IMAGE = "pipelines/pusht-sparse-observations-image.toml"

FIVE_DEMOS = [
    ("`re4`, first 5 demos, state", FIVE, change("re4")),
    ("`re4`, first 5 demos, image", FIVE_IMAGE, change("re4")),
]

MAIN = [
    ("`re4`", STATE, change("re4")),
    ("`paper`", STATE, change("paper")),
    ("`re2`", STATE, change("re2")),
    ("`re4`, first 50 demos", SPARSE, change("re4")),
    ("`paper`, first 50 demos", SPARSE, change("paper")),
]

FROM_IMAGES = [
    ("`re4`", IMAGE, change("re4")),
    ("`paper`", IMAGE, change("paper")),
    ("`re2`", IMAGE, change("re2")),
    ("`re4`, first 50 demos", SPARSE_IMAGE, change("re4")),
    ("`paper`, first 50 demos", SPARSE_IMAGE, change("paper")),
    ("`re4`, only the paper's estimate", IMAGE, [*change("re4"), "--set", "pose.refine=false"]),
    ("`paper`, only the paper's estimate", IMAGE, [*change("paper"), "--set", "pose.refine=false"]),
]

FROM_PAPER = [
    ("`paper`", STATE, change("paper")),
    ("Retrieve by outcome", STATE, change("paper", "retrieve.selector=outcome", "retrieve.candidates=256", "retrieve.step_cost=0.8", "retrieve.motion_cost=0.05", "replay.horizon=200")),
    ("periodic angle", STATE, change("paper", "retrieve.angle=periodic")),
    ("shortest path instead of RRT, keep-out 18 px", STATE, change("paper", "replan.planner=visibility", "replan.keepout=18")),
    ("waypoints every 15 px", STATE, change("paper", "replan.spacing=15")),
    ("path tracking at 20 px per step", STATE, change("paper", "replay.tracking=path", "replan.spacing=60")),
    ("every 2nd action, n = 16", STATE, change("paper", "replay.stride=2", "replay.horizon=16")),
    ("without epsilon filter", STATE, change("paper", "retrieve.epsilon=1000")),
    ("without Reframe", STATE, change("paper", "reframe.enabled=false")),
    ("without Replan", STATE, change("paper", "replan.enabled=false")),
    ("without both (`re2`)", STATE, change("re2")),
    ("without both, n = 1", STATE, change("re2", "replay.horizon=1")),
]

FROM_RE4 = [
    ("`re4`", STATE, change("re4")),
    ("two-stage Retrieve, n = 24", STATE, change("re4", "retrieve.selector=two_stage", "replay.horizon=24")),
    ("recorded actions instead of path tracking", STATE, change("re4", "replay.tracking=actions")),
    ("RRT instead of the shortest path", STATE, change("re4", "replan.planner=rrt")),
    ("keep-out 15 px", STATE, change("re4", "replan.keepout=15")),
    ("speed 10 px per step", STATE, change("re4", "replay.speed=10")),
    ("no divergence check", STATE, change("re4", "replay.divergence=10000")),
    ("no cost of steps", STATE, change("re4", "retrieve.step_cost=0")),
    ("no cost of pushing", STATE, change("re4", "retrieve.motion_cost=0")),
    ("only the nearest outcome", STATE, change("re4", "retrieve.candidates=1")),
    ("without Reframe", STATE, change("re4", "reframe.enabled=false")),
    ("without Replan", STATE, change("re4", "replan.enabled=false")),
]

PROTOCOL = [
    ("`re4`, 100 steps", STATE, change("re4", "max_steps=100")),
    ("`re4`, 300 steps", STATE, change("re4", "max_steps=300")),
    ("`re4`, reset to the pose", STATE, change("re4", "reset=pose")),
    ("`re4`, scenes of gym-pusht", STATE, change("re4", "seed_scheme=gym_pusht")),
    ("`paper`, 100 steps", STATE, change("paper", "max_steps=100")),
    ("`paper`, 300 steps", STATE, change("paper", "max_steps=300")),
    ("`paper`, reset to the pose", STATE, change("paper", "reset=pose")),
    ("`paper`, scenes of gym-pusht", STATE, change("paper", "seed_scheme=gym_pusht")),
]

TABLES = {
    "five": ("Five demonstrations", FIVE_DEMOS, ["100", "300"]),
    "main": ("Scores", MAIN, ["100", "300"]),
    "image": ("From images", FROM_IMAGES, ["100", "300"]),
    "paper": ("The `paper` preset, one setting changed at a time", FROM_PAPER, ["400"]),
    "re4": ("The `re4` preset, one setting changed at a time", FROM_RE4, ["400"]),
    "protocol": ("Other protocols", PROTOCOL, ["400"]),
}


def print_poses(artifacts):
    """How far the estimated poses are from the recorded ones, over every frame."""
    print("\nPoses from images, over every frame\n")
    print("| estimate | frames | flag not `clear` | position, px: p50 / p90 / p99 / max | angle, degrees: p50 / p90 / p99 / max | flips |")
    print("|---|---|---|---|---|---|")
    for label, refine in [("aligned with the outline", "true"), ("only the paper's closed form", "false")]:
        command = [BINARY, "train-pose", IMAGE, "--json", "--quiet", "--artifacts", artifacts, "--set", f"pose.refine={refine}"]
        summary = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)["summary"]
        evaluation = summary["evaluation"]
        spread = lambda name: " / ".join(f"{evaluation[name][key]:.2f}" for key in ("p50", "p90", "p99", "max"))
        print(
            f"| {label} | {summary['frames']} | {summary['frames_not_clear']} | {spread('position_px')} "
            f"| {spread('angle_deg')} | {evaluation['flips']} |",
            flush=True,
        )


def print_observations(artifacts):
    """Scores under budgets of steps on the scenes far from the demonstrations."""
    print("\nSparse observations: scaled score / raw coverage by the budget of steps\n")
    columns = [(f"`{preset}`, {variant}", pipeline, preset) for variant, pipeline in (("state", OBSERVATIONS), ("image", OBSERVATIONS_IMAGE)) for preset in ("re4", "paper", "re2")]
    results = [rollout(pipeline, ["--policy", preset], artifacts) for _, pipeline, preset in columns]
    print(f"| steps | {' | '.join(label for label, _, _ in columns)} |")
    print("|---" * (len(columns) + 1) + "|")
    for row in range(len(results[0]["budgets"])):
        budgets = [result["budgets"][row] for result in results]
        cells = [f"{b['score_scaled_mean']['value']:.3f} / {b['coverage_raw_mean']['value']:.3f}" for b in budgets]
        print(f"| {budgets[0]['budget']} | {' | '.join(cells)} |")
    for name, key in (("scaled score at the end", "score_scaled_mean"), ("success rate at the end", "success_rate")):
        print(f"| {name} | {' | '.join(cell(result['metrics'][key]) for result in results)} |")


def main():
    special = {"poses": print_poses, "observations": print_observations}
    wanted = sys.argv[1:] or [*TABLES, *special]
    with tempfile.TemporaryDirectory() as artifacts:
        for name in wanted:
            if name in special:
                special[name](artifacts)
            else:
                print_table(*TABLES[name], artifacts)


if __name__ == "__main__":
    main()
