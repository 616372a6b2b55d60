"""Recorded quantities as arrays, and the messages that carry them.

Times are integer nanoseconds since 1970 (`header.stamp`); n is the number of samples; NaN: absent. SI units
and radians. ImuSamples are in the axes of the imu frame (REP-103); everything else carries the model's SAE
signs (x forward, y right, z down). Nothing is converted between the two here: a message holds what its array
holds.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from tms_bag.growing import Growing, Rows

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def _unknown_variance() -> FloatArray:
    return np.full(3, np.nan)


def _none() -> FloatArray:
    return np.empty(0)


def _no_place() -> FloatArray:
    return np.empty((0, 2))


def _no_phase() -> NDArray[np.uint8]:
    return np.empty(0, np.uint8)


def _identity() -> FloatArray:
    return np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class ImuSamples:
    """Readings of an inertial sensor, in its own axes."""

    time_ns: IntArray  # (n,) [ns]
    angular_velocity: FloatArray  # (n, 3) [rad/s]
    specific_force: FloatArray  # (n, 3) [m/s^2], +g along the axis that points up at rest (REP-145)
    angular_velocity_variance: FloatArray = field(
        default_factory=_unknown_variance
    )  # (3,) [rad^2/s^2], NaN: unknown
    specific_force_variance: FloatArray = field(
        default_factory=_unknown_variance
    )  # (3,) [m^2/s^4], NaN: unknown
    frame_id: str = "imu_link"
    # (n, 4) quaternion x, y, z, w of the sensor in the world (x east, y north, z up); None: it has none
    orientation: FloatArray | None = None
    orientation_variance: FloatArray = field(
        default_factory=_unknown_variance
    )  # (3,) [rad^2] about the world's axes, NaN: unknown


@dataclass(frozen=True, eq=False)
class MagneticSamples:
    """Readings of a magnetometer, in its own axes (REP-103)."""

    time_ns: IntArray  # (n,) [ns]
    magnetic_field: FloatArray  # (n, 3) [T]
    magnetic_field_variance: FloatArray = field(default_factory=_unknown_variance)  # (3,) [T^2], NaN: unknown
    frame_id: str = "imu_link"


@dataclass(frozen=True, eq=False)
class LeanYawSamples:
    """Lean and yaw of the rear frame, as a sensor node sums them up."""

    time_ns: IntArray  # (n,) [ns]
    lean: FloatArray  # (n,) [rad], to the right positive
    lean_rate: FloatArray  # (n,) [rad/s]
    yaw_rate: FloatArray  # (n,) [rad/s], about the vertical, to the right positive
    saturation: NDArray[np.uint8]  # (n,) flags of tms_msgs/LeanYaw, 0: no axis at its limit


@dataclass(frozen=True, eq=False)
class SpeedSamples:
    """Forward speed; what is left out is NaN."""

    time_ns: IntArray  # (n,) [ns]
    speed: FloatArray  # (n,) [m/s]
    variance: FloatArray = field(default_factory=_none)  # (n,) [m^2/s^2], NaN: unknown

    def __post_init__(self) -> None:
        if len(self.variance) == 0 and self.time_ns.size:
            object.__setattr__(self, "variance", np.full(self.time_ns.size, np.nan))


@dataclass(frozen=True, eq=False)
class SteerTorqueSamples:
    """Known steer torque (commanded or measured)."""

    time_ns: IntArray  # (n,) [ns], each value holds from its time on
    steer_torque: FloatArray  # (n,) [N m], positive steers to the right


@dataclass(frozen=True, eq=False)
class StateSamples:
    """True state of a simulated bicycle; what is left out is NaN, and phase 0 (tms_msgs/BicycleState)."""

    time_ns: IntArray  # (n,) [ns]
    speed: FloatArray  # (n,) [m/s]
    state: FloatArray  # (n, 4) lean [rad], steer [rad], lean rate [rad/s], steer rate [rad/s]
    yaw: FloatArray  # (n,) [rad]
    yaw_rate: FloatArray  # (n,) [rad/s]
    steer_torque: FloatArray  # (n,) [N m]
    phase: NDArray[np.uint8] = field(default_factory=_no_phase)  # (n,) constants of tms_msgs/BicycleState
    acceleration: FloatArray = field(default_factory=_none)  # (n,) [m/s^2] of the speed
    lean_acceleration: FloatArray = field(default_factory=_none)  # (n,) [rad/s^2]
    steer_acceleration: FloatArray = field(default_factory=_none)  # (n,) [rad/s^2]
    yaw_acceleration: FloatArray = field(default_factory=_none)  # (n,) [rad/s^2]
    rear_contact: FloatArray = field(default_factory=_no_place)  # (n, 2) [m] x, y on the floor
    front_contact: FloatArray = field(default_factory=_no_place)  # (n, 2) [m] x, y on the floor
    rear_slip: FloatArray = field(default_factory=_none)  # (n,) [m/s] lateral, to the right positive
    front_slip: FloatArray = field(default_factory=_none)  # (n,) [m/s] lateral, to the right positive

    def __post_init__(self) -> None:
        for entry in dataclasses.fields(self):
            values = getattr(self, entry.name)
            if len(values) == 0 and self.time_ns.size:
                shape = (self.time_ns.size, *values.shape[1:])
                absent = np.zeros(shape, np.uint8) if values.dtype == np.uint8 else np.full(shape, np.nan)
                object.__setattr__(self, entry.name, absent)


@dataclass(frozen=True, eq=False)
class RunInfo:
    """What a run was and what made it. NaN, empty, -1: unknown."""

    start_ns: int  # [ns] start of the run
    bicycle: str = ""  # name in the catalogue
    parameters: dict[str, float] = field(default_factory=dict)  # of the bicycle, SI units and radians
    speed: float = float("nan")  # [m/s] nominal
    imu_position: FloatArray = field(
        default_factory=_unknown_variance
    )  # (3,) [m] in rear_frame, REP-103 axes
    imu_orientation: FloatArray = field(
        default_factory=_identity
    )  # (4,) quaternion x, y, z, w, imu -> rear_frame
    simulated: bool = False
    seed: int = -1
    source: str = ""  # program and scenario, or logger and mapping
    version: str = ""
    source_sha256: str = ""  # of the file it was imported from
    configuration: str = ""  # resolved, as YAML


Samples = TypeVar(
    "Samples", ImuSamples, MagneticSamples, LeanYawSamples, SpeedSamples, SteerTorqueSamples, StateSamples
)

_PER_RUN = frozenset(
    {
        "angular_velocity_variance",
        "specific_force_variance",
        "orientation_variance",
        "magnetic_field_variance",
    }
)


def selected(samples: Samples, rows: IntArray | NDArray[np.bool_] | slice) -> Samples:
    """The samples at some rows (indices, a mask or a slice), everything else unchanged."""
    arrays = {
        entry.name: getattr(samples, entry.name)[rows]
        for entry in dataclasses.fields(samples)
        if entry.name not in _PER_RUN and isinstance(getattr(samples, entry.name), np.ndarray)
    }
    return dataclasses.replace(samples, **arrays)


class Joining(Generic[Samples]):
    """Samples of several stretches of one recording, one after the other; what is per run is the first's.

    Each part is copied to its place and not kept: memory is that of the whole, and of one part.
    """

    def __init__(self, expected: int) -> None:
        self._expected = expected  # samples to make room for at once; more when more come
        self._first: Samples | None = None
        self._arrays: dict[str, Growing] = {}
        self._count = 0

    def add(self, part: Samples) -> None:
        """The next stretch. A quantity that only some of the stretches have is NaN in the others."""
        self._first = part if self._first is None else self._first
        for entry in dataclasses.fields(part):
            values = getattr(part, entry.name)
            if entry.name in _PER_RUN or not isinstance(values, np.ndarray):
                continue
            if entry.name not in self._arrays:
                self._arrays[entry.name] = Growing(values.dtype, values.shape[1:], self._expected)
            self._arrays[entry.name].put(Rows(self._count, part.time_ns.size), values)
        self._count += part.time_ns.size

    def whole(self) -> Samples | None:
        """All of them; None without a part."""
        if self._first is None:
            return None
        arrays: dict[str, Any] = {name: array.whole(self._count) for name, array in self._arrays.items()}
        return dataclasses.replace(self._first, **arrays)


def in_time_order(samples: Samples) -> tuple[Samples, int]:
    """The samples sorted by time, of those with the same time only the first, and how many were left out."""
    if (samples.time_ns[1:] > samples.time_ns[:-1]).all():
        return samples, 0
    order = np.argsort(samples.time_ns, kind="stable")
    times = samples.time_ns[order]
    first = np.ones(times.size, dtype=bool)
    first[1:] = times[1:] != times[:-1]
    return selected(samples, order[first]), int(times.size - first.sum())
