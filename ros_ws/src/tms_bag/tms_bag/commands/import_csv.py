"""`bag import-csv`: a logger's CSV turned into a bag."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from tms_model.command_line import print_json
from tms_model.errors import ParameterError

from tms_bag.logs.mapping_files import DECIMALS, mapping_names

if TYPE_CHECKING:
    from tms_bag.logs.csv_import import Import
    from tms_bag.logs.mapping import LogMapping


def add_import(commands: Any) -> None:
    """The parser of `bag import-csv`."""
    parser = commands.add_parser(
        "import-csv",
        help="turn a logger's CSV into a bag",
        description=(
            "Turns a logger's CSV into a bag with the topics of this project. A mapping says what the"
            " columns mean;"
            " nothing is guessed but the delimiter."
        ),
    )
    flag = parser.add_argument
    flag("log", help="CSV file with a header")
    flag(
        "--mapping",
        required=True,
        metavar="NAME_OR_FILE",
        help=f"meaning of the columns: {', '.join(mapping_names())}, or a .yaml file",
    )
    flag("-o", "--output", required=True, metavar="BAG", help="bag to write")
    flag("--force", action="store_true", help="replace a bag that is there already")
    text = "the column is called NAME in this log"
    flag("--column", action="append", default=[], metavar="QUANTITY=NAME", help=text)
    flag("--without", action="append", default=[], metavar="QUANTITY", help="this log has no such column")
    text = "empty or NaN cells: refuse them, or let each topic have the rows with something for it"
    flag("--missing", choices=("error", "skip"), help=f"{text} (default: the mapping's)")
    text = "between cells (default: the mapping's, else whichever of , ; tab | fits the header)"
    flag("--delimiter", metavar="CHARACTER", help=text)
    flag(
        "--decimal", metavar="MARK", choices=DECIMALS, help="in numbers: 1.5 or 1,5 (default: the mapping's)"
    )
    flag("--bicycle", metavar="NAME", help="name in the catalogue (default: the mapping's)")
    flag("--json", action="store_true", help="one JSON document on stdout")


def import_log(arguments: argparse.Namespace) -> None:
    """Write the bag and say what is in it. Raises RecordingError and ParameterError."""
    from tms_bag.logs.csv_import import import_csv
    from tms_bag.logs.mapping import adapted, load_mapping

    mapping = adapted(
        load_mapping(arguments.mapping),
        dict(_assignment(text) for text in arguments.column),
        arguments.without,
        None if arguments.missing is None else arguments.missing == "skip",
        arguments.bicycle,
        arguments.delimiter,
        arguments.decimal,
    )
    done = import_csv(arguments.log, mapping, arguments.output, overwrite=arguments.force)
    if arguments.json:
        print_json({**_document(arguments, done), "absent": _absent(done, mapping)})
    else:
        _print(arguments.output, done, mapping)


def _document(arguments: argparse.Namespace, done: Import) -> dict[str, Any]:
    log = done.log
    return {
        "log": arguments.log,
        "sha256": log.sha256,
        "bag": arguments.output,
        "mapping": arguments.mapping,
        "delimiter": log.delimiter,
        "rows": int(log.time_ns.size),
        "blank_lines": log.blank_lines,
        "missing": log.missing,
        "start_ns": int(log.time_ns[0]),
        "duration": int(log.time_ns[-1] - log.time_ns[0]) / 1e9,
        "topics": [{"name": name, "count": count} for name, count in sorted(done.counts.items())],
    }


def _absent(done: Import, mapping: LogMapping) -> list[str]:
    """Optional quantities of the mapping that the log doesn't hold."""
    return [name for name in mapping.columns if name not in done.log.columns]


def _print(output: str, done: Import, mapping: LogMapping) -> None:
    log = done.log
    print(f"{output}: {log.time_ns.size} rows of {', '.join(log.columns)}")
    absent = _absent(done, mapping)
    if absent:
        names = ", ".join(f"{name} ({mapping.columns[name].name!r})" for name in absent)
        print(f"  not in this log, or empty: {names}")
    if log.missing:
        cells = ", ".join(f"{count} of {quantity}" for quantity, count in log.missing.items())
        print(f"  empty or NaN cells left out: {cells}")
    if log.blank_lines:
        print(f"  {log.blank_lines} blank lines between the rows left out")
    for topic, count in sorted(done.counts.items()):
        print(f"  {topic:28} {count:9d}")


def _assignment(text: str) -> tuple[str, str]:
    quantity, equals, name = text.partition("=")
    if not (quantity and equals and name):
        raise ParameterError(f"--column: expected QUANTITY=NAME, found {text!r}")
    return quantity, name
