"""`bag check`: what a colleague would tell about a recording before it is trusted."""

from __future__ import annotations

import argparse
import sys
import tempfile
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tms_model.command_line import print_json

from tms_bag.logs.mapping_files import mapping_names

if TYPE_CHECKING:
    from tms_bag.checks import Finding, Survey

FOUND = 3  # exit code with --strict
_MARKS = {"error": "ERROR  ", "warning": "warning", "note": "note   "}  # by severity
_GRAVE = ("error", "warning")


def add_check(commands: Any) -> None:
    """The parser of `bag check`."""
    parser = commands.add_parser(
        "check",
        help="what to know before a recording is trusted",
        description=(
            "Looks at rates, gaps, clocks, units, range and mounting of the sensor, and at the speed."
            " Each finding"
            " comes with its evidence, what it does to an analysis, and what to do. Exit code 0 whatever"
            " is found;"
            f" with --strict {FOUND} if there is an error or a warning."
        ),
    )
    flag = parser.add_argument
    flag("bag", help="folder of a bag, an .mcap or .db3 file, or with --mapping a CSV log")
    flag(
        "--mapping",
        metavar="NAME_OR_FILE",
        help=f"the CSV's columns: {', '.join(mapping_names())}, or a .yaml file",
    )
    flag("--imu-topic", metavar="NAME", help="the sensor's topic (default: imu/data_raw, else the busiest)")
    flag(
        "--speed-topic", metavar="NAME", help="the speed's topic (default: bicycle/speed, else the only one)"
    )
    flag(
        "--rest-pose",
        action="append",
        default=[],
        metavar="AXIS=FILE",
        help="bag or CSV log of the sensor at rest with this axis of the bicycle (x forward, y left, z"
        " up, or -x, ...)"
        " pointing up; two or more tell how the sensor sits",
    )
    flag("--strict", action="store_true", help=f"exit code {FOUND} if there is an error or a warning")
    flag("--json", action="store_true", help="one JSON document on stdout, SI units and radians")


def check(arguments: argparse.Namespace) -> None:
    """Look and tell. RecordingError and ParameterError if there is nothing to look at."""
    from tms_bag.checks import findings, survey
    from tms_bag.checks.poses import read_pose
    from tms_bag.checks.run import onwards
    from tms_bag.logs.csv_import import import_csv
    from tms_bag.logs.mapping import load_mapping

    poses = [read_pose(text) for text in arguments.rest_pose]
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(arguments.bag)
        if arguments.mapping:
            bag = Path(folder) / bag.stem
            import_csv(arguments.bag, load_mapping(arguments.mapping), bag)
        seen = survey(bag, arguments.imu_topic, arguments.speed_topic, poses)
        found = findings(seen)
    go_on = onwards(seen)
    if arguments.mapping:
        go_on = f"./tms bag import-csv {arguments.bag} --mapping {arguments.mapping} -o BAG"
    if arguments.json:
        _print_json(arguments.bag, seen, found, go_on)
    else:
        _print(arguments.bag, seen, found, go_on)
    if arguments.strict and any(finding.severity in _GRAVE for _, finding in found):
        sys.stdout.flush()
        sys.exit(FOUND)


def _print_json(path: str, seen: Survey, found: list[tuple[str, Finding]], go_on: str) -> None:
    counts = {severity: sum(f.severity == severity for _, f in found) for severity in _MARKS}
    print_json(
        {
            "path": path,
            "topics": [
                {
                    "name": stream.name,
                    "type": stream.type,
                    "count": int(stream.log_ns.size),
                    "duration": stream.duration,
                    "rate": (stream.log_ns.size - 1) / stream.duration if stream.duration else None,
                    "frame_ids": list(stream.frame_ids),
                }
                for stream in seen.streams.values()
            ],
            "imu_topic": seen.imu_topic,
            "speed_topic": seen.speed_topic,
            "findings": [finding.as_dict(name) for name, finding in found],
            "counts": counts,
            "command": go_on,
        }
    )


def _print(path: str, seen: Survey, found: list[tuple[str, Finding]], go_on: str) -> None:
    print(path)
    for stream in seen.streams.values():
        rate = f"{(stream.log_ns.size - 1) / stream.duration:8.1f} Hz" if stream.duration else ""
        print(f"  {stream.name:28} {stream.type:36} {stream.log_ns.size:9d} {rate}")
    for name, finding in found:
        where = f" on {finding.topic}" if finding.topic else ""
        print(f"\n{_MARKS[finding.severity]} {name}{where}")
        for label, text in (
            ("seen", finding.evidence),
            ("so", finding.consequence),
            ("do", finding.remedy),
            ("type", finding.command),
        ):
            if text:
                wrapped = text if label == "type" else textwrap.fill(text, 100, subsequent_indent=" " * 8)
                print(f"  {label + ':':6}{wrapped}")
    errors, warnings = (sum(finding.severity == severity for _, finding in found) for severity in _GRAVE)
    print(f"\n{errors} errors, {warnings} warnings. To go on: {go_on}")
