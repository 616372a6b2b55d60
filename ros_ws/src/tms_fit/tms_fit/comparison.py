"""Comparison of a strike's recording with its prediction beyond the fitted window."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tms_bag import RecordingError
from tms_model.acceleration import coasting_loss
from tms_model.bicycle import Array
from tms_model.frames import imu_to_rear_frame

from tms_fit.estimate import Estimate, Status
from tms_fit.gyroscopes import orientation_of
from tms_fit.recording_fit import RecordingFit
from tms_fit.response.prediction import predict_by
from tms_fit.speed_profile import constant_speed
from tms_fit.strike_fit import StrikeFit
from tms_fit.window import Window, make_window

SHOWN_BEFORE_S, SHOWN_AFTER_S = 0.5, 4.0  # around the start of the free response
SPEED_MARGIN = 0.1  # of a speed curve beyond its range in the window, relative
MIN_SPEED_RATIO = 0.1  # of a decelerating bicycle, relative to its start speed


@dataclass(frozen=True, eq=False)
class Comparison:
    """Lean rate and yaw rate (columns) around one strike, times [s] since the start of the free response."""

    strike: StrikeFit
    estimate: Estimate  # of the prediction
    used: Window  # fitted
    shown: Window  # extended to SHOWN_AFTER_S or to the next strike
    time: Array  # (n,) [s] of the samples shown
    measured: Array  # (n, 2) [rad/s], NaN: absent
    predicted: Array  # (n, 2) [rad/s]
    half: Array  # (n, 2) [rad/s] half of the 95 % band, propagated from the estimate's covariance
    before_time: Array  # (m,) [s], negative
    before: Array  # (m, 2) [rad/s] measured just before

    @property
    def start_speed(self) -> float:
        """Speed [m/s] at the start of the free response, by the estimate."""
        return self.estimate.complete.get("speed", self.used.start_speed)

    @property
    def end(self) -> float:
        """Last time used for the fit [s]."""
        return (self.strike.end_ns - self.strike.start_ns) / 1e9


def first_good(strike: StrikeFit) -> Estimate | None:
    """First estimate of a strike with status ok; None without such an estimate or without a window."""
    good = [one for one in strike.estimates if one.status == Status.OK]
    return good[0] if good and strike.window is not None else None


def comparison(fit: RecordingFit, number: int = 1) -> Comparison:
    """Comparison for strike `number`, counted from 1. Raises RecordingError if it was not fitted."""
    if not 1 <= number <= len(fit.strikes):
        raise RecordingError(
            f"{fit.recording.path}: expected a strike number from 1 to {len(fit.strikes)}, found {number}"
            + ("" if fit.strikes else "; the recording holds no strike")
        )
    strike = fit.strikes[number - 1]
    estimate = first_good(strike)
    if strike.window is None or estimate is None:
        raise RecordingError(
            f"{fit.recording.path}: strike {number} has no estimate: {strike.estimates[0].message}"
        )
    used = _as_assumed(strike.window, estimate)
    shown = _foreseeable(_shown_window(fit, number, used), used, estimate)
    predicted, slopes = predict_by(shown, estimate)
    # Student's t, as in the interval of the estimate.
    variance = np.einsum("nci,ij,ncj->nc", slopes, estimate.covariance, slopes)
    std = np.sqrt(np.maximum(variance, 0.0))  # rounding leaves less than none where the response grows fast
    before_time, before = _before(fit, strike)
    return Comparison(
        strike=strike,
        estimate=estimate,
        used=used,
        shown=shown,
        time=shown.time + shown.delay,
        measured=shown.measured,
        predicted=predicted,
        half=std * estimate.quantile,
        before_time=before_time,
        before=before,
    )


def source_of(fit: RecordingFit) -> str:
    """Origin of a recording in words: 'simulated' or 'measured'."""
    info = fit.recording.run_info
    return "simulated" if info is not None and info.simulated else "measured"


def _shown_window(fit: RecordingFit, number: int, used: Window) -> Window:
    """Window extended beyond the fitted samples, up to SHOWN_AFTER_S or to the next strike."""
    imu, torque = fit.recording.imu, fit.recording.steer_torque
    strikes = fit.strikes
    end = used.start_ns + round(SHOWN_AFTER_S * 1e9)
    if number < len(strikes):
        end = min(end, strikes[number].strike.onset_ns)
    rows = np.flatnonzero((imu.time_ns >= used.first_ns) & (imu.time_ns <= end))
    known = None
    if torque is not None and used.steer_torque is not None:
        index = np.searchsorted(torque.time_ns, imu.time_ns[rows], side="right") - 1
        known = np.where(index >= 0, torque.steer_torque[np.maximum(index, 0)], np.nan)
    rates = imu_to_rear_frame(imu.angular_velocity[rows], orientation_of(fit.recording.run_info))
    shown = make_window(fit.bicycle, fit.settings, imu.time_ns[rows], rates, used.speed, known)
    return replace(
        shown,
        steer_torque=known,
        lean_rate_gain=used.lean_rate_gain,
        torque_r2=used.torque_r2,
        delay=used.delay,
    )


def _as_assumed(window: Window, estimate: Estimate) -> Window:
    """Window with the speed that the estimator assumed, constant for som2011."""
    if estimate.settings is None or estimate.settings.speed_model != "constant":
        return window
    return replace(window, speed=constant_speed(estimate.complete["speed"], window.speed.std))


def _foreseeable(shown: Window, used: Window, estimate: Estimate) -> Window:
    """Extended window up to the time where its speed curve leaves the range of validity."""
    values = estimate.complete
    if "rolling_resistance" in values:
        start = values.get("speed", used.start_speed)
        speed = start - values["rolling_resistance"] * coasting_loss(used.bicycle) * shown.time
        low, high = MIN_SPEED_RATIO * start, np.inf
    else:
        speed, inside = used.speed.at(shown.time), used.speed.at(used.time)
        low, high = (1.0 - SPEED_MARGIN) * inside.min(), (1.0 + SPEED_MARGIN) * inside.max()
    beyond = np.flatnonzero(((speed < low) | (speed > high)) & (shown.time > used.time[-1]))
    if (used.speed.constant and "rolling_resistance" not in values) or not len(beyond):
        return shown
    kept = slice(0, int(beyond[0]))
    torque = None if shown.steer_torque is None else shown.steer_torque[kept]
    lean_rate, yaw_rate = shown.lean_rate[kept], shown.yaw_rate[kept]
    time = shown.time[kept]
    return replace(shown, time=time, lean_rate=lean_rate, yaw_rate=yaw_rate, steer_torque=torque)


def _before(fit: RecordingFit, strike: StrikeFit) -> tuple[Array, Array]:
    """Times (n,) [s] and both channels (n, 2) just before the free response.

    The bicycle is nearly upright there, so the gyroscopes measure lean and yaw rate directly.
    """
    imu = fit.recording.imu
    rows = np.flatnonzero(
        (imu.time_ns >= strike.start_ns - round(SHOWN_BEFORE_S * 1e9)) & (imu.time_ns < strike.strike.time_ns)
    )
    rates = imu_to_rear_frame(imu.angular_velocity[rows], orientation_of(fit.recording.run_info))
    return (imu.time_ns[rows] - strike.start_ns) / 1e9, rates[:, [0, 2]]
