"""Transition and process noise of a bicycle over one step at constant speed, cached by speed and duration.

    x' = A x + B T + white accelerations of density D,   A = A0 + v A1 + v^2 A2

Transition F, the torque's part and the covariance Q of the process noise come from one exponential (Van Loan,
see `tms_model.response`),

    exp([[A, D], [0, -A']] h) = [[F, G], [0, F'^-1]],   Q = G F',

a Taylor series in the step h, whose terms are computed once for each speed: a step is then one product with
them. A long step is halved until the matrix's norm times h is at most 2, where the truncated terms are below
1e-17 of the exponential, and doubled again: F(2 h) = F F, Q(2 h) = Q + F Q F'.
"""

from __future__ import annotations

import math

import numpy as np
from tms_model import Bicycle
from tms_model.bicycle import Array
from tms_model.response import first_order, torque_column

TERMS = 24
MAX_NORM = 2.0  # of the exponent, for the series
CACHE_SIZE = 1000  # speeds, and steps
_ORDERS = np.arange(1, TERMS + 1)
_IDENTITY = np.eye(4)
_FACTORIALS = np.cumprod(_ORDERS.astype(float))

Step = tuple[Array, Array, Array]  # transition (4, 4), torque's part (4, 1), covariance (4, 4)


def speed_polynomial(bicycle: Bicycle) -> Array:
    """A0, A1 and A2 (3, 5, 5), with the held steer torque as fifth state."""
    none, elements = np.zeros((2, 2)), bicycle.steer_elements
    still = bicycle.gravity * bicycle.stiffness0 + elements.stiffness
    found = np.zeros((3, 5, 5))
    zero = first_order(bicycle.mass, none, none)
    found[0, :4, :4] = first_order(bicycle.mass, elements.damping, still)
    found[0, :4, 4] = torque_column(bicycle)
    found[1, :4, :4] = first_order(bicycle.mass, bicycle.damping, none) - zero
    found[2, :4, :4] = first_order(bicycle.mass, none, bicycle.stiffness2) - zero
    return found


class TransitionCache:
    """Steps of one bicycle by speed and duration."""

    def __init__(self, bicycle: Bicycle, density: Array) -> None:
        """density: (4, 4) of the white process noise, squared units of the state's derivative per Hz."""
        self._polynomial = speed_polynomial(bicycle)
        self._scale = float(np.abs(density).max()) or 1.0
        self._density = density / self._scale
        self._series: dict[float, tuple[Array, float]] = {}
        self._steps: dict[tuple[float, float], Step] = {}

    def at(self, speed: float, step: float) -> Step:
        """Step at a speed [m/s], rounded to mm/s, over a duration [s], rounded to ns."""
        key = (max(round(speed, 3), 1e-3), round(step, 9))
        found = self._steps.get(key)
        if found is None:
            if len(self._steps) >= CACHE_SIZE:
                self._steps.clear()
            found = self._steps[key] = self._step(*key)
        return found

    def _step(self, speed: float, step: float) -> Step:
        """Step by the series."""
        found = self._series.get(speed)
        if found is None:
            if len(self._series) >= CACHE_SIZE:
                self._series.clear()
            found = self._series[speed] = self._terms(speed)
        terms, norm = found
        doublings = (
            max(0, math.ceil(math.log2(norm * step / MAX_NORM))) if 0.0 < norm * step < math.inf else 0
        )
        sums = ((step / 2.0**doublings) ** _ORDERS / _FACTORIALS).dot(terms).reshape(9, 9)
        change = sums[:5, :5]  # without the leading 1
        spread = sums[:4, 5:].dot((_IDENTITY + change[:4, :4]).T)
        for _ in range(doublings):
            carried = spread + change[:4, :4].dot(spread)
            spread = spread + carried + carried.dot(change[:4, :4].T)
            change = 2.0 * change + change.dot(change)
        process = (0.5 * self._scale) * (spread + spread.T)
        return _IDENTITY + change[:4, :4], change[:4, 4:].copy(), process

    def _terms(self, speed: float) -> tuple[Array, float]:
        """Powers of the block matrix from the first on, each in a row (24, 81), and its 1-norm."""
        a = self._polynomial[0] + speed * (self._polynomial[1] + speed * self._polynomial[2])
        block = np.zeros((9, 9))
        block[:5, :5], block[:4, 5:], block[5:, 5:] = a, self._density, -a[:4, :4].T
        powers = np.empty((TERMS, 9, 9))
        powers[0], count = block, 1
        while count < TERMS:
            more = min(count, TERMS - count)
            np.matmul(powers[:more], powers[count - 1], out=powers[count : count + more])
            count += more
        return powers.reshape(TERMS, 81), float(np.abs(block).sum(axis=0).max())
