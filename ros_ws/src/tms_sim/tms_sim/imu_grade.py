"""Inertial sensors as data: noise and limits, one YAML file each in the folder `imus/`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tms_model import ParameterError
from tms_model.bicycle import Array
from tms_model.catalogue import check_keys, number, read_yaml

FOLDER = Path(__file__).parent / "imus"


@dataclass(frozen=True)
class ImuGrade:
    """What a sensor adds to the truth. Names and units of the noise densities are Kalibr's."""

    gyroscope_noise_density: float  # [rad/s/sqrt(Hz)]
    gyroscope_limit: float  # [rad/s] per axis, infinite: none
    accelerometer_noise_density: float  # [m/s^2/sqrt(Hz)]
    accelerometer_limit: float  # [m/s^2] per axis, infinite: none

    def gyroscope_std(self, rate: float) -> float:
        """Standard deviation of one sample [rad/s] at a sample rate [Hz]."""
        return self.gyroscope_noise_density * math.sqrt(rate)

    def accelerometer_std(self, rate: float) -> float:
        """Standard deviation of one sample [m/s^2] at a sample rate [Hz]."""
        return self.accelerometer_noise_density * math.sqrt(rate)


def imu_names() -> list[str]:
    """Names of the shipped sensors, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def load_imu(name: str) -> ImuGrade:
    """Sensor by name. Raises ParameterError."""
    if name not in imu_names():
        raise ParameterError(f"imu.grade: unknown sensor {name!r}; expected one of {', '.join(imu_names())}")
    path = FOLDER / f"{name}.yaml"
    document = read_yaml(path)
    densities = ("gyroscope_noise_density", "accelerometer_noise_density")
    limits = ("gyroscope_limit", "accelerometer_limit")
    check_keys(document, ("description", "source", "uncertainty", *densities, *limits), str(path))
    values = {key: number(document[key], f"{path}: {key}") for key in densities}
    for key in limits:
        values[key] = math.inf if document[key] is None else number(document[key], f"{path}: {key}")
    for key, value in values.items():
        if value < 0.0 or (key in limits and value == 0.0):
            raise ParameterError(f"{path}: {key}: expected a positive number, found {value:g}")
    return ImuGrade(**values)


def measure(
    truth: Array, std: float, limit: float, rng: np.random.Generator
) -> tuple[Array, NDArray[np.bool_]]:
    """Readings (n, 3): truth (n, 3) plus white noise, cut off at +-limit; and which were cut off (n, 3)."""
    noisy = truth + std * rng.standard_normal(truth.shape)
    return np.clip(noisy, -limit, limit), np.abs(noisy) >= limit
