"""Chebyshev series of the transitions at constant deceleration and constant sampling step.

At one deceleration and one step the transition is an entire function of the speed at the step's start.
Its Chebyshev series (L. N. Trefethen, Approximation Theory and Approximation Practice (2013), ch. 3 and 8)
over the window's speeds needs a handful of transitions, however many samples there are.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from tms_model import Bicycle
from tms_model.bicycle import Array
from tms_model.resistance import Resistance
from tms_model.varying_speed import transitions_from

TERMS = 20
SERIES_TOLERANCE = 1e-13  # of the series' last terms, relative to the largest
_ANGLES = (np.arange(TERMS) + 0.5) * (math.pi / TERMS)
_NODES = np.cos(_ANGLES)
_COEFFICIENTS = 2.0 / TERMS * np.cos(np.outer(np.arange(TERMS), _ANGLES))
_COEFFICIENTS[0] *= 0.5


def even_transitions(
    bicycle: Bicycle, speeds: Array, acceleration: float, step: float, resistance: Resistance
) -> Array | None:
    """Transitions (n, 5, 5) of state and held torque over equal steps [s] that begin with speeds (n,) [m/s].

    acceleration [m/s^2]: the same in all. None for too few steps or a series not exact to 1e-13. Raises
    ParameterError as `transitions_from` does.
    """
    low, high = float(speeds.min()), float(speeds.max())
    if len(speeds) < 2 * TERMS or not high > low:
        return None
    middle, half = 0.5 * (high + low), 0.5 * (high - low)
    count = np.full(TERMS, 1.0)
    known = transitions_from(
        bicycle, middle + half * _NODES, acceleration * count, step * count, resistance
    ).reshape(TERMS, 25)
    series = _COEFFICIENTS @ known
    if not np.abs(series[-2:]).max() <= SERIES_TOLERANCE * np.abs(series[0]).max():
        return None
    return (chebvander((speeds - middle) / half, TERMS - 1) @ series).reshape(-1, 5, 5)
