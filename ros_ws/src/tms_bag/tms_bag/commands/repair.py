"""`bag repair`: a clean bag out of an unfinished or damaged one."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any


def add_repair(commands: Any) -> None:
    """The parser of `bag repair`."""
    parser = commands.add_parser(
        "repair",
        help="a clean bag out of an unfinished or damaged one",
        description=(
            "Writes what can be read of a bag as a clean MCAP bag of one file; keeps the original. With -o"
            " also a bag that needs no repair, for example an sqlite3 bag (.db3)."
        ),
    )
    parser.add_argument("bag", help="folder of a bag, or an .mcap or .db3 file")
    parser.add_argument(
        "-o",
        "--output",
        metavar="NEW",
        help="bag to write (default: in the place of BAG, kept as BAG.unrepaired)",
    )


def mend(arguments: argparse.Namespace) -> None:
    """Write the clean bag and say what was lost. Raises RecordingError."""
    from tqdm import tqdm

    from tms_bag.writing.repair import repair

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
