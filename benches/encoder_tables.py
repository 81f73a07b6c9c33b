"""Makes the tables of docs/results/encoder.md: trains encoders with other settings, and prints their errors as Markdown.

    python benches/encoder_tables.py [--table departures losses learning_curve] [--tasks lift square] [--seeds 0 1 2]
        [--artifacts artifacts] [--program target/release/re4-pipe]

Needs the datasets in RE4_DATA, as the pipelines do. Each row is one setting that differs from the preset `re4`; each cell is the
median and the 90 % quantile over held-out frames before the grasp, and with several seeds the range of the medians. The rows of a
learning curve have other demonstrations, whose images are rendered first.
"""

import argparse
import json
import statistics
import subprocess
import sys

TABLES = {
    "departures": {
        "preset re4": [],
        "ResNet-18 of width 16": ["network=resnet18", "width=16", "learning_rate=1e-3"],
        "squared distances": ["losses.distance=squared", "losses.translation=1000.0", "losses.rotation=1.0"],
        "symmetry unknown": ["symmetry=false"],
        "anchor at the command": ["anchor=command"],
        "two held images of four": ["held_images=2"],
        "weight decay 1e-4": ["weight_decay=1e-4"],
        "one crop": ["crops=1"],
        "brightness 0.1": ["brightness=0.1"],
    },
    "losses": {
        "L_abs, L_rel (preset re4)": [],
        "all three": ["losses.cross=0.5"],
        "L_abs, L_cross": ["losses.relative=0.0", "losses.cross=0.5"],
        "L_abs": ["losses.relative=0.0"],
    },
    "learning_curve": {f"{count} demonstrations": [f"ingest.select={{first={count}}}"] for count in (10, 20, 50, 100)},
}


def train(given: argparse.Namespace, task: str, settings: list[str], seed: int) -> dict:
    command = [given.program, "train-pose", f"pipelines/{task}-image.toml", "--json", "--artifacts", given.artifacts]
    for setting in [*settings, f"seed={seed}"]:
        command += ["--set", setting if setting.startswith("ingest.") else f"pose.encoder.{setting}"]
    ran = subprocess.run(command, capture_output=True, text=True)
    if ran.returncode:
        sys.exit(ran.stderr)
    answers = [json.loads(line) for line in ran.stdout.splitlines()]
    trained = next(answer for answer in answers if answer.get("stage") == "train-pose")
    return trained["summary"]["evaluation"]["estimates"]["held_out"]["before_grasp"]


def cell(results: list[dict], measure: str) -> str:
    medians = [result[measure]["p50"] for result in results]
    upper = statistics.median(result[measure]["p90"] for result in results)
    spread = f" ({min(medians):.1f}-{max(medians):.1f})" if len(medians) > 1 else ""
    return f"{statistics.median(medians):.1f}{spread} / {upper:.1f}"


def main(given: argparse.Namespace) -> None:
    for name in given.table:
        measures = [(task, measure) for task in given.tasks for measure in ("translation_at_grasp_mm", "rotation_deg")]
        heads = [f"{task}: {'mm' if measure.endswith('mm') else 'degrees'}" for task, measure in measures]
        print(f"\n| {name} | " + " | ".join(heads) + " |\n|" + "---|" * (1 + len(heads)), flush=True)
        for row, settings in TABLES[name].items():
            results = {task: [train(given, task, settings, seed) for seed in given.seeds] for task in given.tasks}
            print(f"| {row} | " + " | ".join(cell(results[task], measure) for task, measure in measures) + " |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--table", nargs="+", choices=TABLES, default=list(TABLES))
    parser.add_argument("--tasks", nargs="+", default=["lift", "square"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--artifacts", default="artifacts")
    parser.add_argument("--program", default="target/release/re4-pipe")
    main(parser.parse_args())
