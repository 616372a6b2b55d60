"""The running filter over a strike's free response: is each innovation as large as the filter expects it?"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2
from tms_model.frames import imu_to_rear_frame

from tms_fit.comparison import Comparison
from tms_fit.gyroscopes import orientation_of
from tms_fit.kalman.ekf import ExtendedKalmanFilter, FilterStep
from tms_fit.recording_fit import RecordingFit
from tms_fit.report.chart import Columns
from tms_fit.report.datasets import column


def filter_steps(fit: RecordingFit, both: Comparison) -> list[FilterStep]:
    """Steps of the live node's filter from the first sample of the free response on, begun as by a strike."""
    imu, torque = fit.recording.imu, both.shown.steer_torque
    rows = np.flatnonzero(imu.time_ns >= both.used.first_ns)[: len(both.time)]
    rates = imu_to_rear_frame(imu.angular_velocity[rows], orientation_of(fit.recording.run_info))
    held = np.zeros(len(rows)) if torque is None else np.nan_to_num(np.concatenate([[0.0], torque[:-1]]))
    if both.used.lean_rate_gain:
        held = both.used.lean_rate_gain * np.nan_to_num(np.concatenate([[0.0], both.measured[:-1, 0]]))
    speeds = np.maximum(both.shown.speed.at(both.shown.time), 1e-3)
    running = ExtendedKalmanFilter(fit.bicycle, fit.settings.gyroscope_noise)
    running.restart(strike=True)
    return [
        running.step(int(time_ns), rate, imu.angular_velocity_variance, float(speed), float(known))
        for time_ns, rate, speed, known in zip(imu.time_ns[rows], rates, speeds, held, strict=True)
    ]


def nis(steps: list[FilterStep], start_ns: int) -> Columns:
    """Normalised innovation squared with the band that holds 95 % of them, by chi square."""
    used = [step for step in steps[1:] if step.channel_count]
    limits = {count: chi2.ppf([0.025, 0.975], count) for count in {step.channel_count for step in used}}
    return {
        "time": column((step.time_ns - start_ns) / 1e9 for step in used),
        "nis": column(step.nis for step in used),
        "low": column(limits[step.channel_count][0] for step in used),
        "high": column(limits[step.channel_count][1] for step in used),
    }


def share_inside(columns: Columns) -> float:
    """Share of the NIS inside the band, 0.95 when filter and noise are right; NaN without any."""
    rows = list(zip(columns["nis"], columns["low"], columns["high"], strict=True))
    return sum(low <= value <= high for value, low, high in rows) / len(rows) if rows else float("nan")
