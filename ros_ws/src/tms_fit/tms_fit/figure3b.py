"""Measured and predicted lean and yaw rate after a strike, in the arrangement of Figure 3B.

The supplement of Kooijman et al. 2011 (doi 10.1126/science.1201959) says what that figure shows: measured and
simulated lean rate and yaw rate of the rear frame. The measurement here is always the recording at hand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from tms_bag import RecordingError
from tms_model.bicycle import Array
from tms_model.frames import imu_to_rear_frame

from tms_fit.estimate import Estimate
from tms_fit.offline import RecordingFit, orientation_of
from tms_fit.online import StrikeFit
from tms_fit.prediction import predictor
from tms_fit.window import Window, make_window

BEFORE, AFTER = 0.5, 4.0  # [s] shown around the strike
# Room for the legend; loc="outside ..." would need a newer matplotlib than Ubuntu 24.04's.
LEGEND_BELOW = (0.0, 0.06, 1.0, 0.94)
MEASURED, PREDICTED = "#555555", "#0072B2"


def figure_3b(fit: RecordingFit, number: int = 1) -> Figure:
    """The figure for strike `number`, counted from 1. Raises RecordingError if it was not fitted."""
    if not 1 <= number <= len(fit.strikes):
        raise RecordingError(
            f"{fit.recording.path}: expected a strike number from 1 to {len(fit.strikes)}, found {number}"
            + ("" if fit.strikes else "; the recording holds no strike")
        )
    strike = fit.strikes[number - 1]
    good = [one for one in strike.estimates if one.status == "ok"]
    if strike.window is None or not good:
        raise RecordingError(
            f"{fit.recording.path}: strike {number} has no estimate: {strike.estimates[0].message}"
        )
    return _draw(fit, strike, strike.window, good[0], number)


def _draw(fit: RecordingFit, strike: StrikeFit, used: Window, estimate: Estimate, number: int) -> Figure:
    figure = Figure(figsize=(7.0, 5.2), layout=ConstrainedLayoutEngine(rect=LEGEND_BELOW))
    upper, lower = figure.subplots(2, 1, sharex=True)
    shown = _shown_window(fit, number, used)
    seconds = shown.time + shown.delay
    model = predictor(shown)
    fixed = fit.settings.fixed_linear
    predicted = model.predict({**fixed, **estimate.parameters})
    columns = model.select(estimate.names)
    # Parameter uncertainty carried to the curves; Student's t as in the interval of the estimate.
    std = np.sqrt(np.einsum("nci,ij,ncj->nc", columns, estimate.covariance, columns))
    half = std * estimate.quantile
    before_time, before = _before(fit, strike)
    end = (strike.end_ns - strike.start_ns) / 1e9
    for channel, (axes, name) in enumerate(((upper, "lean rate [rad/s]"), (lower, "yaw rate [rad/s]"))):
        axes.axvspan(0.0, end, color="#F0E442", alpha=0.18, lw=0, label="used for the fit")
        axes.plot(before_time, before[:, channel], ".", ms=3, color=MEASURED)
        axes.plot(seconds, shown.measured[:, channel], ".", ms=3, color=MEASURED, label=_source(fit))
        axes.fill_between(
            seconds,
            predicted[:, channel] - half[:, channel],
            predicted[:, channel] + half[:, channel],
            color=PREDICTED,
            alpha=0.3,
            lw=0,
            label="95 % band",
        )
        axes.plot(seconds, predicted[:, channel], "-", lw=1.5, color=PREDICTED, label="predicted")
        axes.axhline(0.0, color="black", lw=0.5)
        axes.axvline(0.0, color="black", lw=0.8, ls="--")
        axes.set_ylabel(name)
        if not np.isfinite(shown.measured[:, channel]).any():
            _say_absent(axes)
    handles, labels = upper.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=4, frameon=False)
    lower.set(
        xlabel="time since the start of the free response [s]", xlim=(-BEFORE, min(float(seconds[-1]), AFTER))
    )
    upper.set_title(_title(fit, used, estimate, number), fontsize=10)
    return figure


def _title(fit: RecordingFit, used: Window, estimate: Estimate, number: int) -> str:
    name = "initial_lean_rate"
    text = f"{_source(fit)} run {fit.recording.path.name}, strike {number}: {fit.bicycle.name}"
    text += f" at {used.system.speed:.2f} m/s"
    if name in estimate.names:
        index = estimate.names.index(name)
        half = estimate.quantile * float(estimate.std[index])
        text += f"\ninitial lean rate {estimate.values[index]:.4f} ± {half:.4f} rad/s"
        text += f" (95 %, {estimate.estimator.replace('_', ' ')})"
    return text


def _source(fit: RecordingFit) -> str:
    """No simulated sample may pass for a measured one."""
    info = fit.recording.run_info
    return "simulated" if info is not None and info.simulated else "measured"


def _shown_window(fit: RecordingFit, number: int, used: Window) -> Window:
    """The window prolonged beyond what was fitted, up to the next strike: there the curve truly predicts."""
    imu, torque = fit.recording.imu, fit.recording.steer_torque
    strikes = fit.strikes
    end = used.start_ns + round(AFTER * 1e9)
    if number < len(strikes):
        end = min(end, strikes[number].strike.onset_ns)
    rows = np.flatnonzero((imu.time_ns >= used.first_ns) & (imu.time_ns <= end))
    known = None
    if torque is not None and used.steer_torque is not None:
        index = np.searchsorted(torque.time_ns, imu.time_ns[rows], side="right") - 1
        known = np.where(index >= 0, torque.steer_torque[np.maximum(index, 0)], np.nan)
    rates = imu_to_rear_frame(imu.angular_velocity[rows], orientation_of(fit.recording.run_info))
    shown = make_window(fit.bicycle, fit.settings, imu.time_ns[rows], rates, used.system.speed, known)
    return replace(shown, system=used.system, steer_torque=known, delay=used.delay)


def _before(fit: RecordingFit, strike: StrikeFit) -> tuple[Array, Array]:
    """Times (n,) [s] and both channels (n, 2) just before the free response.

    The bicycle is upright enough there to take the gyroscopes as they are.
    """
    imu = fit.recording.imu
    rows = np.flatnonzero(
        (imu.time_ns >= strike.start_ns - round(BEFORE * 1e9)) & (imu.time_ns < strike.strike.time_ns)
    )
    rates = imu_to_rear_frame(imu.angular_velocity[rows], orientation_of(fit.recording.run_info))
    return (imu.time_ns[rows] - strike.start_ns) / 1e9, rates[:, [0, 2]]


def _say_absent(axes: Axes) -> None:
    axes.text(
        0.5,
        0.9,
        "not measured in this recording",
        transform=axes.transAxes,
        ha="center",
        va="top",
        style="italic",
    )
