"""A node as a process: spin until a signal, one line on stderr for bad input, exit codes."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions, install_signal_handlers
from rclpy.utilities import remove_ros_args
from tms_model import ParameterError

from tms_bag.errors import RecordingError
from tms_bag.nodes.loopback import stay_on_this_machine
from tms_bag.nodes.security import refuse_without_security

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
    caught = _catch_signals()
    try:
        if _wants_help(args):
            print(_usage(create))
            return 0
        refuse_without_security(args)
        stay_on_this_machine(os.environ)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except (*BAD_ARGUMENTS, ParameterError) as error:
        return _complain(error, 2)
    node, code = None, 0
    try:
        node = create()
        rclpy.get_global_executor()  # made now, since it can't be after a signal
        install_signal_handlers(SignalHandlerOptions.ALL)
        if caught:
            signal.raise_signal(caught[0])
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


def _wants_help(args: list[str] | None) -> bool:
    """Whether help is asked for. ParameterError for other arguments that aren't ROS's, which ROS ignores."""
    words = remove_ros_args(args)[1 if args is None else 0 :]
    if words and words[0] not in ("-h", "--help"):
        raise ParameterError(
            f"unexpected argument {words[0]!r}: parameters and remaps stand behind --ros-args,"
            " as in --ros-args -p NAME:=VALUE"
        )
    return bool(words)


def _usage(create: Callable[[], Runnable]) -> str:
    name = Path(sys.argv[0]).name
    return f"""usage: {name} [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]

{create.__doc__}

docs/nodes.md lists its parameters, topics and services; so do, while it runs,
`ros2 param describe /{name} NAME` and `ros2 node info /{name}`."""


def _catch_signals() -> list[int]:
    """Catch SIGINT and SIGTERM; returns the list of those that have come.

    While a node is made they wait, since what they shut down must not be half made. Afterwards rclpy's own
    handlers shut rclpy down, which ends waiting and spinning, and nothing else: Python would raise
    KeyboardInterrupt wherever it is, in the middle of writing a message, too.
    """
    caught: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda came, frame: caught.append(came))
    return caught


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
