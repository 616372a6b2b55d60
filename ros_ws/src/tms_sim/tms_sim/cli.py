"""Command line of the simulator: python -m tms_sim, or ./tms sim.

What a command needs is imported when it runs: `--help` loads no numpy.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tms_bag.errors import RecordingError
from tms_model.command_line import Parser, print_json

from tms_sim.fault_command import fault, fault_arguments

if TYPE_CHECKING:
    from tms_bag import Record


def main(argv: Sequence[str] | None = None) -> None:
    """Parse the arguments and answer. Raises ParameterError and RecordingError."""
    arguments = _parser().parse_args(argv)
    if arguments.command == "list":
        _list(arguments)
    elif arguments.command == "plot":
        _plot(arguments)
    elif arguments.command == "fault":
        fault(arguments)
    else:
        _run(arguments)


def _parser() -> Parser:
    parser = Parser(prog="tms sim", description="Makes runs: a bicycle, a strike, sensors.")
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("list", help="scenarios", description="scenarios")
    one.add_argument("--json", action="store_true", help="one JSON document on stdout")
    text = "a simulated run on one page: path, angles, rates, speed, forces, with the truth"
    one = commands.add_parser("plot", help=text, description=text)
    one.add_argument("bag", help="bag of a simulated run, with its truth")
    one.add_argument("-o", "--output", required=True, help="file to make: .png, .svg or .pdf")
    text = "put faults into a recording, each told as an event of the truth"
    fault_arguments(commands.add_parser("fault", help=text, description=text))
    one = commands.add_parser(
        "run", help="run a scenario into a bag", description="run a scenario into a bag"
    )
    one.add_argument("scenario", help="name (see `list`) or .yaml file")
    one.add_argument("-o", "--output", required=True, help="bag folder to make")
    one.add_argument("--seed", type=int, help="seed of all noise (default: the scenario's)")
    one.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a key, e.g. strike.time=1.5"
    )
    one.add_argument("--force", action="store_true", help="replace the bag if it exists")
    one.add_argument(
        "--blind", action="store_true", help="leave the truth out of the bag: it goes to BAG.truth.json"
    )
    return parser


def _list(arguments: argparse.Namespace) -> None:
    from tms_sim.scenario import description, scenario_names

    scenarios = {name: description(name) for name in scenario_names()}
    if arguments.json:
        print_json({"scenarios": [{"name": name, "description": text} for name, text in scenarios.items()]})
        return
    for name, text in scenarios.items():
        print(f"{name:18} {text}")


def _plot(arguments: argparse.Namespace) -> None:
    from tms_model.figures.saving import save_figure

    from tms_sim.notebook import draw, read_page

    save_figure(draw(read_page(arguments.bag)), Path(arguments.output))


def _run(arguments: argparse.Namespace) -> None:
    import numpy as np
    from tms_model.atomic_write import atomic_write

    from tms_sim.blind import blind_custom_data, blind_records, blinded, truth_path, truth_text
    from tms_sim.run import simulate
    from tms_sim.scenario import load_scenario, parse_change

    changes = dict(parse_change(text) for text in arguments.set)
    if arguments.seed is not None:
        changes["seed"] = arguments.seed
    scenario = load_scenario(arguments.scenario, changes)
    result = simulate(scenario, np.random.default_rng(scenario.integer("seed")))
    truth = truth_path(arguments.output)
    if truth.exists() and not arguments.force:
        raise RecordingError(f"{truth}: exists already; choose another bag, or replace both with --force")
    if arguments.blind:
        told, text = blinded(result, scenario), truth_text(result, scenario).encode()
        _write(
            arguments, blind_records(told), blind_custom_data(told.info), partial(atomic_write, truth, text)
        )
        return
    _write(arguments, result.records(), result.custom_data(), partial(truth.unlink, missing_ok=True))
    if result.fallen_at is not None:
        print(
            f"the bicycle falls {result.fallen_at:.2f} s after the start; the run ends there", file=sys.stderr
        )


def _write(
    arguments: argparse.Namespace,
    records: Iterable[Record],
    custom_data: dict[str, str],
    beside: Callable[[], None],  # so that no bag stands beside another's truth, and no blind one without
) -> None:
    from tms_bag import BagWriter, topics

    with BagWriter(arguments.output, custom_data, overwrite=arguments.force, beside=beside) as bag:
        for record in records:
            bag.write(record, topics.qos_of(record.topic))
