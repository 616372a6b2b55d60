"""How every figure of the project reaches the disk."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure

from tms_model.atomic_write import atomic_write
from tms_model.errors import ParameterError


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF by the suffix of `path`; the file appears whole or not at all.

    Raises ParameterError for another suffix or a place that can't be written.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("png", "svg", "pdf"):
        raise ParameterError(f"{path}: expected a name that ends in .png, .svg or .pdf")
    drawn = io.BytesIO()
    figure.savefig(drawn, format=kind, dpi=150)
    atomic_write(path, drawn.getvalue())
