"""Checks of times: rates, gaps, jitter, duplicates, order, clocks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tms_bag.checks.finding import ERROR, NOTE, WARNING, Finding
from tms_bag.checks.survey import Stream, Survey
from tms_bag.samples import FloatArray, IntArray

SLOWEST, FASTEST = 50.0, 400.0  # [Hz] of a sensor: what strikes are found at
GAP = 2.5  # sample intervals without a message
JITTER = 0.2  # of an interval, standard deviation
JUMP_NS = 10**9  # [ns] that a clock is set by, at least
FEWEST = 10  # messages to judge a rate by


def _timed(survey: Survey) -> Iterator[tuple[Stream, IntArray]]:
    """The sensor's and the speed's stamps in the order of arrival, those that were stamped at all."""
    for name in (survey.imu_topic, survey.speed_topic):
        stream = survey.streams.get(name) if name else None
        if stream is not None and stream.stamp_ns is not None and stream.stamp_ns.any():
            yield stream, stream.stamp_ns


def _intervals(stamps: IntArray) -> tuple[FloatArray, float]:
    """Intervals between different stamps in their order [s], and the usual one (NaN: too few to say)."""
    steps = np.diff(np.unique(stamps)) / 1e9
    return np.asarray(steps, np.float64), float(np.median(steps)) if steps.size >= FEWEST else float("nan")


def unstamped(survey: Survey) -> Iterator[Finding]:
    """Messages without header.stamp."""
    for name in (survey.imu_topic, survey.speed_topic):
        stream = survey.streams.get(name) if name else None
        if stream is not None and stream.stamp_ns is not None and not stream.stamp_ns.any():
            yield Finding(
                ERROR,
                stream.name,
                f"all {stream.log_ns.size} messages have the stamp 0",
                "samples can't be ordered in time, and the fit refuses them",
                "let the sensor's driver fill header.stamp, with the time of measurement",
            )


def rate(survey: Survey) -> Iterator[Finding]:
    """A sensor that samples too slowly or too fast for what follows."""
    for stream, stamps in _timed(survey):
        _, usual = _intervals(stamps)
        if stream.name != survey.imu_topic or not usual > 0.0:
            continue
        hertz = 1.0 / usual
        if hertz < SLOWEST:
            yield Finding(
                WARNING,
                stream.name,
                f"{hertz:.1f} messages a second",
                f"a push lasts 0.1 s and is hardly seen below {SLOWEST:g} Hz: its end is uncertain",
                "let the sensor send 100 Hz or more",
                values={"rate": hertz},
            )
        elif hertz > FASTEST:
            yield Finding(
                WARNING,
                stream.name,
                f"{hertz:.0f} messages a second",
                f"above {FASTEST:g} Hz strikes can be missed: a sample changes little from one to the next",
                "average the samples down to 100 Hz before the fit",
                values={"rate": hertz},
            )


def gaps(survey: Survey) -> Iterator[Finding]:
    """Stretches without messages."""
    for stream, stamps in _timed(survey):
        steps, usual = _intervals(stamps)
        if not usual > 0.0:
            continue
        long = steps[steps > GAP * usual]
        if not long.size:
            continue
        missing = int(np.rint(long / usual - 1.0).sum())
        share = missing / (missing + steps.size + 1)
        when = float(np.diff(np.unique(stamps)).argmax())
        at = (np.unique(stamps)[int(when)] - stamps.min()) / 1e9
        yield Finding(
            ERROR if share > 0.1 else WARNING,
            stream.name,
            f"{long.size} gaps, {missing} messages missing ({100 * share:.1f} %); the longest has"
            f" {long.max():.3f} s, {at:.2f} s after the first message",
            "a push inside a gap isn't seen, and a free response with one is known less well",
            "record over a cable or with a deeper queue (reliable, depth of a second); what the recorder lost"
            " stands in its diagnostics",
            values={"gaps": int(long.size), "missing": missing, "longest": float(long.max())},
        )


def jitter(survey: Survey) -> Iterator[Finding]:
    """Uneven sampling without gaps."""
    for stream, stamps in _timed(survey):
        steps, usual = _intervals(stamps)
        if not usual > 0.0:
            continue
        even = steps[steps <= GAP * usual]
        spread = float(np.std(even)) / usual
        if spread > JITTER:
            yield Finding(
                WARNING,
                stream.name,
                f"intervals scatter by {1e3 * spread * usual:.2f} ms around {1e3 * usual:.2f} ms",
                "stamps seem to be times of arrival: each sample is taken at another time than it says",
                "let the driver stamp by the sensor's own clock",
                values={"interval": usual, "interval_std": spread * usual},
            )


def duplicates(survey: Survey) -> Iterator[Finding]:
    """Stamps that come more than once."""
    for stream, stamps in _timed(survey):
        count = int(stamps.size - np.unique(stamps).size)
        if count:
            share = count / stamps.size
            yield Finding(
                WARNING if share > 0.01 else NOTE,
                stream.name,
                f"{count} of {stamps.size} messages have a stamp that was there before",
                "of several with the same stamp the first counts, the others are left out",
                "if they differ, the stamps are too coarse: let the driver stamp in nanoseconds",
                values={"duplicates": count},
            )


def out_of_order(survey: Survey) -> Iterator[Finding]:
    """Messages that arrived later than ones with a later stamp."""
    for stream, stamps in _timed(survey):
        back = np.diff(stamps)
        late = back[(back < 0) & (back > -JUMP_NS)]
        if late.size:
            yield Finding(
                NOTE,
                stream.name,
                f"{late.size} messages arrived after later ones, up to {-late.min() / 1e6:.1f} ms late",
                "none offline, where samples are sorted by their stamps; a live run leaves them out",
                "fit the bag rather than live, or let the estimator wait",
                values={"late": int(late.size), "latest": float(-late.min()) / 1e9},
            )


def clock_jumps(survey: Survey) -> Iterator[Finding]:
    """Stamps that leave the log times behind: a clock was set during the recording."""
    for stream, stamps in _timed(survey):
        difference = stamps - stream.log_ns
        jumps = np.diff(difference)
        found = np.flatnonzero(np.abs(jumps) > JUMP_NS)
        # A gap of the recorder moves both alike; a sensor that was silent moves neither against the other.
        if found.size:
            first = int(found[0])
            at = (stream.log_ns[first + 1] - stream.log_ns[0]) / 1e9
            yield Finding(
                ERROR,
                stream.name,
                f"{found.size} times the stamps jump against the time of recording, first {at:.2f} s"
                " after the"
                f" start, by {jumps[first] / 1e9:+.3f} s",
                "samples from before and after are mixed or torn apart when they are sorted",
                "let the clocks settle (chrony, PTP) before recording; cut this bag at the jump",
                values={"jumps": int(found.size), "first": float(at), "size": float(jumps[first]) / 1e9},
            )


def clock_offset(survey: Survey) -> Iterator[Finding]:
    """Sensor and speed stamped by clocks that don't agree."""
    timed = dict(_by_name(survey))
    imu, speed = timed.get(survey.imu_topic or ""), timed.get(survey.speed_topic or "")
    if imu is None or speed is None:
        return
    overlap = min(imu.max(), speed.max()) - max(imu.min(), speed.min())
    shorter = min(np.ptp(imu), np.ptp(speed))
    if overlap < 0.5 * shorter:
        between = (np.median(speed) - np.median(imu)) / 1e9
        yield Finding(
            ERROR,
            survey.speed_topic or "",
            f"its stamps lie {between:+.1f} s from those of {survey.imu_topic}, and hardly overlap with them",
            "no speed belongs to the sensor's samples",
            "stamp both by one clock; until then give the speed by hand",
            f"./tms fit run {survey.path} --fix speed=V",
            {"offset": float(between)},
        )


def _by_name(survey: Survey) -> Iterator[tuple[str, IntArray]]:
    return ((stream.name, stamps) for stream, stamps in _timed(survey))
