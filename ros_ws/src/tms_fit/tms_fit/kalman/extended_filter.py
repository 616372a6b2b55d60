"""Extended Kalman filter that runs along with the measurement and estimates speed and rolling resistance too.

To the state of the bicycle come four slow ones (SLOW): the gyroscopes' biases, the speed and C_r. The
bicycle coasts, v' = -C_r g m / m_eff (`tms_fit.kalman.coasting`); all slow states wander a little
(`ProcessNoise`).
Lean rate and yaw rate are measured, and the speed wherever somebody measures it: a speed that is only
stated is no more than a first guess.

A strike changes lean, steer and their rates, but not the slow states. It is known some time after it fell;
the filter then goes on from what it knew of the slow states before it.

An extended filter linearises about its own estimate, so that what it takes for a speed must be larger than
what disturbs the bicycle. With disturbances as large as the linear filter allows for and no measured speed
it would be up to one and a half times too sure; and where it expects much larger disturbances than there
are, its speed is biased (L. Ljung, IEEE TAC 24 (1979), doi 10.1109/TAC.1979.1101943). Hence the smaller
ones here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from tms_model import Bicycle
from tms_model.bicycle import Array
from tms_model.response import LEAN_RATE, STEER, yaw_row

from tms_fit.kalman.coasting import Coasting
from tms_fit.kalman.running_filter import FIRST_STD, STRIKE_STD, FilterStep, RunningFilter
from tms_fit.kalman.transitions import TransitionCache

SLOW = ("lean_rate_bias", "yaw_rate_bias", "speed", "rolling_resistance")  # [rad/s], [rad/s], [m/s], [-]
BIAS, SPEED, RESISTANCE, SIZE = slice(4, 6), 6, 7, 8
REMEMBERED = 3_000_000_000  # [ns]; a strike is known by then


@dataclass(frozen=True)
class InitialState:
    """What is known of the states at the first sample; standard deviations."""

    state_std: tuple[float, float, float, float] = FIRST_STD
    strike_std: tuple[float, float, float, float] = STRIKE_STD
    bias_std: float = 0.02  # [rad/s]
    speed_share: float = 0.1  # of the speed that is stated
    rolling_resistance: float = 0.03  # C_r, between a treadmill's and that of soft rubber
    rolling_resistance_std: float = 0.03


@dataclass(frozen=True)
class ProcessNoise:
    """Disturbances by white noise, and the noise of a measured speed."""

    # A tenth of what the linear filter allows for: see the module.
    acceleration: tuple[float, float] = (0.03, 0.3)  # [rad/s^2/sqrt(Hz)] of lean and steer
    bias: float = 1e-4  # [rad/s/sqrt(s)]
    speed: float = 0.01  # [m/s/sqrt(s)]
    rolling_resistance: float = 1e-3  # [1/sqrt(s)]
    measured_speed: float = 0.02  # [m/s]


class ExtendedFilter(RunningFilter):
    """filterpy's extended Kalman filter; to be used as the RunningFilter."""

    def __init__(
        self,
        bicycle: Bicycle,
        noise: float,
        first: InitialState | None = None,
        wandering: ProcessNoise | None = None,
    ) -> None:
        """noise [rad/s]: standard deviation of a reading where a sample states none."""
        super().__init__(bicycle, noise)
        self._first, self._wandering = first or InitialState(), wandering or ProcessNoise()
        self._coasting = Coasting(bicycle)
        self._speed_ns: int | None = None  # stamp of the last speed used
        self._past: deque[tuple[int, int | None, Array, Array]] = deque()
        w = self._wandering
        self._transitions = TransitionCache(bicycle, np.diag(np.square([0.0, 0.0, *w.acceleration])))
        slow = (w.bias, w.bias, w.speed, w.rolling_resistance)
        self._density = np.diag(np.square([0.0] * 4 + [*slow]))

    def _new_filter(self) -> Any:
        self._rows = np.zeros((2, SIZE))
        self._rows[0, LEAN_RATE] = self._rows[0, 4] = self._rows[1, 5] = 1.0
        self._rows[1, :4] = yaw_row(self._bicycle, 0.0)
        return _Coaster(dim_x=SIZE, dim_z=2)

    def _begin(self, time_ns: int, speed: float) -> None:
        first, kalman = self._first, self._kalman
        std = first.strike_std if self._strike else first.state_std
        spread = (first.bias_std, first.bias_std, first.speed_share * speed, first.rolling_resistance_std)
        kalman.x = np.zeros((SIZE, 1))
        kalman.x[SPEED], kalman.x[RESISTANCE] = speed, first.rolling_resistance
        kalman.P = np.diag(np.square([*std, *spread]))
        self._speed_ns = None
        while self._past and self._past[-1][0] >= time_ns:
            self._past.pop()
        if self._past and self._strike:
            self._go_on(time_ns)
        else:
            self._past.clear()

    def _go_on(self, time_ns: int) -> None:
        """Take over what was known of the slow states at the last sample before this."""
        past_ns, self._speed_ns, slow, covariance = self._past[-1]
        step = (time_ns - past_ns) / 1e9
        lost = self._coasting.step(step, slow[2, 0], slow[3, 0])
        transition = np.eye(4)
        transition[2, 3] = lost.speed_by_resistance
        self._kalman.x[4:] = slow
        self._kalman.x[SPEED] = lost.speed
        spread = transition @ covariance @ transition.T + step * self._density[4:, 4:]
        self._kalman.P[4:, 4:] = spread

    def _predict(self, step: float, speed: float, steer_torque: float) -> None:
        kalman = self._kalman
        speed_before = kalman.x.item(SPEED)
        taken = self._coasting.step(step, speed_before, kalman.x.item(RESISTANCE))
        before = np.append(kalman.x[:4, 0], steer_torque)
        kalman.predicted = kalman.x.copy()
        kalman.predicted[:4, 0] = taken.transition[:4] @ before
        kalman.predicted[SPEED] = taken.speed
        jacobian = np.eye(SIZE)
        jacobian[:4, :4] = taken.transition[:4, :4]
        jacobian[:4, SPEED] = taken.by_speed[:4] @ before
        jacobian[:4, RESISTANCE] = taken.by_resistance[:4] @ before
        jacobian[SPEED, RESISTANCE] = taken.speed_by_resistance
        kalman.F = jacobian
        # Accelerations exactly, at the speed of the middle; the slow states by the trapezoidal rule, of which
        # theirs is exact and what they pass on to the bicycle is of the second order in the step.
        process = 0.5 * step * (self._density + jacobian.dot(self._density).dot(jacobian.T))
        process[:4, :4] += self._transitions.at(0.5 * (speed_before + taken.speed), step)[2]
        kalman.Q = process
        kalman.predict()

    def _update(
        self,
        time_ns: int,
        angular_velocity: Sequence[float] | Array,
        variance: Sequence[float] | Array,
        speed: float,
        speed_ns: int | None,
        reset: bool,
    ) -> FilterStep:
        kalman = self._kalman
        if speed_ns is not None and (self._speed_ns is None or speed_ns > self._speed_ns):
            self._use_speed(speed, (time_ns - speed_ns) / 1e9)
            self._speed_ns = speed_ns
        measured, noise, good = self._rates(angular_velocity, variance)
        if any(good):
            rows = slice(None) if all(good) else np.flatnonzero(good)
            kalman.update(
                measured[rows],
                HJacobian=lambda x: self.measurement_jacobian(x)[rows],
                Hx=lambda x: self.measurement(x)[rows],
                R=noise[rows][:, rows],
            )
        self._remember(time_ns)
        return replace(
            self._step(time_ns, good, float(kalman.x[SPEED, 0]), reset),
            slow=kalman.x[4:, 0].copy(),
            slow_covariance=kalman.P[4:, 4:].copy(),
        )

    def measurement(self, state: Array) -> Array:
        """Lean rate and yaw rate (2, 1) that the gyroscopes show in a state (8, 1)."""
        lean_rate = state[LEAN_RATE] + state[4]
        yaw_rate = self._rows[1, :4] @ state[:4] + (self._turn * state[SPEED] * state[STEER]) + state[5]
        return np.array([lean_rate, yaw_rate])

    def measurement_jacobian(self, state: Array) -> Array:
        """Its derivative by the state (2, 8)."""
        rows = self._rows.copy()
        rows[1, STEER] = self._turn * state[SPEED, 0]
        rows[1, SPEED] = self._turn * state[STEER, 0]
        return rows

    def _use_speed(self, speed: float, age: float) -> None:
        """Use a speed [m/s] that was measured `age` [s] before this sample, and was then still higher."""
        row = np.zeros((1, SIZE))
        row[0, SPEED], row[0, RESISTANCE] = 1.0, self._coasting.loss * age
        self._kalman.update(
            np.array([[speed]]),
            HJacobian=lambda x: row,
            Hx=lambda x: row @ x,
            R=np.array([[self._wandering.measured_speed**2]]),
        )

    def _remember(self, time_ns: int) -> None:
        kalman = self._kalman
        self._past.append((time_ns, self._speed_ns, kalman.x[4:].copy(), kalman.P[4:, 4:].copy()))
        while self._past[0][0] < time_ns - REMEMBERED:
            self._past.popleft()


class _Coaster(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy has no types
    """filterpy's filter, with the state that the coasting bicycle comes to in place of F x + B u."""

    predicted: Array

    def predict_x(self, u: object = 0) -> None:
        """Take what was predicted, (8, 1)."""
        self.x = self.predicted
