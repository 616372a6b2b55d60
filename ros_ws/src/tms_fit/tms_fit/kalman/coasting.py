"""Transition of a coasting bicycle over one step, and its derivatives by speed and rolling resistance.

    x' = A(v, v') x + B T,   v' = -C_r g m / m_eff

A is a polynomial, A0 + v A1 + v^2 A2 + K(v'), where K is the stiffness that a changing speed adds
(`tms_model.acceleration`). Over a step of h seconds the Magnus expansion to fourth order gives the exponent

    W = h A + h^3 / 24 A'' - h^3 / 12 [A, A'],   A and its time derivatives at the middle of the step,

and the transition exp W by `tms_model.exponential`: a Taylor series of 16 terms of W / 2^s, with s such that
its 1-norm is at most 1/2. The truncated terms are below 0.5^17 / 17! * 1.03 = 2.2e-20 of the norm there, and
2^s times as much after squaring, far below rounding. The terms beyond the expansion are of the order h^5 v':
below 1e-6 of the transition's norm for every bicycle of the catalogue at h = MAX_STEP_S and C_r = 0.06, 1e-8
for the supplement's, and 2e-6 of the torque's part (a test compares with scipy and with
`tms_model.varying_speed`).

Derivatives are those of this W, by the exponential of [[W, 0], [dW, W]], whose lower left block is the
derivative of exp W along dW (I. Najfeld and T. F. Havel, Adv. Appl. Math. 16 (1995), doi
10.1006/aama.1995.1017).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from tms_model import Bicycle, ParameterError
from tms_model.acceleration import acceleration_stiffness, coasting_loss, parameters_under_acceleration
from tms_model.bicycle import Array
from tms_model.exponential import TERMS
from tms_model.parameters import WhippleParameters
from tms_model.response import first_order

from tms_fit.kalman.transition_cache import speed_polynomial

MAX_STEP_S = 0.01  # [s]; a longer step is divided
MIN_SPEED = 0.1  # [m/s]; a bicycle that slows down to it keeps it
_NODES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])  # of the interpolation of K(v'), in units of its range
_POWERS = np.arange(float(len(_NODES)))
_ORDERS = np.arange(1.0, TERMS + 1.0)[:, None, None]
_RANGES = (0.5, 0.05, 0.005)  # [m/s^2] of v'; the widest is used at which both wheels carry weight


@dataclass(frozen=True, eq=False)
class CoastingStep:
    """Transition of state (4,) and held torque [N m] over a step, and its derivatives."""

    transition: Array  # (5, 5)
    by_speed: Array  # (5, 5), per m/s at the beginning
    by_resistance: Array  # (5, 5), per unit of C_r
    speed: float  # [m/s] at the end
    speed_by_resistance: float  # [m/s] per unit of C_r


class Coasting:
    """Coasting steps of one bicycle."""

    def __init__(self, bicycle: Bicycle) -> None:
        """K(v') of a bicycle given by matrices only is that of its stand-in; without one it is zero."""
        mass, none = bicycle.mass, np.zeros((2, 2))
        self._constant, self._linear, self._square = speed_polynomial(bicycle)  # A0, A1, A2
        zero = first_order(mass, none, none)
        self.loss = coasting_loss(bicycle)  # g m / m_eff [m/s^2]
        self._changing = np.zeros((len(_NODES), 5, 5))  # coefficients of K by powers of v', from v'^0 on
        try:
            parameters, _ = parameters_under_acceleration(bicycle)
        except ParameterError:
            return
        for power, one in enumerate(_stiffness_polynomial(parameters)):
            self._changing[power, :4, :4] = first_order(mass, none, one) - zero

    def matrix(self, speed: float, acceleration: float) -> Array:
        """A(v, v') (5, 5) with the torque as fifth state, at a speed [m/s] and an acceleration [m/s^2]."""
        changing: Array = (acceleration**_POWERS).dot(self._changing.reshape(-1, 25)).reshape(5, 5)
        constant_speed: Array = self._constant + speed * (self._linear + speed * self._square)
        return constant_speed + changing

    def step(self, duration: float, speed: float, resistance: float) -> CoastingStep:
        """Step of a duration [s] from a speed [m/s] on, which falls by C_r = `resistance`."""
        parts = max(1, math.ceil(round(duration / MAX_STEP_S, 6)))
        whole = self._part(duration / parts, speed, resistance)
        for _ in range(1, parts):
            part = self._part(duration / parts, whole.speed, resistance)
            by_resistance = part.by_resistance + whole.speed_by_resistance * part.by_speed
            whole = CoastingStep(
                transition=part.transition @ whole.transition,
                by_speed=part.by_speed @ whole.transition + part.transition @ whole.by_speed,
                by_resistance=by_resistance @ whole.transition + part.transition @ whole.by_resistance,
                speed=part.speed,
                speed_by_resistance=whole.speed_by_resistance + part.speed_by_resistance,
            )
        return whole

    def _part(self, h: float, speed: float, resistance: float) -> CoastingStep:
        """Step of at most MAX_STEP_S."""
        change, loss = -self.loss * resistance, self.loss
        if speed + change * h < MIN_SPEED:
            change = loss = 0.0
        middle = speed + 0.5 * h * change
        at, slope = self.matrix(middle, change), self._linear + 2.0 * middle * self._square
        first, second = change * slope, 2.0 * change**2 * self._square  # A', A''
        exponent = h * at + h**3 / 24.0 * second - h**3 / 12.0 * _commutator(at, first)
        # By v: A changes by the slope, A' by 2 v' A2.
        by_speed = h * slope - h**3 / 12.0 * (
            _commutator(slope, first) + _commutator(at, 2.0 * change * self._square)
        )
        # By v': through the speed at the middle, and by itself.
        slopes = _POWERS[1:] * change ** _POWERS[:-1]
        bent = slopes.dot(self._changing[1:].reshape(-1, 25)).reshape(5, 5)
        at_by, first_by = 0.5 * h * slope + bent, slope + change * h * self._square
        by_change = h * at_by + h**3 / 6.0 * change * self._square
        by_change -= h**3 / 12.0 * (_commutator(at_by, first) + _commutator(at, first_by))
        transition, by_speed, by_resistance = _exponential(exponent, by_speed, -loss * by_change)
        return CoastingStep(transition, by_speed, by_resistance, speed + change * h, -loss * h)


def _exponential(exponent: Array, *directions: Array) -> list[Array]:
    """exp W (k, k) and its derivatives along directions dW: the first columns of the block exponential."""
    size, count = len(exponent), len(directions)
    norm = float(np.abs(exponent).sum(axis=0).max())
    squarings = max(0, math.ceil(math.log2(norm)) + 1) if 0.0 < norm < math.inf else 0
    block = np.zeros(((count + 1) * size, (count + 1) * size))
    for k, direction in enumerate((exponent, *directions)):
        part = slice(k * size, (k + 1) * size)
        block[part, :size] = direction
        block[part, part] = exponent
    one = np.eye(len(block), size)
    # Horner's scheme, as in `tms_model.exponential`, without the leading 1
    factors = block / (2.0**squarings * _ORDERS)
    change = factors[-1, :, :size]
    for factor in factors[-2::-1]:
        change = factor.dot(one + change)
    change, slopes = change[:size], change[size:].reshape(count, size, size)
    for _ in range(squarings):
        slopes = 2.0 * slopes + change @ slopes + slopes @ change
        change = 2.0 * change + change @ change
    return [one[:size] + change, *slopes]


def _stiffness_polynomial(p: WhippleParameters) -> Array:
    """Coefficients (5, 2, 2) of the added stiffness by powers of v'; it is rational and nearly quadratic."""
    for width in _RANGES:
        try:
            values = acceleration_stiffness(p, width * _NODES)
        except ParameterError:
            continue
        powers = np.linalg.solve(np.vander(_NODES, increasing=True), values.reshape(len(_NODES), 4))
        scaled: Array = powers.reshape(-1, 2, 2) / width ** np.arange(len(_NODES))[:, None, None]
        return scaled
    return np.zeros((len(_NODES), 2, 2))


def _commutator(first: Array, second: Array) -> Array:
    """[first, second]."""
    return first @ second - second @ first
