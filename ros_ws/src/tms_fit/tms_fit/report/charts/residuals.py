"""What the prediction leaves of the measurement."""

from __future__ import annotations

from tms_fit.report.chart import (
    BLUE,
    ORANGE,
    SHAPES,
    TIME,
    Chart,
    Key,
    Spec,
    field,
    layer,
    legend,
    named,
    panel,
    zero_line,
)

KEYS: dict[str, tuple[str, Key]] = {
    "lean_rate": ("lean rate", (BLUE, "dot")),
    "yaw_rate": ("yaw rate", (ORANGE, "triangle")),
}


def residual_chart(channels: tuple[str, ...]) -> Chart:
    """Residuals of each channel against time, over what was fitted."""
    colours: dict[str, Key] = {KEYS[channel][0]: KEYS[channel][1] for channel in channels}
    layers = [legend(colours), zero_line()]
    layers += [
        layer(
            "residuals",
            {
                "type": "point",
                "filled": True,
                "size": 14,
                "opacity": 0.9,
                "shape": SHAPES[KEYS[channel][1][1]],
            },
            x=field("time", TIME, scale={"nice": False}),
            y=field(channel, "residual [rad/s]"),
            color=named(channel.replace("_", " "), colours),
        )
        for channel in channels
    ]
    return Chart(
        name="residuals",
        title="Residuals",
        caption="Measured less predicted, over the samples used. A good model leaves noise, no waves.",
        panels=(panel(*layers, height=130, cursor=True),),
        alternative="residuals against time",
    )


def histogram_chart(channels: tuple[str, ...]) -> Chart:
    """How the residuals are distributed, beside the normal distribution of the same deviation."""
    return Chart(
        name="residual_histogram",
        title="Distribution of the residuals",
        caption="Bars: residuals. Line: normal distribution with the estimate's residual standard deviation.",
        panels=tuple(_histogram(channel) for channel in channels),
        alternative="histogram of the residuals",
    )


def _histogram(channel: str) -> Spec:
    words = channel.replace("_", " ")
    return panel(
        layer(
            f"histogram_{channel}",
            {
                "type": "rect",
                "color": KEYS[channel][1][0],
                "opacity": 0.65,
                "stroke": "white",
                "strokeWidth": 0.5,
            },
            x=field("low", f"residual of the {words} [rad/s]"),
            x2={"field": "high"},
            y=field("count", "samples"),
            y2={"datum": 0},
        ),
        layer(
            f"normal_{channel}",
            {"type": "line", "color": "#222222", "strokeWidth": 1.3},
            x=field("residual"),
            y=field("count"),
        ),
        height=110,
    )
