"""Profiles of the parameters in which the response bends; of the others they are straight by nature."""

from __future__ import annotations

import numpy as np

from tms_fit.comparison import Comparison
from tms_fit.least_squares.intervals import profile
from tms_fit.parameters import NONLINEAR, STRIKE
from tms_fit.report.chart import Chart, Columns
from tms_fit.report.charts.profile import profile_chart
from tms_fit.report.datasets import column
from tms_fit.report.parameters import unit_of, words_of
from tms_fit.settings import Settings


def profile_charts(both: Comparison, settings: Settings) -> tuple[tuple[Chart, ...], dict[str, Columns]]:
    """A chart for each of them, and the numbers; none for an estimate that holds the strike."""
    charts: list[Chart] = []
    data: dict[str, Columns] = {}
    estimate = both.estimate
    for name in estimate.names:
        if name not in NONLINEAR or STRIKE[0] in estimate:
            continue
        found = profile(both.used, estimate, settings, name)
        value, std = estimate.parameters[name], float(estimate.std[estimate.names.index(name)])
        chart = profile_chart(name, words_of(name), unit_of(name))
        charts.append(chart)
        data[chart.name] = {
            "value": column(found.values),
            "t": column(found.t),
            "straight": column((found.values - value) / std),
        }
        quantile = estimate.quantile
        data[f"{chart.name}_ends"] = {
            "value": column(end if np.isfinite(end) else np.nan for end in found.interval),
            "t": column([-quantile, quantile]),
        }
    return tuple(charts), data
