"""Three real Ray nodes on the loopback of this machine: `loopback_ray.py FOLDER`, run by a Python that has ray.

Prints {"address": ..., "node_ip_address": ...} when all nodes are alive. Commands on standard input:
  start N    starts node N again, and waits until it is alive; prints the number of nodes that are
  kill N     kills node N (1 or 2; 0 is the head): only its raylet, as a node that is lost; prints the names of the processes
  alive      prints the number of nodes that are alive
At the end of standard input everything is killed.

127.0.0.1 is not used, because Ray replaces it by the machine's own address.
"""

import os
import socket
import subprocess
import sys
import time

import loopback
import ray

NODES = ["127.0.0.2", "127.0.0.3", "127.0.0.4"]
SMALL = ["--num-cpus=1", "--object-store-memory=80000000", "--memory=8000000000"]


def start(folder):
    os.makedirs(folder)
    with socket.create_server((NODES[0], 0)) as found:
        port = found.getsockname()[1]
    address = f"{NODES[0]}:{port}"
    begin(0, ["--head", f"--port={port}", "--include-dashboard=false", f"--temp-dir={folder}"])
    for number in range(1, len(NODES)):
        begin(number, [f"--address={address}"])
    ray.init(address=address, _node_ip_address=NODES[0], log_to_driver=False, logging_level="error")
    wait_for_all()
    return {"address": address, "node_ip_address": NODES[0]}


def begin(number, role):
    # A script beside this interpreter, which need not be on the PATH.
    program = os.path.join(os.path.dirname(sys.executable), "ray")
    environment = loopback.environment(f"node{number}", RAY_USAGE_STATS_ENABLED="0", RAY_DISABLE_IMPORT_WARNING="1")
    command = [program, "start", f"--node-ip-address={NODES[number]}", *role, *SMALL]
    started = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if started.returncode != 0:
        raise SystemExit(started.stdout + started.stderr)


def again(number):
    begin(int(number), [f"--address={ray.get_runtime_context().gcs_address}"])
    return wait_for_all()


def wait_for_all():
    while alive() < len(NODES):
        time.sleep(0.05)
    return alive()


def alive():
    return sum(node["Alive"] for node in ray.nodes())


def kill(number):
    found = {i: name for i, name in loopback.of(f"node{number}").items() if name == "raylet"}
    loopback.kill(found)
    return sorted(found.values())


if __name__ == "__main__":
    try:
        loopback.serve(start(os.path.abspath(sys.argv[1])), {"start": again, "kill": kill, "alive": alive})
    finally:
        loopback.end()
