"""Measurements of one free response, and the window made of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from tms_bag.reading_limits import SPEED_LIMIT, measured
from tms_bag.samples import IntArray
from tms_model import Bicycle, ParameterError
from tms_model.acceleration import coasting_loss
from tms_model.bicycle import Array

from tms_fit.settings import Settings
from tms_fit.speed_profile import (
    FIXED,
    MEASURED,
    NOMINAL,
    PRIOR,
    SpeedProfile,
    constant_speed,
    fit_speed_profile,
)
from tms_fit.strikes.strike import NANOSECONDS, Strike
from tms_fit.strikes.window_end import WindowEnd
from tms_fit.window import Window, make_window


@dataclass(frozen=True, eq=False)
class Segment:
    """Synchronised samples between two times: all that a window needs but the bicycle and the settings."""

    time_ns: IntArray  # (n,)
    angular_velocity: Array  # (n, 3) [rad/s], SAE axes of the rear frame
    steer_torque: Array  # (n,) [N m], NaN: unknown
    speed_time_ns: IntArray  # (m,)
    speed: Array  # (m,) [m/s]
    speed_variance: Array  # (m,) [m^2/s^2], NaN: unknown
    nominal_speed: float  # [m/s], used where none was measured; NaN: unknown
    flagged: NDArray[np.bool_] | None = None  # (n, 3), axes that a saturated axis of the sensor enters

    def until(self, end_ns: int) -> Segment:
        """The samples up to and including a time [ns]."""
        rows, speeds = self.time_ns <= end_ns, self.speed_time_ns <= end_ns
        return Segment(
            self.time_ns[rows],
            self.angular_velocity[rows],
            self.steer_torque[rows],
            self.speed_time_ns[speeds],
            self.speed[speeds],
            self.speed_variance[speeds],
            self.nominal_speed,
            None if self.flagged is None else self.flagged[rows],
        )


def joined(before: Segment, after: Segment) -> Segment:
    """Samples of a segment before another one, and those of the other."""
    rows = before.time_ns < after.time_ns[0]
    speeds = before.speed_time_ns < (after.speed_time_ns[0] if len(after.speed_time_ns) else 2**63 - 1)
    flagged = [
        np.zeros(one.angular_velocity.shape, dtype=bool) if one.flagged is None else one.flagged
        for one in (before, after)
    ]
    return Segment(
        np.concatenate([before.time_ns[rows], after.time_ns]),
        np.concatenate([before.angular_velocity[rows], after.angular_velocity]),
        np.concatenate([before.steer_torque[rows], after.steer_torque]),
        np.concatenate([before.speed_time_ns[speeds], after.speed_time_ns]),
        np.concatenate([before.speed[speeds], after.speed]),
        np.concatenate([before.speed_variance[speeds], after.speed_variance]),
        after.nominal_speed,
        np.concatenate([flagged[0][rows], flagged[1]]) if flagged[0].any() or flagged[1].any() else None,
    )


@dataclass(frozen=True, eq=False)
class FreeResponse:
    """A strike and the measurements after it."""

    strike: Strike
    segment: Segment
    window_end: WindowEnd | None  # what ended the response before the window did; None: nothing
    before: Segment | None = None  # free motion before it, with the strike; None: not known


def segment_window(segment: Segment, bicycle: Bicycle, settings: Settings) -> Window:
    """Window of a segment. Raises ParameterError where the speed isn't known."""
    torque = segment.steer_torque if np.isfinite(segment.steer_torque).any() else None
    source, speed = _speed(segment, bicycle, settings)
    speed = replace(speed, source=source)
    return make_window(
        bicycle, settings, segment.time_ns, segment.angular_velocity, speed, torque, segment.flagged
    )


def _speed(segment: Segment, bicycle: Bicycle, settings: Settings) -> tuple[str, SpeedProfile]:
    """The fixed speed, else the measured one, else the nominal one, and which of these it is."""
    if "speed" in settings.fixed:
        return FIXED, constant_speed(settings.fixed["speed"])
    speed = measured(segment.speed, SPEED_LIMIT)
    if np.isfinite(speed).any():
        first_ns = segment.time_ns[0]
        return MEASURED, fit_speed_profile(
            (segment.speed_time_ns - first_ns) / NANOSECONDS,
            speed,
            segment.speed_variance,
            settings.speed_model,
            float(segment.time_ns[-1] - first_ns) / NANOSECONDS,
            coasting_loss(bicycle),
        )
    if not np.isfinite(segment.nominal_speed):
        raise ParameterError(
            "speed: expected a topic bicycle/speed or a known speed, found none; use --fix speed=V"
        )
    return PRIOR if "speed" in settings.priors else NOMINAL, constant_speed(segment.nominal_speed)
