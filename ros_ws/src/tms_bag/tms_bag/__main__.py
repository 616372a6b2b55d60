"""Command line of recordings: python -m tms_bag, or ./tms bag."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import datetime, timezone
from functools import partial

from tms_model import ParameterError
from tms_model.command_line import Parser, print_json, run
from tqdm import tqdm

from tms_bag.commands.check import add_check, check
from tms_bag.commands.export import add_export, export
from tms_bag.commands.import_csv import add_import, import_log
from tms_bag.commands.record_play import add_play, add_record, play, record
from tms_bag.errors import RecordingError
from tms_bag.reading.reader import BagReader
from tms_bag.writing.repair import repair


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
    info = commands.add_parser("info", help="what a bag holds", description="What a bag holds.")
    info.add_argument("bag", help="folder of a bag, or an .mcap or .db3 file")
    info.add_argument("--json", action="store_true", help="one JSON document on stdout, SI units")
    add_check(commands)
    add_import(commands)
    add_export(commands)
    mend = commands.add_parser(
        "repair",
        help="a clean bag out of an unfinished or damaged one",
        description=(
            "Writes what can be read of a bag as a clean MCAP bag of one file; keeps the original. With"
            " -o also a bag"
            " that needs no repair, for example an sqlite3 bag (.db3)."
        ),
    )
    mend.add_argument("bag", help="folder of a bag, or an .mcap or .db3 file")
    mend.add_argument(
        "-o",
        "--output",
        metavar="NEW",
        help="bag to write (default: in the place of BAG, kept as BAG.unrepaired)",
    )
    add_record(commands)
    add_play(commands)
    return parser


def _info(arguments: argparse.Namespace) -> None:
    with BagReader(arguments.bag) as bag:
        duration = (bag.end_ns - bag.start_ns) / 1e9
        if arguments.json:
            print_json(
                {
                    "path": str(bag.path),
                    "duration": duration,
                    "message_count": bag.message_count,
                    "topics": [topic._asdict() for topic in bag.topics],
                    "warnings": list(bag.warnings),
                    "metadata": {**bag.custom_data, "complete": bag.complete, "start_ns": bag.start_ns},
                }
            )
        else:
            _print_info(bag, duration)


def _print_info(bag: BagReader, duration: float) -> None:
    state = "" if bag.complete else " (unfinished: `tms bag repair` makes a clean bag of it)"
    start = datetime.fromtimestamp(bag.start_ns / 1e9, timezone.utc).isoformat(timespec="milliseconds")
    print(f"{bag.path}: {bag.message_count} messages in {duration:.3f} s from {start}{state}")
    for topic in bag.topics:
        print(f"  {topic.name:28} {topic.type:36} {topic.count:9d}")
    for key, value in bag.custom_data.items():
        lines = value.rstrip().split("\n")
        print(f"  {key}: {lines[0]}" if len(lines) == 1 else "\n    ".join([f"  {key}:", *lines]))


def _repair(arguments: argparse.Namespace) -> None:
    progress = partial(tqdm, desc="repair", unit=" messages", disable=None)
    done = repair(arguments.bag, arguments.output, progress)
    if done.output is None:
        print(f"{arguments.bag}: {done.message_count} messages, closed properly; nothing to repair")
        return
    saved = f", {done.saved} messages saved from it" if done.saved else ""
    lost = (
        f"; damaged parts left out: {done.damaged_chunks}; incomplete at the end: {done.unread_bytes} bytes"
    )
    lost += saved
    kept = f"; the original is {done.original}" if done.original else ""
    print(f"{done.output}: {done.message_count} messages recovered{lost}{kept}")


COMMANDS = {
    "info": _info,
    "check": check,
    "export": export,
    "import-csv": import_log,
    "repair": _repair,
    "record": record,
    "play": play,
}

if __name__ == "__main__":
    sys.exit(run(main, (RecordingError, ParameterError)))
