"""Texts beside points of a drawing, placed where they cover neither each other nor points nor lines."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tms_model.bicycle import Array

FONT_SIZE = 9.0  # [points]
LETTER = 0.58  # width of a letter in font sizes, generously
DOT = 4.0  # distance of the dots that stand for a line [points]
Box = tuple[float, float, float, float]  # left, bottom, right, top [points]


@dataclass(frozen=True)
class Label:
    """A text for the round symbol at x, y with a radius, all in data units."""

    text: str
    x: float
    y: float
    radius: float
    colour: str


def place_labels(axes: Axes, labels: list[Label], lines: list[Array]) -> None:
    """Write each label where it covers least, trying eight directions and three distances.

    lines: what else should stay visible, (n, 2) in data units. The axes' limits and aspect must be final.
    """
    figure = axes.figure
    if not isinstance(figure, Figure):
        raise ValueError("expected axes of a whole figure")
    figure.draw_without_rendering()  # the layout decides the scale
    scale = 72.0 / figure.dpi

    def in_points(places: Array) -> Array:
        return np.asarray(axes.transData.transform(places)) * scale

    whole = axes.get_window_extent()
    frame = (whole.x0 * scale, whole.y0 * scale, whole.x1 * scale, whole.y1 * scale)
    centres = in_points(np.array([[label.x, label.y] for label in labels]))
    edges = in_points(np.array([[label.x + label.radius, label.y] for label in labels]))
    radii = edges[:, 0] - centres[:, 0]
    taken: list[Box] = [(x - r, y - r, x + r, y + r) for (x, y), r in zip(centres, radii, strict=True)]
    dots = np.concatenate([_dotted(in_points(line)) for line in lines])
    for label, centre, radius in zip(labels, centres, radii, strict=True):
        candidates = [
            (_cost(box, taken, dots, frame) + distance, box)
            for distance, box in _candidates(label.text, centre, float(radius))
        ]
        box = min(candidates)[1]
        taken.append(box)
        axes.annotate(
            label.text,
            (label.x, label.y),
            xytext=(0.5 * (box[0] + box[2]) - centre[0], 0.5 * (box[1] + box[3]) - centre[1]),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=FONT_SIZE,
            color=label.colour,
            zorder=7,
        )


def _candidates(text: str, centre: Array, radius: float) -> list[tuple[float, Box]]:
    """Boxes around a symbol, with their distances from it [points]."""
    half_width, half_height = 0.5 * LETTER * FONT_SIZE * len(text), 0.6 * FONT_SIZE
    boxes = []
    for distance, turn in product((3.0, 9.0, 18.0), range(8)):
        cos, sin = math.cos(turn * math.pi / 4.0), math.sin(turn * math.pi / 4.0)
        x = float(centre[0]) + (radius + distance) * cos + half_width * _sign(cos)
        y = float(centre[1]) + (radius + distance) * sin + half_height * _sign(sin)
        boxes.append((distance, (x - half_width, y - half_height, x + half_width, y + half_height)))
    return boxes


def _cost(box: Box, taken: list[Box], dots: Array, frame: Box) -> float:
    """What a label there would cover or stick out [points^2]; a dot on a line counts as DOT squared."""
    covered = sum(_overlap(box, other) for other in taken)
    outside = (box[2] - box[0]) * (box[3] - box[1]) - _overlap(box, frame)
    x, y = dots.T
    inside = (x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])
    return 3.0 * (covered + outside) + DOT**2 * float(np.count_nonzero(inside))


def _dotted(line: Array) -> Array:
    """Dots along a line, one every DOT points."""
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    along = np.linspace(0.0, lengths[-1], max(2, math.ceil(lengths[-1] / DOT)))
    return np.stack([np.interp(along, lengths, coordinate) for coordinate in line.T], axis=1)


def _sign(value: float) -> float:
    return 0.0 if abs(value) < 1e-9 else math.copysign(1.0, value)


def _overlap(one: Box, other: Box) -> float:
    """Common area of two boxes."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return max(0.0, width) * max(0.0, height)
