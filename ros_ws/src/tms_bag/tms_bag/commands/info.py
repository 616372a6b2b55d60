"""`bag info`: what a bag holds."""

from __future__ import annotations

import argparse
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any

from tms_model.command_line import print_json

if TYPE_CHECKING:
    from tms_bag.reading.reader import BagReader


def add_info(commands: Any) -> None:
    """The parser of `bag info`."""
    parser = commands.add_parser("info", help="what a bag holds", description="What a bag holds.")
    parser.add_argument("bag", help="folder of a bag, or an .mcap or .db3 file")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout, SI units")


def info(arguments: argparse.Namespace) -> None:
    """Look and tell. Raises RecordingError."""
    from tms_bag.reading.reader import BagReader

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
            _print(bag, duration)


def _print(bag: BagReader, duration: float) -> None:
    state = "" if bag.complete else " (unfinished: `tms bag repair` makes a clean bag of it)"
    start = datetime.fromtimestamp(bag.start_ns / 1e9, timezone.utc).isoformat(timespec="milliseconds")
    print(f"{bag.path}: {bag.message_count} messages in {duration:.3f} s from {start}{state}")
    for topic in bag.topics:
        print(f"  {topic.name:28} {topic.type:36} {topic.count:9d}")
    for key, value in bag.custom_data.items():
        lines = value.rstrip().split("\n")
        print(f"  {key}: {lines[0]}" if len(lines) == 1 else "\n    ".join([f"  {key}:", *lines]))
