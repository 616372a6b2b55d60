"""Command line of the bicycle model: python -m tms_model, or ./tms model."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tms_model import response_commands, stability_commands
from tms_model.acceleration import parameters_under_acceleration as parameters_of
from tms_model.bicycle import Bicycle
from tms_model.catalogue import bicycle_names, load_bicycle
from tms_model.changes import parse_changes, with_parameters
from tms_model.command_line import Parser, print_json, run
from tms_model.description import show
from tms_model.parameters import ParameterError
from tms_model.response_commands import print_linearity, respond
from tms_model.stability_commands import print_eigenvalues, print_stability
from tms_model.urdf import urdf


def main(argv: Sequence[str] | None = None) -> None:
    """Parse the arguments and answer. Raises ParameterError."""
    arguments = _parser().parse_args(argv)
    if arguments.command == "list":
        _list(arguments)
    else:
        COMMANDS[arguments.command](_bicycle(arguments), arguments)


def _bicycle(arguments: argparse.Namespace) -> Bicycle:
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
    stability_commands.add_arguments(subparsers)
    response_commands.add_arguments(subparsers)
    return parser


def _list(arguments: argparse.Namespace) -> None:
    bicycles = [load_bicycle(name) for name in bicycle_names()]
    if arguments.json:
        print_json({"bicycles": [{"name": b.name, "description": b.description} for b in bicycles]})
        return
    width = max(len(bicycle.name) for bicycle in bicycles)
    for bicycle in bicycles:
        print(f"{bicycle.name:{width}} {bicycle.description}")


def _matrices(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    if arguments.json:
        print_json({"bicycle": bicycle.name, **{k: m.tolist() for k, m in bicycle.canonical.items()}})
        return
    for letter, matrix in bicycle.canonical.items():
        print(
            f"{letter:3} [[{matrix[0, 0]:.9g}, {matrix[0, 1]:.9g}], [{matrix[1, 0]:.9g}, {matrix[1, 1]:.9g}]]"
        )


def _urdf(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    parameters, _ = parameters_of(bicycle)
    text = urdf(parameters, bicycle.name)
    if arguments.json:
        print_json({"bicycle": bicycle.name, "urdf": text})
    else:
        print(text, end="")


def _plot(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    # matplotlib takes a second to import: only who plots pays for it
    from tms_model.figures import FIGURES
    from tms_model.figures.saving import save_figure

    if arguments.figure not in FIGURES:
        raise ParameterError(f"figure: expected one of {', '.join(FIGURES)}, found {arguments.figure!r}")
    save_figure(FIGURES[arguments.figure](bicycle), Path(arguments.output))


COMMANDS = {
    "show": show,
    "matrices": _matrices,
    "eigenvalues": print_eigenvalues,
    "stability": print_stability,
    "response": respond,
    "linearity": print_linearity,
    "urdf": _urdf,
    "plot": _plot,
}

if __name__ == "__main__":
    sys.exit(run(main, (ParameterError,)))
