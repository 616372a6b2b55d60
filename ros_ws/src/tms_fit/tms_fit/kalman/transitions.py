"""A disturbed bicycle over one step at constant speed: what a running filter needs for each sample, at once.

    x' = A x + B T + white accelerations of density D,   A = A0 + v A1 + v^2 A2

Transition F, the torque's part and the covariance Q of what disturbs come from one exponential (Van Loan, see
`tms_model.response`),

    exp([[A, D], [0, -A']] h) = [[F, G], [0, F'^-1]],   Q = G F',

a Taylor series in the step h, whose terms are made once for each speed: a step is then one product with
them. A long step is halved until the matrix's norm times h is at most 2, where 24 terms leave out less than
1e-17 of its exponential, and doubled again: F(2 h) = F F, Q(2 h) = Q + F Q F'.
"""

from __future__ import annotations

import math

import numpy as np
from tms_model import Bicycle
from tms_model.bicycle import Array
from tms_model.response import first_order, torque_column

TERMS = 24
LARGEST = 2.0  # norm of what the series is for
KEPT = 1000  # speeds, and steps, that are remembered
_ORDERS = np.arange(1, TERMS + 1)
_STILL = np.eye(4)
_FACTORIALS = np.cumprod(_ORDERS.astype(float))

Step = tuple[Array, Array, Array]  # transition (4, 4), torque's part (4, 1), covariance (4, 4)


def speed_polynomial(bicycle: Bicycle) -> Array:
    """A0, A1 and A2 (3, 5, 5), with the steer torque as fifth state, which is held."""
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
    """The steps of one bicycle, remembered by speed and duration."""

    def __init__(self, bicycle: Bicycle, density: Array) -> None:
        """density: (4, 4) of the white disturbances of the state's derivative, squared units per second."""
        self._polynomial = speed_polynomial(bicycle)
        self._largest = float(np.abs(density).max()) or 1.0
        self._density = density / self._largest
        self._series: dict[float, tuple[Array, float]] = {}
        self._steps: dict[tuple[float, float], Step] = {}

    def at(self, speed: float, step: float) -> Step:
        """Over some seconds at a speed [m/s], to the nanosecond and the millimetre per second."""
        key = (max(round(speed, 3), 1e-3), round(step, 9))
        found = self._steps.get(key)
        if found is None:
            if len(self._steps) >= KEPT:
                self._steps.clear()
            found = self._steps[key] = self._step(*key)
        return found

    def _step(self, speed: float, step: float) -> Step:
        found = self._series.get(speed)
        if found is None:
            if len(self._series) >= KEPT:
                self._series.clear()
            found = self._series[speed] = self._terms(speed)
        terms, norm = found
        doublings = max(0, math.ceil(math.log2(norm * step / LARGEST))) if 0.0 < norm * step < math.inf else 0
        sums = ((step / 2.0**doublings) ** _ORDERS / _FACTORIALS).dot(terms).reshape(9, 9)
        change = sums[:5, :5]  # without the leading 1
        spread = sums[:4, 5:].dot((_STILL + change[:4, :4]).T)
        for _ in range(doublings):
            carried = spread + change[:4, :4].dot(spread)
            spread = spread + carried + carried.dot(change[:4, :4].T)
            change = 2.0 * change + change.dot(change)
        process = (0.5 * self._largest) * (spread + spread.T)
        return _STILL + change[:4, :4], change[:4, 4:].copy(), process

    def _terms(self, speed: float) -> tuple[Array, float]:
        """Powers of the matrix, from the first on, each in a row (24, 81), and its 1-norm."""
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
