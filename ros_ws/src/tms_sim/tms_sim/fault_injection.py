"""Faults asked for by name, put into recorded or simulated messages, and told as events of the truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from tms_bag import Record, RecordingError
from tms_bag.event import event_records
from tms_bag.record import merged
from tms_model import ParameterError

from tms_sim.faults import FAULTS, Fault
from tms_sim.motion import Event
from tms_sim.stream import Stream, read_stream, write_stream
from tms_sim.truth import true_events

NONE = "none"


@dataclass(frozen=True)
class Request:
    """A fault with its settings and its window."""

    name: str
    settings: dict[str, float | str]  # all of the fault's own
    time: float  # [s since the start] when it begins
    duration: float  # [s], infinite: to the end
    topic: str | None  # None: those of the fault

    @property
    def fault(self) -> Fault:
        """What it does."""
        return FAULTS[self.name]


def parse_request(asked: str) -> Request:
    """Request from NAME or NAME:key=value,key=value. Raises ParameterError."""
    name, _, rest = asked.strip().partition(":")
    name = name.strip()
    if name not in FAULTS:
        raise ParameterError(f"fault: unknown {name!r}; expected one of {', '.join(FAULTS)}")
    fault = FAULTS[name]
    known: dict[str, float | str] = {"time": 0.0, "duration": 0.0, "topic": "", **fault.defaults}
    for part in filter(None, (item.strip() for item in rest.split(","))):
        key, equals, value = (item.strip() for item in part.partition("="))
        if not equals or key not in known:
            raise ParameterError(
                f"fault {name}: expected {', '.join(f'{k}=...' for k in known)}, found {part!r}"
            )
        known[key] = value if isinstance(known[key], str) else _number(name, key, value)
    if known.get("axis", "all") not in ("x", "y", "z", "all") or known.get("other", "x") not in (
        "x",
        "y",
        "z",
    ):
        raise ParameterError(f"fault {name}: expected an axis x, y or z, found {known['axis']!r}")
    if not 0.0 <= float(known.get("share", 0.0)) <= 1.0:
        raise ParameterError(f"fault {name}: expected a share from 0 to 1, found {known['share']}")
    for key in ("time", "duration", "delay", "std"):
        if float(known.get(key, 0.0)) < 0.0:
            raise ParameterError(f"fault {name}: expected {key} of at least 0, found {known[key]}")
    time, duration, topic = float(known.pop("time")), float(known.pop("duration")), str(known.pop("topic"))
    return Request(name, known, time, duration or math.inf, ("/" + topic.lstrip("/")) if topic else None)


def parse_requests(asked: str) -> list[Request]:
    """Requests from a text with ';' between them, 'none' for none. Raises ParameterError."""
    if asked.strip() == NONE:
        return []
    return [parse_request(part) for part in asked.split(";") if part.strip()]


def timed(asked: str, time: float) -> str:
    """The text of some requests, those that don't say when beginning at a time [s since the start]."""
    parts = [part.strip() for part in asked.split(";") if part.strip()]
    if asked.strip() == NONE:
        return NONE
    return "; ".join(part if _says_when(part) else _begun(part, time) for part in parts)


def _says_when(part: str) -> bool:
    return any(item.strip().startswith("time") for item in part.partition(":")[2].split(","))


def _begun(part: str, time: float) -> str:
    name, _, rest = part.partition(":")
    return f"{name}:time={time:.6f}" + (f",{rest}" if rest.strip() else "")


def inject(
    records: Iterable[Record], requests: Sequence[Request], start_ns: int, rng: np.random.Generator
) -> tuple[list[Record], list[Event]]:
    """The records with the faults in them, in the order of log time, and an event for each fault.

    start_ns: [ns] what the requests' times count from. Raises RecordingError where a topic isn't there.
    """
    numbered = list(enumerate(records))
    events = []
    for request, own in zip(requests, rng.spawn(len(requests)), strict=True):
        present = sorted({record.topic for _, record in numbered})
        chosen = _topics(request, present)
        changed = []
        for topic, generator in zip(chosen, _alike(own, len(chosen)), strict=True):
            stream = read_stream([entry for entry in numbered if entry[1].topic == topic])
            hit = _window(stream, request, start_ns)
            spoilt = request.fault.apply(stream, hit, request.settings, generator)
            changed += list(write_stream(spoilt))
        numbered = [entry for entry in numbered if entry[1].topic not in chosen] + changed
        numbered.sort(key=lambda entry: (entry[1].time_ns, entry[0]))
        last = max((record.time_ns for _, record in numbered), default=start_ns)
        events.append(_event(request, chosen, (last - start_ns) / 1e9))
    return [record for _, record in numbered], events


def with_faults(
    records: Iterable[Record], requests: Sequence[Request], start_ns: int, rng: np.random.Generator
) -> Iterator[Record]:
    """The records with the faults in them, and with the events that tell them."""
    spoilt, events = inject(records, requests, start_ns, rng)
    return merged(spoilt, event_records(true_events(events, start_ns)))  # run_info stays the first


def _topics(request: Request, present: list[str]) -> list[str]:
    if request.topic is not None:
        if request.topic in present:
            return [request.topic]
        raise RecordingError(
            f"fault {request.name}: expected a topic {request.topic} with messages, found"
            f" {', '.join(present)}"
        )
    found = [name for name in present if name.endswith(tuple("/" + topic for topic in request.fault.topics))]
    if not found:
        wanted = ", ".join(request.fault.topics)
        raise RecordingError(
            f"fault {request.name}: expected one of the topics {wanted}, found"
            f" {', '.join(present)}; choose one with topic="
        )
    return found


def _alike(rng: np.random.Generator, count: int) -> list[np.random.Generator]:
    """Generators that draw the same: a packet that is lost is lost on all topics of its sensor."""
    (seed,) = rng.spawn(1)
    state = int(seed.integers(2**63))
    return [np.random.default_rng(state) for _ in range(count)]


def _window(stream: Stream, request: Request, start_ns: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Messages stamped inside the fault's window, half open."""
    since = (stream.stamp_ns - start_ns) / 1e9
    inside: np.ndarray[tuple[int], np.dtype[np.bool_]] = (since >= request.time) & (
        since < request.time + request.duration
    )
    return inside


def _event(request: Request, chosen: list[str], end: float) -> Event:
    settings = ", ".join(f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
                         for key, value in request.settings.items())  # fmt: skip
    figures = {key: value for key, value in request.settings.items() if isinstance(value, float)}
    return Event(
        time=request.time,
        kind="fault",
        text=f"{request.name}: {request.fault.text}, on {', '.join(chosen)}"
        + (f" ({settings})" if settings else ""),
        duration=max(min(request.duration, end - request.time), 0.0),
        figures=figures,
    )


def _number(name: str, key: str, value: str) -> float:
    try:
        found = float(value)
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise ParameterError(f"fault {name}: expected a number for {key}, found {value!r}")
    return found
