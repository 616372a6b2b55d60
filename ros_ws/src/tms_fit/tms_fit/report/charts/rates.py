"""Measured and predicted lean rate and yaw rate: Figure 3B for this recording."""

from __future__ import annotations

from tms_fit.report.chart import (
    BLUE,
    GREY,
    ORANGE,
    TIME,
    Chart,
    Key,
    Spec,
    field,
    layer,
    legend,
    named,
    panel,
    start_line,
    zero_line,
)

USED, BAND, PREDICTED, TRUE = "used for the fit", "95 % band", "predicted", "truth"
SLIP = "a wheel slips (truth)"


def rates_chart(source: str, with_yaw: bool, with_truth: bool, with_slip: bool) -> Chart:
    """source: 'measured' or 'simulated'."""
    panels = (
        _panel("lean_rate", source, True, with_truth, with_slip),
        _panel("yaw_rate", source, with_yaw, with_truth, with_slip),
    )
    absent = "" if with_yaw else " The yaw rate was not measured here: its curve is only predicted."
    return Chart(
        name="figure_3b",
        title=f"{source.capitalize()} and predicted rates, as in Figure 3B",
        caption=(
            f"Dots: {source}. Line: predicted from the state at the dashed vertical; band: 95 %, from the"
            " parameters' uncertainty. Shaded: used for the fit; beyond it the line predicts."
            + (" Dashed line: the true motion of the simulated bicycle." if with_truth else "")
            + absent
        ),
        panels=panels,
        alternative=f"lean rate and yaw rate against time, {source} and predicted",
    )


def _panel(name: str, source: str, present: bool, with_truth: bool, with_slip: bool) -> Spec:
    """The upper panel has the legend, the lower one the title of the axis of time."""
    upper, title = name == "lean_rate", f"{name.replace('_', ' ')} [rad/s]"
    below = None if upper else TIME
    colours: dict[str, Key] = {source: (GREY, "dot")}
    colours |= {PREDICTED: (BLUE, "line"), BAND: ("#7fb8d8", "area")}
    colours |= {TRUE: (ORANGE, "dash")} if with_truth else {}
    colours[USED] = ("#f4ecaa", "area")
    colours |= {SLIP: ("#c9a0c9", "area")} if with_slip else {}
    x = field("time", scale={"nice": False, "zero": False}, axis={"title": below})
    layers = [
        layer(
            "window",
            {"type": "rect", "opacity": 0.45},
            x=field("start", axis={"title": below}),
            x2={"field": "end"},
            color=named(USED, colours),
        ),
        *(
            [
                layer(
                    "slips",
                    {"type": "rect", "opacity": 0.7},
                    x=field("start", axis={"title": below}),
                    x2={"field": "end"},
                    color=named(SLIP, colours),
                )
            ]
            if with_slip
            else []
        ),
        zero_line(),
        start_line(),
        layer(
            "series",
            {"type": "area", "opacity": 0.5},
            x=x,
            y=field(f"{name}_low", title),
            y2={"field": f"{name}_high"},
            color=named(BAND, colours),
        ),
    ]
    if present:
        layers.append(
            layer(
                "series",
                {"type": "circle", "size": 7, "opacity": 1.0},
                x=x,
                y=field(name, title),
                color=named(source, colours),
            )
        )
    layers.append(
        layer(
            "series",
            {"type": "line"},
            x=x,
            y=field(f"{name}_predicted", title),
            color=named(PREDICTED, colours),
        )
    )
    if with_truth:
        layers.append(
            layer(
                "truth",
                {"type": "line", "strokeDash": [6, 3], "strokeWidth": 1.3},
                x=x,
                y=field(name, title),
                color=named(TRUE, colours),
            )
        )
    if upper:
        layers.append(legend(colours))
    return panel(*layers, cursor=True)
