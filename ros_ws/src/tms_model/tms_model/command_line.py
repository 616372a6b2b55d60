"""What all command lines share: one line on stderr and exit code 2 for bad input, one JSON on stdout."""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, NoReturn

NEGATIVE_LIST = re.compile(r"-[0-9.]+(,[-+0-9.e]+)+")  # of numbers, which argparse takes for a flag


class Parser(argparse.ArgumentParser):
    """An ArgumentParser whose errors are one line, and to which -90,0,180 is a value and no flag."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse does, a list of numbers that begins with a minus sign joined to the flag before it."""
        words: list[str] = []
        for word in sys.argv[1:] if args is None else args:
            if (
                words
                and words[-1].startswith("--")
                and "=" not in words[-1]
                and NEGATIVE_LIST.fullmatch(word)
            ):
                words[-1] += f"={word}"
            else:
                words.append(word)
        return super().parse_known_args(words, namespace)

    def error(self, message: str) -> NoReturn:
        """Say in one line what is wrong with the arguments and leave with exit code 2."""
        self.exit(2, f"{self.prog}: {' '.join(message.split())} (see '{self.prog} --help')\n")


class Command(NamedTuple):
    """A sub-command that a package offers to another one's command line, as an entry point."""

    text: str  # one line of help
    declare: Callable[[Parser], None]  # adds its arguments
    run: Callable[[argparse.Namespace, str], None]  # with the arguments, and the command line as typed


def offered_commands(group: str) -> dict[str, Command]:
    """Sub-commands that installed packages offer under an entry-point group such as `tms.fit`."""
    from importlib.metadata import entry_points

    return {point.name: point.load() for point in entry_points(group=group)}


def run(
    main: Callable[[Sequence[str] | None], None],
    bad_input: tuple[type[Exception], ...],
    argv: Sequence[str] | None = None,
) -> int:
    """Run `main(argv)`; return the exit code: 0, or 2 after one line about the bad input.

    One line, too, where the system refuses: a full disk, a place that may not be written. Defects keep their
    traceback.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # ./tms lets it end the imports
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        try:
            main(argv)
        except SystemExit:  # after --help, too
            _flush_stdout()
            raise
        _flush_stdout()
    except bad_input as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; nothing half-written is left", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has gone, as in `... | head`
        _give_up_stdout()
        return 141
    except OSError as error:
        _give_up_stdout()
        where = error.filename or "standard output or a file takes no more"
        print(f"error: {where}: {error.strerror or error}", file=sys.stderr)
        return 2
    return 0


def seed(text: str) -> int:
    """Seed of a random generator: a whole number from 0 on. Raises argparse.ArgumentTypeError."""
    try:
        number = int(text)
    except ValueError:
        number = -1
    if number < 0:
        raise argparse.ArgumentTypeError(f"expected a whole number from 0 on, found {text!r}")
    return number


def _flush_stdout() -> None:
    if sys.stdout:  # None where it has been closed, as in `... >&-`
        sys.stdout.flush()


def _give_up_stdout() -> None:
    """Python writes what is left on stdout when it ends; where that can't be, let it go nowhere."""
    try:
        _flush_stdout()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_json(document: dict[str, Any]) -> None:
    """One JSON document on stdout. NaN and infinity, which JSON does not know, become null."""
    print(json.dumps(finite(document), indent=1, allow_nan=False))


def finite(value: Any) -> Any:
    """The value with NaN and infinity as None, at any depth: what JSON can say."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
