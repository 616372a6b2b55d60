"""Eigenvalues against speed, with the speeds of this run."""

from __future__ import annotations

from tms_fit.report.chart import BLUE, GREY, ORANGE, PURPLE, SKY, Chart, Spec, field, layer, panel, zero_line

COLOURS = {"weave": BLUE, "capsize": ORANGE, "castering": PURPLE, "castering-capsize": "#7F3C8D"}
OTHERS = (SKY, "#8C6D1F", "#44AA99", "#999933")


def eigenvalue_chart(names: tuple[str, ...], feedback: str) -> Chart:
    """names: of the modes; feedback: in words what controls the steering, or an empty text."""
    others = iter(OTHERS)
    colours = {name: COLOURS.get(name) or next(others, GREY) for name in names}
    colour = {
        "field": "mode",
        "type": "nominal",
        "scale": {"domain": list(colours), "range": list(colours.values())},
    }

    def curve(column: str, dash: list[int], width: float) -> Spec:
        return layer(
            "eigenvalues",
            {"type": "line", "clip": True, "strokeDash": dash, "strokeWidth": width},
            x=field("speed", "forward speed [m/s]", scale={"nice": False}),
            y=field(column, "eigenvalue [1/s]", scale={"domain": [-10, 10]}),
            color=colour,
            detail=[{"field": "curve", "type": "nominal"}],
        )

    return Chart(
        name="eigenvalues",
        title="Eigenvalues against speed",
        caption=f"Real parts (lines) and imaginary parts (dashed) of the modes of the bicycle{feedback}."
        " Green: stable. Grey: the speeds of this free response; the line in it is the speed used.",
        panels=(
            panel(
                layer(
                    "stable",
                    {"type": "rect", "color": "#009E73", "opacity": 0.14},
                    x=field("low"),
                    x2={"field": "high"},
                ),
                layer(
                    "run_speeds",
                    {"type": "rect", "color": "#555555", "opacity": 0.3},
                    x=field("low"),
                    x2={"field": "high"},
                ),
                layer("run_speeds", {"type": "rule", "color": "#222222"}, x=field("used")),
                zero_line(),
                curve("real", [1, 0], 1.8),
                curve("imaginary", [5, 3], 1.2),
                height=240,
            ),
        ),
        alternative="real and imaginary parts of the eigenvalues against forward speed",
    )
