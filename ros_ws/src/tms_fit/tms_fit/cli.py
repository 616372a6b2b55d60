"""Command line of the estimators: python -m tms_fit, or ./tms fit.

Imports are deferred until a command runs: `--help` loads neither numpy nor the bicycle.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tms_model.command_line import Command, Parser, offered_commands, print_json
from tms_model.errors import ParameterError

from tms_fit.settings_parser import add_options, settings_of

if TYPE_CHECKING:
    from tms_bag import Recording
    from tms_model import Bicycle

    from tms_fit.recording_fit import RecordingFit
    from tms_fit.settings import Settings

DIAGNOSTICS = {  # of `fit run`, on request
    "hypotheses": "test rival explanations of each strike, one sentence each",
    "budget": "error budget of the initial lean rate: what speed, resistance, start and each entry of the"
    " bicycle's matrices change in it",
}


def main(argv: Sequence[str] | None = None) -> None:
    """Parse the arguments and run the command. Raises ParameterError and RecordingError."""
    words = sys.argv[1:] if argv is None else list(argv)
    offered = offered_commands("tms.fit")
    arguments = _parser(offered).parse_args(words)
    if arguments.command in offered:
        offered[arguments.command].run(arguments, shlex.join(["tms", "fit", *words]))
    elif arguments.command == "run":
        _run(arguments)
    elif arguments.command == "report":
        _report(arguments)
    else:
        _figure3b(arguments)


def _parser(offered: Mapping[str, Command]) -> Parser:
    parser = Parser(
        prog="tms fit", description="Reads a run: strikes, initial lean rate, measured against predicted."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    texts = {
        "run": "find the strikes of a bag and fit each",
        "report": "one HTML file to look at and to print: figures, tables, animation",
        "figure3b": "figure of measured and predicted lean and yaw rate (PNG, SVG, PDF)",
    }
    for name, text in texts.items():
        command = commands.add_parser(name, help=text, description=text)
        command.add_argument("bag", help="bag folder or .mcap file")
        command.add_argument(
            "--bicycle", help="catalogue name or .yaml file (default: the one the bag names)"
        )
        add_options(command)
        command.add_argument("--imu-topic", help="topic of type sensor_msgs/msg/Imu")
        command.add_argument("--speed-topic", help="topic of type geometry_msgs/msg/TwistStamped")
        command.add_argument("--steer-torque-topic", help="topic of type tms_msgs/msg/SteerTorque")
        _ADD_OUTPUT[name](command)
    for name, one in offered.items():
        one.declare(commands.add_parser(name, help=one.text, description=one.text))
    return parser


def _add_run_arguments(command: Parser) -> None:
    command.add_argument("--json", action="store_true", help="one JSON document on stdout, SI units")
    command.add_argument(
        "--strike",
        action="append",
        default=[],
        type=float,
        metavar="TIME",
        help="start of a free response [s since the recording's start], in place of those found;"
        " may be repeated",
    )
    for name, text in DIAGNOSTICS.items():
        command.add_argument(f"--{name}", action="store_true", help=text)


def _add_report_arguments(command: Parser) -> None:
    command.add_argument("-o", "--output", required=True, help="file to write, .html")
    command.add_argument(
        "--figures", metavar="DIR", help="folder for every figure as PNG, SVG and PDF, for papers"
    )


def _add_figure3b_arguments(command: Parser) -> None:
    command.add_argument("-o", "--output", required=True, help="file to write, .png, .svg or .pdf")
    command.add_argument("--strike", type=int, default=1, help="which strike, counted from 1 (default 1)")


_ADD_OUTPUT = {
    "run": _add_run_arguments,
    "report": _add_report_arguments,
    "figure3b": _add_figure3b_arguments,
}


def _run(arguments: argparse.Namespace) -> None:
    from tms_fit.output import to_json, to_table

    fit = _fit(arguments, tuple(arguments.strike))
    asked = [name for name in DIAGNOSTICS if getattr(arguments, name)]
    if arguments.json:
        print_json(to_json(fit, asked))
    else:
        print(to_table(fit, asked))


def _report(arguments: argparse.Namespace) -> None:
    fit = _fit(arguments)
    try:
        import vl_convert  # noqa: F401  # optional: not available by rosdep
    except ImportError as error:
        raise ParameterError(
            "report: needs vl-convert-python, which isn't installed: pip install vl-convert-python"
        ) from error
    from tms_fit.report.files import write_report

    write_report(fit, Path(arguments.output), Path(arguments.figures) if arguments.figures else None)


def _figure3b(arguments: argparse.Namespace) -> None:
    arguments.estimators = (arguments.estimators or ["least_squares"])[:1]
    fit = _fit(arguments)
    from tms_model.figures.saving import save_figure

    from tms_fit.figure3b import figure_3b

    save_figure(figure_3b(fit, arguments.strike), Path(arguments.output))


def _fit(arguments: argparse.Namespace, strike_times: tuple[float, ...] = ()) -> RecordingFit:
    settings = settings_of(arguments)
    from tms_bag import read_recording

    from tms_fit.recording_fit import bicycle_of

    recording = read_recording(
        arguments.bag, arguments.imu_topic, arguments.speed_topic, arguments.steer_torque_topic
    )
    return fit_with_bar(recording, bicycle_of(recording, arguments.bicycle), settings, strike_times)


def fit_with_bar(
    recording: Recording, bicycle: Bicycle, settings: Settings, strike_times: tuple[float, ...] = ()
) -> RecordingFit:
    """`fit_recording` with a progress bar on stderr where that is a terminal."""
    from tqdm import tqdm

    from tms_fit.recording_fit import fit_recording

    with tqdm(total=1.0, desc="fit", leave=False, disable=None, bar_format="{l_bar}{bar}| {postfix}") as bar:

        def show(share: float, strikes: int) -> None:
            bar.set_postfix_str(f"{strikes} strikes", refresh=False)
            bar.update(share - bar.n)

        return fit_recording(recording, bicycle, settings, strike_times, show)
