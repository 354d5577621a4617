"""The program: `scenesplat`, or `python -m scenesplat`."""

import os
import signal
import sys

from ._scenesplat import run_program


def main() -> int:
    """Runs the program on the words of the command line and gives its exit code."""
    # Ctrl-C is the program's own: it saves what it can, and the second one ends it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Errors name the file and the value; a list of functions would hide them.
    os.environ["RUST_LIB_BACKTRACE"] = "0"
    return run_program(["scenesplat", *sys.argv[1:]], [sys.executable, "-m", "scenesplat"])


if __name__ == "__main__":
    sys.exit(main())
