"""Command line of recordings: python -m tms_bag, or ./tms bag.

What a command needs is imported when it runs: `--help` loads no numpy.
"""

from __future__ import annotations

from collections.abc import Sequence

from tms_model.command_line import Parser

from tms_bag.commands.check import add_check, check
from tms_bag.commands.export import add_export, export
from tms_bag.commands.import_csv import add_import, import_log
from tms_bag.commands.info import add_info, info
from tms_bag.commands.record_play import add_play, add_record, play, record
from tms_bag.commands.repair import add_repair, mend


def main(argv: Sequence[str] | None = None) -> None:
    """Parse the arguments and answer. Raises RecordingError and ParameterError."""
    arguments = _parser().parse_args(argv)
    COMMANDS[arguments.command](arguments)


def _parser() -> Parser:
    parser = Parser(
        prog="tms bag",
        description="Recordings: rosbag2 bags looked at, checked, imported, exported, repaired,"
        " recorded, played.",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    add_info(commands)
    add_check(commands)
    add_import(commands)
    add_export(commands)
    add_repair(commands)
    add_record(commands)
    add_play(commands)
    return parser


COMMANDS = {
    "info": info,
    "check": check,
    "export": export,
    "import-csv": import_log,
    "repair": mend,
    "record": record,
    "play": play,
}
