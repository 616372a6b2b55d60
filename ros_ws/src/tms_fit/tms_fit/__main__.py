"""Command line of the estimators: python -m tms_fit, or ./tms fit."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from tms_bag import RecordingError, read_recording
from tms_model import ParameterError
from tms_model.acceleration import RESISTANCES
from tms_model.command_line import Command, Parser, offered_commands, print_json, run

from tms_fit.arguments import add_noise_arguments, add_prior_argument, assignment, each_once, names
from tms_fit.diagnostics.output import ASKED
from tms_fit.estimators import ESTIMATORS
from tms_fit.least_squares.losses import LOSSES
from tms_fit.output import to_json, to_table
from tms_fit.recording_fit import RecordingFit, bicycle_of, fit_recording
from tms_fit.settings import (
    DEFAULT_FREE,
    INTERVALS,
    PARAMETERS,
    SATURATIONS,
    SLIPS,
    SPEED_MODELS,
    STEER_TORQUES,
    Settings,
)


def main(argv: Sequence[str] | None = None) -> None:
    """Parse the arguments and answer. Raises ParameterError and RecordingError."""
    words = sys.argv[1:] if argv is None else list(argv)
    offered = offered_commands("tms.fit")
    arguments = _parser(offered).parse_args(words)
    if arguments.command in offered:
        offered[arguments.command].run(arguments, shlex.join(["tms", "fit", *words]))
    elif arguments.command == "run":
        estimators = tuple(arguments.estimator or Settings.estimators)
        fit = _fit(arguments, estimators, tuple(arguments.strike))
        asked = [name for name in ASKED if getattr(arguments, name)]
        if arguments.json:
            print_json(to_json(fit, asked))
        else:
            print(to_table(fit, asked))
    elif arguments.command == "report":
        fit = _fit(arguments, tuple(arguments.estimator or Settings.estimators))
        try:
            import vl_convert  # noqa: F401  # here, since rosdep doesn't know it: all else works without
        except ImportError as error:
            raise ParameterError(
                "report: needs vl-convert-python, which isn't installed: pip install vl-convert-python"
            ) from error
        from tms_fit.report.files import write_report

        write_report(fit, Path(arguments.output), Path(arguments.figures) if arguments.figures else None)
    else:
        estimator = arguments.estimator[0] if arguments.estimator else "least_squares"
        fit = _fit(arguments, (estimator,))
        # matplotlib takes a second to import: only who plots pays for it
        from tms_model.figures.saving import save_figure

        from tms_fit.figure3b import figure_3b

        save_figure(figure_3b(fit, arguments.strike), Path(arguments.output))


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
        command.add_argument(
            "--estimator",
            action="append",
            choices=list(ESTIMATORS),
            help="may be repeated (default: least_squares, kalman_rts)",
        )
        _add_fit_arguments(command)
        _add_noise_arguments(command)
        command.add_argument("--imu-topic", help="topic of type sensor_msgs/msg/Imu")
        command.add_argument("--speed-topic", help="topic of type geometry_msgs/msg/TwistStamped")
        command.add_argument("--steer-torque-topic", help="topic of type tms_msgs/msg/SteerTorque")
        if name == "run":
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
            command.add_argument(
                "--hypotheses",
                action="store_true",
                help="test rival explanations of each strike, one sentence each",
            )
            command.add_argument(
                "--budget",
                action="store_true",
                help="error budget of the initial lean rate: what speed, resistance, start and each entry of"
                " the bicycle's matrices change in it",
            )
        elif name == "report":
            command.add_argument("-o", "--output", required=True, help="file to write, .html")
            command.add_argument(
                "--figures", metavar="DIR", help="folder for every figure as PNG, SVG and PDF, for papers"
            )
        else:
            command.add_argument("-o", "--output", required=True, help="file to write, .png, .svg or .pdf")
            command.add_argument(
                "--strike", type=int, default=1, help="which strike, counted from 1 (default 1)"
            )
    for name, one in offered.items():
        one.declare(commands.add_parser(name, help=one.text, description=one.text))
    return parser


def _add_fit_arguments(command: argparse.ArgumentParser) -> None:
    """What is found, what is known, and with which model of the run."""
    command.add_argument(
        "--free",
        type=names,
        metavar="NAME,...",
        help=f"parameters to find, of {', '.join(PARAMETERS)} (default: {','.join(DEFAULT_FREE)})",
    )
    command.add_argument(
        "--fix",
        action="append",
        default=[],
        type=assignment,
        metavar="NAME=VALUE",
        help="a parameter that is known, SI units; may be repeated",
    )
    add_prior_argument(command, "a free parameter")
    command.add_argument(
        "--window",
        type=float,
        default=Settings.window,
        help="longest free response used [s] (default %(default)s)",
    )
    command.add_argument(
        "--channels",
        type=names,
        default=Settings.channels,
        metavar="NAME,...",
        help="rates to compare with the model (default: lean_rate,yaw_rate)",
    )
    command.add_argument(
        "--speed-model",
        choices=SPEED_MODELS,
        default=Settings.speed_model,
        help="the speed after the strike: as measured, constant, falling by rolling resistance, or auto: as"
        " measured where the samples show beyond doubt that it changes, else constant (default %(default)s)",
    )
    command.add_argument(
        "--resistance",
        choices=RESISTANCES,
        default=Settings.resistance,
        help="by what a speed that changes is changed (default %(default)s)",
    )
    command.add_argument(
        "--steer-torque",
        choices=STEER_TORQUES,
        default=Settings.steer_torque,
        help="how a known steer torque enters (default: feedback where it is proportional to the lean"
        " rate, else input)",
    )


def _add_noise_arguments(command: argparse.ArgumentParser) -> None:
    """What the noise is like, and which samples are not to be trusted."""
    add_noise_arguments(command)
    command.add_argument(
        "--noise-std",
        type=float,
        metavar="RATE",
        help="[rad/s] of one sample, that the residuals are compared with: reduced chi-square (default: what"
        " the covariance in the IMU's messages says); no estimate depends on it",
    )
    command.add_argument(
        "--loss",
        choices=LOSSES,
        default=Settings.loss,
        help="squares; huber and student_t, which outliers don't move; or auto: squares, and huber when the"
        " residuals hold outliers (default %(default)s)",
    )
    command.add_argument(
        "--gyroscope-range",
        type=float,
        metavar="RATE",
        help="[rad/s] at which the gyroscopes saturate (default: only where imu/lean_yaw marks a sample)",
    )
    command.add_argument(
        "--saturation",
        choices=SATURATIONS,
        default=Settings.saturation,
        help="saturated samples are left out, taken as at least that large, or used as they are"
        " (default %(default)s)",
    )
    command.add_argument(
        "--slip-window",
        type=float,
        default=Settings.slip_window,
        metavar="S",
        help="time after the strike in which the front wheel slips [s] (default %(default)s)",
    )
    command.add_argument(
        "--slip",
        choices=SLIPS,
        default=Settings.slip,
        help="leave that time out, or find an offset of the yaw rate that fades over it"
        " (default %(default)s)",
    )
    command.add_argument(
        "--intervals",
        choices=INTERVALS,
        default=Settings.intervals,
        help="95 %% intervals by the covariance, by profiles of the squares, or by residuals drawn anew"
        " (default %(default)s)",
    )


def _fit(
    arguments: argparse.Namespace, estimators: tuple[str, ...], strike_times: tuple[float, ...] = ()
) -> RecordingFit:
    settings = Settings(
        free=arguments.free,
        fixed=each_once(arguments.fix, "--fix"),
        window=arguments.window,
        priors=each_once(arguments.prior, "--prior"),
        steer_torque=arguments.steer_torque,
        speed_model=arguments.speed_model,
        resistance=arguments.resistance,
        channels=arguments.channels,
        noise=arguments.noise,
        noise_std=arguments.noise_std,
        oscillator=arguments.oscillator,
        loss=arguments.loss,
        gyroscope_range=arguments.gyroscope_range,
        saturation=arguments.saturation,
        slip_window=arguments.slip_window,
        slip=arguments.slip,
        intervals=arguments.intervals,
        estimators=estimators,
    )
    recording = read_recording(
        arguments.bag, arguments.imu_topic, arguments.speed_topic, arguments.steer_torque_topic
    )
    return fit_recording(recording, bicycle_of(recording, arguments.bicycle), settings, strike_times)


if __name__ == "__main__":
    sys.exit(run(main, (ParameterError, RecordingError)))
