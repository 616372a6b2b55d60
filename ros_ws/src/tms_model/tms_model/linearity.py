"""How far the linear prediction holds: lean angle at which the nonlinear bicycle departs from it by so much.

The deviation of a free response is the larger of two numbers, one for the lean rate and one for the yaw
rate: root mean square of (nonlinear - linear) over root mean square of the linear one, over the whole
duration. Left and right are alike, so it grows with the square of the initial lean rate while it is small.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tms_model.bicycle import Array, Bicycle
from tms_model.errors import ParameterError
from tms_model.nonlinear import whipple_parameters
from tms_model.nonlinear_response import OK, nonlinear_response
from tms_model.response import LEAN, LEAN_RATE, STEER, LinearSystem, linear_system, response, yaw_rate

DEVIATIONS = (0.01, 0.05)
LONGEST, FASTEST = 60.0, 100.0  # [s], [m/s]; beyond them the nonlinear motion takes minutes to integrate
_STEP = 0.01  # [s], between compared samples
_SMALL = 1e-3  # [rad], of lean: where the search begins
_TRIALS = 40
_SEARCH_TOLERANCE = 1e-4  # relative, of the deviation found
_FALL_TOLERANCE = 1e-3  # relative, of the initial lean rate from which on it falls
_STEP_TOLERANCE = 1e-8  # of the nonlinear response: far below the smallest deviation of interest


@dataclass(frozen=True)
class Linearity:
    """The free response that departs from the linear prediction by `deviation`."""

    deviation: float  # [1], the one asked for
    lean_rate: float  # [rad/s], initial; NaN if no motion that stays upright departs that far
    peak_lean: float  # [rad], largest lean angle of the nonlinear motion
    peak_steer: float  # [rad]
    status: str  # ok; not_reached: the bicycle falls before
    message: str


def linearity(
    bicycle: Bicycle, speed: float, deviations: Sequence[float] = DEVIATIONS, duration: float = 2.0
) -> list[Linearity]:
    """The responses to an initial lean rate that deviate by each of `deviations` within `duration` [s].

    Raises ParameterError for a bicycle without parameters, a speed that is not positive, or a deviation that
    is not between 0 and 1.
    """
    whipple_parameters(bicycle)
    if not _STEP <= duration <= LONGEST:
        wanted = f"at least {_STEP:g} s, at most {LONGEST:g} s"
        raise ParameterError(f"duration: expected {wanted}, found {duration:g}")
    if speed > FASTEST:
        raise ParameterError(f"speed: expected at most {FASTEST:g} m/s, found {speed:g}")
    for deviation in deviations:
        if not 0.0 < deviation < 1.0:
            raise ParameterError(f"deviation: expected a number between 0 and 1, found {deviation:g}")
    comparison = _Comparison(bicycle, linear_system(bicycle, speed), duration)
    return [comparison.search(deviation) for deviation in deviations]


class _Comparison:
    """Nonlinear against linear responses at one speed; the linear one is computed once, per unit."""

    def __init__(self, bicycle: Bicycle, system: LinearSystem, duration: float) -> None:
        self.bicycle, self.speed = bicycle, system.speed
        count = round(duration / _STEP)
        self.times = np.linspace(0.0, count * _STEP, count + 1)
        states = response(system, _initial(1.0)[:4], self.times)
        self.unit = np.stack([states[:, LEAN_RATE], yaw_rate(system, states)])  # (2, n), per rad/s
        self.first_rate = _SMALL / float(np.abs(states[:, LEAN]).max())

    def deviation(self, lean_rate: float) -> tuple[float, Array]:
        """Deviation at an initial lean rate [rad/s] and the states (n, 8); infinite if the bicycle falls."""
        initial = _initial(lean_rate, self.speed)
        found = nonlinear_response(self.bicycle, initial, self.times, tolerance=_STEP_TOLERANCE)
        if found.status != OK:
            return math.inf, found.states
        difference = np.stack([found.states[:, LEAN_RATE], found.yaw_rate]) - lean_rate * self.unit
        ratio = np.linalg.norm(difference, axis=1) / np.linalg.norm(lean_rate * self.unit, axis=1)
        return float(ratio.max()), found.states

    def search(self, target: float) -> Linearity:
        """Secant steps between bounds, on the square root of the deviation, which is nearly straight."""
        low, high, rate, fall = 0.0, math.inf, self.first_rate, math.nan
        for _ in range(_TRIALS):
            found, states = self.deviation(rate)
            if abs(found - target) <= _SEARCH_TOLERANCE * target:
                peaks = np.abs(states).max(axis=0)
                return Linearity(target, rate, float(peaks[LEAN]), float(peaks[STEER]), OK, "found by search")
            low, high = (rate, high) if found < target else (low, rate)
            fall = rate if math.isinf(found) else fall
            if high == fall and high - low < _FALL_TOLERANCE * high:
                break
            guess = rate * min(math.sqrt(target / found), 10.0) if found > 0.0 else 10.0 * rate
            rate = guess if low < guess < high else 0.5 * (low + high)
        message = f"upright up to {low:.4g} rad/s, where it deviates by less than {100 * target:g} %"
        return Linearity(target, math.nan, math.nan, math.nan, "not_reached", message)


def _initial(lean_rate: float, speed: float = 0.0) -> Array:
    initial = np.zeros(5)
    initial[LEAN_RATE], initial[4] = lean_rate, speed
    return initial
