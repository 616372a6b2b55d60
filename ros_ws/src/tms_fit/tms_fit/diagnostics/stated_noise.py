"""Stated noise of one sample, for the comparison with the residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from tms_bag import Recording
from tms_model.bicycle import Array
from tms_model.frames import flip_axes, rotation_matrix

from tms_fit.gyroscopes import orientation_of
from tms_fit.parameters import CHANNELS
from tms_fit.settings import Settings


@dataclass(frozen=True)
class StatedNoise:
    """Standard deviation of one sample of each channel."""

    std: dict[str, float]  # [rad/s] by channel
    by: str  # noise_std (the setting) or recording (covariance in the IMU's messages)

    @property
    def in_words(self) -> str:
        """As a half sentence."""
        rates = " and ".join(
            f"{value:.3g} rad/s ({name.replace('_', ' ')})" for name, value in self.std.items()
        )
        if len(set(self.std.values())) == 1:
            rates = f"{next(iter(self.std.values())):.3g} rad/s"
        return f"{rates}, stated by {'--noise-std' if self.by == 'noise_std' else 'the recording'}"


def stated_noise(recording: Recording, settings: Settings) -> StatedNoise | None:
    """Noise by the settings, else by the covariance in the recording's IMU messages; None: not stated.

    Variances of the sensor's axes are turned into those of the rear frame. The yaw rate is taken as the
    downward axis, which it is to second order of the lean angle.
    """
    if settings.noise_std is not None:
        return StatedNoise(dict.fromkeys(CHANNELS, settings.noise_std), "noise_std")
    variance = _in_rear_frame(recording.imu.angular_velocity_variance, orientation_of(recording.run_info))
    std = {
        name: math.sqrt(float(one))
        for name, one in zip(CHANNELS, variance[[0, 2]], strict=True)
        if np.isfinite(one) and one > 0.0
    }
    return StatedNoise(std, "recording") if std else None


def _in_rear_frame(variance: Array, orientation: Array) -> Array:
    """Variances (3,) of the sensor's axes, independent of each other, in the axes of the rear frame."""
    squares = flip_axes(rotation_matrix(orientation).T).T ** 2
    enters = squares > 1e-12  # an axis whose variance is unknown spoils only what it enters
    turned: Array = np.sum(np.where(enters, squares * variance, 0.0), axis=1)
    return turned
