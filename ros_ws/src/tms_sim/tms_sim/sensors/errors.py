"""Errors of a sensor with three axes.

    reading = rounded((I + scale and misalignment) truth + bias + random walk + white noise), cut at the limit

Noise densities and random walks as in Kalibr's IMU noise model
(https://github.com/ethz-asl/kalibr/wiki/IMU-Noise-Model): one sample's white noise has the standard deviation
density * sqrt(rate), the bias moves by random walk * sqrt(1 / rate) from one sample to the next. Allan
deviation at an averaging time T: density / sqrt(T), random walk * sqrt(T / 3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_sim.imu_grade import SensorErrors


@dataclass(frozen=True, eq=False)
class Imperfection:
    """What one sensor has of bias, scale and misalignment: the same throughout a run."""

    matrix: Array  # (3, 3), I for a perfect sensor
    bias: Array  # (3,) [u]

    def steady(self, truth: Array) -> Array:
        """Readings (n, 3) without noise, limits and rounding."""
        distorted: Array = truth @ self.matrix.T + self.bias
        return distorted


@dataclass(frozen=True, eq=False)
class Readings:
    """What a sensor reads, and where it could not."""

    values: Array  # (n, 3) [u]
    cut: NDArray[np.bool_]  # (n, 3) the axis stands at its limit
    imperfection: Imperfection


def measure(truth: Array, errors: SensorErrors, rate: float, rng: np.random.Generator) -> Readings:
    """Readings of the truth (n, 3) [u], sampled at a constant rate [Hz].

    More samples at the end leave those before as they were.
    """
    fixed, white, walk = rng.spawn(3)
    imperfection = _imperfection(errors, fixed)
    values = imperfection.steady(truth)
    values = values + errors.noise_density * math.sqrt(rate) * white.standard_normal(truth.shape)
    steps = walk.standard_normal(truth.shape)
    steps[:1] = 0.0  # the bias of the run is that of its first sample
    values = values + errors.random_walk * math.sqrt(1.0 / rate) * np.cumsum(steps, axis=0)
    if errors.resolution > 0.0:
        values = errors.resolution * np.round(values / errors.resolution)
    return Readings(
        np.clip(values, -errors.limit, errors.limit), np.abs(values) >= errors.limit, imperfection
    )


def _imperfection(errors: SensorErrors, rng: np.random.Generator) -> Imperfection:
    bias, scale, tilt = rng.standard_normal(3), rng.standard_normal(3), rng.standard_normal((3, 3))
    tilt[np.diag_indices(3)] = 0.0
    matrix = np.eye(3) + errors.scale * np.diag(scale) + errors.misalignment * tilt
    return Imperfection(matrix, errors.bias * bias)
