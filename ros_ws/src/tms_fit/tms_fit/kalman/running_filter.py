"""Kalman filter that runs along with the measurement: state, innovation and NIS after every sample.

Unlike the estimator `kalman_rts`, which knows that nothing disturbs the bicycle after a strike, this one
allows for disturbances (white torques about both axes), so that it can follow a real bicycle. The speed is
given; `tms_fit.kalman.extended_filter` estimates it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from filterpy.kalman import KalmanFilter
from tms_model import Bicycle
from tms_model.bicycle import Array
from tms_model.response import LEAN, LEAN_RATE, STEER, yaw_row

from tms_fit.kalman.transitions import TransitionCache

FIRST_STD = (0.1, 0.1, 1.0, 2.0)  # [rad, rad, rad/s, rad/s], of the state at the first sample
STRIKE_STD = (0.02, 0.02, 2.0, 5.0)  # the same where a strike begins: upright, but of unknown rates
ACCELERATION_NOISE = (0.3, 3.0)  # [rad/s^2/sqrt(Hz)], white disturbances of lean and steer acceleration
Good: TypeAlias = tuple[bool, bool]  # whether lean rate and yaw rate were measured
LONGEST_GAP = 0.5  # [s]; after a longer one the filter starts anew
_ABSENT, _ABSENT_SPREAD = np.full(2, np.nan), np.full((2, 2), np.nan)
_ABSENT.flags.writeable = _ABSENT_SPREAD.flags.writeable = False


@dataclass(frozen=True, eq=False)
class FilterStep:
    """The filter after one sample; NaN where a channel was absent."""

    time_ns: int
    state: Array  # (4,) lean, steer, lean rate, steer rate
    covariance: Array  # (4, 4)
    innovation: Array  # (2,) [rad/s] lean rate, yaw rate
    innovation_covariance: Array  # (2, 2)
    nis: float
    channel_count: int
    reset: bool
    speed: float  # [m/s]
    slow: Array | None = None  # (4,) what else the extended filter estimates, see there
    slow_covariance: Array | None = None  # (4, 4)


class RunningFilter:
    """filterpy's Kalman filter on lean rate and yaw rate, with the speed and steer torque of each step."""

    def __init__(self, bicycle: Bicycle, noise: float) -> None:
        """noise [rad/s]: standard deviation of a reading where a sample states none."""
        self._bicycle = bicycle
        self._variance = noise**2
        self._kalman = self._new_filter()
        self._time_ns: int | None = None
        self._strike = False  # the next sample is the first after a strike
        self._transitions = TransitionCache(bicycle, np.diag([0.0, 0.0, *np.square(ACCELERATION_NOISE)]))
        self._noise: dict[tuple[float, float], Array] = {}
        self._turn = float(yaw_row(bicycle, 1.0)[STEER])  # yaw rate per steer and speed [1/m]

    def restart(self, strike: bool) -> None:
        """Forget the state; the next sample is the first one, after a strike or without one."""
        self._time_ns = None
        self._strike = strike

    def step(
        self,
        time_ns: int,
        angular_velocity: Sequence[float] | Array,
        variance: Sequence[float] | Array,
        speed: float,
        steer_torque: float,
        speed_ns: int | None = None,
    ) -> FilterStep:
        """Use one sample: gyroscopes (3,) [rad/s] in SAE axes of the rear frame; NaN is not used.

        variance: (3,) of the gyroscopes, NaN: unknown. speed [m/s] positive, measured at speed_ns (None: not
        measured but stated); steer_torque [N m] since the last sample, 0 when none is known.
        """
        if self._time_ns is not None and (time_ns - self._time_ns) > LONGEST_GAP * 1e9:
            self.restart(strike=False)
        reset = self._time_ns is None
        if self._time_ns is None:
            self._begin(time_ns, speed)
        else:
            self._predict((time_ns - self._time_ns) / 1e9, speed, steer_torque)
        self._time_ns = time_ns
        return self._update(time_ns, angular_velocity, variance, speed, speed_ns, reset)

    def _new_filter(self) -> Any:
        """The filter's arithmetic, and what of it never changes."""
        self._rows = np.zeros((2, 4))
        self._rows[0, LEAN_RATE] = 1.0
        self._rows[1] = yaw_row(self._bicycle, 0.0)
        kalman = KalmanFilter(dim_x=4, dim_z=2, dim_u=1)
        kalman.inv = _inverse
        return kalman

    def _begin(self, time_ns: int, speed: float) -> None:
        std = STRIKE_STD if self._strike else FIRST_STD
        self._kalman.x, self._kalman.P = np.zeros((4, 1)), np.diag(std) ** 2

    def _predict(self, step: float, speed: float, steer_torque: float) -> None:
        kalman = self._kalman
        kalman.F, kalman.B, kalman.Q = self._transitions.at(speed, step)
        kalman.predict(np.array([[steer_torque]]) if steer_torque else None)

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
        measured, noise, good = self._rates(angular_velocity, variance)
        self._rows[1, STEER] = speed * self._turn
        if all(good):
            kalman.R = noise
            kalman.update(measured, H=self._rows)
        elif any(good):
            rows = np.array(good)
            kalman.update(measured[rows], R=noise[np.ix_(rows, rows)], H=self._rows[rows])
        return self._step(time_ns, good, speed, reset)

    def _rates(
        self, angular_velocity: Sequence[float] | Array, variance: Sequence[float] | Array
    ) -> tuple[Array, Array, Good]:
        """Lean rate and yaw rate (2, 1), their noise (2, 2), and which of them were measured.

        As `tms_model.imu.lean_and_yaw_rate`, for one sample, with the lean that the filter predicts.
        """
        w_x, w_y, w_z = angular_velocity
        lean = self._kalman.x.item(LEAN)
        if not math.isfinite(lean):
            lean = math.nan
        level = w_z / math.cos(lean) if math.isnan(w_y) else w_y * math.sin(lean) + w_z * math.cos(lean)
        var_x, _, var_z = variance
        good = math.isfinite(w_x), math.isfinite(level)
        return np.array(((w_x,), (level,))), self._noise_of(float(var_x), float(var_z)), good

    def _noise_of(self, first: float, second: float) -> Array:
        """Covariance (2, 2) of a reading that states these variances, NaN: none."""
        first = first if math.isfinite(first) else self._variance
        second = second if math.isfinite(second) else self._variance
        noise = self._noise.get((first, second))
        if noise is None:
            if len(self._noise) > 1000:
                self._noise.clear()
            noise = self._noise[first, second] = np.diag((first, second))
        return noise

    def _step(self, time_ns: int, good: Good, speed: float, reset: bool) -> FilterStep:
        """What the filter says after the update with the good ones of both rates."""
        kalman = self._kalman
        nis, innovation, spread = math.nan, _ABSENT, _ABSENT_SPREAD
        if all(good):
            innovation, spread = kalman.y[:, 0], kalman.S
            first, second = innovation.tolist()
            (a, b), (c, d) = kalman.SI.tolist()
            nis = first * (a * first + b * second) + second * (c * first + d * second)
        elif any(good):
            rows = np.array(good)
            innovation, spread = innovation.copy(), spread.copy()
            innovation[rows], spread[np.ix_(rows, rows)] = kalman.y[:, 0], kalman.S
            nis = float((kalman.y.T @ kalman.SI @ kalman.y).item())
        return FilterStep(
            time_ns=time_ns,
            state=kalman.x[:4, 0].copy(),
            covariance=kalman.P[:4, :4].copy(),
            innovation=innovation,
            innovation_covariance=spread,
            nis=nis,
            channel_count=sum(good),
            reset=reset,
            speed=speed,
        )


def _inverse(matrix: Array) -> Array:
    """Inverse of a covariance (2, 2) in closed form; of any other, and a hardly regular one, numpy's."""
    if matrix.shape == (2, 2):
        (a, b), (c, d) = matrix.tolist()
        determinant = a * d - b * c
        if 1e-300 < determinant < 1e300:
            return np.array(((d / determinant, -b / determinant), (-c / determinant, a / determinant)))
    return np.asarray(np.linalg.inv(matrix))
