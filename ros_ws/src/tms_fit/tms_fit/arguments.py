"""Texts of the command line and of node parameters that stand for names and numbers."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from typing import TypeVar

from tms_model import ParameterError

from tms_fit.settings import NOISE_MODELS, Settings

Value = TypeVar("Value")


def names(text: str) -> tuple[str, ...]:
    """NAME,NAME,... as names."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def assignment(text: str) -> tuple[str, float]:
    """NAME=VALUE as both. Raises argparse.ArgumentTypeError."""
    name, equals, value = text.partition("=")
    try:
        if equals:
            return name.strip(), float(value)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"expected NAME=VALUE with a number, found {text!r}")


def prior(text: str) -> tuple[str, tuple[float, float]]:
    """NAME=MEAN,STD as a name, a mean and a positive deviation. Raises argparse.ArgumentTypeError."""
    name, equals, values = text.partition("=")
    try:
        mean, std = (float(part) for part in values.split(","))
        if equals and math.isfinite(mean) and 0.0 < std < math.inf:
            return name.strip(), (mean, std)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"expected NAME=MEAN,STD with STD positive, found {text!r}")


def add_prior_argument(command: argparse.ArgumentParser, unknowns: str) -> None:
    """Declare `--prior`, the same for every command; unknowns: what a prior may be on, in words."""
    command.add_argument(
        "--prior",
        action="append",
        default=[],
        type=prior,
        metavar="NAME=MEAN,STD",
        help=f"what is known beforehand of {unknowns}; may be repeated",
    )


def add_noise_arguments(command: argparse.ArgumentParser) -> None:
    """Declare what the noise is like."""
    command.add_argument(
        "--noise",
        choices=NOISE_MODELS,
        default=Settings.noise,
        help="white; autoregressive, as intervals need when neighbouring residuals are alike; white with an"
        " oscillation, such as a shimmy; or auto: white, and when they are alike the likelier of the others"
        " (default %(default)s)",
    )
    command.add_argument(
        "--oscillator",
        type=numbers,
        default=Settings.oscillator,
        metavar="HZ[,S[,RATE]]",
        help="what is known of that oscillation: frequency, time in which its phase is forgotten, standard"
        " deviation [rad/s] (default: found from the residuals)",
    )


def numbers(text: str) -> tuple[float, ...]:
    """NUMBER,NUMBER,... as numbers. Raises argparse.ArgumentTypeError."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected numbers, found {text!r}") from None


def each_once(pairs: Iterable[tuple[str, Value]], option: str) -> dict[str, Value]:
    """Names and values as a dictionary. Raises ParameterError for a name that comes twice."""
    found: dict[str, Value] = {}
    for name, value in pairs:
        if name in found:
            raise ParameterError(f"{option}: {name}: expected each name once, found it twice")
        found[name] = value
    return found
