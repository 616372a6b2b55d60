"""Residuals against their own past and over frequency."""

from __future__ import annotations

from tms_fit.report.chart import SHAPES, Chart, Spec, field, layer, legend, named, panel, zero_line
from tms_fit.report.charts.residuals import KEYS

SHIMMY = 20.0  # [Hz] of the steering oscillation in the supplement, chapter 11


def autocorrelation_chart(channels: tuple[str, ...]) -> Chart:
    """Autocorrelation by lag with the band of white residuals."""
    keys = {KEYS[channel][0]: KEYS[channel][1] for channel in channels}
    lag = field("lag", "lag [s]", scale={"nice": False, "zero": True})
    mark = {"type": "rule", "strokeDash": [4, 3], "color": "#222222", "strokeWidth": 0.9}
    bands = [
        {
            **layer("autocorrelation", mark, y=field(name, "autocorrelation", aggregate="max")),
            "transform": [{"calculate": "-datum.limit", "as": "lower"}],
        }
        for name in ("limit", "lower")
    ]
    points = [
        _of(
            channel,
            layer(
                "autocorrelation",
                {"type": "point", "filled": True, "size": 18, "shape": SHAPES[KEYS[channel][1][1]]},
                x=lag,
                y=field("value", "autocorrelation"),
                color=named(KEYS[channel][0], keys),
            ),
        )
        for channel in channels
    ]
    return Chart(
        name="residual_autocorrelation",
        title="Autocorrelation of the residuals",
        caption="Of white residuals 95 % of the dots lie between the dashed lines. Waves mean that the model"
        " misses a motion, and that the interval is too narrow.",
        panels=(panel(legend(keys), zero_line(), *bands, *points, height=120),),
        alternative="autocorrelation of the residuals against lag",
    )


def spectrum_chart(channels: tuple[str, ...], with_shimmy: bool) -> Chart:
    """Power density against frequency; with_shimmy: the sample rate lets 20 Hz be seen."""
    keys = {KEYS[channel][0]: KEYS[channel][1] for channel in channels}
    layers = [legend(keys)]
    for channel in channels:
        dash = [1, 0] if channel == "lean_rate" else [5, 2]
        colour = named(KEYS[channel][0], keys)
        x = field("frequency", "frequency [Hz]", scale={"nice": False})
        title = "density [(rad/s)²/Hz]"
        logarithmic = {"type": "log", "nice": False}
        axis = {"format": ".0e", "tickCount": 5}
        line = {"type": "line", "strokeWidth": 1.3, "strokeDash": dash}
        flat = {"type": "line", "strokeWidth": 0.9, "strokeDash": [2, 3]}
        y = field("density", title, scale=logarithmic, axis=axis)
        layers.append(_of(channel, layer("spectrum", line, x=x, y=y, color=colour)))
        layers.append(_of(channel, layer("spectrum", flat, x=x, y=field("level"), color=colour)))
    if with_shimmy:
        layers += _shimmy()
    return Chart(
        name="residual_spectrum",
        title="Spectrum of the residuals",
        caption="Dotted: the level of white residuals of the same power."
        + (
            " Vertical line: the steering oscillation that the supplement saw; the model does not have it."
            if with_shimmy
            else ""
        ),
        panels=(panel(*layers, height=130),),
        alternative="power density of the residuals against frequency",
    )


def _of(channel: str, one: Spec) -> Spec:
    return {**one, "transform": [{"filter": f"datum.channel === '{channel}'"}]}


def _shimmy() -> list[Spec]:
    data = {"values": [{"frequency": SHIMMY}]}
    x = field("frequency")
    return [
        {
            "data": data,
            "mark": {"type": "rule", "color": "#222222", "strokeDash": [6, 3]},
            "encoding": {"x": x},
        },
        {
            "data": data,
            "mark": {"type": "text", "align": "left", "baseline": "top", "dx": 4, "dy": 3, "text": "20 Hz"},
            "encoding": {"x": x, "y": {"value": 0}},
        },
    ]
