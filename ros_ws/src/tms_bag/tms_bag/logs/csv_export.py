"""Topics of a bag as one CSV table: a row for each stamp, a column for each number."""

from __future__ import annotations

import csv
import fnmatch
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tms_bag.errors import RecordingError
from tms_bag.reading.columns import Column, Columns
from tms_bag.reading.reader import BagReader
from tms_bag.samples import IntArray

TIME, SECONDS = "time [ns]", "time since start [s]"
MOST_CELLS = 2**27  # an hour of everything at 100 Hz has 10 million

# Units of fields by type, for the headers.
UNITS: dict[str, dict[str, str]] = {
    "sensor_msgs/msg/Imu": {"angular_velocity.*": "rad/s", "linear_acceleration.*": "m/s^2"},
    "sensor_msgs/msg/MagneticField": {"magnetic_field.*": "T"},
    "sensor_msgs/msg/JointState": {"position": "rad", "velocity": "rad/s", "effort": "N m"},
    "geometry_msgs/msg/TwistStamped": {"twist.linear.*": "m/s", "twist.angular.*": "rad/s"},
    "geometry_msgs/msg/TwistWithCovarianceStamped": {
        "twist.twist.linear.*": "m/s",
        "twist.twist.angular.*": "rad/s",
    },
    "tms_msgs/msg/LeanYaw": {"lean": "rad", "lean_rate": "rad/s", "yaw_rate": "rad/s"},
    "tms_msgs/msg/SteerTorque": {"steer_torque": "N m"},
    "tms_msgs/msg/BicycleState": {
        "speed": "m/s",
        "acceleration": "m/s^2",
        "lean": "rad",
        "steer": "rad",
        "yaw": "rad",
        "*_rate": "rad/s",
        "*_acceleration": "rad/s^2",
        "steer_torque": "N m",
        "*_contact": "m",
        "*_slip": "m/s",
    },
}

Progress = Callable[[Iterable[int]], Iterable[int]]


@dataclass(frozen=True)
class Export:
    """What was written."""

    output: Path
    rows: int
    columns: tuple[str, ...]


def export_csv(
    bag: str | os.PathLike[str],
    output: str | os.PathLike[str],
    topics: Collection[str] | None = None,
    fields: Collection[str] | None = None,
    delimiter: str = ",",
    decimal: str = ".",
    overwrite: bool = False,
    progress: Progress = iter,
) -> Export:
    """Write a table; numbers come back from it as they were, to the last bit.

    `topics` None: all whose messages can be columns. `fields` are patterns of field names such as
    'angular_velocity.*'; None: all numbers that aren't arrays. RecordingError if nothing fits, or if
    there is a file already that isn't to be replaced.
    """
    target = Path(output)
    if target.exists() and not (overwrite and target.is_file()):
        raise RecordingError(
            f"{target}: exists already; choose another name, or say --force to replace a file"
        )
    with BagReader(bag) as reader:
        tables = list(_tables(reader, topics))
    parts = [(table, _chosen(table, fields)) for table in tables]
    parts = [(table, columns) for table, columns in parts if columns]
    if not parts:
        raise RecordingError(
            f"{bag}: expected messages with numbers to write, found none"
            + (f" of {', '.join(fields)}" if fields else "")
            + "; `tms bag info` lists the topics"
        )
    times, places = _rows([table.time_ns for table, _ in parts])
    names = [TIME, SECONDS, *(name for _, columns in parts for name in columns)]
    if times.size * len(names) > MOST_CELLS:
        raise RecordingError(
            f"{bag}: {times.size} rows of {len(names)} columns are too many; choose --topics"
        )
    values = [
        (place, column)
        for place, (_, columns) in zip(places, parts, strict=True)
        for column in columns.values()
    ]
    _write(target, names, times, values, delimiter, decimal, progress)
    return Export(target, int(times.size), tuple(names))


def _tables(reader: BagReader, topics: Collection[str] | None) -> Iterator[Columns]:
    """Messages of the topics asked for; of all, those that can't be columns are left out."""
    if topics is not None:
        found = reader.columns(dict.fromkeys(topics))
        yield from (found[name] for name in topics)
        return
    for topic in reader.topics:
        if topic.count:
            try:
                yield reader.columns({topic.name: None})[topic.name]
            except RecordingError:
                continue


def _chosen(table: Columns, patterns: Collection[str] | None) -> dict[str, Column]:
    """Columns by their headers; arrays and sequences with one for each element."""
    units = UNITS.get(table.type, {})
    found: dict[str, Column] = {}
    for name, values in table.values.items():
        wanted = values.ndim == 1 if patterns is None else any(fnmatch.fnmatchcase(name, p) for p in patterns)
        if not wanted:
            continue
        unit = next((unit for pattern, unit in units.items() if fnmatch.fnmatchcase(name, pattern)), "")
        bracket = f" [{unit}]" if unit else ""
        if values.ndim == 1:
            found[f"{table.topic} {name}{bracket}"] = values
        else:
            for number in range(values.shape[1]):
                found[f"{table.topic} {name}[{number}]{bracket}"] = values[:, number]
    return found


def _rows(stamps: Sequence[IntArray]) -> tuple[IntArray, list[NDArray[np.int64]]]:
    """Time of each row, and for each topic which of its messages stands there (-1: none).

    Messages of different topics share a row if they have the same stamp; two of one topic never do.
    """
    keys = []
    orders = [np.argsort(times, kind="stable") for times in stamps]
    for times, order in zip(stamps, orders, strict=True):
        ordered = times[order]
        first = np.searchsorted(ordered, ordered, side="left")
        keys.append(np.stack([ordered, np.arange(ordered.size) - first], axis=1))
    unique, inverse = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    places, start = [], 0
    for order in orders:
        place = np.full(len(unique), -1, np.int64)
        place[inverse.ravel()[start : start + order.size]] = order
        places.append(place)
        start += order.size
    return unique[:, 0], places


def _write(
    target: Path,
    names: Sequence[str],
    times: IntArray,
    values: Sequence[tuple[NDArray[np.int64], Column]],
    delimiter: str,
    decimal: str,
    progress: Progress,
) -> None:
    """Written beside the target and renamed at the end: whoever finds the file finds all of it."""
    partial = target.with_name(f".{target.name}.{os.getpid()}.partial")
    seconds = (times - times[0]) / 1e9
    try:
        with partial.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, delimiter=delimiter)
            writer.writerow([_plain(name) for name in names])
            for row in progress(range(times.size)):
                cells = [
                    _text(column[place[row]], decimal) if place[row] >= 0 else "" for place, column in values
                ]
                writer.writerow([int(times[row]), _text(seconds[row], decimal), *cells])
        partial.replace(target)
    except OSError as error:
        raise RecordingError(f"{target}: can't be written ({error.strerror})") from error
    finally:
        with suppress(OSError):
            partial.unlink()


def _text(value: np.generic, decimal: str) -> str:
    """The shortest text that is read as the same number; empty for NaN, as the import takes it."""
    number = value.item()
    if isinstance(number, bool):
        return str(int(number))
    text = "" if number != number else repr(number)
    return text if decimal == "." else text.replace(".", decimal)


def _plain(name: str) -> str:
    """A header that no spreadsheet takes for a formula, whatever a bag calls its topics."""
    return f"'{name}" if name[:1] in "=+-@\t\r" else name
