"""Makes the tables of docs/results/encoder.md: trains encoders with other settings, and prints their errors as Markdown.

    python benches/encoder_tables.py [--table departures losses learning_curve] [--rows N ...] [--tasks lift square]
        [--seeds 0 1 2] [--artifacts artifacts] [--program target/release/re4-pipe]

`--rows` selects rows by number, from 0.

Needs the datasets in RE4_DATA, as the pipelines do. Each row is one setting that differs from the preset `re4`; each cell is the
median and the 90 % quantile of the errors over held-out frames before the grasp. With several seeds it is the median over the seeds,
with the range of the medians. All rows have 2,000 steps, and estimates from the centre crop alone, which takes a fifth of the time.
The rows of a learning curve have fewer demonstrations, whose images are rendered first.
"""

import argparse
import json
import statistics
import subprocess
import sys

EVERY_ROW = ["epochs=20", "crops=1"]

TABLES = {
    "departures": {
        "preset re4": [],
        "squared distances": ["losses.distance=squared", "losses.translation=1000.0", "losses.rotation=1.0"],
        "symmetry unknown": ["symmetry=false"],
        "anchor after the fingers have settled": ["anchor=settled"],
        "frames that hold the object from the command on": ["held_from=command"],
        "two held images of four": ["held_images=2"],
        "weight decay 1e-4": ["weight_decay=1e-4"],
        "five crops": ["crops=5"],
    },
    "losses": {
        "L_abs, L_rel (preset re4)": [],
        "all three": ["losses.cross=0.5"],
        "L_abs": ["losses.relative=0.0"],
    },
    "learning_curve": {
        **{f"{count} demonstrations": [f"ingest.select={{first={count}}}"] for count in (10, 20, 50, 100)},
        "all": [],
    },
}


def train(given: argparse.Namespace, task: str, settings: list[str], seed: int) -> dict:
    command = [given.program, "train-pose", f"pipelines/{task}-image.toml", "--json", "--artifacts", given.artifacts]
    for setting in [*EVERY_ROW, *settings, f"seed={seed}"]:
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
        for number, (row, settings) in enumerate(TABLES[name].items()):
            if given.rows and number not in given.rows:
                continue
            results = {task: [train(given, task, settings, seed) for seed in given.seeds] for task in given.tasks}
            print(f"| {row} | " + " | ".join(cell(results[task], measure) for task, measure in measures) + " |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--table", nargs="+", choices=TABLES, default=list(TABLES))
    parser.add_argument("--rows", nargs="+", type=int, default=[])
    parser.add_argument("--tasks", nargs="+", default=["lift", "square"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--artifacts", default="artifacts")
    parser.add_argument("--program", default="target/release/re4-pipe")
    main(parser.parse_args())
