"""The commands `stability` and `eigenvalues`, with the uncertainties of measured bicycles on request."""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict
from typing import Any

import numpy as np

from tms_model.bicycle import Bicycle
from tms_model.command_line import print_json
from tms_model.errors import ParameterError
from tms_model.response import FASTEST
from tms_model.stability import eigenvalues, stability
from tms_model.uncertainty import Uncertain, eigenvalue_uncertainty, stability_uncertainty

MOST_SAMPLES = 1_000_000
SHOWN = 5  # parameters that contribute most


def print_stability(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    """Print stable speed ranges, weave and capsize speed."""
    answer = stability(bicycle)
    found = stability_uncertainty(bicycle, *_sampling(arguments)) if arguments.uncertainty else {}
    if arguments.json:
        document: dict[str, Any] = {
            "bicycle": bicycle.name,
            "stable_speed_ranges": [[low, high] for low, high in answer.stable_speed_ranges],
            "onset_speed": answer.onset_speed,
            "weave_speed": answer.weave_speed,
            "capsize_speed": answer.capsize_speed,
        }
        if found:
            document["uncertainty"] = {name: _as_json(quantity) for name, quantity in found.items()}
            document |= {"samples": arguments.samples, "seed": arguments.seed}
        print_json(document)
        return
    if not answer.stable_speed_ranges:
        print(f"{bicycle.name} is not self-stable at any speed")
    for low, high in answer.stable_speed_ranges:
        end = f"to {high:.7f} m/s" if math.isfinite(high) else "up"
        print(f"{bicycle.name} is self-stable from {low:.7f} m/s {end}")
    for name, speed, text in (
        ("weave", answer.weave_speed, "an unstable oscillation becomes stable"),
        ("capsize", answer.capsize_speed, "a slow fall to one side begins"),
    ):
        print(f"  {name:8}" + (f"{speed:12.7f} m/s  {text}" if speed is not None else "        none"))
    for name, quantity in found.items():
        _print_uncertain(name.replace("_", " "), quantity, "m/s")


def print_eigenvalues(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    """Print the four eigenvalues at a speed. Raises ParameterError for a negative or not finite speed."""
    speed = arguments.speed
    if not 0.0 <= speed <= FASTEST:
        raise ParameterError(
            f"speed: expected zero or a positive number of m/s, at most {FASTEST:g}, found {speed:g}"
        )
    roots = eigenvalues(bicycle, speed)
    found = eigenvalue_uncertainty(bicycle, speed, *_sampling(arguments)) if arguments.uncertainty else []
    if arguments.json:
        values = [{"re": float(root.real), "im": float(root.imag)} for root in roots]
        document: dict[str, Any] = {"bicycle": bicycle.name, "speed": speed, "eigenvalues": values}
        if found:
            document["uncertainty"] = [{"re": _as_json(re), "im": _as_json(im)} for re, im in found]
            document |= {"samples": arguments.samples, "seed": arguments.seed}
        print_json(document)
        return
    for root in roots:
        print(f"{root.real:+.9f} {root.imag:+.9f}i 1/s")
    for re, im in found:
        if im.value >= 0.0:  # of a conjugate pair, one says it all
            _print_uncertain(f"real part of {re.value:+.4f} {im.value:+.4f}i", re, "1/s")
        if im.value > 0.0:
            _print_uncertain("its imaginary part", im, "1/s")


def _sampling(arguments: argparse.Namespace) -> tuple[np.random.Generator, int]:
    if not 0 <= arguments.samples <= MOST_SAMPLES:
        raise ParameterError(f"samples: expected 0 to {MOST_SAMPLES}, found {arguments.samples}")
    if arguments.seed < 0:
        raise ParameterError(f"seed: expected zero or more, found {arguments.seed}")
    return np.random.default_rng(arguments.seed), arguments.samples


def _as_json(quantity: Uncertain) -> dict[str, Any]:
    return {**asdict(quantity), "interval": list(quantity.interval)}


def _print_uncertain(name: str, quantity: Uncertain, unit: str) -> None:
    low, high = quantity.interval
    print(f"{name}: {_number(quantity.value)} +/- {_number(quantity.std)} {unit} to first order")
    if not math.isnan(quantity.sample_share):
        share = "" if quantity.sample_share == 1.0 else f"; {100.0 * quantity.sample_share:.2f} % have one"
        print(
            f"  samples: {_number(quantity.sample_mean)} +/- {_number(quantity.sample_std)} {unit},"
            f" 95 % in {_number(low)} to {_number(high)}{share}"
        )
    parts = sorted(quantity.contributions.items(), key=lambda part: -abs(part[1]))[:SHOWN]
    if math.isfinite(quantity.std):
        print("  mostly " + ", ".join(f"{parameter} {part:+.2g}" for parameter, part in parts))


def _number(value: float) -> str:
    return "none" if math.isnan(value) else f"{value:.5g}"
