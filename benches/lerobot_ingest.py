"""Compares the ingest of LeRobot videos of Push-T, whole command, with PyAV decoding the same frames to RGB and doing nothing else.

usage: lerobot_ingest.py PROGRAM DATASET... [--rounds N]   (needs av and numpy)

The programs alternate, and the minimum of the rounds counts. Ingest also hashes the files, checks the numbers, and writes every image as
PNG; its artifact is removed after each round. PyAV decodes with one thread, and with the threads that it chooses itself. CPU seconds
are given, too, because other load hardly changes them. Prints one JSON object per dataset.
"""

import argparse
import json
import pathlib
import resource
import subprocess
import sys
import tempfile
import time

DECODE = """
import sys, av
frames = 0
for path in sys.argv[2:]:
    with av.open(path) as file:
        stream = file.streams.video[0]
        if sys.argv[1] == "1":
            stream.thread_count = 1
        else:
            stream.thread_type = "AUTO"
        for frame in file.decode(stream):
            frame.to_ndarray(format="rgb24")
            frames += 1
print(frames)
"""
PIPELINE = 'task = "pusht"\n[ingest]\nsource = "{}"\n[segment]\nrule = "always_transit"\n'


def timed(command):
    """Wall and CPU seconds of a command, and its output."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, output


arguments = argparse.ArgumentParser()
arguments.add_argument("program")
arguments.add_argument("datasets", nargs="+", type=pathlib.Path)
arguments.add_argument("--rounds", type=int, default=3)
arguments = arguments.parse_args()
for dataset in arguments.datasets:
    videos = sorted(str(path) for path in dataset.rglob("*.mp4"))
    best = {}
    for _ in range(arguments.rounds):
        with tempfile.TemporaryDirectory() as folder:
            pipeline = pathlib.Path(folder) / "pipeline.toml"
            pipeline.write_text(PIPELINE.format(dataset.resolve()))
            artifacts = str(pathlib.Path(folder) / "artifacts")
            ingest = [arguments.program, "ingest", str(pipeline), "--artifacts", artifacts, "--quiet", "--json"]
            commands = {
                "re4-pipe ingest": ingest,
                "PyAV, one thread": [sys.executable, "-c", DECODE, "1", *videos],
                "PyAV, its own choice": [sys.executable, "-c", DECODE, "auto", *videos],
            }
            for name, command in commands.items():
                wall, cpu, output = timed(command)
                if name.startswith("PyAV"):
                    frames = int(output)
                best[name] = min(best.get(name, (1e9, 1e9)), (wall, cpu))
    ours = best["re4-pipe ingest"][0]
    ratio = min(wall for name, (wall, _) in best.items() if name.startswith("PyAV")) / ours
    seconds = {name: {"wall_s": round(wall, 2), "cpu_s": round(cpu, 2)} for name, (wall, cpu) in best.items()}
    print(json.dumps({"dataset": dataset.name, "frames": frames, **seconds, "ratio": round(ratio, 2)}))
