"""A node as a process: spin until a signal, one line on stderr for bad input, exit codes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from tms_model import ParameterError

from tms_bag.errors import RecordingError

RCLError = rclpy_implementation.RCLError
BAD_ARGUMENTS = (rclpy_implementation.UnknownROSArgsError, RCLError)


class Runnable(Protocol):
    """A node with something to do, and something to leave behind."""

    def run(self) -> None:
        """Work until done, or until rclpy is shut down by a signal."""

    def close(self) -> None:
        """Finish what was begun; rclpy may be shut down already."""


def run_node(create: Callable[[], Runnable], args: list[str] | None = None) -> int:
    """Run a node and return the exit code of its process.

    0: done, or stopped by SIGINT or SIGTERM; 1: the system failed (a full disk); 2: bad input.
    """
    try:
        rclpy.init(args=args)
    except BAD_ARGUMENTS as error:
        return _complain(error, 2)
    node, code = None, 0
    try:
        node = create()
        node.run()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        if rclpy.ok():  # else a signal came while something was published
            raise
    except (ParameterError, RecordingError) as error:
        code = _complain(error, 2)
    except OSError as error:
        code = _complain(error, 1)
    finally:
        code = _close(node, code)
    return code


def _close(node: Runnable | None, code: int) -> int:
    """Finish the node; returns the exit code, another one if only this fails."""
    try:
        if node is not None:
            node.close()
    except (OSError, RecordingError) as error:
        code = code or _complain(error, 1)
    with suppress(RCLError):  # the signal handler may be shutting down at this very moment
        rclpy.try_shutdown()
    return code


def _complain(error: Exception, code: int) -> int:
    print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
    return code
