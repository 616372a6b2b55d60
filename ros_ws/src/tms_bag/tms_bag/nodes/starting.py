"""How an executable starts: loading a node's modules takes a second, in which a signal just ends it.

Nothing of weight is imported here, nor by the modules of executables: it would be loaded too early.
"""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module
from types import FrameType


def start(module: str) -> int:
    """Load a node's module and run its `main`, which catches signals itself; returns the exit code.

    Until then nothing has begun: SIGINT and SIGTERM end the process with exit code 0 and without the
    traceback of whatever was being imported.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    return int(import_module(module).main())


def _leave(number: int, frame: FrameType | None) -> None:
    os._exit(0)


if __name__ == "__main__":  # python -m tms_bag.nodes.starting MODULE ARGUMENTS
    sys.exit(start(sys.argv.pop(1)))
