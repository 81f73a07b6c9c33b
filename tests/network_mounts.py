#!/usr/bin/env python3
"""Runs the tasks of a plan on two nodes that share a network file system, while one of them is disturbed, and compares the artifacts.

    tests/network_mounts.py PROGRAM PIPELINE.toml DATA FOLDER --shards N --disturb GROUP [--stages A,B,...] [options of re4-pipe plan]

The file system is GlusterFS, served on the loopback and mounted twice. A node is a mount with a host name of its own, and has the files at
the same path FOLDER/shared as the other one (namespaces of Linux). DATA, the folder of the datasets, and the pipeline are copied to the
file system. The tasks of every group run alternately on the two nodes, both at the same time. There are four runs:

  local   one process per stage, on the local disk, without the file system: its artifacts are what the others must equal
  killed  the client of node 1's mount is killed while a task of GROUP writes its second part; node 2 runs the rest
  frozen  the client is stopped there, so that the task hangs; node 2 runs everything else, also that task, and publishes the artifact;
          then the client goes on
  both    both nodes run every task at the same time

In all runs, the artifacts must have the same paths, so the same keys, and the same bytes. After `killed`, node 1 is mounted again and
removes what its killed task left. Prints a line for each run. FOLDER must be empty or absent. Needs root, /dev/fuse and the Debian
packages glusterfs-server and glusterfs-client; otherwise it prints that it is skipped.
"""

import argparse
import contextlib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid

import loopback

LONGEST = 300  # seconds until an event counts as not happening

BRICK = """volume posix
  type storage/posix
  option directory {brick}
  option volume-id {id}
end-volume
volume locks
  type features/locks
  subvolumes posix
end-volume
volume {brick}
  type performance/io-threads
  subvolumes locks
end-volume
volume server
  type protocol/server
  option transport-type tcp
  option transport.address-family inet
  option transport.socket.bind-address 127.0.0.1
  option transport.socket.listen-port {port}
  option auth.addr.{brick}.allow 127.0.0.1
  subvolumes {brick}
end-volume
"""

CLIENT = """volume client
  type protocol/client
  option transport-type tcp
  option transport.address-family inet
  option remote-host 127.0.0.1
  option remote-port {port}
  option remote-subvolume {brick}
end-volume
volume write-behind
  type performance/write-behind
  subvolumes client
end-volume
"""


def fail(text):
    raise SystemExit(f"error: {text}")


def impossible(folder):
    """Why two mounts cannot be made here; None if they can."""
    for name in ["glusterfsd", "glusterfs", "unshare", "mount", "umount", "hostname"]:
        if not shutil.which(name):
            return f"no {name} on the PATH; run scripts/setup-engines.sh"
    if os.getuid() != 0:
        return "mounts need root"
    if not os.path.exists("/dev/fuse"):
        return "no /dev/fuse"
    try:
        os.setxattr(folder, "trusted.re4", b"1")
    except OSError as error:
        return f"{folder} takes no trusted attributes ({error.strerror})"
    probe = subprocess.run(["unshare", "--mount", "--uts", "hostname", "node1"], capture_output=True, text=True, check=False)
    return f"no namespaces ({probe.stderr.strip()})" if probe.returncode else None


def unmount(folder, number):
    subprocess.run(["umount", "-l", f"{folder}/m{number}"], check=False, capture_output=True)


class Mounts:
    """A file system on the loopback, and two mounts of it."""

    def __init__(self, folder):
        self.folder, self.brick = folder, f"{folder}/brick"
        for name in ["brick", "m1", "m2", "shared"]:
            os.makedirs(f"{folder}/{name}", exist_ok=True)
        identity = uuid.uuid4()
        os.setxattr(self.brick, "trusted.glusterfs.volume-id", identity.bytes)
        (port,) = loopback.free_ports(1)
        for name, text in [("brick", BRICK), ("client", CLIENT)]:
            with open(f"{folder}/{name}.vol", "w") as file:
                file.write(text.format(brick=self.brick, id=identity, port=port))
        self.start("glusterfsd", "brick")
        for number in (1, 2):
            self.mount(number)

    def start(self, program, name, *where):
        volume = "brick" if name == "brick" else "client"
        command = [program, "-f", f"{self.folder}/{volume}.vol", "-l", f"{self.folder}/{name}.log", "-p", f"{self.folder}/{name}.pid"]
        subprocess.run([*command, *where], check=True, env=loopback.environment(name))

    def mount(self, number):
        path = f"{self.folder}/m{number}"
        self.start("glusterfs", f"m{number}", path)
        end = time.monotonic() + LONGEST
        while True:
            with contextlib.suppress(OSError):
                if os.path.ismount(path) and os.listdir(path) is not None:
                    return
            if time.monotonic() > end:
                fail(f"{path} is not mounted, see {self.folder}/m{number}.log")
            time.sleep(0.05)

    def client(self, number, number_of_signal):
        for process in loopback.of(f"m{number}"):
            os.kill(process, number_of_signal)

    def kill(self, number):
        loopback.kill(loopback.of(f"m{number}"))


class Task:
    """A process on a node. Its output is in a file of the local disk."""

    def __init__(self, mounts, node, command):
        self.command = command
        self.output = f"{mounts.folder}/task-{uuid.uuid4().hex[:8]}.txt"
        inside = 'hostname "node$1" && mount --bind "$2/m$1" "$2/shared" && cd "$2/shared" && shift 2 && exec "$@"'
        words = ["unshare", "--mount", "--uts", "--propagation", "private", "sh", "-c", inside, "sh", str(node), mounts.folder, *command]
        environment = loopback.environment(f"node{node}", RE4_DATA=f"{mounts.folder}/shared/data")
        with open(self.output, "wb") as output:
            # Not in a folder of a mount, because every process of the machine may have to look it up.
            self.process = subprocess.Popen(words, stdout=output, stderr=output, env=environment, cwd="/")
        self.pid = self.process.pid

    def text(self):
        with open(self.output) as file:
            return file.read()

    def end(self):
        return self.process.wait(timeout=10 * LONGEST)

    def done(self):
        if self.end() != 0:
            fail(f"{' '.join(self.command)} ended with {self.process.returncode}: {self.text()}")

    def caught(self, artifacts):
        """Stops the process while it writes a part, after it has published another one. False if it has ended before."""
        seen = set()
        while self.process.poll() is None:
            own = set()
            with contextlib.suppress(OSError):
                # .tmp-WHAT-HOST-BOOT-NAMESPACE-PROCESS-START-RANDOM
                own = {name for name in os.listdir(artifacts) if name.split("-")[5:6] == [str(self.pid)]}
            seen |= own
            if own and len(seen) > 1:
                os.kill(self.pid, signal.SIGSTOP)
                # What it had asked the file system for may still be done.
                time.sleep(0.1)
                if any(os.path.exists(f"{artifacts}/{name}") for name in own):
                    return True
                os.kill(self.pid, signal.SIGCONT)
            time.sleep(0.001)
        return False


def tasks(group):
    for index in range(group["count"]):
        yield [word.replace("{index}", str(index)).replace("{count}", str(group["count"])) for word in group["command"]]


def hashes(artifacts):
    """Hashes of the files of all artifacts by path. Records of runs contain times."""
    found = {}
    for folder, _, names in os.walk(artifacts):
        for name in names:
            path = os.path.relpath(os.path.join(folder, name), artifacts)
            if not path.startswith(("runs/", ".tmp-")):
                with open(os.path.join(folder, name), "rb") as file:
                    found[path] = hashlib.sha256(file.read()).hexdigest()
    return found


def unfinished(artifacts):
    return sorted(name for name in os.listdir(artifacts) if name.startswith(".tmp-"))


def parts(artifacts):
    return sum(path.split("/")[-2].isdigit() and path.endswith("/part.json") for path in hashes(artifacts))


def compare(name, found, expected):
    for path in sorted(expected.keys() | found.keys()):
        if found.get(path) != expected.get(path):
            state = "is missing" if path not in found else "is extra" if path not in expected else "has other bytes"
            fail(f"in run {name}, {path} {state}")


class Run:
    """A run of a plan on both nodes, with its artifacts in a folder of its own."""

    def __init__(self, mounts, name, options):
        self.mounts, self.name, self.options = mounts, name, options
        self.artifacts = f"{mounts.brick}/{name}"
        plan = [*options.plan, "--shards", str(options.shards), "--artifacts", name]
        task = Task(mounts, 2, [options.program, "plan", "pipeline.toml", "--json", "--quiet", *plan])
        task.done()
        self.plan = json.loads(task.text())
        with open(f"{mounts.folder}/m2/{name}.json", "w") as file:
            file.write(task.text())
        self.groups = [g for g in self.plan["groups"] if options.stages is None or g["stage"] in options.stages]
        for group in self.groups:
            # As the front-ends do.
            group["command"] += ["--plan", f"{name}.json"] if self.plan["sources"] else []
        # The task that was disturbed, and what is known about that moment.
        self.victim, self.moment = None, None

    def task(self, node, command):
        return Task(self.mounts, node, command)

    def disturb(self, task):
        """Kills or stops the client of node 1 in the middle of a task. False if the task has ended before."""
        if not task.caught(self.artifacts):
            return False
        self.moment = parts(self.artifacts)
        if self.name == "killed":
            self.mounts.kill(1)
        else:
            self.mounts.client(1, signal.SIGSTOP)
        os.kill(task.pid, signal.SIGCONT)
        self.victim = task
        return True

    def on_node_1(self, waiting, left, disturbed):
        while waiting:
            command = waiting.pop(0)
            task = self.task(1, command)
            if disturbed and self.disturb(task):
                left += [command, *waiting]
                return
            task.done()

    def on_node_2(self, waiting):
        for command in waiting:
            self.task(2, command).done()

    def all(self):
        turn, errors = 0, []
        # An error of a thread must end the run.
        threading.excepthook = lambda found: errors.append(found.exc_value)
        for group in self.groups:
            waiting = {1: [], 2: []}
            for command in tasks(group):
                waiting[2 if self.victim else turn % 2 + 1].append(command)
                turn += 1
            if self.name == "both":
                for command in waiting[1] + waiting[2]:
                    for task in [self.task(1, command), self.task(2, command)]:
                        task.done()
                continue
            left = []
            thread = threading.Thread(target=self.on_node_1, args=(waiting[1], left, group["id"] == self.options.disturb))
            thread.start()
            self.on_node_2(waiting[2])
            thread.join()
            if errors:
                raise errors[0]
            self.on_node_2(left)
        if self.name != "both" and self.victim is None:
            fail(f"no task of {self.options.disturb} on node 1 could be disturbed after its first part; use fewer shards")

    def after_killed(self):
        self.victim.end()
        text = self.victim.text()
        if self.victim.process.returncode == 0 or "panicked" in text or "changed while" in text or "error: " not in text:
            fail(f"the task whose mount was lost ended with {self.victim.process.returncode}: {text}")
        print(f"  the task of node 1 ended with {self.victim.process.returncode}: {text.strip().splitlines()[-1]}")
        left = unfinished(self.artifacts)
        unmount(self.mounts.folder, 1)
        self.mounts.mount(1)
        *_, last = self.groups
        for node, expected in [(2, left), (1, [])]:
            self.task(node, next(tasks(last))).done()
            found = unfinished(self.artifacts)
            if found != expected:
                fail(f"after a task of node {node}, the unfinished folders are {found}, not {expected}")
        return f"{len(left)} unfinished folder of node 1 kept by node 2, removed by node 1"

    def after_frozen(self):
        if self.victim.process.poll() is not None:
            fail(f"the task whose mount hangs has ended: {self.victim.text()}")
        self.mounts.client(1, signal.SIGCONT)
        self.victim.done()
        return "the task that hung ended with 0"


def copy(options, folder):
    shutil.copytree(options.data, f"{folder}/data")
    shutil.copyfile(options.pipeline, f"{folder}/pipeline.toml")


def local(options, folder):
    """The artifacts of one process per stage on the local disk, and the wall time."""
    os.makedirs(folder)
    copy(options, folder)
    environment = {**os.environ, "RE4_DATA": f"{folder}/data"}
    plan = [options.program, "plan", "pipeline.toml", "--json", "--quiet", *options.plan, "--shards", "1"]
    answer = subprocess.run(plan, cwd=folder, env=environment, check=True, capture_output=True).stdout
    begin = time.monotonic()
    for group in json.loads(answer)["groups"]:
        if options.stages is None or group["stage"] in options.stages:
            for command in tasks(group):
                subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
    return hashes(f"{folder}/artifacts"), time.monotonic() - begin


def main():
    parser = argparse.ArgumentParser(usage=__doc__.split("\n\n")[1].strip(), allow_abbrev=False)
    for name in ["program", "pipeline", "data", "folder"]:
        parser.add_argument(name, type=os.path.abspath)
    parser.add_argument("--shards", type=int, required=True)
    parser.add_argument("--disturb", required=True)
    parser.add_argument("--stages", type=lambda text: text.split(","))
    options, options.plan = parser.parse_known_args()
    os.makedirs(options.folder, exist_ok=True)
    reason = impossible(options.folder)
    if reason:
        print(f"skipped: {reason}")
        return
    expected, seconds = local(options, f"{options.folder}/local")
    size = sum(os.path.getsize(f"{options.folder}/local/artifacts/{path}") for path in expected)
    print(f"local: {seconds:.1f} s, {len(expected)} files, {size / 1e6:.1f} MB, {parts(f'{options.folder}/local/artifacts')} parts", flush=True)
    try:
        mounts = Mounts(options.folder)
        copy(options, f"{options.folder}/m1")
        for name in ["killed", "frozen", "both"]:
            run = Run(mounts, name, options)
            begin = time.monotonic()
            run.all()
            seconds = time.monotonic() - begin
            more = {"killed": run.after_killed, "frozen": run.after_frozen, "both": lambda: None}[name]()
            compare(name, hashes(run.artifacts), expected)
            if unfinished(run.artifacts):
                fail(f"run {name} left {unfinished(run.artifacts)}")
            facts = ["same bytes"]
            if run.moment is not None:
                facts.append(f"disturbed after {run.moment} parts")
            facts += [more] if more else []
            print(f"{name}: {seconds:.1f} s, " + ", ".join(facts), flush=True)
    finally:
        loopback.end()
        for number in (1, 2):
            unmount(options.folder, number)


if __name__ == "__main__":
    sys.exit(main())
