"""Inertial sensors as data: one YAML file each in `imus/`, with Kalibr's names and units.

Kalibr's four noise terms and its update_rate must stand there, so that one of its files can be pasted; all
other errors are 0 where they're left out (`SensorErrors`), and Kalibr's rostopic is
ignored.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from tms_model import ParameterError
from tms_model.catalogue import check_keys, number, read_yaml


@dataclass(frozen=True)
class SensorErrors:
    """Sizes of the errors, the same for the three axes; u is the unit of the reading. 0 switches one off."""

    noise_density: float = 0.0  # [u/sqrt(Hz)] white noise
    random_walk: float = 0.0  # [u/s/sqrt(Hz)] the bias wanders
    bias: float = 0.0  # [u] standard deviation from run to run
    scale: float = 0.0  # [1] standard deviation of the relative error of each axis
    misalignment: float = 0.0  # [rad] standard deviation of each axis towards each of the others
    resolution: float = 0.0  # [u] step of the reading
    limit: float = math.inf  # [u] largest reading

    def noise_std(self, rate: float) -> float:
        """Standard deviation of the white noise and the rounding of one sample [u] at a sample rate [Hz]."""
        return math.sqrt(self.noise_density**2 * rate + self.resolution**2 / 12.0)


FOLDER = Path(__file__).parent / "imus"
TEXT = ("description", "source", "uncertainty")
TRIADS = ("gyroscope", "accelerometer", "magnetometer")
ERRORS = tuple(entry.name for entry in fields(SensorErrors))
_KALIBR = tuple(f"{triad}_{error}" for triad in TRIADS[:2] for error in ("noise_density", "random_walk"))


@dataclass(frozen=True)
class ImuGrade:
    """What a sensor adds to the truth, in rad/s, m/s^2 and T."""

    gyroscope: SensorErrors
    accelerometer: SensorErrors
    magnetometer: SensorErrors
    update_rate: float  # [Hz] at which the sensor is usually run

    def only(self, kept: Collection[str]) -> ImuGrade:
        """The same sensor with no other errors than those of ERRORS that are kept. Raises ParameterError."""
        if unknown := sorted(set(kept) - set(ERRORS)):
            raise ParameterError(
                f"imu.errors: expected 'all', 'none' or some of {', '.join(ERRORS)}, found"
                f" {', '.join(unknown)}"
            )
        return ImuGrade(
            _only(self.gyroscope, kept),
            _only(self.accelerometer, kept),
            _only(self.magnetometer, kept),
            self.update_rate,
        )


def _only(errors: SensorErrors, kept: Collection[str]) -> SensorErrors:
    return SensorErrors(**{name: getattr(errors, name) for name in kept})


def imu_names() -> list[str]:
    """Names of the shipped sensors, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def load_imu(name: str) -> ImuGrade:
    """Sensor by name. Raises ParameterError."""
    if name not in imu_names():
        raise ParameterError(f"imu.grade: unknown sensor {name!r}; expected one of {', '.join(imu_names())}")
    path = FOLDER / f"{name}.yaml"
    document = read_yaml(path)
    optional = tuple(f"{triad}_{error}" for triad in TRIADS for error in ERRORS)
    check_keys(
        document,
        (*TEXT, *_KALIBR, "update_rate"),
        str(path),
        ("rostopic", *(key for key in optional if key not in _KALIBR)),
    )
    errors = {triad: _errors(document, triad, str(path)) for triad in TRIADS}
    return ImuGrade(**errors, update_rate=_size(document["update_rate"], f"{path}: update_rate"))


def error_names(text: str) -> tuple[str, ...]:
    """Which errors a text asks for: 'all', 'none', or names with commas between."""
    if text.strip() == "all":
        return ERRORS
    return () if text.strip() == "none" else tuple(part.strip() for part in text.split(","))


def _errors(document: dict[str, Any], triad: str, where: str) -> SensorErrors:
    values = {}
    for name in ERRORS:
        key = f"{triad}_{name}"
        if name == "limit":
            values[name] = (
                math.inf
                if document.get(key) is None
                else _size(document[key], f"{where}: {key}", least=1e-12)
            )
        elif key in document:
            values[name] = _size(document[key], f"{where}: {key}")
    return SensorErrors(**values)


def _size(value: Any, where: str, least: float = 0.0) -> float:
    size = number(value, where)
    if size < least:
        raise ParameterError(f"{where}: expected a positive number, found {size:g}")
    return size
