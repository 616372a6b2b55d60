"""Eigenvalues against speed, as the field draws them; how every figure of the project reaches the disk."""

from __future__ import annotations

import contextlib
import math
import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tms_model.bicycle import Bicycle
from tms_model.parameters import ParameterError
from tms_model.stability import eigenvalues, stability


def eigenvalue_figure(bicycle: Bicycle, highest_speed: float = 10.0) -> Figure:
    """Real and imaginary parts of the eigenvalues from 0 to `highest_speed` [m/s], stable ranges shaded."""
    speeds = np.linspace(0.0, highest_speed, 1001)
    roots = np.array([eigenvalues(bicycle, float(speed)) for speed in speeds])
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for low, high in stability(bicycle).stable_speed_ranges:
        if low < highest_speed:
            axes.axvspan(
                low, min(high, highest_speed), color="#009E73", alpha=0.15, lw=0, label="self-stable"
            )
            ends = f"{low:.2f} to {high:.2f} m/s" if math.isfinite(high) else f"from {low:.2f} m/s up"
            axes.set_title(f"{bicycle.name}: self-stable {ends}")
    if not stability(bicycle).stable_speed_ranges:
        axes.set_title(f"{bicycle.name}: not self-stable at any speed")
    axes.plot(speeds, np.where(roots.imag > 1e-9, roots.imag, np.nan), ".", ms=1.5, color="#E69F00")
    axes.plot(speeds, roots.real, ".", ms=2.0, color="#0072B2")
    axes.plot([], [], "o", color="#0072B2", label="real part")
    axes.plot([], [], "o", color="#E69F00", label="imaginary part")
    axes.axhline(0.0, color="black", lw=0.8)
    axes.set(
        xlabel="forward speed [m/s]", ylabel="eigenvalue [1/s]", xlim=(0.0, highest_speed), ylim=(-10.0, 10.0)
    )
    axes.legend(loc="upper left", framealpha=0.9)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF by the suffix of `path`; the file appears whole or not at all.

    Raises ParameterError for another suffix or a place that can't be written.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("png", "svg", "pdf"):
        raise ParameterError(f"{path}: expected a name that ends in .png, .svg or .pdf")
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(unfinished, format=kind, dpi=150)
        unfinished.replace(path)
    except OSError as error:
        raise ParameterError(
            f"{path}: expected a place to write a figure, found: {error.strerror}"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            unfinished.unlink()
