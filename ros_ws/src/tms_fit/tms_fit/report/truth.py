"""A simulated run compared with what really happened. The one place in tms_fit that reads the truth."""

from __future__ import annotations

import numpy as np
from tms_bag import BagReader, Recording, topics
from tms_bag.event import Event, events
from tms_bag.recording import find_topic
from tms_bag.samples import StateSamples
from tms_model.bicycle import Array
from tms_model.response import LEAN_RATE

from tms_fit.comparison import Comparison
from tms_fit.parameters import BIASES, CHANNELS
from tms_fit.report.element import Element, element, table
from tms_fit.report.rounding import decimals, fixed, number


def true_events(recording: Recording) -> list[Event]:
    """What happened in a simulated run, empty where that is not recorded."""
    if recording.state is None:
        return []
    with BagReader(recording.path) as bag:
        name = find_topic(bag, topics.EVENTS)
        return events(bag.records([name])) if name else []


def truth_table(state: StateSamples, both: Comparison) -> Element | None:
    """Truth beside prediction at its first instant, and over what was fitted; None without samples there.

    A bias is the sensor's, not the bicycle's: it is taken out.
    """
    seconds = (state.time_ns - both.strike.start_ns) / 1e9
    rows = np.flatnonzero((seconds >= both.time[0]) & (seconds <= both.end))
    if len(rows) < 2:
        return None
    parameters = both.estimate.complete
    biases = np.array([parameters.get(name, 0.0) for name in BIASES])
    true = np.stack([state.state[rows, LEAN_RATE], state.yaw_rate[rows]], axis=1)
    at = seconds[rows]
    predicted = _at(at, both.time, both.predicted) - biases
    std = _at(at[:1], both.time, both.half)[0] / both.estimate.quantile
    lines: list[list[Element | str]] = []
    for channel, name in enumerate(CHANNELS):
        words = name.replace("_", " ")
        places = decimals(float(std[channel]))
        difference = predicted[:, channel] - true[:, channel]
        if channel == 0:  # the yaw rate begins at zero
            lines.append(
                [
                    f"{words} at {fixed(float(at[0]), 3)} s [rad/s]",
                    number(float(predicted[0, channel]), places),
                    number(float(true[0, channel]), places),
                    number(float(difference[0]), places),
                ]
            )
        rms = float(np.sqrt(np.mean(difference**2)))
        lines.append([f"{words}, root mean square of the difference [rad/s]", "", "", f"{rms:.2g}"])
    used, mean = both.start_speed, float(state.speed[rows[0]])
    places = decimals(both.used.speed.std) if both.used.speed.std else 3
    lines.append(
        ["speed at the start [m/s]", number(used, places), number(mean, places), number(used - mean, places)]
    )
    return element(
        "section",
        element("h3", "Against the truth"),
        element("p", "This run is simulated, so the truth is known. No estimator has seen it."),
        table(["quantity", "estimated", "true", "estimated less true"], lines, class_="truth"),
    )


def _at(times: Array, time: Array, values: Array) -> Array:
    """Both channels (n, 2) at other times."""
    return np.stack([np.interp(times, time, values[:, channel]) for channel in range(2)], axis=1)
