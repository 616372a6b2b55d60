"""How much worse the fit becomes with one parameter held elsewhere."""

from __future__ import annotations

from tms_fit.report.chart import BLUE, GREY, Chart, Key, field, layer, legend, named, panel

KEYS: dict[str, Key] = {"all others found anew": (BLUE, "line"), "by the covariance": (GREY, "dash")}


def profile_chart(name: str, words: str, unit: str) -> Chart:
    """name: of the parameter, in files; words: in text."""
    data = f"profile_{name}"
    x = field("value", f"{words} [{unit}]", scale={"zero": False, "nice": False})
    wanted = {"type": "rule", "color": "#777777", "strokeWidth": 0.8}
    ends = {"type": "rule", "color": BLUE, "strokeWidth": 1, "strokeDash": [2, 3]}
    dashed = {"type": "line", "strokeDash": [6, 3]}
    return Chart(
        name=data,
        title=f"Profile of the {words}",
        caption="How far the fit is from its best with this parameter held at a value, in standard errors."
        " Where the curve crosses the thin lines the 95 % interval by profile ends (dotted); a straight line"
        " is what the covariance says. A curve that bends away from it makes the interval lopsided.",
        panels=(
            panel(
                legend(KEYS),
                layer(f"{data}_ends", wanted, y=field("t")),
                layer(f"{data}_ends", ends, x=field("value")),
                layer(
                    data,
                    dashed,
                    x=x,
                    y=field("straight", "standard errors"),
                    color=named("by the covariance", KEYS),
                ),
                layer(data, {"type": "line"}, x=x, y=field("t"), color=named("all others found anew", KEYS)),
                height=140,
            ),
        ),
        alternative=f"profile of the {words}",
    )
