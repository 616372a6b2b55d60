"""Measured and predicted lean rate and yaw rate: Figure 3B for this recording."""

from __future__ import annotations

from dataclasses import dataclass

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

BAND, PREDICTED, TRUE = "95 % band", "predicted", "truth"
USED, LEFT_OUT, SLIPPING = "used for the fit", "taken as slip, left out", "taken as slip, in the model"
SLIP = "a wheel slips (truth)"
LINE = {"type": "line"}
DASHED = {"type": "line", "strokeDash": [6, 3], "strokeWidth": 1.3}
DOTS = {"type": "circle", "size": 7, "opacity": 1.0}


@dataclass(frozen=True)
class Shown:
    """What there is to show besides the lean rate and the predictions."""

    source: str  # 'measured' or 'simulated'
    yaw_rate: bool  # measured
    truth: bool
    slip: bool  # the truth tells of some
    slip_window: str = ""  # LEFT_OUT, SLIPPING, or none

    @property
    def keys(self) -> dict[str, Key]:
        """The legend."""
        return {
            self.source: (GREY, "dot"),
            PREDICTED: (BLUE, "line"),
            BAND: ("#7fb8d8", "area"),
            **({TRUE: (ORANGE, "dash")} if self.truth else {}),
            USED: ("#f4ecaa", "area"),
            **({self.slip_window: ("#b8b8b8", "area")} if self.slip_window else {}),
            **({SLIP: ("#c9a0c9", "area")} if self.slip else {}),
        }


def rates_chart(shown: Shown) -> Chart:
    """Both rates over each other, the legend above, the title of the axis of time below."""
    absent = "" if shown.yaw_rate else " The yaw rate was not measured here: its curve is only predicted."
    return Chart(
        name="figure_3b",
        title=f"{shown.source.capitalize()} and predicted rates, as in Figure 3B",
        caption=(
            f"Dots: {shown.source}. Line: predicted from the state at the dashed vertical; band: 95 %, by the"
            " parameters' uncertainty. Shaded: used for the fit; beyond it the line predicts."
            + (" Dashed line: the true motion of the simulated bicycle." if shown.truth else "")
            + absent
        ),
        panels=(
            panel(*_layers("lean_rate", True, None, shown), legend(shown.keys), cursor=True),
            panel(*_layers("yaw_rate", shown.yaw_rate, TIME, shown), cursor=True),
        ),
        alternative=f"lean rate and yaw rate against time, {shown.source} and predicted",
    )


def _layers(name: str, present: bool, below: str | None, shown: Shown) -> list[Spec]:
    """Layers of one rate, from back to front; below: title of the axis of time."""
    keys, title = shown.keys, f"{name.replace('_', ' ')} [rad/s]"
    x = field("time", scale={"nice": False, "zero": False}, axis={"title": below})
    high = {"field": f"{name}_high"}
    band = {"type": "area", "opacity": 0.5}
    layers = [_span("window", USED, 0.45, below, keys)]
    if shown.slip_window:
        layers.append(_span("slip_window", shown.slip_window, 0.6, below, keys))
    if shown.slip:
        layers.append(_span("slips", SLIP, 0.7, below, keys))
    layers += [zero_line(), start_line()]
    layers.append(layer("series", band, x=x, y=field(f"{name}_low", title), y2=high, color=named(BAND, keys)))
    if present:
        layers.append(layer("series", DOTS, x=x, y=field(name, title), color=named(shown.source, keys)))
    predicted = field(f"{name}_predicted", title)
    layers.append(layer("series", LINE, x=x, y=predicted, color=named(PREDICTED, keys)))
    if shown.truth:
        layers.append(layer("truth", DASHED, x=x, y=field(name, title), color=named(TRUE, keys)))
    return layers


def _span(data: str, label: str, opacity: float, below: str | None, keys: dict[str, Key]) -> Spec:
    """Stretches of time, over the whole height."""
    x = field("start", axis={"title": below})
    mark = {"type": "rect", "opacity": opacity}
    return layer(data, mark, x=x, x2={"field": "end"}, color=named(label, keys))
