"""Normalised innovation squared of the running filter."""

from __future__ import annotations

from tms_fit.report.chart import BLUE, TIME, Chart, field, layer, panel
from tms_fit.report.rounding import fixed


def nis_chart(inside: float) -> Chart:
    """inside: share of the NIS within the band."""
    logarithmic = {"type": "log", "domain": [1e-3, 100], "clamp": True}
    x = field("time", TIME, scale={"nice": False, "zero": False})
    return Chart(
        name="nis",
        title="Innovations of the running filter (NIS)",
        caption=f"{fixed(100.0 * inside, 0)} % of the normalised innovations squared lie in the band that"
        " holds 95 % when model and noise are right. Above it the filter is surprised, below it expects too"
        " much noise. This filter, unlike the fit, lets disturbances act on the bicycle.",
        panels=(
            panel(
                layer(
                    "nis",
                    {"type": "area", "color": "#009E73", "opacity": 0.16},
                    x=x,
                    y=field("low", scale=logarithmic),
                    y2={"field": "high"},
                ),
                layer(
                    "nis",
                    {"type": "circle", "size": 9, "opacity": 1.0, "color": BLUE},
                    x=x,
                    y=field("nis", "NIS", scale=logarithmic, axis={"format": "~g", "tickCount": 5}),
                ),
                height=120,
                cursor=True,
            ),
        ),
        alternative="normalised innovation squared against time",
    )
