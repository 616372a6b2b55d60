"""Source of the forward speed: fixed, measured, prior or nominal."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import Any

from tms_bag import Recording, RecordingError
from tms_bag.speed_topic import KINDS, is_command

from tms_fit.settings import Settings
from tms_fit.speed_profile import FIXED, MEASURED, NOMINAL, PRIOR
from tms_fit.window import Window

CHOICES = "use --fix speed=V [m/s], or --prior speed=MEAN,STD where it is to be found"


def recording_source(recording: Recording, settings: Settings) -> str:
    """Source of the speed of a recording: fixed, measured, prior or run_info."""
    if "speed" in settings.fixed:
        return FIXED
    if recording.speed is not None:
        return MEASURED
    return PRIOR if "speed" in settings.priors else NOMINAL


def nominal_speed(recording: Recording, settings: Settings) -> float:
    """Speed [m/s] where none is measured: of the settings, else of the run_info; NaN: unknown."""
    stated = settings.stated_speed
    info = recording.run_info
    return stated if math.isfinite(stated) or info is None else info.speed


def check_speed(recording: Recording, settings: Settings) -> None:
    """Raise RecordingError where the speed is unknown, or measured but not to be had without a choice.

    The nominal speed of run_info does not stand in for a topic of a measured one.
    """
    if recording.speed is not None or math.isfinite(settings.stated_speed):
        return
    topic, path = recording.speed_topic, recording.path
    if topic.candidates:
        raise RecordingError(
            f"{path}: expected one topic of a measured speed, found {', '.join(topic.candidates)}; choose"
            f" one with {topic.flags}, or {CHOICES}"
        )
    if topic.name is not None:
        raise RecordingError(
            f"{path}: expected the messages of {topic.name} that the bag counts, found none: it is damaged;"
            f" {CHOICES}"
        )
    if not math.isfinite(nominal_speed(recording, settings)):
        taken = f"; {topic.remark}" if topic.commands else ""
        raise RecordingError(f"{path}: expected a topic bicycle/speed, found none; {CHOICES}{taken}")


def speed_sentence(recording: Recording, settings: Settings) -> str:
    """Which speed a fit of a recording uses, and where it is from."""
    source = recording_source(recording, settings)
    if source == FIXED:
        return f"speed {settings.fixed['speed']:.3f} m/s, fixed" + _unused(recording)
    if source == MEASURED and recording.speed is not None:
        where = f" on {recording.speed_topic.name}" if recording.speed_topic.name else ""
        return f"speed measured{where}, {len(recording.speed.time_ns)} readings"
    value = nominal_speed(recording, settings)
    if source == PRIOR:
        return f"speed {value:.3f} m/s, the mean of its prior: none was measured"
    return f"speed {value:.3f} m/s, the nominal one of run_info: none was measured"


def speed_json(recording: Recording, settings: Settings) -> dict[str, Any]:
    """Source of the speed of a recording, its topic and its value [m/s], null where it is measured."""
    source = recording_source(recording, settings)
    measured = source == MEASURED
    return {
        "source": source,
        "topic": recording.speed_topic.name if measured else None,
        "value": None if measured else nominal_speed(recording, settings),
        "text": speed_sentence(recording, settings),
    }


def speed_remark(window: Window) -> str:
    """One clause where the speed of a free response is the nominal one; else empty."""
    if window.speed.source != NOMINAL:
        return ""
    return (
        f"the speed of {window.start_speed:.3f} m/s is the nominal one of run_info: none was measured up to"
        " the window's end"
    )


def live_speed_sentence(source: str, topic: str, others: Sequence[str]) -> str:
    """Which speed a live run uses; others: topics of a speed's type that are not read instead of `topic`."""
    texts = {
        FIXED: "speed fixed",
        MEASURED: f"speed measured on {topic}",
        PRIOR: "speed: the mean of its prior, none was measured",
        NOMINAL: "speed: the nominal one of run_info, none was measured",
        "": f"no speed: no message on {topic}",
    }
    if source in (FIXED, MEASURED) or not others:
        return texts[source]
    return f"{texts[source]}; {others[0]} may hold it: -r {topic.lstrip('/')}:={others[0]}"


def other_speed_topics(topics: Iterable[tuple[str, Sequence[str]]], read: Collection[str]) -> list[str]:
    """Topics (name, types) of a speed's type that are no commands and are not read."""
    return [
        name
        for name, types in topics
        if name not in read and KINDS.keys() & set(types) and not is_command(name)
    ]


def _unused(recording: Recording) -> str:
    """What a fixed speed takes the place of."""
    topic = recording.speed_topic.name if recording.speed is not None else None
    return f" in place of {topic}" if topic else ""
