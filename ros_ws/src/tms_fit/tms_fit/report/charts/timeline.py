"""Lean rate over the whole recording, and below it when what happened."""

from __future__ import annotations

from tms_fit.report.chart import BLUE, GREEN, GREY, ORANGE, Chart, Spec, field, layer, panel, zero_line
from tms_fit.report.charts.overview import WHEN

ROW = 32  # height of a kind of event
COLOURS = {"strike": BLUE, "samples missing": ORANGE}


def timeline_chart(kinds: tuple[str, ...], simulated: bool) -> Chart:
    """kinds: of the spans, each gets a row; none: the lean rate alone."""
    x = field("time", WHEN, scale={"nice": False}, axis={"title": None if kinds else WHEN})
    band = {"type": "area", "color": GREY, "line": {"strokeWidth": 0.8, "color": GREY}}
    upper = panel(
        zero_line(),
        layer("envelope", band, x=x, y=field("low", "lean rate [rad/s]"), y2={"field": "high"}),
        height=110,
    )
    return Chart(
        name="timeline",
        title="What happened when",
        caption="Lean rate (least to greatest, where samples lie close) over the whole recording"
        + (
            "; below, strikes with what was fitted, lost samples and sensors at their limit."
            if kinds
            else "."
        )
        + (" Rows that begin with 'truth' are known because the run is simulated." if simulated else ""),
        panels=(upper, _rows(kinds)) if kinds else (upper,),
        alternative="lean rate and events against time over the whole recording",
    )


def _rows(kinds: tuple[str, ...]) -> Spec:
    y = {
        "field": "kind",
        "type": "nominal",
        "scale": {"domain": list(kinds)},
        "axis": {"labels": False, "ticks": False, "grid": True, "title": " "},  # as wide as the panel above
    }
    colour = {
        "field": "kind",
        "type": "nominal",
        "scale": {"domain": list(kinds), "range": [COLOURS.get(kind, GREEN) for kind in kinds]},
        "legend": None,
    }
    names = {
        "data": {"values": [{"kind": kind} for kind in kinds]},
        "mark": {
            "type": "text",
            "align": "left",
            "baseline": "middle",
            "fontSize": 11,
            "dx": 4,
            "yOffset": -8,
        },
        "encoding": {"y": y, "x": {"value": 0}, "text": {"field": "kind", "type": "nominal"}},
    }
    scale = {"nice": False}
    bar = {"type": "bar", "height": 12, "yOffset": 7}
    tick = {"type": "tick", "thickness": 2, "height": 12, "yOffset": 7}
    return panel(
        {
            "data": {"name": "envelope"},
            "mark": {"type": "point", "opacity": 0},
            "encoding": {"x": field("time")},
        },
        layer("spans", bar, x=field("first", WHEN, scale=scale), x2={"field": "last"}, y=y, color=colour),
        layer("spans", tick, x=field("first"), y=y, color=colour),
        names,
        height=ROW * len(kinds),
    )
