"""The commands that take several recordings: `together` and `calibrate`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tms_bag import RecordingError, read_recording
from tms_fit.arguments import add_noise_arguments, add_prior_argument, assignment, each_once, names
from tms_fit.recording_fit import RecordingFit, bicycle_of, fit_recording
from tms_fit.settings import PARAMETERS, SPEED_MODELS, STEER_TORQUES, Settings
from tms_model import ParameterError, bicycle_names, load_bicycle
from tms_model.command_line import Command, Parser, print_json
from tms_model.measured import Measured

from tms_calibrate.calibration import Calibration, calibrate
from tms_calibrate.calibration_file import sources_of, write_calibration
from tms_calibrate.calibration_output import CrossValidationRow, calibration_json, calibration_table, judge
from tms_calibrate.pooled_fit import Strike, fit_pooled, strikes_of, usable
from tms_calibrate.pooled_output import together_json, together_table
from tms_calibrate.pooled_problem import Run
from tms_calibrate.random_effects import METHODS

OWN_UNKNOWNS = "unknowns of each strike (default: as fit run)"
FOUND_WITHIN = 0.3  # [s] of the time that `--near` names


def _declare_common(command: Parser) -> None:
    """Declare what both commands share."""
    command.add_argument("bags", nargs="+", metavar="BAG", help="bag folder or .mcap file")
    command.add_argument("--bicycle", help="catalogue name or .yaml file (default: the one each bag names)")
    command.add_argument(
        "--near",
        action="append",
        type=_times,
        metavar="T,...",
        help="only the strikes nearest to these times [s] since the bag's start, 'all' for all;"
        " once per BAG, in their order",
    )
    command.add_argument("--window", type=float, default=Settings.window, help="[s] (default %(default)s)")
    command.add_argument(
        "--speed-model", choices=SPEED_MODELS, default=Settings.speed_model, help="as in fit run"
    )
    command.add_argument(
        "--steer-torque", choices=STEER_TORQUES, default=Settings.steer_torque, help="as in fit run"
    )
    command.add_argument(
        "--fix", action="append", default=[], type=assignment, metavar="NAME=VALUE", help="as in fit run"
    )
    command.add_argument("--json", action="store_true", help="one JSON document on stdout, SI units")


def _declare_together(command: Parser) -> None:
    _declare_common(command)
    command.add_argument("--free", type=names, metavar="NAME,...", help=OWN_UNKNOWNS)
    command.add_argument(
        "--share",
        type=names,
        default=(),
        metavar="NAME,...",
        help="unknowns that all strikes have in common: biases, numbers of the bicycle (default: none)",
    )
    add_prior_argument(command, "an unknown, shared or of each strike")
    add_noise_arguments(command)
    command.add_argument(
        "--method", choices=METHODS, default="reml", help="of the random-effects mean (default reml)"
    )


def _declare_calibrate(command: Parser) -> None:
    _declare_common(command)
    command.add_argument("--each", type=names, metavar="NAME,...", help=OWN_UNKNOWNS)
    command.add_argument(
        "--free",
        type=names,
        required=True,
        metavar="NAME,...",
        help="numbers of the bicycle to be found: parameters, steer elements, or entries of the matrices",
    )
    add_prior_argument(
        command, "these numbers (default: the bicycle's standard deviations, else 20 %% of the value)"
    )
    command.add_argument("-o", "--output", required=True, help="bicycle to write, a .yaml file for --bicycle")
    command.add_argument("--picture", help="pushes against the calibrated bicycle: .png, .svg or .pdf")


def print_together(arguments: argparse.Namespace, typed: str) -> None:
    """Answer `fit together`."""
    free = None
    if arguments.free is not None:
        free = (*(name for name in arguments.share if name in PARAMETERS), *arguments.free)
        free = tuple(dict.fromkeys(free))
    priors = _priors(arguments)
    fits = _fits(arguments, free, {name: one for name, one in priors.items() if name in PARAMETERS})
    strikes = _chosen(fits, arguments.near)
    fit = fit_pooled(
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


def print_calibration(arguments: argparse.Namespace, typed: str) -> None:
    """Answer `fit calibrate`; typed: the command line, which the written file records."""
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
    write_calibration(calibration, output, parent, typed, sources_of(fits, strikes))
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


def _picture(
    calibration: Calibration, strikes: tuple[Strike, ...], judged: CrossValidationRow, path: Path
) -> None:
    # matplotlib takes a second to import: only who plots pays for it
    from tms_model.figures.saving import save_figure

    from tms_calibrate.calibration_figure import calibration_figure

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
    settings = Settings(
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


TOGETHER = Command(
    "fit the strikes of several bags in one, and tell how much they differ", _declare_together, print_together
)
CALIBRATE = Command(
    "find numbers of the bicycle from the strikes of one or more bags", _declare_calibrate, print_calibration
)
