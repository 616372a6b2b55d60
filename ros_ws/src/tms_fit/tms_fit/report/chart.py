"""A figure of the report as data: Vega-Lite specifications with named data sets, and words about them.

Specifications name their data (`{"data": {"name": "series"}}`); the page's script and `figures` put the
numbers in. So the page holds each specification once, however many strikes share it.

Colours are Okabe and Ito's, told apart by colour-blind readers (https://jfly.uni-koeln.de/color/); what they
mean is also said by shape, dash or words.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

Spec = dict[str, Any]
Columns = dict[str, list[Any]]

GREY, BLUE, ORANGE, GREEN, YELLOW, SKY, PURPLE = (
    "#4d4d4d",
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#F0E442",
    "#56B4E9",
    "#AA4499",
)
CONFIG: Spec = {
    "font": "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif",
    "background": "white",
    "padding": {"left": 2, "right": 8, "top": 4, "bottom": 2},
    "view": {"stroke": "#999999"},
    "axis": {
        "labelFontSize": 11,
        "titleFontSize": 12,
        "titleFontWeight": "normal",
        "labelColor": "#222222",
        "titleColor": "#222222",
        "gridColor": "#e4e4e4",
        "domain": False,
        "tickColor": "#999999",
        "labelOverlap": True,
        "labelSeparation": 6,
    },
    "axisX": {"tickCount": 8, "labelFlush": False},
    "axisY": {"minExtent": 44, "maxExtent": 44, "titlePadding": 4},
    "legend": {
        "orient": "top",
        "title": None,
        "labelFontSize": 11,
        "labelLimit": 260,
        "symbolStrokeWidth": 2,
        "symbolSize": 110,
        "columnPadding": 14,
        "offset": 6,
    },
    "line": {"strokeWidth": 1.8},
}
CURSOR = [{"calculate": "section_time", "as": "at"}]
TIME = "time since the start of the free response [s]"


@dataclass(frozen=True)
class Chart:
    """One figure: panels one above the other."""

    name: str  # of its file, such as figure_3b
    title: str
    caption: str  # one or two sentences that say what is seen
    panels: tuple[Spec, ...]
    alternative: str  # the same for who cannot see it


def panel(*layers: Spec, height: int = 180, cursor: bool = False) -> Spec:
    """Layers over each other; with a cursor at the section's time."""
    spec: Spec = {"width": "container", "height": height, "layer": list(layers)}
    if cursor:
        spec["params"] = [{"name": "section_time", "value": 0}]
        spec["layer"].append(_cursor())
    return spec


def layer(data: str, mark: Spec, **encoding: Any) -> Spec:
    """A mark drawn from a data set."""
    return {"data": {"name": data}, "mark": mark, "encoding": encoding}


def field(name: str, title: str | None = None, **more: Any) -> Spec:
    """A column of numbers on a channel."""
    return {"field": name, "type": "quantitative", **({"title": title} if title is not None else {}), **more}


Key = tuple[str, str]  # colour and kind: dot, triangle, line, dash, dots or area
SHAPES = {"dot": "circle", "triangle": "triangle-up", "area": "square"}
DASHES = {"dash": [6, 3], "dots": [2, 3]}


def legend(keys: dict[str, Key]) -> Spec:
    """A layer that draws nothing but a legend: each label with the symbol that stands for it."""
    kinds = {name: kind for name, (_, kind) in keys.items()}
    symbols = {
        "shape": _by_label({name: SHAPES.get(kind, "stroke") for name, kind in kinds.items()}),
        "strokeDash": _by_label({name: DASHES.get(kind, []) for name, kind in kinds.items()}),
        "fill": _by_label(
            {name: colour if kind in SHAPES else "transparent" for name, (colour, kind) in keys.items()}
        ),
        "stroke": _by_label({name: colour for name, (colour, _) in keys.items()}),
        "opacity": {"value": 1},
    }
    colour = {
        "field": "label",
        "type": "nominal",
        "scale": {"domain": list(keys), "range": [colour for colour, _ in keys.values()]},
        "legend": {"encoding": {"symbols": symbols}},
    }
    mark = {"type": "point", "opacity": 0}
    data = {"values": [{"label": label} for label in keys]}
    return {"data": data, "mark": mark, "encoding": {"color": colour}}


def named(label: str, keys: dict[str, Key]) -> Spec:
    """The colour of a label of the legend."""
    return {"value": keys[label][0]}


def _by_label(values: dict[str, Any]) -> Spec:
    """A signal that gives the value of a legend's entry."""
    return {"value": {"signal": f"({json.dumps(values)})[datum.label]"}}


def zero_line() -> Spec:
    """A thin line at y = 0."""
    return {
        "data": {"values": [{}]},
        "mark": {"type": "rule", "color": "#777777", "strokeWidth": 0.8},
        "encoding": {"y": {"datum": 0}},
    }


def start_line() -> Spec:
    """A dashed line at time 0, the start of the free response."""
    return {
        "data": {"values": [{}]},
        "mark": {"type": "rule", "color": "#222222", "strokeWidth": 0.8, "strokeDash": [4, 3]},
        "encoding": {"x": {"datum": 0}},
    }


def _cursor() -> Spec:
    return {
        "data": {"values": [{}]},
        "transform": CURSOR,
        "mark": {"type": "rule", "color": "#000000", "strokeWidth": 1},
        "encoding": {"x": {"field": "at", "type": "quantitative"}},
    }
