"""`bag export`: topics of a bag as a CSV that a spreadsheet opens."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from typing import Any

from tms_model.command_line import print_json
from tms_model.errors import ParameterError

from tms_bag.logs.mapping_files import DECIMALS


def add_export(commands: Any) -> None:
    """The parser of `bag export`."""
    parser = commands.add_parser(
        "export",
        help="topics as a CSV that a spreadsheet opens",
        description=(
            "Writes one table: a row for each stamp (in ns, and in s since the first), a column for each"
            " number of each"
            " topic, with its unit. `tms bag import-csv FILE --mapping export` makes a bag of it again."
        ),
    )
    flag = parser.add_argument
    flag("bag", help="folder of a bag, or an .mcap or .db3 file")
    flag("-o", "--output", required=True, metavar="FILE", help="CSV file to write")
    flag("--topics", nargs="+", metavar="NAME", help="topics (default: all with numbers)")
    text = "fields, * stands for anything: 'angular_velocity.*' (default: all numbers but arrays)"
    flag("--columns", nargs="+", metavar="PATTERN", help=text)
    flag("--delimiter", default=",", metavar="CHARACTER", help="between cells (default a comma)")
    flag(
        "--decimal",
        metavar="MARK",
        choices=DECIMALS,
        default=".",
        help="in numbers, . or , (default a point)",
    )
    flag("--force", action="store_true", help="replace a file that is there already")
    flag("--json", action="store_true", help="one JSON document on stdout")


def export(arguments: argparse.Namespace) -> None:
    """Write the table and say what is in it. Raises RecordingError and ParameterError."""
    from tqdm import tqdm

    from tms_bag.logs.csv_export import export_csv

    delimiter = arguments.delimiter
    if len(delimiter) != 1 or delimiter.isalnum() or delimiter in '"\r\n.-' or delimiter == arguments.decimal:
        raise ParameterError(
            f"--delimiter: expected one character that stands in no number, such as ; found {delimiter!r}"
        )
    done = export_csv(
        arguments.bag,
        arguments.output,
        arguments.topics,
        arguments.columns,
        delimiter,
        arguments.decimal,
        arguments.force,
        partial(tqdm, desc="export", unit=" rows", leave=False, disable=not sys.stderr.isatty()),
    )
    if arguments.json:
        print_json(
            {"bag": arguments.bag, "csv": str(done.output), "rows": done.rows, "columns": list(done.columns)}
        )
    else:
        print(f"{done.output}: {done.rows} rows of {len(done.columns)} columns")
