"""The commands that take several recordings: `together` and `calibrate`."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tms_bag import RecordingError, read_recording
from tms_model import ParameterError, bicycle_names, load_bicycle
from tms_model.command_line import print_json
from tms_model.measured import Measured

from tms_fit.arguments import add_noise_arguments, add_prior_argument, assignment, each_once, names
from tms_fit.joint.calibration import Calibration, calibrate
from tms_fit.joint.calibration_file import sources_of, write_calibration
from tms_fit.joint.calibration_result import Judged, calibration_json, calibration_table, judge
from tms_fit.joint.heterogeneity import METHODS
from tms_fit.joint.problem import Run
from tms_fit.joint.together import Strike, fit_together, strikes_of, usable
from tms_fit.joint.together_result import together_json, together_table
from tms_fit.offline import RecordingFit, bicycle_of, fit_recording
from tms_fit.settings import PARAMETERS, SPEED_MODELS, STEER_TORQUES, FitSettings

FOUND_WITHIN = 0.3  # [s] of the time that `--near` names

TEXTS = {
    "together": "fit the strikes of several bags in one, and tell how much they differ",
    "calibrate": "find numbers of the bicycle from the strikes of one or more bags",
}


def add_arguments(commands: Any) -> None:
    """Declare both commands among `commands`, the parser's subparsers."""
    together, calibrating = (
        commands.add_parser(name, help=text, description=text) for name, text in TEXTS.items()
    )
    for command in (together, calibrating):
        command.add_argument("bags", nargs="+", metavar="BAG", help="bag folder or .mcap file")
        command.add_argument(
            "--bicycle", help="catalogue name or .yaml file (default: the one each bag names)"
        )
        command.add_argument(
            "--near",
            action="append",
            type=_times,
            metavar="T,...",
            help="only the strikes nearest to these times [s] since the bag's start, 'all' for all;"
            " once per BAG, in their order",
        )
        command.add_argument(
            "--window", type=float, default=FitSettings.window, help="[s] (default %(default)s)"
        )
        command.add_argument(
            "--speed-model", choices=SPEED_MODELS, default=FitSettings.speed_model, help="as in fit run"
        )
        command.add_argument(
            "--steer-torque", choices=STEER_TORQUES, default=FitSettings.steer_torque, help="as in fit run"
        )
        command.add_argument(
            "--fix", action="append", default=[], type=assignment, metavar="NAME=VALUE", help="as in fit run"
        )
        command.add_argument("--json", action="store_true", help="one JSON document on stdout, SI units")
    own = {"type": names, "metavar": "NAME,...", "help": "unknowns of each strike (default: as fit run)"}
    together.add_argument("--free", **own)
    together.add_argument(
        "--share",
        type=names,
        default=(),
        metavar="NAME,...",
        help="unknowns that all strikes have in common: biases, numbers of the bicycle (default: none)",
    )
    add_prior_argument(together, "an unknown, shared or of each strike")
    add_noise_arguments(together)
    together.add_argument(
        "--method", choices=METHODS, default="reml", help="of the random-effects mean (default reml)"
    )
    calibrating.add_argument("--each", **own)
    calibrating.add_argument(
        "--free",
        type=names,
        required=True,
        metavar="NAME,...",
        help="numbers of the bicycle to be found: parameters, steer elements, or entries of the matrices",
    )
    add_prior_argument(
        calibrating, "these numbers (default: the bicycle's standard deviations, else 20 %% of the value)"
    )
    calibrating.add_argument(
        "-o", "--output", required=True, help="bicycle to write, a .yaml file for --bicycle"
    )
    calibrating.add_argument("--picture", help="pushes against the calibrated bicycle: .png, .svg or .pdf")


def print_together(arguments: argparse.Namespace) -> None:
    """Answer `fit together`."""
    free = None
    if arguments.free is not None:
        free = (*(name for name in arguments.share if name in PARAMETERS), *arguments.free)
        free = tuple(dict.fromkeys(free))
    priors = _priors(arguments)
    fits = _fits(arguments, free, {name: one for name, one in priors.items() if name in PARAMETERS})
    strikes = _chosen(fits, arguments.near)
    fit = fit_together(
        strikes,
        arguments.share,
        each_once(arguments.fix, "--fix"),
        arguments.method,
        priors,
        arguments.noise,
        arguments.oscillator,
    )
    if arguments.json:
        print_json(together_json(fit, fits))
    else:
        print(together_table(fit))


def print_calibration(arguments: argparse.Namespace, words: Sequence[str]) -> None:
    """Answer `fit calibrate`; words: the command line, which the file that it writes tells."""
    output = Path(arguments.output)
    if output.suffix not in (".yaml", ".yml"):
        raise ParameterError(f"{output}: expected a name that ends in .yaml")
    priors = _priors(arguments)
    fits = _fits(arguments, arguments.each, {})
    parent = arguments.bicycle or _common_bicycle(fits)
    strikes, _ = usable(_chosen(fits, arguments.near))
    runs = tuple(Run(one.window, one.alone.names) for one in strikes)
    calibration = calibrate(fits[0].bicycle, runs, arguments.free, priors)
    judged = judge(calibration, strikes)
    command = shlex.join(["tms", "fit", *words])
    write_calibration(calibration, output, parent, command, sources_of(fits, strikes))
    if arguments.picture:
        _picture(calibration, strikes, judged, Path(arguments.picture))
    if arguments.json:
        print_json({"output": str(output), **calibration_json(calibration, strikes, judged)})
    else:
        print(calibration_table(calibration, strikes, judged))
        print(f"written: {output}")


def _common_bicycle(fits: list[RecordingFit]) -> str:
    """Name of the bicycle of all bags: one of the catalogue, as the file to be written refers to it."""
    found = {fit.bicycle.name for fit in fits}
    if len(found) > 1:
        raise ParameterError(f"expected bags of one bicycle, found {', '.join(sorted(found))}; use --bicycle")
    (name,) = found
    if name not in bicycle_names():
        raise ParameterError(
            f"expected bags that name a bicycle of the catalogue, found {name!r}; what is written refers to"
            " the bicycle before: use --bicycle FILE"
        )
    return name


def _picture(calibration: Calibration, strikes: tuple[Strike, ...], judged: Judged, path: Path) -> None:
    # matplotlib takes a second to import: only who plots pays for it
    from tms_model.figures.saving import save_figure

    from tms_fit.joint.calibration_figure import calibration_figure

    save_figure(calibration_figure(calibration, strikes, judged), path)


def _priors(arguments: argparse.Namespace) -> dict[str, Measured]:
    return {name: Measured(mean, std) for name, (mean, std) in each_once(arguments.prior, "--prior").items()}


def _fits(
    arguments: argparse.Namespace, free: tuple[str, ...] | None, priors: dict[str, Measured]
) -> list[RecordingFit]:
    """The strikes of each bag by themselves, under white noise: what is free in each."""
    if arguments.near and len(arguments.near) != len(arguments.bags):
        raise ParameterError(
            f"near: expected once per bag ({len(arguments.bags)}), found {len(arguments.near)} times"
        )
    paths = [Path(bag).resolve() for bag in arguments.bags]
    if len(set(paths)) < len(paths):
        raise ParameterError("bags: expected each once, found one twice: its strikes would count double")
    settings = FitSettings(
        free=free,
        fixed=each_once(arguments.fix, "--fix"),
        window=arguments.window,
        speed_model=arguments.speed_model,
        steer_torque=arguments.steer_torque,
        priors={name: (one.value, one.deviation) for name, one in priors.items()},
        noise="white",
        estimators=("least_squares",),
    )
    fits = []
    for bag in arguments.bags:
        recording = read_recording(bag)
        bicycle = load_bicycle(arguments.bicycle) if arguments.bicycle else bicycle_of(recording, None)
        fits.append(fit_recording(recording, bicycle, settings))
    return fits


def _chosen(fits: list[RecordingFit], near: list[tuple[float, ...]] | None) -> list[Strike]:
    """All strikes, or those nearest to the times asked for."""
    chosen: list[Strike] = []
    for fit, times in zip(fits, near or [()] * len(fits), strict=True):
        strikes = strikes_of(fit)
        found = np.array([one.seconds for one in strikes])
        for time in times:
            nearest = int(np.abs(found - time).argmin()) if len(found) else -1
            if nearest < 0 or abs(found[nearest] - time) > FOUND_WITHIN:
                raise RecordingError(
                    f"{fit.recording.path}: expected a strike within {FOUND_WITHIN:g} s of {time:g} s, found"
                    f" {f'the nearest at {found[nearest]:.2f} s' if nearest >= 0 else 'none at all'}"
                )
            if strikes[nearest] not in chosen:
                chosen.append(strikes[nearest])
        chosen.extend(() if times else strikes)
    return chosen


def _times(text: str) -> tuple[float, ...]:
    if text.strip() == "all":
        return ()
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected times in seconds, found {text!r}") from None
