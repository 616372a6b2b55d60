"""All strikes of a recording: estimate with its interval, VAF and speed against time."""

from __future__ import annotations

from typing import Any

from tms_fit.report.chart import BLUE, SHAPES, Chart, field, layer, legend, named, panel, zero_line
from tms_fit.report.charts.residuals import KEYS

WHEN = "time since the start of the recording [s]"


def overview_chart(channels: tuple[str, ...]) -> Chart:
    """Three panels, one dot per strike; channels: those that were measured."""
    estimate = [
        zero_line(),
        layer(
            "strikes", {"type": "rule", "strokeWidth": 2, "color": BLUE}, **_at("low"), y2={"field": "high"}
        ),
        layer("strikes", {"type": "point", "filled": True, "size": 40, "color": BLUE}, **_at("estimate")),
    ]
    keys = {KEYS[channel][0]: KEYS[channel][1] for channel in channels}
    vaf = [legend(keys)]
    for name, (_, kind) in keys.items():
        vaf.append(
            layer(
                "strikes",
                {"type": "point", "filled": True, "size": 40, "shape": SHAPES[kind]},
                x=field("time", WHEN, scale={"nice": True}),
                y=field(f"vaf_{name.replace(' ', '_')}", "VAF [%]"),
                color=named(name, keys),
            )
        )
    speed = [layer("strikes", {"type": "point", "filled": True, "size": 40, "color": BLUE}, **_at("speed"))]
    return Chart(
        name="overview",
        title="All strikes",
        caption="Initial lean rate with its 95 % interval, share of the measured variance that the model"
        " accounts for (VAF), and forward speed of each strike.",
        panels=(panel(*estimate, height=150), panel(*vaf, height=110), panel(*speed, height=90)),
        alternative="initial lean rate, variance accounted for and speed of every strike against time",
    )


def _at(column: str) -> dict[str, Any]:
    titles = {"speed": "speed [m/s]"}
    return {
        "x": field("time", WHEN, scale={"nice": True}),
        "y": field(
            column, titles.get(column, "initial lean rate [rad/s]"), scale={"zero": column != "speed"}
        ),
    }
