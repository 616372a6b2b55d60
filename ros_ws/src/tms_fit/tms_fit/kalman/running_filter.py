"""Kalman filter that runs along with the measurement: state, innovation and NIS after every sample.

Unlike the estimator `kalman_rts`, which knows that nothing disturbs the bicycle after a strike, this one
allows for disturbances (white torques about both axes), so that it can follow a real bicycle. The speed is
given; `tms_fit.kalman.extended_filter` estimates it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from tms_model import Bicycle, discretise, linear_system
from tms_model.bicycle import Array
from tms_model.response import LEAN, LEAN_RATE, STEER, yaw_row

FIRST_STD = (0.1, 0.1, 1.0, 2.0)  # [rad, rad, rad/s, rad/s], of the state at the first sample
STRIKE_STD = (0.02, 0.02, 2.0, 5.0)  # the same where a strike begins: upright, but of unknown rates
ACCELERATION_NOISE = (0.3, 3.0)  # [rad/s^2/sqrt(Hz)], white disturbances of lean and steer acceleration
LONGEST_GAP = 0.5  # [s]; after a longer one the filter starts anew


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
        self._transitions: dict[tuple[float, float], tuple[Array, Array, Array]] = {}
        self._turn = float(yaw_row(bicycle, 1.0)[STEER])  # yaw rate per steer and speed [1/m]

    def restart(self, strike: bool) -> None:
        """Forget the state; the next sample is the first one, after a strike or without one."""
        self._time_ns = None
        self._strike = strike

    def step(
        self,
        time_ns: int,
        angular_velocity: Array,
        variance: Array,
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
        return KalmanFilter(dim_x=4, dim_z=2, dim_u=1)

    def _begin(self, time_ns: int, speed: float) -> None:
        std = STRIKE_STD if self._strike else FIRST_STD
        self._kalman.x, self._kalman.P = np.zeros((4, 1)), np.diag(std) ** 2

    def _predict(self, step: float, speed: float, steer_torque: float) -> None:
        phi, gamma, process = self._transition(speed, step)
        self._kalman.predict(u=np.array([[steer_torque]]), B=gamma, F=phi, Q=process)

    def _transition(self, speed: float, step: float) -> tuple[Array, Array, Array]:
        key = (round(speed, 3), round(step, 9))  # speed to the millimetre per second, so that steps repeat
        if key not in self._transitions:
            if len(self._transitions) > 1000:
                self._transitions.clear()
            phi, gamma = discretise(linear_system(self._bicycle, max(key[0], 1e-3)), key[1])
            density = np.diag([0.0, 0.0, *np.square(ACCELERATION_NOISE)])
            process = 0.5 * step * (density + phi @ density @ phi.T)  # trapezoidal rule over the step
            self._transitions[key] = phi, gamma.reshape(4, 1), process
        return self._transitions[key]

    def _update(
        self,
        time_ns: int,
        angular_velocity: Array,
        variance: Array,
        speed: float,
        speed_ns: int | None,
        reset: bool,
    ) -> FilterStep:
        kalman = self._kalman
        measured, noise, good = self._rates(angular_velocity, variance)
        self._rows[1, STEER] = speed * self._turn
        if good.all():
            kalman.update(measured, R=noise, H=self._rows)
        elif good.any():
            kalman.update(measured[good], R=noise[np.ix_(good, good)], H=self._rows[good])
        return self._step(time_ns, good, speed, reset)

    def _rates(self, angular_velocity: Array, variance: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Lean rate and yaw rate (2, 1), their noise (2, 2), and which of them were measured (2,).

        As `tms_model.imu.lean_and_yaw_rate`, for one sample, with the lean that the filter predicts.
        """
        w_x, w_y, w_z = angular_velocity.tolist()
        lean = self._kalman.x[LEAN, 0]
        level = w_z / np.cos(lean) if math.isnan(w_y) else w_y * np.sin(lean) + w_z * np.cos(lean)
        var_x, _, var_z = variance.tolist()
        noise = np.zeros((2, 2))
        noise[0, 0] = var_x if math.isfinite(var_x) else self._variance
        noise[1, 1] = var_z if math.isfinite(var_z) else self._variance
        measured = np.array([[w_x], [level]])
        return measured, noise, np.isfinite(measured[:, 0])

    def _step(self, time_ns: int, good: NDArray[np.bool_], speed: float, reset: bool) -> FilterStep:
        """What the filter says after the update with the good ones of both rates."""
        kalman, count = self._kalman, int(np.count_nonzero(good))
        nis = float((kalman.y.T @ kalman.SI @ kalman.y).item()) if count else float("nan")
        if count == 2:
            innovation, spread = kalman.y[:, 0].copy(), kalman.S.copy()
        else:
            innovation, spread = np.full(2, np.nan), np.full((2, 2), np.nan)
        if count == 1:
            innovation[good] = kalman.y[:, 0]
            spread[np.ix_(good, good)] = kalman.S
        return FilterStep(
            time_ns=time_ns,
            state=kalman.x[:4, 0].copy(),
            covariance=kalman.P[:4, :4].copy(),
            innovation=innovation,
            innovation_covariance=spread,
            nis=nis,
            channel_count=count,
            reset=reset,
            speed=speed,
        )
