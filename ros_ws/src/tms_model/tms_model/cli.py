"""Command line of the bicycle model: python -m tms_model, or ./tms model.

What a command needs is imported when it runs: `--help` loads neither numpy nor scipy.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from tms_model.command_line import Parser, print_json
from tms_model.errors import ParameterError
from tms_model.resistance import RESISTANCES

if TYPE_CHECKING:
    from tms_model.bicycle import Bicycle

COMMANDS = {  # a function (bicycle, arguments) each, by its module
    "show": "tms_model.description:show",
    "matrices": "tms_model.cli:print_matrices",
    "eigenvalues": "tms_model.stability_commands:print_eigenvalues",
    "stability": "tms_model.stability_commands:print_stability",
    "response": "tms_model.response_commands:respond",
    "linearity": "tms_model.response_commands:print_linearity",
    "urdf": "tms_model.cli:print_urdf",
    "plot": "tms_model.cli:plot",
}


def main(argv: Sequence[str] | None = None) -> None:
    """Parse the arguments and answer. Raises ParameterError."""
    arguments = _parser().parse_args(argv)
    if arguments.command == "list":
        _list(arguments)
    else:
        module, _, name = COMMANDS[arguments.command].partition(":")
        answer: Callable[[Bicycle, argparse.Namespace], None] = getattr(import_module(module), name)
        answer(_bicycle(arguments), arguments)


def _bicycle(arguments: argparse.Namespace) -> Bicycle:
    from tms_model.catalogue import load_bicycle
    from tms_model.changes import parse_changes, with_parameters

    bicycle = load_bicycle(arguments.bicycle)
    return with_parameters(bicycle, parse_changes(arguments.set)) if arguments.set else bicycle


def _parser() -> Parser:
    parser = Parser(prog="tms model", description="The bicycle: parameters, matrices, stability, response.")
    commands = parser.add_subparsers(dest="command", required=True)
    help_texts = {
        "list": "bicycles of the catalogue",
        "show": "parameters of a bicycle and where they come from",
        "matrices": "M, C1, K0, K2 of the equations of motion (3.1)",
        "eigenvalues": "eigenvalues at a speed",
        "stability": "stable speed ranges, weave and capsize speed",
        "response": "free response to an initial lean rate, linear or nonlinear",
        "linearity": "lean angles at which the nonlinear motion departs from the linear prediction",
        "urdf": "the bicycle for viewers such as RViz and Foxglove",
        "plot": "figure of the eigenvalues against speed with the bicycle to scale, or another one",
    }
    subparsers = {
        name: commands.add_parser(name, help=text, description=text) for name, text in help_texts.items()
    }
    for name, subparser in subparsers.items():
        if name != "list":
            subparser.add_argument("bicycle", help="name in the catalogue, or a .yaml or .txt file")
            subparser.add_argument(
                "--set",
                action="append",
                default=[],
                metavar="NAME=VALUE",
                help="change a parameter or a steer element, SI units: trail=-0.02, steer_axis_tilt_deg=25,"
                " steer_spring=-10; may be given more than once",
            )
        if name == "plot":
            subparser.add_argument("-o", "--output", required=True, help="PNG, SVG or PDF to write")
            subparser.add_argument(
                "--figure",
                default="eigenvalues",
                help="(default eigenvalues; a wrong one lists all)",
            )
        else:
            subparser.add_argument(
                "--json", action="store_true", help="one JSON document on stdout, SI units"
            )
    for name in ("eigenvalues", "response", "linearity"):
        subparsers[name].add_argument("--speed", type=float, required=True, help="forward speed [m/s]")
    _add_uncertainty_arguments(subparsers)
    _add_response_arguments(subparsers)
    return parser


def _add_uncertainty_arguments(subparsers: Mapping[str, argparse.ArgumentParser]) -> None:
    """Declare what `stability` and `eigenvalues` take besides the bicycle, --speed and --json."""
    for name in ("stability", "eigenvalues"):
        one = subparsers[name]
        one.add_argument(
            "--uncertainty", action="store_true", help="what the parameters' standard deviations make of it"
        )
        one.add_argument(
            "--samples", type=int, default=10_000, help="for the Monte Carlo method, or 0 (default 10000)"
        )
        one.add_argument("--seed", type=int, default=0, help="of the Monte Carlo method (default 0)")


def _add_response_arguments(subparsers: Mapping[str, argparse.ArgumentParser]) -> None:
    """Declare what `response` and `linearity` take besides the bicycle, --speed and --json."""
    one = subparsers["response"]
    one.add_argument("--lean-rate", type=float, required=True, help="initial lean rate [rad/s]")
    one.add_argument("--duration", type=float, default=4.0, help="[s] (default 4)")
    one.add_argument("--step", type=float, default=0.01, help="[s] (default 0.01)")
    one.add_argument(
        "--gain", type=float, default=0.0, help="steer torque per lean rate [N m s/rad] (default 0)"
    )
    one.add_argument("--nonlinear", action="store_true", help="by the nonlinear equations of motion")
    one.add_argument(
        "--deceleration", type=float, default=0.0, help="loss of speed [m/s^2] (default 0: constant speed)"
    )
    one.add_argument(
        "--resistance",
        choices=RESISTANCES,
        default="rolling",
        help="what slows it down: the ground, by a moment about each axle (rolling, the default) or by normal"
        " forces ahead of the contacts, or the brake of one wheel",
    )
    far = subparsers["linearity"]
    far.add_argument("--duration", type=float, default=2.0, help="of the compared responses [s] (default 2)")
    far.add_argument(
        "--deviation",
        type=float,
        action="append",
        help="from the linear prediction, as a fraction; may be repeated (default 0.01 and 0.05)",
    )


def _list(arguments: argparse.Namespace) -> None:
    from tms_model.catalogue import bicycle_names, load_bicycle

    bicycles = [load_bicycle(name) for name in bicycle_names()]
    if arguments.json:
        print_json({"bicycles": [{"name": b.name, "description": b.description} for b in bicycles]})
        return
    width = max(len(bicycle.name) for bicycle in bicycles)
    for bicycle in bicycles:
        print(f"{bicycle.name:{width}} {bicycle.description}")


def print_matrices(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    """Print M, C1, K0, K2 of the equations of motion (3.1)."""
    if arguments.json:
        print_json({"bicycle": bicycle.name, **{k: m.tolist() for k, m in bicycle.canonical.items()}})
        return
    for letter, matrix in bicycle.canonical.items():
        print(
            f"{letter:3} [[{matrix[0, 0]:.9g}, {matrix[0, 1]:.9g}], [{matrix[1, 0]:.9g}, {matrix[1, 1]:.9g}]]"
        )


def print_urdf(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    """Print the bicycle as a robot description."""
    from tms_model.acceleration import parameters_under_acceleration
    from tms_model.urdf import urdf

    parameters, _ = parameters_under_acceleration(bicycle)
    text = urdf(parameters, bicycle.name)
    if arguments.json:
        print_json({"bicycle": bicycle.name, "urdf": text})
    else:
        print(text, end="")


def plot(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    """Write a figure of the bicycle."""
    from tms_model.figures import FIGURES
    from tms_model.figures.saving import save_figure

    if arguments.figure not in FIGURES:
        raise ParameterError(f"figure: expected one of {', '.join(FIGURES)}, found {arguments.figure!r}")
    save_figure(FIGURES[arguments.figure](bicycle), Path(arguments.output))
