"""Priors of a strike: the state at its onset, the kick of the steering, biases, and the shape of the force.

The default standard deviations are in the options table (`tms_fit.settings.DEFAULT_PRIORS`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from tms_model import Bicycle
from tms_model.bicycle import Array

from tms_fit.parameters import BIASES, ONSET
from tms_fit.settings import DEFAULT_PRIORS, Settings

LEAN_RATE_STD = 10.0  # [rad/s] of the change of the lean rate: flat
BLOW_PLACES = (0.2, 0.5, 0.8)  # of a blow, ahead of the rear contact, per wheelbase
SHAPE_STDS = (0.3, 0.3)  # of skewness and flatness of a long force
ASSUMED_STD = 1e-5  # of what is assumed to be known, SI


@dataclass(frozen=True, eq=False)
class ImpulsePrior:
    """Means and standard deviations of a strike's unknowns."""

    onset_mean: Array  # (4,) state at the onset, SI
    onset_std: Array  # (4,)
    bias_mean: Array  # (2,) [rad/s]
    bias_std: Array  # (2,) [rad/s]
    kick_ratio: float  # change of the steer rate per change of the lean rate
    kick_mean: float  # [rad/s] of the change of the steer rate beside the ratio
    kick_std: float  # [rad/s] about ratio and mean
    size: float  # [rad/s] of the change of the lean rate, for the scale of the shapes

    def rows(self, shapes: int) -> tuple[Array, Array]:
        """Rows (k, 2 + 2 shapes) of unit variance on biases and forces, and their values (k,)."""
        rows, values = np.zeros((2 + 2 * shapes, 2 + 2 * shapes)), np.zeros(2 + 2 * shapes)
        rows[0, 0], rows[1, 1] = 1.0 / self.bias_std
        values[:2] = self.bias_mean / self.bias_std
        rows[2, 2] = 1.0 / LEAN_RATE_STD
        rows[3, 2:4] = np.array([-self.kick_ratio, 1.0]) / self.kick_std
        values[3] = self.kick_mean / self.kick_std
        kick = math.hypot(self.kick_ratio * self.size, self.kick_std)
        for k, std in zip(range(1, shapes), SHAPE_STDS, strict=False):
            rows[2 + 2 * k, 2 + 2 * k] = 1.0 / (std * self.size)
            rows[3 + 2 * k, 3 + 2 * k] = 1.0 / (std * kick)
        return rows, values


def impulse_prior(bicycle: Bicycle, settings: Settings, change: float) -> ImpulsePrior:
    """Priors of a strike that changes the lean rate by about `change` [rad/s]."""
    known = {name: (0.0, std) for name, std in DEFAULT_PRIORS.items()}
    ratio, spread = kick_ratio(bicycle)
    size = max(abs(change), 0.05)
    kick = (0.0, math.hypot(spread * size, known["strike_steer_rate"][1]))
    if "upright" in settings.assume:
        known |= dict.fromkeys(ONSET, (0.0, ASSUMED_STD))
    if "no_kick" in settings.assume:
        ratio, kick = 0.0, (0.0, ASSUMED_STD)
    known |= settings.priors
    known |= {name: (value, ASSUMED_STD) for name, value in settings.fixed.items()}
    if "strike_steer_rate" in {*settings.priors, *settings.fixed}:
        ratio, kick = 0.0, known["strike_steer_rate"]
    onset, biases = (np.array([known[name] for name in names]) for names in (ONSET, BIASES))
    return ImpulsePrior(
        onset_mean=onset[:, 0],
        onset_std=onset[:, 1],
        bias_mean=biases[:, 0],
        bias_std=biases[:, 1],
        kick_ratio=ratio,
        kick_mean=kick[0],
        kick_std=kick[1],
        size=size,
    )


def kick_ratio(bicycle: Bicycle) -> tuple[float, float]:
    """Change of the steer rate per change of the lean rate by a lateral blow on the frame, and its spread.

    M q' = J [h, x c cos(lambda) / w]: a blow x ahead of the rear contact and h above the floor, h where it
    would not move the contacts sideways. The spread is that of blows between BLOW_PLACES, and of a hand that
    may hold the handlebars.
    """
    steering = bicycle.trail / bicycle.wheelbase * math.cos(bicycle.steer_axis_tilt)
    height = bicycle.mass[0, 0] / -bicycle.stiffness0[0, 0]
    ratios = []
    for place in BLOW_PLACES:
        lean, steer = np.linalg.solve(bicycle.mass, [height, place * bicycle.wheelbase * steering])
        ratios.append(float(steer / lean))
    low, middle, high = ratios
    return middle, math.hypot(0.5 * (high - low), middle)
