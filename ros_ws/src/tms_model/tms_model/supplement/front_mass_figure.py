"""Where the front mass of a two-mass skate may be, as SOM Figure 7.3 shades it, for either tilt."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tms_model.bicycle import Array, Bicycle
from tms_model.supplement.two_mass_skate import TwoMassSkate, two_mass_skate

BLUE, ORANGE, GREEN, SKY = "#0072B2", "#D55E00", "#009E73", "#56B4E9"
POINTS = 900  # of the grid that is shaded, each way
LEVELS = (1.0, 2.0, 3.0, 5.0, 10.0, 20.0)  # [kg] of m_H,max that are drawn


def front_mass_figure(bicycle: Bicycle) -> Figure:
    """Allowed places of the front mass of the skate that the bicycle is: lightly shaded where m_H is limited.

    Raises ParameterError for a bicycle that is no two-mass skate.
    """
    skate = two_mass_skate(bicycle)
    right = 1.15 * max(skate.rear_x, skate.front_x, skate.wheelbase)
    top = 1.8 * max(-skate.rear_z, -skate.front_z)
    x, z = np.meshgrid(np.linspace(-0.1, right, POINTS), -np.linspace(0.0, top, POINTS))
    allowed = np.logical_and.reduce(list(skate.conditions(x, z).values()))
    limit = skate.most_front_mass(x)
    figure = Figure(figsize=(7.5, 1.2 + 6.0 * top / (right + 0.1)), layout="constrained")
    axes = figure.add_subplot()
    for mask, colour in ((allowed & np.isinf(limit), GREEN), (allowed & np.isfinite(limit), SKY)):
        axes.contourf(x, -z, mask.astype(float), levels=[0.5, 1.5], colors=[colour], alpha=0.45)
    _limits(axes, skate, x, z, np.where(allowed, limit, np.nan))
    _lines(axes, skate, right, top)
    axes.fill([], [], color=GREEN, alpha=0.45, label="allowed, any front mass")
    axes.fill([], [], color=SKY, alpha=0.45, label="allowed below $m_{H,max}$ (lines, kg)")
    axes.plot(skate.rear_x, -skate.rear_z, "o", ms=13, color=BLUE, label=f"$m_B$ = {skate.rear_mass:g} kg")
    axes.plot(
        skate.front_x, -skate.front_z, "o", ms=7, color=ORANGE, label=f"$m_H$ = {skate.front_mass:g} kg"
    )
    axes.set(
        xlim=(-0.1, right), ylim=(0.0, top), xlabel="forward of the rear contact [m]", ylabel="height [m]"
    )
    axes.set_aspect("equal")
    axes.set_title(f"{bicycle.name}: where the front mass may be")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.19), ncols=2)
    return figure


def _limits(axes: Axes, skate: TwoMassSkate, x: Array, z: Array, limit: Array) -> None:
    """Lines of equal m_H,max, each with its number at the end that is away from the rear mass."""
    bottom = skate.steer_axis_tilt > 0.0
    height, last = (0.02 if bottom else 0.98) * float(-z.min()), math.inf
    for mass in LEVELS:
        there = skate.wheelbase - skate.rear_mass * skate.rear_z * math.tan(skate.steer_axis_tilt) / mass
        near = np.abs(x[0] - there).argmin()
        if np.isfinite(limit[:, near]).any() and abs(there - last) > 0.012 * np.ptp(x):
            line = np.isfinite(limit[:, near])
            axes.plot(np.full(line.sum(), there), -z[line, near], color=BLUE, lw=0.6)
            axes.text(
                there,
                height,
                f"{mass:g}",
                rotation=90,
                ha="right",
                va="bottom" if bottom else "top",
                fontsize="small",
                color=BLUE,
            )
            last = there


def _lines(axes: Axes, skate: TwoMassSkate, right: float, top: float) -> None:
    """The four lines that bound the region, named by their coefficients."""
    heights, reach = np.array([0.0, top]), np.array([0.0, right])
    axis = skate.wheelbase - heights * math.tan(skate.steer_axis_tilt)
    rear_x, rear_height = np.full(2, skate.rear_x), np.full(2, -skate.rear_z)
    for x, height, style, name in (
        (axis, heights, "-", "steer axis ($E_0$)"),
        (rear_x, heights, "--", "through $m_B$ ($D_1$)"),
        (np.array([-0.1, right]), rear_height, ":", "through $m_B$ ($C_2$)"),
        (reach, -reach * skate.rear_z / skate.rear_x, "-.", "$P$ to $m_B$ ($B_1$)"),
    ):
        axes.plot(x, height, style, label=name, color="black", lw=0.9)
    axes.plot([0.0, skate.wheelbase], [0.0, 0.0], "^", ms=9, color="black", clip_on=False, zorder=5)
