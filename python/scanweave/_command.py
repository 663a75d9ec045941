"""The console script: the command ``scanweave``, without training."""

from __future__ import annotations

import signal
import sys

from ._scanweave import command


def main() -> None:
    """Run the command with the arguments of this process and end with its exit code."""
    # The command watches for Ctrl-C itself, and before it does, Ctrl-C ends the process.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(command(["scanweave", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
