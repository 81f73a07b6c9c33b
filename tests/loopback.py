"""What the loopback clusters of the tests share: processes marked by their node, commands on standard input, and the end of everything.

Every process of a node inherits RE4_TEST_NODE=CLUSTER/NODE, so that a node can be killed whole, and nothing of other clusters with it.
"""

import json
import os
import signal
import socket
import sys
import time
import uuid

CLUSTER = uuid.uuid4().hex
MARK = "RE4_TEST_NODE"


def free_ports(count):
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [s.getsockname()[1] for s in sockets]
    for s in sockets:
        s.close()
    return ports


def environment(node, **more):
    return {**os.environ, MARK: f"{CLUSTER}/{node}", **more}


def processes():
    """(id, parent, environment, name) of every process that may be read."""
    found = []
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/environ", "rb") as file:
                    marks = file.read().split(b"\0")
                with open(f"/proc/{entry}/stat") as file:
                    name, rest = file.read().split("(", 1)[1].rsplit(")", 1)
                state, parent = rest.split()[:2]
                if state not in "ZX":
                    found.append((int(entry), int(parent), marks, name))
            except OSError:
                pass
    return found


def of(node):
    """Processes of a node (None: of all nodes), with everything that they started."""
    all_of_them = processes()
    mark = f"{MARK}={CLUSTER}/{node or ''}".encode()
    ids = {i for i, _, marks, _ in all_of_them if any(m == mark or (node is None and m.startswith(mark)) for m in marks)}
    size = -1
    while size != len(ids):
        size = len(ids)
        ids |= {i for i, parent, _, _ in all_of_them if parent in ids}
    return {i: name for i, _, _, name in all_of_them if i in ids and i != os.getpid()}


def kill(ids):
    """Kills processes, and waits until they are gone."""
    ids = list(ids)
    for i in ids:
        try:
            os.kill(i, signal.SIGKILL)
        except ProcessLookupError:
            pass
    for _ in range(1000):
        if not set(ids) & {i for i, *_ in processes()}:
            return ids
        time.sleep(0.01)
    raise SystemExit(f"processes {ids} do not end")


def end():
    """Kills all nodes. A process may start another one meanwhile, so this is repeated until none is left."""
    while True:
        found = of(None)
        if not found:
            return
        kill(found)


def serve(ready, commands):
    """Prints `ready` as a line of JSON, then answers each line of standard input, `NAME [ARGUMENT...]`, with a line. Ends with the input."""
    print(json.dumps(ready), flush=True)
    for line in sys.stdin:
        name, *arguments = line.split()
        print(json.dumps(commands[name](*arguments)), flush=True)
