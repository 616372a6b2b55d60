"""`study strikes`: its arguments, and the table as text, JSON and Markdown."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, Any

from tms_model.command_line import print_json, seed
from tms_model.errors import ParameterError

from tms_study import __version__

if TYPE_CHECKING:
    from tms_study.strikes import Score


def add_strikes(commands: Any) -> None:
    """Add the command to the others."""
    text = "how well strikes are found: every scenario, weak strikes, pushes by hand, a treadmill"
    command = commands.add_parser("strikes", help=text, description=text)
    command.add_argument("--runs", type=int, default=10, help="runs of each case (default %(default)s)")
    command.add_argument("--seed", type=seed, default=2011, help="seed of all noise (default %(default)s)")
    command.add_argument(
        "--only", default="", metavar="TEXT", help="cases whose name holds this, and no treadmill"
    )
    command.add_argument("--json", action="store_true", help="one JSON document on stdout, SI units")


def run_strikes(arguments: argparse.Namespace) -> None:
    """Run and print. Raises ParameterError for a number of runs below one, and names that no case has."""
    import numpy as np

    from tms_study.strikes import cases, study

    if arguments.runs < 1:
        raise ParameterError(f"--runs: expected one or more, found {arguments.runs}")
    if arguments.only and not any(arguments.only in case.topic for case in cases()):
        raise ParameterError(
            f"--only: expected part of a case's name such as {cases()[0].topic}, found {arguments.only!r}"
        )
    scores = study(np.random.default_rng(arguments.seed), arguments.runs, arguments.only)
    if arguments.json:
        print_json(scores_json(scores, arguments.seed))
    else:
        print(scores_text(scores))


def scores_json(scores: list[Score], seed: int) -> dict[str, Any]:
    """The document of `study strikes --json`."""
    return {"version": __version__, "seed": seed, "cases": [_score(one) for one in scores]}


def _score(one: Score) -> dict[str, Any]:
    import numpy as np

    sizes = np.abs(one.errors)
    return {
        "case": one.topic,
        "runs": one.runs,
        "strikes": one.strikes,
        "found": one.found,
        "missed": one.strikes - one.found,
        "false": one.false,
        "within_10_ms": _number(one.close),
        "median_error": _number(float(np.median(sizes)) if len(sizes) else math.nan),
        "largest_error": _number(float(sizes.max()) if len(sizes) else math.nan),
        "end_bound": _number(one.bound),
        "end_bound_length_unknown": _number(one.bound_unknown),
        "initial_lean_rate_off": _number(float(np.median(one.off)) if len(one.off) else math.nan),
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def scores_text(scores: list[Score]) -> str:
    """The table, Markdown that reads well on a terminal."""
    heads = [f"{'case':46}", "strikes", "missed", "false", "within 10 ms", "median", "largest", "bound"]
    heads += ["length unknown", "lean rate off"]
    lines = [f"| {' | '.join(heads)} |", f"|{'|'.join('-' * (len(head) + 2) for head in heads)}|"]
    for one in (_score(score) for score in scores):
        cells = [
            f"{one['strikes']:7}",
            f"{one['missed']:6}",
            f"{one['false']:5}",
            _in(one["within_10_ms"], 12, 100.0, " %"),
            _in(one["median_error"], 6, 1e3, " ms"),
            _in(one["largest_error"], 7, 1e3, " ms"),
            _in(one["end_bound"], 5, 1e3, " ms"),
            _in(one["end_bound_length_unknown"], 14, 1e3, " ms"),
            _in(one["initial_lean_rate_off"], 13, 100.0, " %"),
        ]
        lines.append(f"| {one['case']:46} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _in(value: float | None, width: int, per: float, unit: str) -> str:
    return f"{'-' if value is None else f'{per * value:.0f}{unit}':>{width}}"
