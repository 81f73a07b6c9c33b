"""``python -m re4_pipe`` is the command ``re4-pipe``."""

import os
import sys

from re4_pipe._command import command
from re4_pipe._errors import Re4Error


def main() -> None:
    try:
        path = command()
    except Re4Error as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    # The command replaces this process, so that signals and the exit code are its own.
    os.execv(path, [str(path), *sys.argv[1:]])


if __name__ == "__main__":
    main()
