"""What the front-ends share: plans, the tasks in them, one try of a task, the order of groups, the final report. Python 3.6 or newer.

A task writes to LOGS/GROUP.INDEX.log, over all its tries. Lines that start with "re4-engine:" say which part ran where, and how it ended.
"""

import argparse
import concurrent.futures
import json
import os
import shutil
import signal
import subprocess
import sys
import time

AGAIN = 75  # The program was interrupted; the same command continues the work.

EXIT_CODES = """exit codes: 0 all tasks are done; 1 tasks failed, or were not started because others failed; 2 nothing was started
(usage, plan or engine); 75 interrupted. After 1 and 75, the same command continues: finished parts are not made again."""


class Task:
    def __init__(self, plan, group, index):
        fill = {"{index}": str(index), "{count}": str(group["count"])}
        self.command = []
        for word in group["command"]:
            for name, value in fill.items():
                word = word.replace(name, value)
            self.command.append(word)
        self.name = "{} {}/{}".format(group["id"], index, group["count"])
        self.index, self.directory = index, plan["directory"]
        self.log = os.path.join(plan["logs"], "{}.{}.log".format(group["id"], index))
        self.environment = {}


def refuse(text):
    print("error: " + text, file=sys.stderr)
    sys.exit(2)


def arguments(engine, about, more):
    """Options and plan of a front-end. Options that are not its own go to `re4-pipe plan`, those after -- are returned as `rest`."""
    parser = argparse.ArgumentParser(prog="scripts/engines/" + engine, description=about, allow_abbrev=False, epilog=EXIT_CODES,
                                     usage="%(prog)s PLAN.json|PIPELINE.toml [options] [options of re4-pipe plan, such as --shards N]")
    parser.add_argument("--logs", help="folder of the logs, which all nodes see; default: re4-logs/{}-TIME".format(engine))
    parser.add_argument("--retries", type=int, default=5, help="how often a task is tried again after an interrupt or a lost node; default 5")
    more(parser)
    words, rest = sys.argv[1:], []
    if "--" in words:
        words, rest = words[: words.index("--")], words[words.index("--") + 1 :]
    if not words or words[0].startswith("-"):
        parser.print_help()
        sys.exit(0 if "--help" in words or "-h" in words else 2)
    options, extra = parser.parse_known_args(words[1:])
    options.rest = rest
    plan = read(words[0], extra)
    logs = options.logs or "re4-logs/{}-{}-{}".format(engine, time.strftime("%Y%m%d-%H%M%S"), os.getpid())
    plan["logs"] = os.path.join(plan["directory"], logs)
    os.makedirs(plan["logs"], exist_ok=True)
    path = os.path.join(plan["logs"], "plan.json")
    for group in plan["groups"]:
        # So that no task hashes the dataset again.
        if plan.get("sources") and "--plan" not in group["command"]:
            group["command"] += ["--plan", path]
    with open(path, "w") as file:
        json.dump(plan, file, indent=1)
    return options, plan


def read(path, extra):
    """The plan in a file, or the plan that `re4-pipe plan` makes for a pipeline."""
    if path.endswith(".json"):
        if extra:
            refuse("{} has no effect on a finished plan; give it to re4-pipe plan".format(" ".join(extra)))
        try:
            with open(path) as file:
                plan = json.load(file)
        except (OSError, ValueError) as error:
            refuse("{} is not a plan: {}; make one with re4-pipe plan --json".format(path, error))
        if not isinstance(plan, dict):
            refuse("{} is not a plan; make one with re4-pipe plan --json".format(path))
    else:
        built = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../target/release/re4-pipe")
        program = os.environ.get("RE4_PIPE") or shutil.which("re4-pipe") or os.path.normpath(built)
        try:
            done = subprocess.run([program, "plan", path, "--json", "--quiet"] + extra, stdout=subprocess.PIPE)
        except OSError as error:
            refuse("{} cannot be run: {}; set RE4_PIPE to the program".format(program, error))
        if done.returncode != 0:
            sys.exit(2)
        plan = json.loads(done.stdout.decode())
    if plan.get("format") != 1:
        refuse("{} has format {}, not 1; use the front-ends of the program that made it".format(path, plan.get("format")))
    if not plan["groups"]:
        print("re4-engine: nothing to do, all artifacts exist")
        sys.exit(0)
    return plan


def tasks(plan, group):
    return [Task(plan, group, index) for index in group.get("indices", range(group["count"]))]


def attempt(task, where):
    """Tries a task once, with its output in its log. Returns the exit code, negative for a signal."""
    with open(task.log, "a") as log:
        log.write("re4-engine: {} begins on {}, {}\n".format(task.name, where, time.strftime("%FT%TZ", time.gmtime())))
        log.flush()
        start = time.monotonic()
        environment = dict(os.environ, **task.environment)
        child = subprocess.Popen(task.command, cwd=task.directory, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        task.child = child
        try:
            # Ray cancels a task by an exception between two statements, which cannot interrupt one long wait.
            while child.poll() is None:
                time.sleep(0.05)
            code = child.returncode
        except BaseException:
            child.terminate()
            child.wait()
            raise
        log.write("re4-engine: {} ended with {} on {} after {:.1f} s\n".format(task.name, code, where, time.monotonic() - start))
        return code


def interrupt_on_termination():
    def handle(*_):
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, handle)


def schedule(plan, start, outcomes):
    """Starts the tasks of a group when all groups before it are done. `start(task, group)` returns a future of the exit code."""
    waiting, running, left = list(plan["groups"]), {}, {}
    while True:
        for group in list(waiting):
            if all(name in left and left[name] == 0 for name in group["after"]):
                waiting.remove(group)
                new = tasks(plan, group)
                left[group["id"]] = len(new)
                running.update({start(task, group): (task, group["id"]) for task in new})
        if not running:
            return
        for future in concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED).done:
            task, group = running.pop(future)
            try:
                outcomes[task.name] = future.result()
            except Exception as error:
                outcomes[task.name] = "failed: {}".format(str(error).strip().split("\n")[-1] or type(error).__name__)
            left[group] -= outcomes[task.name] == 0


def history(task):
    """Hosts on which a task began, and the last line that the program itself wrote, from the task's log."""
    hosts, said = [], ""
    try:
        with open(task.log, errors="replace") as log:
            for line in log:
                if line.startswith("re4-engine: {} begins on ".format(task.name)):
                    hosts.append(line.split(" begins on ")[1].split(",")[0])
                elif not line.startswith("re4-engine:") and line.strip():
                    said = line.strip()
    except OSError:
        pass
    return hosts, said


def report(plan, outcomes, start, interrupted=False, most=20):
    """Prints what ran and what failed. `outcomes` has an exit code or a text for each task that ended. Returns the exit code."""
    total = failed = missing = retried = 0
    for group in plan["groups"]:
        mine, lines = tasks(plan, group), []
        for task in mine:
            outcome = outcomes.get(task.name)
            hosts, said = history(task)
            missing += outcome is None
            failed += outcome not in (None, 0)
            retried += len(hosts) > 1
            if outcome not in (None, 0):
                what = outcome if isinstance(outcome, str) else "failed with {}".format(outcome)
                lines.insert(0, "  {} {} on {}, see {}\n    {}".format(task.name, what, hosts[-1] if hosts else "no node", task.log, said))
            elif len(hosts) > 1:
                lines.append("  {} ran {} times, on {}, see {}".format(task.name, len(hosts), ", ".join(hosts), task.log))
        total += len(mine)
        print("{:<16} {} of {} tasks done".format(group["id"], sum(outcomes.get(task.name) == 0 for task in mine), len(mine)))
        print("\n".join(lines[:most] + ["  and {} more, see the logs".format(len(lines) - most)] * (len(lines) > most)), end="\n" * bool(lines))
    print("re4-engine: {}{} of {} tasks done, {} failed, {} not run, {} tried again, {:.0f} s; logs in {}".format(
        "interrupted, " * interrupted, total - failed - missing, total, failed, missing, retried, time.monotonic() - start, plan["logs"]), flush=True)
    return AGAIN if interrupted else int(failed + missing > 0)
