#!/usr/bin/env python3
"""Compares the modes of demonstrations with the true grasps, for every rule of segmentation.

    benches/audit_modes.py RE4_PIPE PIPELINE.toml SOURCE.hdf5 TRUTH.json [RULE...]

TRUTH.json maps demonstrations to `grasp`, which is 1 in the frames in which both fingers touch the object. Prints the F1 score of
transfer against `grasp` over the frames of all demonstrations that the dataset keeps, and how far the first transfer frame is from
the first true grasp. RULE is a rule of segment.rule; default: those of robosuite's tasks. For the task arm, give gripper. Needs polars.
"""

import json
import subprocess
import sys

import polars as pl

pipe, pipeline, source, truth, *rules = sys.argv[1:]
truth = json.load(open(truth))


def run(command, rule):
    settings = [f"ingest.source={source}", "ingest.on_bad=leave_out", f"segment.rule={rule}"]
    arguments = [argument for setting in settings for argument in ("--set", setting)]
    output = subprocess.run([pipe, command, pipeline, "--json", "--quiet", *arguments], check=True, capture_output=True)
    return json.loads(output.stdout)


print(f"{'rule':16} {'F1':>6} {'precision':>9} {'recall':>7}  demonstrations whose first transfer frame is within 1 / 3 / 10 of the grasp")
for rule in rules or ("gripper_command", "grasp", "evidence", "rigid_motion"):
    episodes = run("ingest", rule)["artifact"]
    modes = pl.read_parquet(f"{run('segment', rule)['artifact']}/modes.parquet")
    names = pl.read_parquet(f"{episodes}/demos.parquet")["demo"].to_list()
    both = own = true = 0
    off = []
    for (episode,), rows in modes.group_by("episode", maintain_order=True):
        transfer = [mode == "transfer" for mode in rows["mode"].to_list()]
        grasp = [bool(value) for value in truth[names[episode]]["grasp"]]
        both += sum(a and b for a, b in zip(transfer, grasp))
        own += sum(transfer)
        true += sum(grasp)
        if True in transfer and True in grasp:
            off.append(abs(transfer.index(True) - grasp.index(True)))
        else:
            off.append(10**6)
    precision, recall = both / max(1, own), both / max(1, true)
    near = " / ".join(str(sum(distance <= limit for distance in off)) for limit in (1, 3, 10))
    print(f"{rule:16} {2 * both / max(1, own + true):6.4f} {precision:9.3f} {recall:7.3f}  {near} of {len(off)}")
