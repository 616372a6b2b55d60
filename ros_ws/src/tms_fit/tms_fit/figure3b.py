"""Figure of measured and predicted lean and yaw rate after a strike, as Figure 3B.

The figure of Kooijman et al. 2011 (doi 10.1126/science.1201959) compares measured and simulated lean rate and
yaw rate of the rear frame. Here the measurements are those of the recording.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from tms_fit.comparison import SHOWN_AFTER_S, SHOWN_BEFORE_S, Comparison, comparison, source_of
from tms_fit.recording_fit import RecordingFit
from tms_fit.report.rounding import decimals, fixed

# Room for the legend; loc="outside ..." would need a newer matplotlib than Ubuntu 24.04's.
LEGEND_BELOW = (0.0, 0.06, 1.0, 0.94)
MEASURED, PREDICTED = "#555555", "#0072B2"


def figure_3b(fit: RecordingFit, number: int = 1) -> Figure:
    """Figure for strike `number`, counted from 1. Raises RecordingError if it was not fitted."""
    both = comparison(fit, number)
    figure = Figure(figsize=(7.0, 5.2), layout=ConstrainedLayoutEngine(rect=LEGEND_BELOW))
    upper, lower = figure.subplots(2, 1, sharex=True)
    for channel, (axes, name) in enumerate(((upper, "lean rate [rad/s]"), (lower, "yaw rate [rad/s]"))):
        _draw_channel(axes, both, channel, source_of(fit))
        axes.set_ylabel(name)
    handles, labels = upper.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=5, fontsize=9, columnspacing=1.2, frameon=False)
    lower.set(
        xlabel="time since the start of the free response [s]",
        xlim=(-SHOWN_BEFORE_S, min(float(both.time[-1]), SHOWN_AFTER_S)),
    )
    upper.set_title(_title(fit, both, number), fontsize=10)
    return figure


def _draw_channel(axes: Axes, both: Comparison, channel: int, source: str) -> None:
    seconds, predicted, half = both.time, both.predicted[:, channel], both.half[:, channel]
    axes.axvspan(0.0, both.end, color="#F0E442", alpha=0.18, lw=0, label="used for the fit")
    settings = both.estimate.settings
    if settings is not None and settings.slip_window:
        axes.axvspan(0.0, settings.slip_window, color="#999999", alpha=0.35, lw=0, label="taken as slip")
    axes.plot(both.before_time, both.before[:, channel], ".", ms=3, color=MEASURED)
    axes.plot(seconds, both.measured[:, channel], ".", ms=3, color=MEASURED, label=source)
    axes.fill_between(
        seconds, predicted - half, predicted + half, color=PREDICTED, alpha=0.3, lw=0, label="95 % band"
    )
    axes.plot(seconds, predicted, "-", lw=1.5, color=PREDICTED, label="predicted")
    axes.axhline(0.0, color="black", lw=0.5)
    axes.axvline(0.0, color="black", lw=0.8, ls="--")
    if not np.isfinite(both.measured[:, channel]).any():
        text = "not measured in this recording"
        axes.text(0.5, 0.9, text, transform=axes.transAxes, ha="center", va="top", style="italic")


def _title(fit: RecordingFit, both: Comparison, number: int) -> str:
    name, estimate = "initial_lean_rate", both.estimate
    text = f"{source_of(fit)} run {fit.recording.path.name}, strike {number}: {fit.bicycle.name}"
    text += f" at {both.start_speed:.2f} m/s"
    if name in estimate:
        found = estimate[name]
        places = decimals(found.std)
        value, half = fixed(found.value, places), fixed(estimate.quantile * found.std, places)
        text += f"\ninitial lean rate {value} ± {half} rad/s"
        text += f" (95 %, {estimate.estimator.replace('_', ' ')})"
    return text
