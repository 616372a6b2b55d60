"""The settings of a fit as parameters of a node."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable, Sequence
from typing import TypeVar

from rclpy.node import Node
from tms_bag.nodes.parameters import declare
from tms_model import ParameterError

from tms_fit.arguments import assignment, each_once, prior
from tms_fit.least_squares.losses import LOSSES
from tms_fit.settings import (
    FILTERS,
    INTERVALS,
    NOISE_MODELS,
    PARAMETERS,
    SATURATIONS,
    SLIPS,
    SPEED_MODELS,
    STEER_TORQUES,
    Settings,
)

Value = TypeVar("Value")

CHOICES: dict[str, tuple[str, tuple[str, ...]]] = {
    "filter": ("filter that runs along; extended estimates speed and rolling resistance", FILTERS),
    "intervals": ("how 95 % intervals are found", INTERVALS),
    "loss": ("how much a residual counts", tuple(LOSSES)),
    "noise": ("noise model", NOISE_MODELS),
    "saturation": ("what saturated samples are taken for", SATURATIONS),
    "slip": ("what is done with the slip window", SLIPS),
    "speed_model": ("the speed after a strike", SPEED_MODELS),
    "steer_torque": ("how a known torque enters", STEER_TORQUES),
}

NUMBERS: dict[str, tuple[str, float, float]] = {  # what it is, least and largest
    "window": ("longest free response used [s]", 0.3, 60.0),
    "gyroscope_noise": ("noise where no message states it [rad/s]", 1e-9, 10.0),
    "slip_window": ("time after a strike in which the front wheel slips [s]", 0.0, 10.0),
}


def declare_fit_settings(node: Node) -> Settings:
    """Declare and read them. Raises ParameterError."""
    free = declare(
        node, "free", [""], f"parameters to estimate, of {', '.join(PARAMETERS)}; empty: the default"
    )
    fixed = declare(node, "fix", [""], "known parameters as NAME=VALUE, SI units, such as speed=3.6")
    priors = declare(
        node, "prior", [""], "free parameters of which something is known, as NAME=MEAN,STD, SI units"
    )
    oscillator = declare(
        node,
        "oscillator",
        [0.0],
        "known of an oscillation in the noise: frequency [Hz], decay time [s], deviation [rad/s]; 0: nothing",
    )
    return Settings(
        free=tuple(name for name in free if name) or None,
        fixed=each_once(_read("fix", assignment, fixed), "parameter fix"),
        priors=each_once(_read("prior", prior, priors), "parameter prior"),
        oscillator=tuple(value for value in oscillator if value),
        gyroscope_range=declare(
            node,
            "gyroscope_range",
            0.0,
            "at which a reading is saturated, and left out; 0: only where imu/lean_yaw says so [rad/s]",
            0.0,
            1000.0,
        )
        or None,
        estimators=tuple(declare(node, "estimators", list(Settings.estimators), "estimators, in order")),
        **{
            name: declare(node, name, getattr(Settings, name), what, low, high)
            for name, (what, low, high) in NUMBERS.items()
        },
        **{
            name: declare(node, name, getattr(Settings, name), f"{what}: {', '.join(choices)}")
            for name, (what, choices) in CHOICES.items()
        },
    )


def _read(
    name: str, read: Callable[[str], tuple[str, Value]], texts: Sequence[str]
) -> list[tuple[str, Value]]:
    try:
        return [read(text) for text in texts if text]
    except ArgumentTypeError as error:
        raise ParameterError(f"parameter {name}: {error}") from error
