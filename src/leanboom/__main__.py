"""Entry point of the command line, for `leanboom` and `python -m leanboom`: Ctrl-C is handled from the first import on.

An interruption while modules load would end in a traceback, or in whatever a library makes of it. So until a command
does its work, and after it, Ctrl-C ends the process at once: there is nothing to tidy up.
"""

import os
import signal
import sys

INTERRUPTED = 130  # exit code of a process ended by Ctrl-C


def main() -> None:
    """Run the command line and end the process with its exit code."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else it is ignored, as under nohup
        signal.signal(signal.SIGINT, _leave)
    from leanboom.cli.app import main as run

    sys.exit(run())


def _leave(*_: object) -> None:
    """Print that the run was interrupted, and end the process."""
    try:
        os.write(2, b"leanboom: interrupted\n")
    finally:
        os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
