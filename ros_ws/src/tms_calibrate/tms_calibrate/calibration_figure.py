"""Figure of a calibration: measured and predicted pushes of each recording, parameters and priors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tms_calibrate.calibration import Calibration
from tms_calibrate.calibration_output import CrossValidationRow
from tms_calibrate.cross_validation import OWN_UNKNOWNS
from tms_calibrate.pooled_fit import Strike
from tms_calibrate.pooled_problem import PooledProblem, Run
from tms_calibrate.pooled_solver import model_of, solve_pooled

MAX_COLUMNS = 3  # panels side by side
MEASURED, BEFORE, AFTER = "0.6", "C1", "C0"


def calibration_figure(
    calibration: Calibration, strikes: Sequence[Strike], validation: CrossValidationRow
) -> Figure:
    """Figure with one panel per recording and one for the parameters."""
    names = list(dict.fromkeys(one.recording for one in strikes))
    columns = min(len(names), MAX_COLUMNS)
    rows = -(-len(names) // columns)
    heights = [3.0] * rows + [0.6 + 0.38 * len(calibration.names)]
    figure = Figure(figsize=(max(8.0, 4.0 * columns), sum(heights) + 0.8), layout="constrained")
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=heights)
    first: Axes | None = None
    for k, name in enumerate(names):
        axes = figure.add_subplot(grid[k // columns, k % columns], sharex=first, sharey=first)
        _pushes(axes, calibration, strikes, validation, name)
        first = first or axes
    _numbers(figure.add_subplot(grid[rows, :]), calibration)
    handles, labels = first.get_legend_handles_labels() if first else ([], [])
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    return figure


def _pushes(
    axes: Axes, calibration: Calibration, strikes: Sequence[Strike], validation: CrossValidationRow, name: str
) -> None:
    """Draw all pushes of a recording per initial lean rate, and the predictions at the median speed."""
    here = [k for k, one in enumerate(strikes) if one.recording == name]
    windows = [calibration.solution.problem.runs[k].window for k in here]
    found = calibration.solution.shared_values
    for k, window in enumerate(windows):
        alone = solve_pooled(PooledProblem((Run(window, OWN_UNKNOWNS),), known=found))
        if alone.status == "ok":
            label = "measured, per initial lean rate" if k == 0 else None
            axes.plot(window.time, window.lean_rate / alone.own[0][0], color=MEASURED, lw=0.7, label=label)
    speeds = [window.start_speed for window in windows]
    middle = windows[int(np.argsort(speeds)[len(speeds) // 2])]
    for numbers, colour, style, words in (
        ({}, BEFORE, "--", f"{calibration.bicycle.name}"),
        (found, AFTER, "-", "calibrated"),
    ):
        curve = model_of(middle, numbers).select(OWN_UNKNOWNS)[:, 0, 0]
        axes.plot(middle.time, curve, color=colour, ls=style, lw=2.0, label=words)
    before, after = (float(np.median(values[here])) for values in (validation.before, validation.after))
    axes.set_title(
        f"{name}: {len(here)} pushes at {np.median(speeds):.2f} m/s\n"
        f"median VAF {before:.3f}, calibrated {after:.3f}",
        fontsize="medium",
    )
    axes.set_xlabel("time since the push [s]")
    axes.set_ylabel("lean rate / initial lean rate")
    axes.axhline(0.0, color="0.8", lw=0.7, zorder=0)


def _numbers(axes: Axes, calibration: Calibration) -> None:
    """Draw 95 % intervals of prior and calibrated values, in prior standard deviations."""
    names = calibration.names
    for k, name in enumerate(names):
        prior = calibration.priors[name]
        value = (calibration.values[k] - prior.value) / prior.deviation
        half = 1.96 * calibration.std[k] / prior.deviation
        axes.plot([-1.96, 1.96], [k, k], color=MEASURED, lw=6.0, solid_capstyle="butt", alpha=0.5)
        axes.errorbar([value], [k], xerr=[half], color=AFTER, marker="o", ms=5.0, lw=2.0, capsize=3.0)
        text = f"{calibration.values[k]:.3g} ± {calibration.std[k]:.2g}"
        axes.annotate(text, (1.01, k), xycoords=("axes fraction", "data"), va="center", fontsize="small")
    axes.set_yticks(range(len(names)), [f"{name}" for name in names])
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.axvline(0.0, color="0.8", lw=0.7, zorder=0)
    axes.set_xlabel("off the prior, in its standard deviations; grey: 95 % of the prior, blue: found")
