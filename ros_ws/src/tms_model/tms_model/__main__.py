"""Command line of the bicycle model: python -m tms_model, or ./tms model."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tms_model.bicycle import Bicycle
from tms_model.catalogue import bicycle_names, load_bicycle
from tms_model.command_line import Parser, print_json, run
from tms_model.parameters import ParameterError
from tms_model.response_commands import add_arguments, print_linearity, respond
from tms_model.stability import eigenvalues, stability


def main(argv: Sequence[str] | None = None) -> None:
    """Parse the arguments and answer. Raises ParameterError."""
    arguments = _parser().parse_args(argv)
    if arguments.command == "list":
        _list(arguments)
    else:
        COMMANDS[arguments.command](load_bicycle(arguments.bicycle), arguments)


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
        "plot": "figure of the eigenvalues against speed",
    }
    subparsers = {
        name: commands.add_parser(name, help=text, description=text) for name, text in help_texts.items()
    }
    for name, subparser in subparsers.items():
        if name != "list":
            subparser.add_argument("bicycle", help="name in the catalogue, or a .yaml file")
        if name == "plot":
            subparser.add_argument("-o", "--output", required=True, help="PNG, SVG or PDF to write")
        else:
            subparser.add_argument(
                "--json", action="store_true", help="one JSON document on stdout, SI units"
            )
    for name in ("eigenvalues", "response", "linearity"):
        subparsers[name].add_argument("--speed", type=float, required=True, help="forward speed [m/s]")
    add_arguments(subparsers)
    return parser


def _list(arguments: argparse.Namespace) -> None:
    bicycles = [load_bicycle(name) for name in bicycle_names()]
    if arguments.json:
        print_json({"bicycles": [{"name": b.name, "description": b.description} for b in bicycles]})
        return
    for bicycle in bicycles:
        print(f"{bicycle.name:16} {bicycle.description}")


def _show(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    text = {key: getattr(bicycle, key) for key in ("description", "source", "uncertainty")}
    if arguments.json:
        print_json({"bicycle": bicycle.name, **text, "parameters": bicycle.numbers})
        return
    for key, value in text.items():
        print(f"{key}: {value}")
    for name, value in bicycle.numbers.items():
        print(f"  {name:28} {value:.9g}")


def _matrices(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    if arguments.json:
        print_json({"bicycle": bicycle.name, **{k: m.tolist() for k, m in bicycle.canonical.items()}})
        return
    for letter, matrix in bicycle.canonical.items():
        print(
            f"{letter:3} [[{matrix[0, 0]:.9g}, {matrix[0, 1]:.9g}], [{matrix[1, 0]:.9g}, {matrix[1, 1]:.9g}]]"
        )


def _eigenvalues(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    if not (np.isfinite(arguments.speed) and arguments.speed >= 0.0):
        raise ParameterError(f"speed: expected zero or a positive number of m/s, found {arguments.speed:g}")
    roots = eigenvalues(bicycle, arguments.speed)
    if arguments.json:
        values = [{"re": float(root.real), "im": float(root.imag)} for root in roots]
        print_json({"bicycle": bicycle.name, "speed": arguments.speed, "eigenvalues": values})
        return
    for root in roots:
        print(f"{root.real:+.9f} {root.imag:+.9f}i 1/s")


def _stability(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    answer = stability(bicycle)
    if arguments.json:
        ranges = [[low, high] for low, high in answer.stable_speed_ranges]
        print_json(
            {
                "bicycle": bicycle.name,
                "stable_speed_ranges": ranges,
                "weave_speed": answer.weave_speed,
                "capsize_speed": answer.capsize_speed,
            }
        )
        return
    if not answer.stable_speed_ranges:
        print(f"{bicycle.name} is not self-stable at any speed")
    for low, high in answer.stable_speed_ranges:
        print(
            f"{bicycle.name} is self-stable from {low:.7f} m/s "
            + (f"to {high:.7f} m/s" if np.isfinite(high) else "up")
        )


def _plot(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    # matplotlib takes a second to import: only who plots pays for it
    from tms_model.plot import eigenvalue_figure, save_figure

    save_figure(eigenvalue_figure(bicycle), Path(arguments.output))


COMMANDS = {
    "show": _show,
    "matrices": _matrices,
    "eigenvalues": _eigenvalues,
    "stability": _stability,
    "response": respond,
    "linearity": print_linearity,
    "plot": _plot,
}

if __name__ == "__main__":
    sys.exit(run(main, (ParameterError,)))
