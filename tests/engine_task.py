"""A task of a plan that stops at a known point: `engine_task.py FOLDER INDEX AT MODE COMMAND...`.

If INDEX is AT, the first try does as MODE says, and later tries run the command. Other tasks run the command.
  interrupt   ends with exit code 75
  die         ends by signal 9
  gate        waits until the file FOLDER/AT.open exists, then runs the command
  I/N         makes shard I/N with the command, then waits as `gate`
A task that waits has written its process id to FOLDER/AT.waiting; a later try writes FOLDER/AT.again.
"""

import os
import signal
import subprocess
import sys
import time

folder, index, at, mode, *command = sys.argv[1:]


def write(name):
    with open(f"{folder}/{at}.tmp", "w") as file:
        file.write(str(os.getpid()))
    os.rename(f"{folder}/{at}.tmp", f"{folder}/{at}.{name}")


if index == at:
    try:
        os.close(os.open(f"{folder}/{at}.first", os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        write("again")
    else:
        if mode == "interrupt":
            sys.exit(75)
        if mode == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if mode != "gate":
            part = list(command)
            part[part.index("--shard") + 1] = mode
            subprocess.run(part, check=True)
        write("waiting")
        while not os.path.exists(f"{folder}/{at}.open"):
            time.sleep(0.02)
os.execvp(command[0], command)
