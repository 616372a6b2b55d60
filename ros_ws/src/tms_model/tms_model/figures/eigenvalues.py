"""Eigenvalues against speed as the field draws them, modes named, stability marked; the bicycle beside."""

from __future__ import annotations

import math
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tms_model.bicycle import Array, Bicycle
from tms_model.figures.drawing import LEGEND_BELOW, draw_bicycle
from tms_model.modes import CAPSIZE, CASTERING, MERGED, WEAVE, ModeCourse, follow_modes
from tms_model.stability import Stability, double_roots, stability

HIGHEST_SPEED = 10.0  # [m/s] shown, or more when stability changes above it
MOST = 30.0  # [m/s] ever shown
REACH = 10.0  # [1/s] shown of the eigenvalues, either way
COLOURS = {WEAVE: "#0072B2", CAPSIZE: "#D55E00", CASTERING: "#7F3C8D", MERGED: "#AA4499"}
OTHERS = ("#56B4E9", "#8C6D1F", "#44AA99", "#999933", "#882255", "#555555")
STABLE = "#009E73"
CLOSE = (-1e-3, -1e-4, -1e-5, 1e-5, 1e-4, 1e-3)  # shares of a meeting speed, around it
REAL = 1e-9  # [1/s] imaginary part that counts as none


def eigenvalue_figure(bicycle: Bicycle) -> Figure:
    """Real and imaginary parts of the eigenvalues from standstill on, and the bicycle to scale."""
    figure = Figure(figsize=(12.0, 5.4), layout=ConstrainedLayoutEngine(rect=LEGEND_BELOW))
    left, right = figure.subplots(1, 2, width_ratios=[1.35, 1.0])
    answer = stability(bicycle)
    highest = _highest_speed(answer)
    course = follow_modes(bicycle, _speeds(bicycle, highest))
    handles = _draw_modes(left, course)
    handles += _draw_stability(left, answer, highest)
    left.axhline(0.0, color="black", lw=0.8, zorder=1)
    left.set(xlabel="forward speed [m/s]", ylabel="eigenvalue [1/s]")
    left.set(xlim=(0.0, highest), ylim=(-REACH, REACH), title=_sentence(answer))
    figure.suptitle(bicycle.name, fontweight="bold")
    draw_bicycle(right, bicycle, handles)
    return figure


def _speeds(bicycle: Bicycle, highest: float) -> Array:
    """Evenly spaced, and close to where modes meet, since curves are steep there."""
    close = [meeting.speed * (1.0 + part) for meeting in double_roots(bicycle) for part in CLOSE]
    speeds = np.concatenate([np.linspace(0.0, highest, 1001), close])
    return np.unique(speeds[speeds <= highest])


def _highest_speed(answer: Stability) -> float:
    edges = [edge for pair in answer.stable_speed_ranges for edge in pair if math.isfinite(edge)]
    return max(HIGHEST_SPEED, *(math.ceil(1.2 * edge) for edge in [0.0, *edges] if edge <= MOST / 1.2))


def _sentence(answer: Stability) -> str:
    if not answer.stable_speed_ranges:
        return "not self-stable at any speed"
    parts = [
        f"{low:.2f} to {high:.2f} m/s" if math.isfinite(high) else f"{low:.2f} m/s up"
        for low, high in answer.stable_speed_ranges
    ]
    return f"self-stable from {' and from '.join(parts)}"


def _draw_modes(axes: Axes, course: ModeCourse) -> list[Line2D | Patch]:
    """Each mode in its colour: real parts as lines, imaginary parts dashed; returns what the legend shows."""
    names = list(dict.fromkeys(name for row in course.names for name in row))
    order = [name for name in COLOURS if name in names] + sorted(set(names) - set(COLOURS))
    others = cycle(OTHERS)
    colours = {name: COLOURS.get(name) or next(others) for name in order}
    table = np.array(course.names)
    for name, colour in colours.items():
        for column in range(4):
            roots = np.where(_belongs(table[:, column] == name), course.eigenvalues[:, column], np.nan)
            axes.plot(course.speeds, roots.real, color=colour, lw=1.8)
            upper = np.where(roots.imag > REAL, roots.imag, np.nan)
            axes.plot(course.speeds, upper, color=colour, lw=1.2, ls=(0, (4, 2)))
    handles: list[Line2D | Patch] = [Line2D([], [], color=c, lw=1.8, label=n) for n, c in colours.items()]
    return [*handles, Line2D([], [], color="0.3", lw=1.2, ls=(0, (4, 2)), label="imaginary part")]


def _belongs(own: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """A mode's speeds and the one before each stretch of them, so that lines join where modes meet."""
    joined = own.copy()
    joined[:-1] |= own[1:]
    return joined


def _draw_stability(axes: Axes, answer: Stability, highest: float) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = []
    for low, high in answer.stable_speed_ranges:
        if low < highest:
            axes.axvspan(low, min(high, highest), color=STABLE, alpha=0.15, lw=0)
            handles = [Patch(color=STABLE, alpha=0.15, lw=0, label="self-stable")]
    marks = {
        "weave": (answer.weave_speed, COLOURS[WEAVE]),
        "capsize": (answer.capsize_speed, COLOURS[CAPSIZE]),
    }
    for name, (speed, colour) in marks.items():
        if speed is None or speed >= highest:
            continue
        axes.axvline(speed, color=colour, lw=1.0, ls=":")
        axes.plot(speed, 0.0, "o", color=colour, ms=6, mec="white", zorder=5)
        # Outside of the stable range, and where few curves pass: weave at the top, capsize at the bottom.
        left = speed > (0.22 if name == "weave" else 0.75) * highest
        axes.annotate(
            f"{name} {speed:.2f} m/s",
            (speed, (0.93 if name == "weave" else -0.93) * REACH),
            xytext=(-4 if left else 4, 0),
            textcoords="offset points",
            ha="right" if left else "left",
            va="center",
            color=colour,
            bbox={"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.0},
            zorder=6,
        )
    return handles
