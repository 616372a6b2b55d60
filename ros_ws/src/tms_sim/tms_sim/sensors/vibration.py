"""Vibration that an uneven floor gives the frame, and what the padding under the sensor lets through.

SOM chapter 10: 'small amplitude, but high frequency vibrations due to the road unevenness' drive the
accelerometers to their limit; padding attenuates them. The padding is the isolator of one mass, spring and
damper, with the transmissibility (2 z w s + w^2) / (s^2 + 2 z w s + w^2). Assumptions: the frame's
acceleration is Gaussian noise between LOW and HIGH, along the frame's own up axis, and grows with the speed;
the motion of the bicycle itself, a few hertz, passes the padding unchanged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import signal
from tms_model.bicycle import Array

LOW, HIGH = 20.0, 300.0  # [Hz] where the floor's unevenness is felt; assumption
REFERENCE_SPEED = 3.6  # [m/s] at which the floor's figure is given
INNER_RATE = 4000.0  # [Hz] of the vibration; a sensor without filter takes from it what aliases
LEAD = 0.5  # [s] of vibration before the first sample


@dataclass(frozen=True)
class Padding:
    """What the sensor is taped to."""

    natural_frequency: float  # [Hz], 0: no padding, the sensor sits on the frame
    damping_ratio: float  # [1]


def floor_vibration(
    speed: Array, rate: float, rms: float, padding: Padding, rng: np.random.Generator
) -> Array:
    """Acceleration (n,) [m/s^2] that the sensor feels along the frame's up axis.

    speed: (n,) [m/s] at the sensor's samples, `rate` [Hz] apart. rms: of the frame at REFERENCE_SPEED
    [m/s^2].
    """
    if rms <= 0.0 or not len(speed):
        return np.zeros(len(speed))
    every = math.ceil(INNER_RATE / rate)
    inner, lead = every * rate, math.ceil(LEAD * rate)
    count = (lead + len(speed) - 1) * every + 1
    share = np.interp(np.arange(count), (lead + np.arange(len(speed))) * every, speed) / REFERENCE_SPEED
    frame = rms * share * _band_noise(count, inner, rng)
    return np.asarray(_isolated(frame, inner, padding)[lead * every :: every], dtype=float)


def _band_noise(count: int, rate: float, rng: np.random.Generator) -> Array:
    """Gaussian noise (n,) between LOW and HIGH, of variance 1."""
    sections = signal.butter(2, (LOW, HIGH), btype="bandpass", fs=rate, output="sos")
    impulse = np.zeros(round(rate))
    impulse[0] = 1.0
    gain = math.sqrt(float(np.sum(signal.sosfilt(sections, impulse) ** 2)))
    noise: Array = signal.sosfilt(sections, rng.standard_normal(count)) / gain
    return noise


def _isolated(acceleration: Array, rate: float, padding: Padding) -> Array:
    """What the padding passes on of an acceleration (n,) sampled at `rate` [Hz]."""
    if padding.natural_frequency <= 0.0:
        return acceleration
    w, z = 2.0 * math.pi * padding.natural_frequency, padding.damping_ratio
    numerator, denominator = signal.bilinear([2 * z * w, w**2], [1.0, 2 * z * w, w**2], fs=rate)
    passed: Array = signal.lfilter(numerator, denominator, acceleration)
    return passed
