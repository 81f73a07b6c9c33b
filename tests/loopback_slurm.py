"""Three real Slurm nodes on the loopback of this machine, without systemd, cgroups or accounting: `loopback_slurm.py FOLDER [MAX_ARRAY_SIZE]`.

Prints {"SLURM_CONF": PATH} when all nodes are idle. Commands on standard input:
  kill NODE     kills a whole node: daemon, steps and tasks; prints the names of the processes
  orphan NODE   kills only the daemon, so that the node is down for Slurm while its tasks go on
  start NODE    starts a node that was killed again, and waits until it is idle; prints its name
  release       lets requeued jobs start now instead of after Slurm's waiting time; prints their numbers
At the end of standard input everything is killed. Needs root and the Debian packages slurmctld, slurmd, slurm-client and munge.
"""

import os
import socket
import subprocess
import sys
import time

import loopback

NODES = ["n1", "n2", "n3"]


def configuration(folder, largest):
    host = socket.gethostname().split(".")[0]
    control, *ports = loopback.free_ports(1 + len(NODES))
    nodes = [f"NodeName={n} NodeHostname={host} NodeAddr=127.0.0.1 Port={p} CPUs=1 RealMemory=8000" for n, p in zip(NODES, ports)]
    return "\n".join([
        "ClusterName=loopback", f"SlurmctldHost={host}(127.0.0.1)", f"SlurmctldPort={control}", "SlurmUser=root",
        "AuthType=auth/munge", f"AuthInfo=socket={folder}/munge.socket", f"StateSaveLocation={folder}/state",
        f"SlurmdSpoolDir={folder}/spool-%n", f"SlurmctldPidFile={folder}/slurmctld.pid", f"SlurmdPidFile={folder}/slurmd-%n.pid",
        f"SlurmctldLogFile={folder}/slurmctld.log", f"SlurmdLogFile={folder}/slurmd-%n.log",
        "ProctrackType=proctrack/linuxproc", "TaskPlugin=task/none", "JobAcctGatherType=jobacct_gather/none",
        "AccountingStorageType=accounting_storage/none", "SelectType=select/cons_tres", "SelectTypeParameters=CR_Core",
        "SlurmdParameters=config_overrides", "SchedulerParameters=sched_interval=2,bf_interval=2,batch_sched_delay=1",
        "ReturnToService=2", "SlurmdTimeout=10", "KillWait=5", f"MaxArraySize={largest}", "MaxJobCount=20000", "JobRequeue=1",
        "MpiDefault=none", *nodes, f"PartitionName=p Nodes={','.join(NODES)} Default=YES MaxTime=60 State=UP", "",
    ])  # fmt: skip


def run(*command, **options):
    return subprocess.run(command, check=True, capture_output=True, text=True, **options).stdout


def start(folder, largest):
    for name in ["state", *(f"spool-{n}" for n in NODES)]:
        os.makedirs(f"{folder}/{name}")
    with open(f"{folder}/key", "wb") as file:
        file.write(os.urandom(1024))
    os.chmod(f"{folder}/key", 0o400)
    os.environ["SLURM_CONF"] = f"{folder}/slurm.conf"
    with open(f"{folder}/slurm.conf", "w") as file:
        file.write(configuration(folder, largest))
    munge = [f"--{name}-file={folder}/munge.{name}" for name in ["pid", "log", "seed"]]
    run("munged", "--force", f"--key-file={folder}/key", f"--socket={folder}/munge.socket", *munge, env=loopback.environment("munge"))
    run("slurmctld", env=loopback.environment("control"))
    begin(*NODES)


def begin(*nodes):
    """Starts nodes, and waits until they are idle."""
    for node in nodes:
        run("slurmd", "-N", node, env=loopback.environment(node))
    for _ in range(600):
        answer = subprocess.run(["sinfo", "-h", "-N", "-n", ",".join(nodes), "-o", "%N %T"], capture_output=True, text=True, check=False)
        if answer.stdout.split() == [word for node in nodes for word in (node, "idle")]:
            return nodes
        time.sleep(0.1)
    raise SystemExit(f"the nodes are not idle: {answer.stdout}{answer.stderr}")


def kill(node):
    found = loopback.of(node)
    loopback.kill(found)
    return sorted(found.values())


def orphan(node):
    found = {i: name for i, name in loopback.of(node).items() if name == "slurmd"}
    loopback.kill(found)
    return sorted(found.values())


def release():
    waiting = []
    for line in run("squeue", "-h", "-r", "-t", "PENDING", "-o", "%i %r").splitlines():
        task, reason = line.split(" ", 1)
        if reason == "BeginTime":
            # Not `run`, because a task that has just started cannot be changed.
            subprocess.run(["scontrol", "update", f"jobid={task}", "StartTime=now"], check=False, capture_output=True)
            waiting.append(task)
    return waiting


if __name__ == "__main__":
    folder = os.path.abspath(sys.argv[1])
    try:
        start(folder, int(sys.argv[2]) if len(sys.argv) > 2 else 10001)
        commands = {"kill": kill, "orphan": orphan, "start": begin, "release": release}
        loopback.serve({"SLURM_CONF": os.environ["SLURM_CONF"]}, commands)
    finally:
        loopback.end()
