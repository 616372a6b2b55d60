"""The part of the report about all strikes together."""

from __future__ import annotations

from tms_fit.comparison import first_good
from tms_fit.parameters import CHANNELS
from tms_fit.recording_fit import RecordingFit, first_stamp
from tms_fit.report.chart import Columns
from tms_fit.report.charts.overview import overview_chart
from tms_fit.report.datasets import column
from tms_fit.report.element import Element, element, table
from tms_fit.report.rounding import NONE, decimals, fixed, number
from tms_fit.report.section import Section
from tms_fit.strikes.thresholds import StrikeThresholds

NAME = "initial_lean_rate"


def overview(fit: RecordingFit) -> Section:
    """Table and charts of all strikes; in words where there is none."""
    if not fit.strikes:
        least = StrikeThresholds().least_change
        words = (
            f"No strike was found: the lean rate never changed suddenly by {least:g} rad/s or more within"
            " 0.3 s. There is nothing to estimate."
        )
        return Section("overview", "Overview", (element("p", words, class_="result"),))
    count = f"{len(fit.strikes)} strike{'s' if len(fit.strikes) > 1 else ''} found."
    words_ = (element("p", count), _table(fit))
    several = len(fit.strikes) > 1 and any(first_good(strike) for strike in fit.strikes)
    seen = {name for strike in fit.strikes for estimate in strike.estimates for name in estimate.vaf}
    channels = tuple(name for name in CHANNELS if name in seen)
    charts = (overview_chart(channels),) if several else ()
    return Section("overview", "Overview", words_, charts, data={"strikes": _columns(fit)} if several else {})


def _table(fit: RecordingFit) -> Element:
    rows: list[list[Element | str]] = []
    for index, strike in enumerate(fit.strikes):
        estimate = first_good(strike)
        link = element("a", str(index + 1), href=f"#strike-{index + 1}")
        when = fixed((strike.start_ns - first_stamp(fit.recording)) / 1e9, 2)
        if estimate is None or strike.window is None:
            rows.append([link, when, NONE, strike.estimates[0].status, NONE, NONE, NONE])
            continue
        rate: Element | str = NONE
        interval: Element | str = NONE
        if NAME in estimate.names:
            at = estimate.names.index(NAME)
            places = decimals(float(estimate.std[at]))
            low, high = estimate.ci95[at]
            rate = number(float(estimate.values[at]), places)
            interval = element("span", number(float(low), places), " to ", number(float(high), places))
        shares = [
            fixed(100.0 * estimate.vaf[channel], 1) if channel in estimate.vaf else NONE
            for channel in CHANNELS
        ]
        rows.append([link, when, fixed(strike.speed, 2), rate, interval, *shares])
    head = ["strike", "at [s]", "speed [m/s]", "initial lean rate [rad/s]", "95 % interval [rad/s]"]
    return table([*head, "VAF lean rate [%]", "VAF yaw rate [%]"], rows, class_="strikes")


def _columns(fit: RecordingFit) -> Columns:
    nan = float("nan")
    names = ("time", "estimate", "low", "high", "speed", *(f"vaf_{channel}" for channel in CHANNELS))
    rows: list[tuple[float, ...]] = []
    for strike in fit.strikes:
        estimate = first_good(strike)
        when = (strike.start_ns - first_stamp(fit.recording)) / 1e9
        if estimate is None or strike.window is None:
            rows.append((when, nan, nan, nan, nan, nan, nan))
            continue
        value = (nan, nan, nan)
        if NAME in estimate.names:
            at = estimate.names.index(NAME)
            value = (float(estimate.values[at]), float(estimate.ci95[at, 0]), float(estimate.ci95[at, 1]))
        shares = [100.0 * estimate.vaf.get(channel, nan) for channel in CHANNELS]
        rows.append((when, *value, strike.speed, *shares))
    return {name: column(row[index] for row in rows) for index, name in enumerate(names)}
