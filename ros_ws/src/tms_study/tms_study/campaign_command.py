"""The command `study campaign`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from tms_fit.settings import OPTIONS, Settings
from tms_model.command_line import print_json
from tms_model.errors import ParameterError


def add_campaign(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "ride a scenario many times with some of its keys varied, fit each run, and judge the estimates"
    command = commands.add_parser("campaign", help=text, description=text)
    command.add_argument("scenario", help="name (see `sim list`) or .yaml file")
    command.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="KEY=[V1,V2,...]",
        help="values of a key, e.g. speed=[3,3.6,4]; may be repeated: every combination is ridden",
    )
    command.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a key of all runs"
    )
    command.add_argument(
        "--runs", type=int, default=20, help="runs of each combination (default %(default)s)"
    )
    command.add_argument(
        "--seed", type=int, default=1, help="seed of the first run of each (default %(default)s)"
    )
    command.add_argument(
        "--estimator",
        choices=OPTIONS["estimators"].choices,
        default="least_squares",
        help="(default %(default)s)",
    )
    command.add_argument(
        "--fit",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a setting of the fit, e.g. noise=ar, window=1.0, free=[initial_lean_rate]; may be repeated",
    )
    command.add_argument(
        "--given",
        action="store_true",
        help="tell the fit when each impulse ended, so that what is off isn't the detector's doing",
    )
    command.add_argument(
        "-o",
        "--output",
        help="CSV with a row per strike, written run by run; a campaign that was interrupted goes on there",
    )
    command.add_argument("--figure", help="figure to make: .png, .svg or .pdf")
    command.add_argument("--json", action="store_true", help="one JSON document on stdout, SI units")


def run_campaign(arguments: argparse.Namespace) -> None:
    """Ride, fit, judge, print. Raises ParameterError and RecordingError."""
    from tms_sim.scenario import parse_change

    from tms_study.campaign import Campaign, ride_all
    from tms_study.campaign_file import CampaignFile
    from tms_study.campaign_result import summarise, to_json, to_text

    campaign = Campaign(
        arguments.scenario,
        dict(parse_change(text) for text in arguments.set),
        dict(_values(text) for text in arguments.vary),
        arguments.runs,
        arguments.seed,
        _settings(arguments.fit, arguments.estimator),
        arguments.given,
    )
    if arguments.output:
        table = CampaignFile(Path(arguments.output), campaign)
        if table.rows:
            print(f"{arguments.output}: goes on after {len(table.rows)} rows", file=sys.stderr)
        rows = ride_all(campaign, table.rows, table.add)
    else:
        rows = ride_all(campaign)
    summaries = summarise(campaign, rows)
    if arguments.figure:
        from tms_model.figures.saving import save_figure

        from tms_study.campaign_figure import campaign_figure

        save_figure(campaign_figure(campaign, rows, summaries), Path(arguments.figure))
    if arguments.json:
        print_json(to_json(campaign, summaries))
    else:
        print(to_text(campaign, summaries))


def _values(text: str) -> tuple[str, tuple[Any, ...]]:
    from tms_sim.scenario import parse_change

    key, values = parse_change(text)
    if not isinstance(values, list) or not values:
        raise ParameterError(f"--vary: expected KEY=[V1,V2,...], found {text!r}")
    if len({str(value) for value in values}) < len(values):
        raise ParameterError(f"--vary: {key}: expected each value once, found {text!r}")
    return key, tuple(values)


def _settings(changes: list[str], estimator: str) -> Settings:
    from tms_sim.scenario import parse_change

    known = OPTIONS.keys() - {"estimators"}
    asked: dict[str, Any] = {}
    for text in changes:
        name, value = parse_change(text)
        if name not in known:
            raise ParameterError(f"--fit: unknown {name!r}; expected of {', '.join(sorted(known))}")
        asked[name] = tuple(value) if isinstance(value, list) else value
    try:
        return Settings(**asked, estimators=(estimator,))
    except (TypeError, ValueError, AttributeError) as error:
        raise ParameterError(
            f"--fit: expected values of the right kind, found {', '.join(changes)}: {error}"
        ) from None
