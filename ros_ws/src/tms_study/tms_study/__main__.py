"""Command line of the studies: python -m tms_study, or ./tms study; `./tms demo` is `./tms study demo`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from tms_bag import RecordingError
from tms_model import ParameterError
from tms_model.command_line import Parser, run

from tms_study.demo import demo


def main(argv: Sequence[str] | None = None) -> None:
    """Parse the arguments and run. Raises ParameterError and RecordingError."""
    parser = Parser(prog="tms study", description="What needs both simulator and estimators.")
    commands = parser.add_subparsers(dest="command", required=True)
    text = "the whole pipeline: simulate, record, replay, estimate, fit, draw"
    command = commands.add_parser("demo", help=text, description=text)
    command.add_argument("--out", default="out/demo", help="folder to make (default %(default)s)")
    command.add_argument("--scenario", default="tms_strike", help="(default %(default)s)")
    command.add_argument("--seed", type=int, default=1, help="seed of all noise (default %(default)s)")
    arguments = parser.parse_args(argv)
    print(demo(Path(arguments.out), arguments.scenario, arguments.seed))


if __name__ == "__main__":
    sys.exit(run(main, (ParameterError, RecordingError)))
