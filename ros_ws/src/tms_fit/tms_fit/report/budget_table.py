"""The error budget of the initial lean rate: noise beside all that the fit takes as known."""

from __future__ import annotations

import math

from tms_fit.diagnostics.error_budget import Budget
from tms_fit.report.chart import Columns
from tms_fit.report.datasets import column
from tms_fit.report.element import Element, element, table
from tms_fit.report.rounding import NONE, decimals, fixed, significant

SHOWN = 12  # largest effects that the figure shows


def budget_table(budget: Budget) -> Element:
    """Statistical and model error, and what each thing taken as known has in it."""
    places = decimals(budget.statistical)
    model = (
        f"what is stated about the model gives {fixed(budget.model, places)} rad/s"
        if math.isfinite(budget.model)
        else "nobody states how sure the bicycle is, so that the model's part is unknown"
    )
    rows: list[list[Element | str]] = [
        [
            one.name.replace("_", " "),
            significant(one.value, 4),
            significant(one.sensitivity),
            fixed(one.per_percent, places),
            significant(one.uncertainty, 2),
            fixed(one.part, places) + (" (in the standard error)" if one.included else "")
            if math.isfinite(one.part)
            else NONE,
        ]
        for one in budget.contributions
    ]
    head = ["taken as known [SI]", "value", "change per unit", "if 1 % more [rad/s]", "its uncertainty"]
    return element(
        "section",
        element("h3", "Error budget of the initial lean rate"),
        element("p", f"Noise gives a standard error of {fixed(budget.statistical, places)} rad/s; {model}."),
        table([*head, "its part [rad/s]"], rows, class_="budget"),
    )


def largest_effects(budget: Budget) -> dict[str, Columns]:
    """The largest changes of the estimate for a value 1 % larger, and the standard error to compare with."""
    known = [one for one in budget.contributions if math.isfinite(one.per_percent) and one.per_percent]
    largest = sorted(known, key=lambda one: -abs(one.per_percent))[:SHOWN]
    return {
        "effects": {
            "name": [one.name.replace("_", " ") for one in largest],
            "change": column(one.per_percent for one in largest),
        },
        "standard_error": {"low": column([-budget.statistical]), "high": column([budget.statistical])},
    }
