"""Command line of the studies: python -m tms_study, or ./tms study; `./tms demo` is `./tms study demo`.

What a command needs is imported when it runs: `--help` loads neither numpy nor scipy.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tms_fit.parameters import PARAMETERS, check_known
from tms_fit.settings_parser import names
from tms_model.command_line import Parser, print_json, seed
from tms_model.errors import ParameterError

from tms_study.campaign_command import add_campaign, run_campaign
from tms_study.strikes_command import add_strikes, run_strikes

FREE = ("initial_lean_rate", "lean_rate_bias", "yaw_rate_bias", "speed")  # unknowns of `study bound`


def main(argv: Sequence[str] | None = None) -> None:
    """Parse the arguments and run. Raises ParameterError and RecordingError."""
    arguments = _parser().parse_args(argv)
    if arguments.command == "demo":
        from tms_study.demo import demo

        print(demo(Path(arguments.out), arguments.scenario, arguments.seed))
    elif arguments.command == "bound":
        _bound(arguments)
    elif arguments.command == "campaign":
        run_campaign(arguments)
    elif arguments.command == "strikes":
        run_strikes(arguments)
    else:
        _validate(arguments)


def _parser() -> Parser:
    parser = Parser(prog="tms study", description="What needs both simulator and estimators.")
    commands = parser.add_subparsers(dest="command", required=True)
    text = "the whole pipeline: simulate, record, replay, estimate, fit, draw"
    command = commands.add_parser("demo", help=text, description=text)
    command.add_argument("--out", default="out/demo", help="folder to make (default %(default)s)")
    command.add_argument("--scenario", default="tms_strike", help="(default %(default)s)")
    command.add_argument("--seed", type=seed, default=1, help="seed of all noise (default %(default)s)")
    text = "what an experiment can tell at best: Cramer-Rao bounds over rate, noise, duration, strength"
    command = commands.add_parser("bound", help=text, description=text)
    command.add_argument("scenario", help="name (see `sim list`) or .yaml file")
    command.add_argument(
        "--free",
        type=names,
        default=FREE,
        metavar="NAME,...",
        help=f"all that is to be found, of {', '.join(PARAMETERS)} (default: {','.join(FREE)})",
    )
    command.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a key of the scenario"
    )
    command.add_argument("--json", action="store_true", help="one JSON document on stdout, SI units")
    text = "check the estimators on runs whose truth is known, and print what came out"
    command = commands.add_parser("validate", help=text, description=text)
    command.add_argument("--quick", action="store_true", help="fewer runs: minutes become seconds")
    command.add_argument("--seed", type=seed, default=2011, help="seed of all noise (default %(default)s)")
    command.add_argument("--json", action="store_true", help="one JSON document on stdout, SI units")
    command.add_argument("-o", "--output", help="Markdown file to write the table to")
    add_campaign(commands)
    add_strikes(commands)
    return parser


def _bound(arguments: argparse.Namespace) -> None:
    from tms_sim.scenario import load_scenario, parse_change

    from tms_study.bound import table, to_json, to_text

    check_known(arguments.free, PARAMETERS, "free")
    scenario = load_scenario(arguments.scenario, dict(parse_change(text) for text in arguments.set))
    rows = table(scenario, arguments.free)
    if arguments.json:
        print_json(to_json(scenario, arguments.free, rows))
    else:
        print(to_text(scenario, arguments.free, rows))


def _validate(arguments: argparse.Namespace) -> None:
    import numpy as np

    from tms_study.findings import findings_json, findings_text, write_markdown
    from tms_study.validation import validate

    if arguments.output and not Path(arguments.output).absolute().parent.is_dir():
        raise ParameterError(f"-o: expected a file in a folder that exists, found {arguments.output}")
    done = validate(np.random.default_rng(arguments.seed), arguments.quick)
    if arguments.output:
        write_markdown(Path(arguments.output), done, arguments.seed, arguments.quick)
    if arguments.json:
        print_json(findings_json(done, arguments.seed, arguments.quick))
    else:
        print(findings_text(done))
