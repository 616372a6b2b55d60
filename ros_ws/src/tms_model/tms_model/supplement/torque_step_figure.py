"""Into a turn by a step of steer torque, as SOM Figure 5.1 arranges it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tms_model.bicycle import Bicycle
from tms_model.errors import ParameterError
from tms_model.stability import stability
from tms_model.supplement.steady_turn import steady_turn
from tms_model.supplement.torque_step import FIGURE_5_1_LEAN, FIGURE_5_1_SPEED, TorqueStep, torque_step

DURATION = 14.0  # [s]
DIP_TIME = 1.2  # [s] shown with the sideways scale widened
BLUE, ORANGE = "#0072B2", "#D55E00"


def torque_step_figure(bicycle: Bicycle) -> Figure:
    """A step of steer torque at 5 m/s, such that the turn leans as the benchmark does in Figure 5.1.

    On the benchmark that is -0.13 N m. A bicycle that isn't stable at 5 m/s is shown in its stable range.
    Raises ParameterError for a bicycle that is nowhere self-stable: it falls.
    """
    speed = _stable_speed(bicycle)
    turn = steady_turn(bicycle, speed)
    torque = FIGURE_5_1_LEAN * turn.torque_per_steer / turn.lean_per_steer
    step = torque_step(bicycle, speed, torque, np.linspace(0.0, DURATION, 2801))
    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    axes = figure.subplot_mosaic("kt;kt;kl;dl;ds;ds", width_ratios=[1.2, 1])
    _tracks(axes["k"], axes["d"], step)
    history = np.concatenate([[-1.0, 0.0], step.times])
    for name, values, unit in (
        ("t", np.full(len(step.times), step.steer_torque), "steer torque [N m]"),
        ("l", np.degrees(step.lean), "lean [deg]"),
        ("s", np.degrees(step.steer), "steer [deg]"),
    ):
        axes[name].axhline(0.0, color="0.7", lw=0.8)
        axes[name].plot(history, np.concatenate([[0.0, 0.0], values]), color=BLUE)
        axes[name].set(ylabel=unit, xlim=(-1.0, DURATION))
    axes["s"].set_xlabel("time [s]")
    figure.suptitle(
        f"{bicycle.name} at {speed:.3g} m/s: {abs(step.steer_torque):.3g} N m to the left turn right,"
        f" after {100.0 * step.countersteer_dip:.1f} cm to the left"
    )
    return figure


def _stable_speed(bicycle: Bicycle) -> float:
    ranges = stability(bicycle).stable_speed_ranges
    if not ranges:
        raise ParameterError(
            f"bicycle {bicycle.name}: expected one that is self-stable at some speed, found none; after a"
            " step of torque it falls"
        )
    if any(low < FIGURE_5_1_SPEED < high for low, high in ranges):
        return FIGURE_5_1_SPEED
    low, high = ranges[0]
    return 0.5 * (low + min(high, low + 4.0))


def _tracks(whole: Axes, dip: Axes, step: TorqueStep) -> None:
    """Track of the front wheel from above, forward up, and its first part with the sideways scale widened."""
    x, y = step.front_contact.T
    early = step.times <= DIP_TIME
    whole.plot([0.0, 0.0], [x[0] - 5.0, x[0]], color=BLUE)
    whole.plot(y, x, color=BLUE)
    whole.set(xlabel="to the right [m]", ylabel="forward [m]", title="track of the front wheel")
    whole.set_aspect("equal", adjustable="datalim")
    dip.axvline(0.0, color="0.7", lw=0.8)
    dip.plot([0.0, 0.0], [x[0] - 1.0, x[0]], color=BLUE)
    dip.plot(100.0 * y[early], x[early], color=BLUE)
    dip.set(xlabel="to the right [cm]", ylabel="forward [m]", title="its countersteer")
    for axes in (whole, dip):
        axes.plot([y[0]], [x[0]], "o", color=ORANGE, ms=5)
        axes.annotate("torque on", (y[0], x[0]), xytext=(8, -3), textcoords="offset points", color=ORANGE)
