"""How every figure of the project reaches the disk."""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path

from matplotlib.figure import Figure

from tms_model.parameters import ParameterError


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF by the suffix of `path`; the file appears whole or not at all.

    Raises ParameterError for another suffix or a place that can't be written.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("png", "svg", "pdf"):
        raise ParameterError(f"{path}: expected a name that ends in .png, .svg or .pdf")
    drawn = io.BytesIO()
    figure.savefig(drawn, format=kind, dpi=150)
    write_whole(path, drawn.getvalue())


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that appears whole or not at all; folders above it are made.

    Raises ParameterError for a place that can't be written.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.write_bytes(content)
        unfinished.replace(path)
    except OSError as error:
        raise ParameterError(f"{path}: expected a place to write a file, found: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError):
            unfinished.unlink()
