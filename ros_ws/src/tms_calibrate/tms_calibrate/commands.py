"""Commands `fit together` and `fit calibrate` for several recordings.

Imports are deferred until a command runs: `fit --help` lists these commands without numpy and scipy.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from tms_bag.errors import RecordingError
from tms_fit.parameters import PARAMETERS
from tms_fit.settings_parser import add_options, each_once, names, settings_of
from tms_model.command_line import Command, Parser, print_json
from tms_model.errors import ParameterError

if TYPE_CHECKING:
    from tms_fit.recording_fit import RecordingFit
    from tms_model.measured import Measured

    from tms_calibrate.calibration import Calibration
    from tms_calibrate.calibration_output import CrossValidationRow
    from tms_calibrate.pooled_fit import Strike

METHODS = ("reml", "dersimonian_laird")  # those of tms_calibrate.random_effects
# Options of `fit run` that both commands have.
COMMON = ("window", "speed_model", "steer_torque", "fixed", "imu_orientation")
OWN_UNKNOWNS = "unknowns of each strike (default: as fit run)"
NEAR_WITHIN_S = 0.3  # [s] between a time of `--near` and the strike that it selects


def _declare_common(command: Parser) -> None:
    """Declare the arguments of both commands."""
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
    add_options(command, *COMMON)
    command.add_argument("--json", action="store_true", help="one JSON document on stdout, SI units")


def _declare_together(command: Parser) -> None:
    _declare_common(command)
    add_options(command, "free", free=OWN_UNKNOWNS)
    command.add_argument(
        "--share",
        type=names,
        default=(),
        metavar="NAME,...",
        help="unknowns that all strikes have in common: biases, numbers of the bicycle (default: none)",
    )
    known = "what is known beforehand of an unknown, shared or of each strike; may be repeated"
    add_options(command, "priors", "noise", "oscillator", priors=known)
    command.add_argument(
        "--method", choices=METHODS, default="reml", help="of the random-effects mean (default reml)"
    )


def _declare_calibrate(command: Parser) -> None:
    _declare_common(command)
    command.add_argument("--each", type=names, metavar="NAME,...", help=OWN_UNKNOWNS)
    command.add_argument(
        "--free",
        dest="numbers",
        type=names,
        required=True,
        metavar="NAME,...",
        help="numbers of the bicycle to be found: parameters, steer elements, or entries of the matrices",
    )
    known = "what is known beforehand of these numbers; may be repeated"
    default = "the bicycle's standard deviations, else 20 %% of the value"
    add_options(command, "priors", priors=f"{known} (default: {default})")
    command.add_argument("-o", "--output", required=True, help="bicycle to write, a .yaml file for --bicycle")
    command.add_argument("--picture", help="pushes against the calibrated bicycle: .png, .svg or .pdf")


def print_together(arguments: argparse.Namespace, typed: str) -> None:
    """Run `fit together` and print its result."""
    from tms_calibrate.pooled_fit import fit_pooled
    from tms_calibrate.pooled_output import together_json, together_table

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
        each_once(arguments.fixed, "--fix"),
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
    """Run `fit calibrate` and print its result; typed: the command line, recorded in the output file."""
    from tms_calibrate.calibration import calibrate
    from tms_calibrate.calibration_file import sources_of, write_calibration
    from tms_calibrate.calibration_output import calibration_json, calibration_table, cross_validate
    from tms_calibrate.pooled_fit import usable
    from tms_calibrate.pooled_problem import Run

    output = Path(arguments.output)
    if output.suffix not in (".yaml", ".yml"):
        raise ParameterError(f"{output}: expected a name that ends in .yaml")
    priors = _priors(arguments)
    fits = _fits(arguments, arguments.each, {})
    parent = arguments.bicycle or _common_bicycle(fits)
    strikes, _ = usable(_chosen(fits, arguments.near))
    runs = tuple(Run(one.window, one.alone.names) for one in strikes)
    calibration = calibrate(fits[0].bicycle, runs, arguments.numbers, priors)
    validation = cross_validate(calibration, strikes)
    write_calibration(calibration, output, parent, typed, sources_of(fits, strikes))
    if arguments.picture:
        _picture(calibration, strikes, validation, Path(arguments.picture))
    if arguments.json:
        print_json({"output": str(output), **calibration_json(calibration, strikes, validation)})
    else:
        print(calibration_table(calibration, strikes, validation))
        print(f"written: {output}")


def _common_bicycle(fits: list[RecordingFit]) -> str:
    """Catalogue name of the one bicycle of all bags, to which the output file refers."""
    from tms_model import bicycle_names

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
    calibration: Calibration, strikes: tuple[Strike, ...], validation: CrossValidationRow, path: Path
) -> None:
    from tms_model.figures.saving import save_figure

    from tms_calibrate.calibration_figure import calibration_figure

    save_figure(calibration_figure(calibration, strikes, validation), path)


def _priors(arguments: argparse.Namespace) -> dict[str, Measured]:
    from tms_model.measured import Measured

    return {name: Measured(mean, std) for name, (mean, std) in each_once(arguments.priors, "--prior").items()}


def _fits(
    arguments: argparse.Namespace, free: tuple[str, ...] | None, priors: dict[str, Measured]
) -> list[RecordingFit]:
    """Fits of each bag's strikes one by one under white noise, which determine the free parameters."""
    if arguments.near and len(arguments.near) != len(arguments.bags):
        raise ParameterError(
            f"near: expected once per bag ({len(arguments.bags)}), found {len(arguments.near)} times"
        )
    paths = [Path(bag).resolve() for bag in arguments.bags]
    if len(set(paths)) < len(paths):
        raise ParameterError("bags: expected each once, found one twice: its strikes would count double")
    settings = settings_of(
        arguments,
        free=free,
        priors={name: (one.value, one.deviation) for name, one in priors.items()},
        noise="white",
        oscillator=(),
        estimators=("least_squares",),
    )
    from tms_bag import read_recording
    from tms_fit.cli import fit_with_bar
    from tms_fit.recording_fit import bicycle_of

    fits = []
    for bag in arguments.bags:
        recording = read_recording(bag)
        fits.append(fit_with_bar(recording, bicycle_of(recording, arguments.bicycle), settings))
    return fits


def _chosen(fits: list[RecordingFit], near: list[tuple[float, ...]] | None) -> list[Strike]:
    """All strikes, or those nearest to the given times [s] since each bag's start."""
    from tms_calibrate.pooled_fit import strikes_of

    chosen: list[Strike] = []
    for fit, times in zip(fits, near or [()] * len(fits), strict=True):
        strikes = strikes_of(fit)
        for time in times:
            nearest = min(strikes, key=lambda one: abs(one.seconds - time), default=None)
            if nearest is None or abs(nearest.seconds - time) > NEAR_WITHIN_S:
                raise RecordingError(
                    f"{fit.recording.path}: expected a strike within {NEAR_WITHIN_S:g} s of {time:g} s, found"
                    f" {f'the nearest at {nearest.seconds:.2f} s' if nearest else 'none at all'}"
                )
            if nearest not in chosen:
                chosen.append(nearest)
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
