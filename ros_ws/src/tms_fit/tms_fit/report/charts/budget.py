"""What 1 % more of each thing taken as known does to the initial lean rate."""

from __future__ import annotations

from tms_fit.report.chart import BLUE, Chart, field, layer, panel

ROW = 18


def budget_chart(names: list[str]) -> Chart:
    """names: of the things, the one with the largest effect first."""
    y = {
        "field": "name",
        "type": "nominal",
        "sort": names,
        "axis": {"title": None, "minExtent": 130, "maxExtent": 130, "labelLimit": 130, "ticks": False},
    }
    band = {"type": "rect", "color": "#009E73", "opacity": 0.16}
    bar = {"type": "bar", "color": BLUE, "height": 10}
    x = field("change", "change of the initial lean rate [rad/s]", scale={"zero": True})
    return Chart(
        name="error_budget",
        title="If it were 1 % more",
        caption="Change of the estimated initial lean rate if one value that the fit takes as known were 1 %"
        " larger."
        " Green: plus and minus the standard error.",
        panels=(
            panel(
                layer("standard_error", band, x=field("low"), x2={"field": "high"}),
                layer("effects", bar, x=x, y=y),
                height=ROW * len(names),
            ),
        ),
        alternative="change of the initial lean rate for a change of 1 % in what is taken as known",
    )
