"""Forward speed, and the speed from which the bicycle stays up by itself."""

from __future__ import annotations

from tms_fit.report.chart import (
    BLUE,
    GREEN,
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
)


def speed_chart(with_samples: bool, with_onset: bool, with_truth: bool) -> Chart:
    """The speed's samples, what the fit used, and the onset of self-stability."""
    samples, used, onset, truth = "speed sensor", "speed used", "onset of self-stability", "truth"
    colours: dict[str, Key] = {
        **({samples: (GREY, "dot")} if with_samples else {}),
        used: (BLUE, "line"),
        **({onset: (GREEN, "dots")} if with_onset else {}),
        **({truth: (ORANGE, "dash")} if with_truth else {}),
    }
    x = field("time", TIME, scale={"nice": False, "zero": False})

    def y(name: str) -> Spec:
        return field(name, "speed [m/s]", scale={"zero": False})

    layers = [legend(colours), start_line()]
    if with_samples:
        layers.append(
            layer(
                "speed",
                {"type": "circle", "size": 7, "opacity": 1.0},
                x=x,
                y=y("speed"),
                color=named(samples, colours),
            )
        )
    layers.append(layer("used_speed", {"type": "line"}, x=x, y=y("speed"), color=named(used, colours)))
    if with_truth:
        mark = {"type": "line", "strokeDash": [6, 3], "strokeWidth": 1.3}
        layers.append(layer("truth", mark, x=x, y=y("speed"), color=named(truth, colours)))
    if with_onset:
        mark = {"type": "rule", "strokeDash": [2, 3], "strokeWidth": 1.6}
        layers.append(layer("onset", mark, y=y("speed"), color=named(onset, colours)))
    return Chart(
        name="speed",
        title="Speed",
        caption="Forward speed around the strike"
        + (", and the speed above which the uncontrolled bicycle is stable (dotted)." if with_onset else "."),
        panels=(panel(*layers, height=130, cursor=True),),
        alternative="forward speed against time",
    )
