"""Speed from the turning rear wheel: frames of a camera counted over three turns, ticks of an encoder.

SOM chapter 10: half of the 0.1 m wheel is black tape; v = 3 pi 0.1 / (n / 300) with n frames, a whole number,
over three turns. The true number lies less than a frame to either side; with the tape's edges at random
instants between the frames the error is the difference of two uniform ones, with the variance 1/6 frame^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_bag.samples import SpeedSamples
from tms_model.bicycle import Array


@dataclass(frozen=True, eq=False)
class Rolled:
    """How far the rear wheel has rolled."""

    time: Array  # (n,) [s], ascending
    distance: Array  # (n,) [m]

    def when(self, distance: float) -> float | None:
        """Time [s] at which the wheel has rolled so far; None: it never does."""
        if not len(self.distance) or distance > self.distance[-1]:
            return None
        return float(np.interp(distance, self.distance, self.time))


@dataclass(frozen=True)
class Camera:
    """A camera beside the track that films the wheel."""

    start: float  # [s] the turns are counted from the first edge of the tape after this time
    frame_rate: float  # [Hz]
    diameter: float  # [m] of the wheel
    turns: int


def rolled(time: Array, speed: Array) -> Rolled:
    """Distance from the speed (n,) [m/s] at times (n,) [s], by the trapezoidal rule; backward is 0."""
    forward = np.maximum(speed, 0.0)
    steps = 0.5 * (forward[1:] + forward[:-1]) * np.diff(time)
    return Rolled(time, np.concatenate([[0.0], np.cumsum(steps)]))


def count_frames(wheel: Rolled, camera: Camera, rng: np.random.Generator) -> tuple[int, float] | None:
    """Frames over the turns, and the time of their middle [s]; None: the wheel stops before.

    Random: where the tape's edge stands, and when the camera opens its shutter first.
    """
    edge, shutter = rng.random(2)
    circumference = math.pi * camera.diameter
    before = float(np.interp(camera.start, wheel.time, wheel.distance))
    first = (math.floor(before / circumference - edge) + 1.0 + edge) * circumference
    start, end = wheel.when(first), wheel.when(first + camera.turns * circumference)
    if start is None or end is None:
        return None
    # The first frame that shows the edge past the mark, before and after the turns.
    frames = [math.ceil(t * camera.frame_rate - shutter) for t in (start, end)]
    count = frames[1] - frames[0]
    return (count, (sum(frames) / 2.0 + shutter) / camera.frame_rate) if count > 0 else None


def camera_speed(wheel: Rolled, camera: Camera, start_ns: int, rng: np.random.Generator) -> SpeedSamples:
    """One mean speed over the turns with its variance, stamped at their middle; none if it stops before."""
    counted = count_frames(wheel, camera, rng)
    if counted is None:
        return SpeedSamples(np.empty(0, np.int64), np.empty(0))
    count, middle = counted
    speed = camera.turns * math.pi * camera.diameter * camera.frame_rate / count
    return SpeedSamples(
        np.array([start_ns + round(1e9 * middle)]), np.array([speed]), np.array([(speed / count) ** 2 / 6.0])
    )


def encoder_speed(
    wheel: Rolled,
    time_ns: NDArray[np.int64],
    ticks: int,
    diameter: float,
    start_ns: int,
    rng: np.random.Generator,
) -> SpeedSamples:
    """Mean speeds (n - 1,) between neighbouring readings, stamped at the middle between them.

    time_ns: (n,) [ns since the start]; ticks: of one turn. Random: where the wheel stands at the start.
    """
    tick = math.pi * diameter / ticks
    counts = np.floor(np.interp(time_ns / 1e9, wheel.time, wheel.distance) / tick + rng.random())
    seconds = np.diff(time_ns) / 1e9
    return SpeedSamples(
        start_ns + (time_ns[1:] + time_ns[:-1]) // 2,
        np.diff(counts) * tick / seconds,
        (tick / seconds) ** 2 / 6.0,
    )
