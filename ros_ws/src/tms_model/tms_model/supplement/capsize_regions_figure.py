"""Where E = E_0 + E_2 v^2 > 0 lets a bicycle be self-stable, as SOM Figure 5.2 draws it."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from tms_model.bicycle import Bicycle
from tms_model.characteristic import coefficients
from tms_model.stability import boundaries

HIGHEST_SPEED = 10.0  # [m/s] of the line drawn
BLUE, ORANGE = "#0072B2", "#D55E00"


def capsize_regions_figure(bicycle: Bicycle) -> Figure:
    """The plane of E_0 and E_2 v^2, shaded where stability is impossible, with the bicycle's speeds."""
    named = coefficients(bicycle)
    e0, e2 = named["E0"], named["E2"]
    speeds = np.array([0.0, HIGHEST_SPEED])
    crossings = [b.speed for b in boundaries(bicycle) if b.condition == "E" and b.speed < HIGHEST_SPEED]
    half = max(2.0 * abs(e0), min(abs(e2) * HIGHEST_SPEED**2, 3.0 * abs(e0)))
    figure = Figure(figsize=(6.0, 5.5), layout="constrained")
    axes = figure.add_subplot()
    axes.fill([-half, half, -half], [half, -half, -half], color="0.85", lw=0)
    axes.plot([-half, half], [half, -half], color="black", lw=1.2)
    axes.axhline(0.0, color="black", lw=0.8)
    axes.axvline(0.0, color="black", lw=0.8)
    axes.plot([e0, e0], e2 * speeds**2, "--", color=BLUE)
    axes.plot([e0], [0.0], "o", color=BLUE, label=f"{bicycle.name}, standing")
    for speed in crossings:
        axes.plot([e0], [e2 * speed**2], "s", color=ORANGE, label=f"E = 0 at {speed:.3f} m/s")
    end = math.copysign(min(half, abs(e2) * HIGHEST_SPEED**2), e2)
    if abs(end) > 0.02 * half:
        axes.annotate("", (e0, 0.75 * end), (e0, 0.65 * end), arrowprops={"arrowstyle": "->", "color": BLUE})
        place = 6 if e0 < 0.0 else -6
        axes.annotate(
            "v increasing",
            (e0, 0.62 * end),
            (place, 0),
            textcoords="offset points",
            color=BLUE,
            ha="left" if place > 0 else "right",
            rotation=90,
            va="center",
        )
    else:
        axes.annotate(
            "$E_2 = 0$ at all speeds", (e0, 0.0), (0, 9), textcoords="offset points", ha="center", color=BLUE
        )
    axes.text(-0.6 * half, -0.6 * half, "E < 0\nstability impossible", ha="center", va="center")
    axes.text(0.45 * half, 0.6 * half, "E > 0\nstability possible", ha="center", va="center")
    axes.set(
        xlim=(-half, half), ylim=(-half, half), xlabel="$E_0$ [N$^2$ m$^2$]", ylabel="$E_2 v^2$ [N$^2$ m$^2$]"
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.11), ncols=2)
    return figure
