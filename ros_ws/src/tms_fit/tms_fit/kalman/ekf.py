"""Extended Kalman filter of the bicycle's state, with optional parameter states.

    x' = A(v, v') x + B T + w        lean, steer and their rates; w: white accelerations
    v' = -C_r g m / m_eff + w_v      a coasting bicycle; C_r and the biases b are random walks
    y  = H(v) x + b + n              lean rate and yaw rate

x: state, T: steer torque [N m], v: speed [m/s], C_r: rolling resistance, y: gyroscopes. Without parameter
states v is given and b = 0: the filter is then linear, and its transition that of a constant speed
(`tms_fit.kalman.transition_cache`). With parameter states b, v and C_r are estimated as well, and the
transition is that of a coasting bicycle (`tms_fit.kalman.coasting`); a measured speed is a third channel, a
stated one an initial value.

A strike changes lean, steer and their rates, but not the parameters. It is detected some time after it fell:
the filter is then started again at the strike, with the parameters as estimated just before.

An extended filter linearises about its own estimate. With process noise as large as at a given speed and
without a measured speed its standard deviations would be up to one and a half times too small, and its
speed is biased where it allows for much larger disturbances than there are (L. Ljung, IEEE Trans. Automatic
Control 24 (1979), doi 10.1109/TAC.1979.1101943). Hence the smaller accelerations with parameter states.

The estimator `kalman_rts` assumes that nothing disturbs the bicycle after a strike; this filter follows a
real bicycle.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from tms_model import Bicycle
from tms_model.bicycle import Array
from tms_model.response import LEAN, LEAN_RATE, STEER, yaw_row

from tms_fit.kalman.coasting import Coasting
from tms_fit.kalman.recursion import kalman_filter, update
from tms_fit.kalman.transition_cache import TransitionCache
from tms_fit.settings import Settings

PARAMETER_STATES = ("lean_rate_bias", "yaw_rate_bias", "speed", "rolling_resistance")
PARAMETERS, SPEED, ROLLING_RESISTANCE = slice(4, 8), 6, 7  # where they stand in the state
MAX_GAP_S = 0.5  # [s] between two samples; the filter starts again after a longer one
MAX_STRIKE_DELAY_NS = 3_000_000_000  # [ns] between a strike and its detection
NOISE_CACHE_SIZE = 1000  # measurement covariances
_NO_INNOVATION, _NO_COVARIANCE = np.full(2, np.nan), np.full((2, 2), np.nan)
_NO_INNOVATION.flags.writeable = _NO_COVARIANCE.flags.writeable = False


@dataclass(frozen=True)
class InitialState:
    """Mean and standard deviations of the state at the first sample; means that are not here are zero."""

    state_std: tuple[float, float, float, float] = (0.1, 0.1, 1.0, 2.0)  # [rad, rad, rad/s, rad/s]
    strike_std: tuple[float, float, float, float] = (0.02, 0.02, 2.0, 5.0)  # after a strike: upright
    bias_std: float = 0.02  # [rad/s]
    relative_speed_std: float = 0.1  # per stated speed, which is the mean
    rolling_resistance: float = 0.03  # C_r [-], between a treadmill's and that of soft rubber
    rolling_resistance_std: float = 0.03


@dataclass(frozen=True)
class ProcessNoise:
    """Densities of the white process noise, and the noise of a measured speed."""

    acceleration: tuple[float, float] = (0.03, 0.3)  # [rad/s^2/sqrt(Hz)] of lean and steer
    bias: float = 1e-4  # [rad/s/sqrt(s)]
    speed: float = 0.01  # [m/s/sqrt(s)]
    rolling_resistance: float = 1e-3  # [1/sqrt(s)]
    measured_speed: float = 0.02  # [m/s]


GIVEN_SPEED_NOISE = ProcessNoise(acceleration=(0.3, 3.0))  # without parameter states


@dataclass(frozen=True, eq=False)
class FilterStep:
    """State, innovation and NIS after one sample; NaN where a channel is missing."""

    time_ns: int
    state: Array  # (4,) lean, steer, lean rate, steer rate [rad, rad/s]
    covariance: Array  # (4, 4)
    innovation: Array  # (2,) [rad/s] lean rate, yaw rate
    innovation_covariance: Array  # (2, 2)
    nis: float  # normalised innovation squared
    channel_count: int
    reset: bool
    speed: float  # [m/s], given or estimated
    parameters: Array | None = None  # (4,) as PARAMETER_STATES [rad/s, rad/s, m/s, -]
    parameter_covariance: Array | None = None  # (4, 4)


class _Parameters(NamedTuple):
    """Parameter states after one sample."""

    time_ns: int
    speed_ns: int | None  # stamp of the last measured speed
    mean: Array  # (4, 1)
    covariance: Array  # (4, 4)


class ExtendedKalmanFilter:
    """Filter of lean rate and yaw rate, one sample at a time."""

    def __init__(
        self,
        bicycle: Bicycle,
        noise_std: float,
        parameter_states: bool = False,
        initial: InitialState | None = None,
        process: ProcessNoise | None = None,
    ) -> None:
        """A filter before its first sample.

        noise_std [rad/s]: standard deviation of a gyroscope whose samples state no variance.
        parameter_states: whether PARAMETER_STATES are estimated. initial: default `InitialState()`. process:
        default `ProcessNoise()`, without parameter states GIVEN_SPEED_NOISE.
        """
        self._variance = noise_std**2
        self._initial = initial or InitialState()
        self._process = process or (ProcessNoise() if parameter_states else GIVEN_SPEED_NOISE)
        accelerations = np.diag(np.square([0.0, 0.0, *self._process.acceleration]))
        self._transitions = TransitionCache(bicycle, accelerations)
        self._coasting = Coasting(bicycle) if parameter_states else None
        p = self._process
        self._density = np.diag(np.square([*4 * [0.0], p.bias, p.bias, p.speed, p.rolling_resistance]))
        size = 8 if parameter_states else 4
        self._kalman = kalman_filter(size)
        self._rows = np.zeros((2, size))  # H at a speed of zero
        self._rows[0, LEAN_RATE] = 1.0
        self._rows[1, :4] = yaw_row(bicycle, 0.0)
        if parameter_states:
            self._rows[:, 4:6] = np.eye(2)  # biases
        self._yaw_gain = float(yaw_row(bicycle, 1.0)[STEER])  # [1/m], yaw rate per steer and speed
        self._noise: dict[tuple[float, float], Array] = {}
        self._time_ns: int | None = None
        self._after_strike = False
        self._speed_ns: int | None = None
        self._history: deque[_Parameters] = deque()

    def restart(self, strike: bool) -> None:
        """Start again with the next sample, which is the first after a strike or not."""
        self._time_ns = None
        self._after_strike = strike

    def step(
        self,
        time_ns: int,
        angular_velocity: Sequence[float] | Array,
        variance: Sequence[float] | Array,
        speed: float,
        steer_torque: float,
        speed_ns: int | None = None,
    ) -> FilterStep:
        """Predict to a sample and update with it.

        angular_velocity: gyroscopes (3,) [rad/s] in SAE axes of the rear frame, NaN: missing. variance: (3,)
        of them, NaN: unknown. speed [m/s]: positive, measured at `speed_ns`, None: stated only. steer_torque
        [N m]: since the last sample, 0 where unknown.
        """
        if self._time_ns is not None and time_ns - self._time_ns > MAX_GAP_S * 1e9:
            self.restart(strike=False)
        reset = self._time_ns is None
        if self._time_ns is None:
            self._initialize(time_ns, speed)
        elif self._coasting is None:
            self._predict((time_ns - self._time_ns) / 1e9, speed, steer_torque)
        else:
            self._predict_coasting(self._coasting, (time_ns - self._time_ns) / 1e9, steer_torque)
        self._time_ns = time_ns
        if self._coasting is not None and speed_ns is not None:
            self._update_speed(self._coasting, speed, time_ns, speed_ns)
        present = self._update_rates(angular_velocity, variance, speed)
        result = self._result(time_ns, present, speed, reset)
        return result if self._coasting is None else self._with_parameters(result)

    def measurement(self, state: Array) -> Array:
        """h(x): lean rate and yaw rate (2, 1) [rad/s] that the gyroscopes measure in a state (8, 1)."""
        lean_rate = state[LEAN_RATE] + state[4]
        yaw_rate = self._rows[1, :4] @ state[:4] + self._yaw_gain * state[SPEED] * state[STEER] + state[5]
        return np.array([lean_rate, yaw_rate])

    def measurement_jacobian(self, state: Array) -> Array:
        """Derivative (2, 8) of h(x) by the state (8, 1)."""
        rows = self._rows.copy()
        rows[1, STEER] = self._yaw_gain * state[SPEED, 0]
        rows[1, SPEED] = self._yaw_gain * state[STEER, 0]
        return rows

    def _initialize(self, time_ns: int, speed: float) -> None:
        """Set mean and covariance at the first sample."""
        initial, kalman = self._initial, self._kalman
        std = initial.strike_std if self._after_strike else initial.state_std
        if self._coasting is None:
            kalman.x, kalman.P = np.zeros((4, 1)), np.diag(std) ** 2
            return
        speed_std, bias_std = initial.relative_speed_std * speed, initial.bias_std
        kalman.x = np.zeros((8, 1))
        kalman.x[SPEED], kalman.x[ROLLING_RESISTANCE] = speed, initial.rolling_resistance
        kalman.P = np.diag(np.square([*std, bias_std, bias_std, speed_std, initial.rolling_resistance_std]))
        self._speed_ns = None
        while self._history and self._history[-1].time_ns >= time_ns:
            self._history.pop()
        if self._history and self._after_strike:
            self._keep_parameters(self._coasting, time_ns)
        else:
            self._history.clear()

    def _keep_parameters(self, coasting: Coasting, time_ns: int) -> None:
        """Predict the parameters from the last sample before a strike to the first after it."""
        before = self._history[-1]
        duration = (time_ns - before.time_ns) / 1e9
        coasted = coasting.step(duration, before.mean[2, 0], before.mean[3, 0])
        transition = np.eye(4)
        transition[2, 3] = coasted.speed_by_resistance
        covariance = transition @ before.covariance @ transition.T
        self._speed_ns = before.speed_ns
        self._kalman.x[PARAMETERS] = before.mean
        self._kalman.x[SPEED] = coasted.speed
        self._kalman.P[PARAMETERS, PARAMETERS] = covariance + duration * self._density[PARAMETERS, PARAMETERS]

    def _predict(self, duration: float, speed: float, steer_torque: float) -> None:
        """Predict over some seconds at a given speed."""
        kalman = self._kalman
        kalman.F, kalman.B, kalman.Q = self._transitions.at(speed, duration)
        kalman.predict(np.array([[steer_torque]]) if steer_torque else None)

    def _predict_coasting(self, coasting: Coasting, duration: float, steer_torque: float) -> None:
        """Predict over some seconds while the speed falls by rolling resistance."""
        kalman = self._kalman
        speed, resistance = kalman.x.item(SPEED), kalman.x.item(ROLLING_RESISTANCE)
        step = coasting.step(duration, speed, resistance)
        before = np.append(kalman.x[:4, 0], steer_torque)
        predicted = kalman.x.copy()
        predicted[:4, 0] = step.transition[:4] @ before
        predicted[SPEED] = step.speed
        jacobian = np.eye(8)
        jacobian[:4, :4] = step.transition[:4, :4]
        jacobian[:4, SPEED] = step.by_speed[:4] @ before
        jacobian[:4, ROLLING_RESISTANCE] = step.by_resistance[:4] @ before
        jacobian[SPEED, ROLLING_RESISTANCE] = step.speed_by_resistance
        # Accelerations: exact at the speed of the middle. Parameters: trapezoidal rule, exact for their own
        # covariance and of second order in the step for what they pass on to the bicycle.
        process = 0.5 * duration * (self._density + jacobian.dot(self._density).dot(jacobian.T))
        process[:4, :4] += self._transitions.at(0.5 * (speed + step.speed), duration)[2]
        kalman.F, kalman.Q = jacobian, process
        kalman.predict()
        kalman.x = predicted  # f(x), where filterpy has F x

    def _update_speed(self, coasting: Coasting, speed: float, time_ns: int, speed_ns: int) -> None:
        """Update with a measured speed [m/s], once; since its stamp the bicycle has slowed down."""
        if self._speed_ns is not None and speed_ns <= self._speed_ns:
            return
        row = np.zeros((1, 8))
        row[0, SPEED], row[0, ROLLING_RESISTANCE] = 1.0, coasting.loss * ((time_ns - speed_ns) / 1e9)
        noise = np.array([[self._process.measured_speed**2]])
        self._kalman.update(np.array([[speed]]), R=noise, H=row)
        self._speed_ns = speed_ns

    def _update_rates(
        self, angular_velocity: Sequence[float] | Array, variance: Sequence[float] | Array, speed: float
    ) -> tuple[bool, bool]:
        """Update with lean rate and yaw rate; returns which of them are present."""
        state = self._kalman.x
        lean_rate, w_y, w_z = angular_velocity
        yaw_rate = _yaw_rate(w_y, w_z, state.item(LEAN))
        measured = np.array(((lean_rate,), (yaw_rate,)))
        present = math.isfinite(lean_rate), math.isfinite(yaw_rate)
        if self._coasting is None:
            rows = self._rows
            rows[1, STEER] = speed * self._yaw_gain
        else:
            rows = self.measurement_jacobian(state)
            measured += rows.dot(state) - self.measurement(state)  # filterpy subtracts H x, an EKF h(x)
        update(self._kalman, measured, rows, self._measurement_noise(variance), present)
        return present

    def _measurement_noise(self, variance: Sequence[float] | Array) -> Array:
        """R (2, 2) for variances (3,) of the gyroscopes, NaN: unknown."""
        var_x, _, var_z = variance
        first = float(var_x) if math.isfinite(var_x) else self._variance
        second = float(var_z) if math.isfinite(var_z) else self._variance
        noise = self._noise.get((first, second))
        if noise is None:
            if len(self._noise) > NOISE_CACHE_SIZE:
                self._noise.clear()
            noise = self._noise[first, second] = np.diag((first, second))
        return noise

    def _result(self, time_ns: int, present: tuple[bool, bool], speed: float, reset: bool) -> FilterStep:
        """State and innovation after the update with the channels that are present."""
        kalman = self._kalman
        nis, innovation, spread = math.nan, _NO_INNOVATION, _NO_COVARIANCE
        if all(present):
            innovation, spread = kalman.y[:, 0], kalman.S
            first, second = innovation.tolist()
            (a, b), (c, d) = kalman.SI.tolist()
            nis = first * (a * first + b * second) + second * (c * first + d * second)
        elif any(present):
            rows = np.array(present)
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
            channel_count=sum(present),
            reset=reset,
            speed=speed,
        )

    def _with_parameters(self, result: FilterStep) -> FilterStep:
        """The result with the parameter states, which are kept in case that a strike fell after it."""
        kalman = self._kalman
        mean, covariance = kalman.x[PARAMETERS].copy(), kalman.P[PARAMETERS, PARAMETERS].copy()
        self._history.append(_Parameters(result.time_ns, self._speed_ns, mean, covariance))
        while self._history[0].time_ns < result.time_ns - MAX_STRIKE_DELAY_NS:
            self._history.popleft()
        return replace(
            result, speed=kalman.x.item(SPEED), parameters=mean[:, 0].copy(), parameter_covariance=covariance
        )


def make_filter(bicycle: Bicycle, settings: Settings) -> ExtendedKalmanFilter:
    """Filter of the settings: `filter` selects the parameter states, `fixed` values have no variance."""
    if settings.filter == "linear":
        return ExtendedKalmanFilter(bicycle, settings.gyroscope_noise)
    initial, process = InitialState(), ProcessNoise()
    resistance = settings.fixed.get("rolling_resistance", 0.0 if "speed" in settings.fixed else None)
    if resistance is not None:
        initial = replace(initial, rolling_resistance=resistance, rolling_resistance_std=0.0)
        process = replace(process, rolling_resistance=0.0)
    if "speed" in settings.fixed:
        initial, process = replace(initial, relative_speed_std=0.0), replace(process, speed=0.0)
    return ExtendedKalmanFilter(bicycle, settings.gyroscope_noise, True, initial, process)


def _yaw_rate(w_y: float, w_z: float, lean: float) -> float:
    """Yaw rate [rad/s] by two gyroscopes at a lean [rad], as `tms_model.imu.lean_and_yaw_rate`; NaN: missing.

    Without w_y it is w_z / cos(lean).
    """
    if not math.isfinite(lean):
        return math.nan
    return w_z / math.cos(lean) if not math.isfinite(w_y) else w_y * math.sin(lean) + w_z * math.cos(lean)
