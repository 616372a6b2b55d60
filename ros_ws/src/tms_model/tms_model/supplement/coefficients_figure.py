"""At which speeds A, B, C, D, E and X are positive: the bars of SOM Figures 7.2b and 7.5b."""

from __future__ import annotations

from matplotlib.figure import Figure

from tms_model.bicycle import Bicycle
from tms_model.characteristic import LETTERS, positive_ranges
from tms_model.stability import stability

HIGHEST_SPEED = 10.0  # [m/s]
GREEN, RED = "#009E73", "#D55E00"


def coefficients_figure(bicycle: Bicycle) -> Figure:
    """One bar for each coefficient, green where it is positive, with the speed at which it changes sign."""
    figure = Figure(figsize=(7.0, 3.4), layout="constrained")
    axes = figure.add_subplot()
    for row, letter in enumerate(LETTERS):
        axes.barh(row, HIGHEST_SPEED, height=0.55, color=RED, alpha=0.25, lw=0)
        for low, high in positive_ranges(bicycle)[letter]:
            if low < HIGHEST_SPEED:
                axes.barh(row, min(high, HIGHEST_SPEED) - low, left=low, height=0.55, color=GREEN, lw=0)
                for edge in (low, high):
                    if 0.0 < edge < HIGHEST_SPEED:
                        axes.annotate(
                            f"{edge:.2f}", (edge, row - 0.3), ha="center", va="bottom", fontsize="small"
                        )
    for low, high in stability(bicycle).stable_speed_ranges:
        if low < HIGHEST_SPEED:
            axes.axvspan(low, min(high, HIGHEST_SPEED), color="0.5", alpha=0.15, lw=0, zorder=0)
    axes.barh(-2, 1.0, color=GREEN, label="positive")
    axes.barh(-2, 1.0, color=RED, alpha=0.25, label="negative or zero")
    axes.barh(-2, 1.0, color="0.5", alpha=0.15, label="self-stable: all positive")
    axes.set_yticks(range(len(LETTERS)), [f"${letter}$" for letter in LETTERS])
    axes.set(xlabel="forward speed [m/s]", xlim=(0.0, HIGHEST_SPEED), ylim=(len(LETTERS) - 0.5, -0.7))
    axes.set_title(f"{bicycle.name}: coefficients of the characteristic polynomial")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=3)
    return figure
