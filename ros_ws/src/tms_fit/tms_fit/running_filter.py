"""Kalman filter that runs along with the measurement: state, innovation and NIS after every sample.

Unlike the estimator `kalman_rts`, which knows that nothing disturbs the bicycle after a strike, this one
allows for disturbances (white torques about both axes), so that it can follow a real bicycle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter
from tms_model import Bicycle, discretise, linear_system
from tms_model.bicycle import Array
from tms_model.imu import lean_and_yaw_rate
from tms_model.response import LEAN, LEAN_RATE, yaw_row

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


class RunningFilter:
    """filterpy's Kalman filter on lean rate and yaw rate, with the speed and steer torque of each step."""

    def __init__(self, bicycle: Bicycle, noise: float) -> None:
        self._bicycle = bicycle
        self._noise = noise  # [rad/s], where a sample states none
        self._kalman = KalmanFilter(dim_x=4, dim_z=2, dim_u=1)
        self._time_ns: int | None = None
        self._first_std = FIRST_STD
        self._transitions: dict[tuple[float, float], tuple[Array, Array, Array]] = {}

    def restart(self, strike: bool) -> None:
        """Forget the state; the next sample is the first one, after a strike or without one."""
        self._time_ns = None
        self._first_std = STRIKE_STD if strike else FIRST_STD

    def step(
        self, time_ns: int, angular_velocity: Array, variance: Array, speed: float, steer_torque: float
    ) -> FilterStep:
        """Use one sample: gyroscopes (3,) [rad/s] in SAE axes of the rear frame.

        variance: (3,) of the gyroscopes, NaN: unknown. speed [m/s] positive; steer_torque [N m] since the
        last sample, 0 when none is known.
        """
        if self._time_ns is not None and (time_ns - self._time_ns) > LONGEST_GAP * 1e9:
            self.restart(strike=False)
        reset = self._time_ns is None
        if self._time_ns is None:
            self._kalman.x, self._kalman.P = np.zeros((4, 1)), np.diag(self._first_std) ** 2
        else:
            phi, gamma, process = self._transition(speed, (time_ns - self._time_ns) / 1e9)
            self._kalman.predict(u=np.array([[steer_torque]]), B=gamma, F=phi, Q=process)
        self._time_ns = time_ns
        return self._update(time_ns, angular_velocity, variance, speed, reset)

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
        self, time_ns: int, angular_velocity: Array, variance: Array, speed: float, reset: bool
    ) -> FilterStep:
        kalman = self._kalman
        lean_rate, yaw_rate = lean_and_yaw_rate(angular_velocity[None, :], kalman.x[LEAN])
        measured = np.array([lean_rate[0], yaw_rate[0]])
        rows = np.zeros((2, 4))
        rows[0, LEAN_RATE] = 1.0
        rows[1] = yaw_row(self._bicycle, speed)
        noise = np.diag(np.where(np.isfinite(variance[[0, 2]]), variance[[0, 2]], self._noise**2))
        good = np.isfinite(measured)
        innovation, spread, nis = np.full(2, np.nan), np.full((2, 2), np.nan), float("nan")
        if good.any():
            kalman.update(measured[good].reshape(-1, 1), R=noise[np.ix_(good, good)], H=rows[good])
            innovation[good] = kalman.y[:, 0]
            spread[np.ix_(good, good)] = kalman.S
            nis = float((kalman.y.T @ kalman.SI @ kalman.y).item())
        return FilterStep(
            time_ns,
            kalman.x[:, 0].copy(),
            kalman.P.copy(),
            innovation,
            spread,
            nis,
            int(good.sum()),
            reset,
            speed,
        )
