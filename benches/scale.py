#!/usr/bin/env python3
"""Measures what every stage costs per demonstration as their number grows, and what cutting the work into shards adds.

    benches/scale.py PROGRAM SOURCE.hdf5 FOLDER --counts 10000 100000 [--frames N] [--files N] [--shards N] [--parallel N] [--again] [--keep]
    benches/scale.py PROGRAM SOURCE.hdf5 FOLDER --counts 100000 --compare 8

For each count, writes that many made-up demonstrations (many_demos.py, which describes SOURCE, --frames and --files) and runs ingest, segment,
audit and index of pipelines/lift-state.toml on them. Without --shards, each stage is one process with one thread. With --shards N,
the stages run as the plan of `re4-pipe plan --shards N` says, each task as a process with one thread, --parallel of them at a time;
the plan's merges run alone. Only plans have the stage observe, which is a part of the audit. Prints for every stage the wall time, the processor time of all processes together and per demonstration,
the part of the merges in it, and the largest memory of one process. Without shards, the stage segment also makes the audit; with
--again, the audit is made a second time, and the cost of that is shown apart.

--compare N runs the stages once in one process with as many threads as --parallel (default 2), and once in N shards of one thread,
--parallel at a time, and prints the ratio of the wall times and of the processor times.

FOLDER must be empty or absent, and is emptied after every count, except with --keep. Needs h5py.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections import defaultdict

HERE = os.path.dirname(os.path.abspath(__file__))
PIPELINE = os.path.join(HERE, "..", "pipelines", "lift-state.toml")
STAGES = ["ingest", "segment", "audit", "index"]


class Cost:
    """Cost of some processes."""

    def __init__(self):
        self.wall = self.cpu = self.merge = 0.0
        self.peak = self.processes = 0

    def add(self, usage, merge):
        cpu = usage.ru_utime + usage.ru_stime
        self.cpu += cpu
        self.merge += cpu if merge else 0.0
        self.peak = max(self.peak, usage.ru_maxrss)
        self.processes += 1


def start(command, folder, log):
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=log)


def run(commands, parallel, cost, folder, merge=False):
    """Runs commands, `parallel` at a time, and adds their costs."""
    log = os.path.join(folder, "errors.txt")
    waiting, running = list(reversed(commands)), {}
    begin = time.perf_counter()
    while waiting or running:
        while waiting and len(running) < parallel:
            command = waiting.pop()
            with open(log, "ab") as errors:
                process = start(command, folder, errors)
                # Without a reference to it, the next Popen would wait for it instead of wait4.
                running[process.pid] = (process, command)
        pid, status, usage = os.wait4(-1, 0)
        process, command = running.pop(pid)
        process.returncode = os.waitstatus_to_exitcode(status)
        if status:
            sys.exit(f"{' '.join(command)}: status {process.returncode}; see {log}")
        cost.add(usage, merge)
    cost.wall += time.perf_counter() - begin


def settings(data):
    return ["--set", f"ingest.source={data}", "--set", "ingest.conventions.eef_orientation=grip_site"]


def whole(program, folder, artifacts, data, threads, again):
    """Runs every stage as one process. `segment` also makes the audit. With `again`, the audit is removed and made once more by itself,
    and its cost is subtracted from that of `segment`."""
    costs = {}
    for stage in STAGES:
        if stage == "audit":
            if not again:
                continue
            shutil.rmtree(os.path.join(folder, artifacts, "audit"))
        cost = costs["segment+audit" if stage == "segment" else stage] = Cost()
        command = [program, stage, PIPELINE, "--artifacts", artifacts, "--jobs", str(threads), "--quiet"]
        run([command + settings(data)], 1, cost, folder)
    if again:
        both, audit = costs["segment+audit"], costs["audit"]
        both.wall, both.cpu = both.wall - audit.wall, both.cpu - audit.cpu
        costs = {"segment" if name == "segment+audit" else name: cost for name, cost in costs.items()}
    return costs


def sharded(program, folder, artifacts, data, shards, parallel):
    """Runs every stage as its plan says."""
    plan = [program, "plan", PIPELINE, "--shards", str(shards), "--artifacts", artifacts, "--json", *settings(data)]
    costs = defaultdict(Cost)
    begin = time.perf_counter()
    answer = subprocess.run(plan, cwd=folder, check=True, capture_output=True).stdout
    plan, path = json.loads(answer), os.path.join(folder, "plan.json")
    with open(path, "wb") as file:
        file.write(answer)
    costs["plan"].wall = time.perf_counter() - begin
    for group in plan["groups"]:
        if group["stage"] not in [*STAGES, "observe"]:
            continue
        fill = {"{index}": None, "{count}": str(group["count"])}
        commands = []
        for index in range(group["count"]):
            words = [word.replace("{index}", str(index)).replace("{count}", fill["{count}"]) for word in group["command"]]
            # The tasks trust the hashes of the plan, as those of the front-ends do.
            words += ["--plan", path]
            commands.append(words if "merge" in words or "--jobs" in words else words + ["--jobs", "1"])
        merge = "merge" in group["id"] or "reduce" in group["id"]
        run(commands, parallel, costs[group["stage"]], plan.get("directory", folder), merge)
    return dict(costs)


def header():
    print(f"{'episodes':>9} {'stage':<13} {'wall s':>8} {'cpu s':>8} {'ms/ep.':>7} {'merge %':>8} {'peak MiB':>8} {'processes':>9}")


def show(count, costs):
    total = Cost()
    for stage, cost in costs.items():
        for name in ("wall", "cpu", "merge", "processes"):
            setattr(total, name, getattr(total, name) + getattr(cost, name))
        total.peak = max(total.peak, cost.peak)
    for stage, cost in [*costs.items(), ("all", total)]:
        share = 100 * cost.merge / cost.cpu if cost.cpu else 0.0
        print(
            f"{count:>9} {stage:<13} {cost.wall:>8.1f} {cost.cpu:>8.1f} {1e3 * cost.cpu / count:>7.3f} {share:>8.1f}"
            f" {cost.peak / 1024:>8.0f} {cost.processes:>9}",
            flush=True,
        )
    return total


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=os.path.abspath)
    parser.add_argument("source", type=os.path.abspath)
    parser.add_argument("folder", type=os.path.abspath)
    parser.add_argument("--counts", type=int, nargs="+", required=True)
    parser.add_argument("--frames", type=int, default=0)
    parser.add_argument("--files", type=int)
    parser.add_argument("--shards", type=int)
    parser.add_argument("--compare", type=int)
    parser.add_argument("--parallel", type=int, default=2)
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--keep", action="store_true")
    arguments = parser.parse_args()
    per_episode = {}
    os.makedirs(arguments.folder, exist_ok=True)
    for count in arguments.counts:
        data = os.path.join(arguments.folder, f"{count}-{arguments.files}" if arguments.files else f"{count}.hdf5")
        if not os.path.exists(data):
            words = [arguments.source, str(count), data, "--frames", str(arguments.frames)]
            if arguments.files:
                words += ["--files", str(arguments.files), "--jobs", str(arguments.parallel)]
            subprocess.run([sys.executable, os.path.join(HERE, "many_demos.py"), *words], check=True)
        header()
        folder, parallel = arguments.folder, arguments.parallel
        if arguments.compare:
            one = show(count, whole(arguments.program, folder, "whole", data, parallel, False))
            many = show(count, sharded(arguments.program, folder, "sharded", data, arguments.compare, parallel))
            print(f"{arguments.compare} shards against one process: wall {many.wall / one.wall:.3f}, cpu {many.cpu / one.cpu:.3f}")
        elif arguments.shards:
            costs = sharded(arguments.program, folder, "sharded", data, arguments.shards, parallel)
            per_episode[count] = show(count, costs).cpu / count
        else:
            per_episode[count] = show(count, whole(arguments.program, folder, "whole", data, 1, arguments.again)).cpu / count
        if not arguments.keep:
            for name in ("whole", "sharded"):
                shutil.rmtree(os.path.join(folder, name), ignore_errors=True)
            if arguments.files:
                shutil.rmtree(data)
            else:
                os.remove(data)
    if len(per_episode) > 1:
        least, most = min(per_episode.values()), max(per_episode.values())
        print(f"cost per demonstration differs by {100 * (most / least - 1):.1f} % over the counts")


if __name__ == "__main__":
    main()
