"""Window: measured rates of one free response, ready to be compared with the model."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tms_bag.reading_limits import RATE_LIMIT, measured
from tms_model import Bicycle, ParameterError, load_bicycle
from tms_model.bicycle import Array
from tms_model.imu import lean_and_yaw_rate
from tms_model.resistance import Resistance

from tms_fit.gyroscopes import saturated
from tms_fit.impulse.posterior import ImpulsePosterior
from tms_fit.settings import Settings
from tms_fit.speed_profile import SpeedProfile, constant_speed

FEEDBACK_R2 = 0.8  # share of a torque proportional to the lean rate, from which on it is lean-rate feedback


@dataclass(frozen=True, eq=False)
class StartInformation:
    """Gaussian information on the start of a free response, from the samples before it and priors.

    rows @ [initial state, biases] = target + independent errors of unit variance.
    """

    rows: Array  # (k, 6) in the order of INITIAL and BIASES
    target: Array  # (k,)


@dataclass(frozen=True, eq=False)
class Window:
    """Measured rates after a strike. SAE signs; NaN: not measured.

    The free response starts `delay` before the first sample; initial states of all estimators are those at
    that instant.
    """

    first_ns: int  # stamp of the first sample
    time: Array  # (n,) [s] since the first sample
    lean_rate: Array  # (n,) [rad/s]
    yaw_rate: Array  # (n,) [rad/s]
    bicycle: Bicycle  # compared with, without the feedback of this run
    speed: SpeedProfile
    steer_torque: Array | None = None  # (n,) [N m] known input, each value held until the next sample
    lean_rate_gain: float = 0.0  # [N m s/rad] lean-rate feedback on the steer torque, 0: none
    lean_rate_gain_std: float = 0.0  # of the gain, where it was found from the torque and the lean rate
    gain_by_lean_rate: Array | None = None  # (n,) its derivative by each lean rate, where it was found so
    torque_r2: float = float("nan")  # share of the known torque proportional to the lean rate, NaN: no torque
    delay: float = 0.0  # [s]
    delay_std: float = 0.0  # [s]
    longest_delay: float = 0.05  # [s]
    resistance: Resistance = "rolling"  # by what the speed changes
    saturated: Array | None = None  # (n, 2) sign of the sensor's limit that a sample stands at, else 0
    force: ImpulsePosterior | None = None  # of the strike, by the samples around it; None: not looked for
    start: StartInformation | None = None  # None: nothing but the samples
    slip_window: float = 0.0  # [s] from the start on, in which the front wheel slips and the yaw rate is off

    @property
    def start_ns(self) -> int:
        """Start of the free response."""
        return self.first_ns - round(self.delay * 1e9)

    @property
    def start_speed(self) -> float:
        """Speed [m/s] at the start of the free response."""
        return float(self.speed.at(-self.delay))

    @property
    def measured(self) -> Array:
        """Both channels (n, 2): lean rate, yaw rate."""
        return np.stack([self.lean_rate, self.yaw_rate], axis=1)

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike,
        lean_rate: ArrayLike,
        yaw_rate: ArrayLike,
        *,
        speed: float | SpeedProfile,
        bicycle: str | Bicycle,
    ) -> Window:
        """Window of a free response that starts at the first sample, for `fit_window`.

        time (n,) [s], ascending; lean_rate and yaw_rate (n,) [rad/s], SAE signs (to the right positive), NaN:
        not measured; speed [m/s] that is constant, or a profile of the time since the first sample; bicycle:
        name of the catalogue, file, or Bicycle. Raises ParameterError for shapes that don't agree.
        """
        seconds, lean, yaw = (np.array(values, dtype=float) for values in (time, lean_rate, yaw_rate))
        lean, yaw = measured(lean, RATE_LIMIT), measured(yaw, RATE_LIMIT)
        if seconds.ndim != 1 or not seconds.size or not seconds.shape == lean.shape == yaw.shape:
            raise ParameterError(
                "window: expected time, lean_rate and yaw_rate of one length, found shapes"
                f" {seconds.shape}, {lean.shape} and {yaw.shape}"
            )
        if not (np.diff(seconds) > 0.0).all() or not np.isfinite(seconds).all():
            raise ParameterError("window: expected finite, ascending times")
        return cls(
            first_ns=round(seconds[0] * 1e9),
            time=seconds - seconds[0],
            lean_rate=lean,
            yaw_rate=yaw,
            bicycle=load_bicycle(bicycle) if isinstance(bicycle, str) else bicycle,
            speed=speed if isinstance(speed, SpeedProfile) else constant_speed(float(speed)),
        )


def make_window(
    bicycle: Bicycle,
    settings: Settings,
    time_ns: NDArray[np.int64],
    angular_velocity: Array,
    speed: SpeedProfile,
    steer_torque: Array | None,
    flagged: NDArray[np.bool_] | None = None,
) -> Window:
    """Window from the samples of one free response.

    time_ns (n,); angular_velocity (n, 3) [rad/s] in SAE axes of the rear frame; steer_torque (n,) [N m] or
    None; flagged (n, 3): readings that the recording marks as saturated, None: none.
    """
    time = (time_ns - time_ns[0]) / 1e9
    lean_rate = angular_velocity[:, 0]
    lean_rate, yaw_rate = lean_and_yaw_rate(angular_velocity, _integral(time, np.nan_to_num(lean_rate)))
    torque = steer_torque
    gain, r2, by_rate = 0.0, float("nan"), np.zeros(len(time))
    if steer_torque is not None and settings.steer_torque != "ignore":
        gain, r2, by_rate = _feedback(steer_torque, lean_rate)
        if settings.steer_torque == "feedback" or (settings.steer_torque == "auto" and r2 >= FEEDBACK_R2):
            steer_torque = None
        else:
            gain, by_rate = 0.0, np.zeros(len(time))
    else:
        steer_torque = None
    if "lean_rate_gain" in settings.fixed or "lean_rate_gain" in (settings.free or ()):
        gain, steer_torque = settings.fixed.get("lean_rate_gain", gain), None
        by_rate = np.zeros(len(time))
    gain_std = float(np.linalg.norm(by_rate)) * _spread(torque, lean_rate, gain)
    return Window(
        first_ns=int(time_ns[0]),
        time=time,
        lean_rate=lean_rate,
        yaw_rate=yaw_rate,
        bicycle=bicycle,
        speed=speed,
        steer_torque=steer_torque,
        lean_rate_gain=gain,
        lean_rate_gain_std=gain_std,
        gain_by_lean_rate=by_rate if gain_std else None,
        torque_r2=r2,
        resistance=settings.resistance,
        saturated=_saturated(angular_velocity, flagged, settings),
    )


def _saturated(
    angular_velocity: Array, flagged: NDArray[np.bool_] | None, settings: Settings
) -> Array | None:
    """Signs (n, 2) of the limits that lean rate and yaw rate stand at, by their size or a flag."""
    if settings.saturation == "use" or (settings.gyroscope_range is None and flagged is None):
        return None
    rates = angular_velocity[:, [0, 2]]
    found = saturated(rates, settings.gyroscope_range or math.inf)
    if flagged is not None:
        found = np.where(flagged[:, [0, 2]], np.sign(np.nan_to_num(rates)), found)
    return found


def without_saturated(window: Window) -> Window:
    """The same window with its saturated samples as if they had not been measured."""
    if window.saturated is None:
        return window
    kept = window.saturated == 0.0
    return replace(
        window,
        lean_rate=np.where(kept[:, 0], window.lean_rate, np.nan),
        yaw_rate=np.where(kept[:, 1], window.yaw_rate, np.nan),
        saturated=None,
    )


def from_sample(window: Window, index: int) -> Window:
    """The window from one of its samples on, where the free response then starts."""
    later = window.time[index:]
    shift = float(later[0])

    def cut(values: Array | None) -> Array | None:
        return None if values is None else values[index:]

    return replace(
        window,
        first_ns=window.first_ns + round(shift * 1e9),
        time=later - shift,
        lean_rate=window.lean_rate[index:],
        yaw_rate=window.yaw_rate[index:],
        speed=replace(window.speed, origin=window.speed.origin - shift),
        steer_torque=cut(window.steer_torque),
        gain_by_lean_rate=cut(window.gain_by_lean_rate),
        saturated=cut(window.saturated),
        delay=0.0,
        delay_std=0.0,
    )


def with_channels(window: Window, channels: tuple[str, ...]) -> Window:
    """The same window with only some of its channels measured."""
    absent = np.full(len(window.time), np.nan)
    return replace(
        window,
        lean_rate=window.lean_rate if "lean_rate" in channels else absent,
        yaw_rate=window.yaw_rate if "yaw_rate" in channels else absent,
    )


def _integral(time: Array, values: Array) -> Array:
    """Running trapezoidal integral, zero at the first sample: good enough for a lean angle to first order."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])


def _feedback(torque: Array, lean_rate: Array) -> tuple[float, float, Array]:
    """Slope [N m s/rad] of torque over lean rate, the share of the torque that it explains, and its change.

    The slope is taken along the torque of one sample earlier (an instrumental variable). A slope along the
    lean rate itself would come out too small, by the share of noise in its variance, where the torque does
    not carry that noise. Its change (n,) is its derivative by each lean rate.
    """
    good = np.flatnonzero(np.isfinite(torque) & np.isfinite(lean_rate))
    t, y = torque[good], lean_rate[good]
    along, change = y[1:] @ t[:-1] if len(t) > 1 else 0.0, np.zeros(len(torque))
    if not along:
        return 0.0, float("nan"), change
    gain = float(t[1:] @ t[:-1] / along)
    change[good[1:]] = -gain * t[:-1] / along
    return gain, 1.0 - float(np.sum((t - gain * y) ** 2) / np.sum(t**2)), change


def _spread(torque: Array | None, lean_rate: Array, gain: float) -> float:
    """Deviation [rad/s] of the lean rate from the torque over the gain."""
    if torque is None or not gain:
        return 0.0
    return float(np.sqrt(np.nanmean((lean_rate - torque / gain) ** 2)))
