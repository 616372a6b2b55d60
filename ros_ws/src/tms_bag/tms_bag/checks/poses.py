"""Readings of an accelerometer at rest, with the bicycle in a known pose."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tms_model import ParameterError

from tms_bag import conversion, topics
from tms_bag.errors import RecordingError
from tms_bag.logs.csv_log import number_in, text_of
from tms_bag.reading.reader import BagReader
from tms_bag.samples import FloatArray

AXES = ("x", "y", "z")
MOVING = 0.5  # [m/s^2] standard deviation of a component that isn't rest any more
_WORDS = ("acc", "force")  # what columns of an accelerometer are called in logs


@dataclass(frozen=True, eq=False)
class RestPose:
    """Mean reading of the accelerometer at rest."""

    up: str  # axis of the bicycle that pointed up: x, -x, y, ...
    force: FloatArray  # (3,) [m/s^2] in the sensor's axes
    name: str  # of its file


def direction(axis: str) -> FloatArray:
    """Unit vector (3,) of x, -x, y, ..."""
    vector = np.zeros(3)
    vector[AXES.index(axis.lstrip("+-"))] = -1.0 if axis.startswith("-") else 1.0
    return vector


def read_pose(text: str) -> RestPose:
    """A pose from AXIS=FILE: which axis of the bicycle points up, and a bag or a CSV log of that pose.

    ParameterError for a text of another form, RecordingError if the file tells nothing or wasn't at rest.
    """
    axis, equals, name = text.partition("=")
    if not equals or not name or axis.lstrip("+-") not in AXES or len(axis) > 2:
        raise ParameterError(
            "--rest-pose: expected AXIS=BAG_OR_LOG, with the axis of the bicycle that points up (x"
            " forward, y left,"
            f" z up, or -x, -y, -z), found {text!r}"
        )
    path = Path(name)
    force = _of_bag(path) if path.is_dir() or path.suffix in (".mcap", ".db3") else _of_csv(path)
    force = force[np.isfinite(force).all(axis=1)]
    if len(force) < 10:
        raise RecordingError(f"{path}: expected 10 or more readings of an accelerometer, found {len(force)}")
    if force.std(axis=0).max() > MOVING:
        raise RecordingError(
            f"{path}: expected an accelerometer at rest, found readings that scatter by"
            f" {force.std(axis=0).max():.2f} m/s^2; hold the bicycle still"
        )
    mean = force.mean(axis=0)
    if np.linalg.norm(mean) < 0.1:
        raise RecordingError(f"{path}: expected gravity in the readings, found {mean.tolist()}")
    return RestPose(axis, mean, path.name)


def _of_bag(path: Path) -> FloatArray:
    kind = topics.TYPES[topics.IMU]
    with BagReader(path) as bag:
        names = [topic.name for topic in bag.topics if topic.type == kind and topic.count]
        if len(names) != 1:
            raise RecordingError(
                f"{path}: expected one topic of type {kind} in a rest pose, found"
                f" {', '.join(names) or 'none'}"
            )
        return conversion.imu_samples(
            bag.columns({names[0]: conversion.FIELDS[topics.IMU]})[names[0]]
        ).specific_force


def _of_csv(path: Path) -> FloatArray:
    """Three columns whose names differ in their last letter only: x, y, z."""
    rows = csv.reader(io.StringIO(text_of(path)))
    try:
        header = [name.strip() for name in next(rows, [])]
        stems = {
            name[:-1]
            for name in header
            if name.lower().endswith("x") and any(w in name.lower() for w in _WORDS)
        }
        stems = {stem for stem in stems if {stem + "y", stem + "z"} <= {*header}}
        if len(stems) != 1:
            raise RecordingError(
                f"{path}: expected three columns of an accelerometer such as acc_x, acc_y, acc_z, found"
                f" {', '.join(header)[:200]}"
            )
        (stem,) = stems
        places = [header.index(stem + axis) for axis in AXES]
        values = [
            [number_in(row[place]) if place < len(row) else np.nan for place in places] for row in rows if row
        ]
    except csv.Error as error:
        raise RecordingError(f"{path}: can't be read as CSV ({error}, line {rows.line_num})") from error
    found = np.array(values, dtype=np.float64).reshape(-1, 3)
    found[np.isinf(found)] = np.nan
    return found
