"""From what was measured after a strike to what each estimator says about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from tms_bag.samples import IntArray
from tms_model import Bicycle, ParameterError
from tms_model.acceleration import coasting_loss
from tms_model.bicycle import Array

from tms_fit.diagnostics.misspecification import Misspecification, doubt
from tms_fit.estimate import Estimate
from tms_fit.estimators import ESTIMATORS
from tms_fit.estimators.least_squares import refine_start
from tms_fit.least_squares.intervals import with_intervals
from tms_fit.settings import Settings
from tms_fit.speed_profile import SpeedProfile, constant_speed, fit_speed_profile
from tms_fit.streaming.synchronizer import Sample, Series
from tms_fit.strikes.strike import NANOSECONDS, Strike
from tms_fit.strikes.window_end import WindowEnd
from tms_fit.window import Window, make_window

FASTEST = 1e3  # [m/s]; a faster reading is none


@dataclass(frozen=True, eq=False)
class Segment:
    """Measurements of a stretch of time: all that a window is made of, but the bicycle and the settings."""

    time_ns: IntArray  # (n,)
    angular_velocity: Array  # (n, 3) [rad/s], SAE axes of the rear frame
    steer_torque: Array  # (n,) [N m], NaN: unknown
    speed_time_ns: IntArray  # (m,)
    speed: Array  # (m,) [m/s]
    speed_variance: Array  # (m,) [m^2/s^2], NaN: unknown
    nominal_speed: float  # [m/s], where none was measured; NaN: unknown
    flagged: NDArray[np.bool_] | None = None  # (n, 3), axes that a saturated one of the sensor enters

    def until(self, end_ns: int) -> Segment:
        """The part up to a time, which is included."""
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


@dataclass(frozen=True, eq=False)
class StrikeFit:
    """One strike and what each estimator says about it."""

    strike: Strike
    stretch: Segment
    window: Window | None  # None: there was nothing to compare with, the estimates say why
    estimates: tuple[Estimate, ...]
    bicycle: str
    final: bool = True  # False: more of this response is still to come
    ending: WindowEnd | None = None  # what ended the response before the window did; None: nothing
    doubt: Misspecification | None = (
        None  # why the first estimate may be wrong by more than its interval, if final
    )

    @property
    def start_ns(self) -> int:
        """Start of the free response."""
        return self.window.start_ns if self.window else self.strike.time_ns

    @property
    def speed(self) -> float:
        """Speed [m/s] at the start of the free response, as the first estimate has it; NaN: unknown."""
        if self.window is None:
            return float("nan")
        return self.estimates[0].complete.get("speed", self.window.start_speed)

    @property
    def end_ns(self) -> int:
        """Last sample used."""
        return int(self.stretch.time_ns[-1])


def stretch_of(
    samples: Sequence[Sample],
    speed: Series,
    nominal_speed: float,
    flagged: NDArray[np.bool_] | None = None,
) -> Segment:
    """Segment of some samples, one at least, in ascending time; flagged (n, 3): see Segment."""
    speed_time_ns, speeds, variances = speed.between(samples[0].time_ns, samples[-1].time_ns)
    return Segment(
        np.array([one.time_ns for one in samples]),
        np.array([one.angular_velocity for one in samples]),
        np.array([one.steer_torque for one in samples]),
        speed_time_ns,
        speeds,
        variances,
        nominal_speed,
        flagged,
    )


def window_of(stretch: Segment, bicycle: Bicycle, settings: Settings) -> Window:
    """Window of a stretch. Raises ParameterError where the speed isn't known."""
    torque = stretch.steer_torque if np.isfinite(stretch.steer_torque).any() else None
    speed = _speed(stretch, bicycle, settings)
    return make_window(
        bicycle, settings, stretch.time_ns, stretch.angular_velocity, speed, torque, stretch.flagged
    )


def fit_strike(
    strike: Strike,
    stretch: Segment,
    bicycle: Bicycle,
    settings: Settings,
    final: bool = True,
    ending: WindowEnd | None = None,
) -> StrikeFit:
    """Fit the free response after a strike, that the stretch holds, by all estimators of the settings.

    `ending`: what ended it before the window did; each message tells.
    """
    try:
        window = window_of(stretch, bicycle, settings)
    except ParameterError as error:
        estimates = tuple(Estimate(name, "not_observable", str(error)) for name in settings.estimators)
        return StrikeFit(strike, stretch, None, _told(estimates, ending, None), bicycle.name, final, ending)
    if strike.sharp:
        window = refine_start(window, settings, (strike.time_ns - strike.before_ns) / 1e9)
    elif strike.end_ns < strike.time_ns:
        delay = (strike.time_ns - strike.end_ns) / NANOSECONDS
        window = replace(window, delay=delay, delay_std=strike.end_std)
    found = (ESTIMATORS[name](window, settings) for name in settings.estimators)
    estimates = tuple(with_intervals(window, one, settings) for one in found)
    why = doubt(window, settings, estimates[0]) if final and estimates else None
    told = _told(estimates, ending, why)
    return StrikeFit(strike, stretch, window, told, bicycle.name, final, ending, why)


def _told(
    estimates: tuple[Estimate, ...], ending: WindowEnd | None, why: Misspecification | None
) -> tuple[Estimate, ...]:
    """The estimates, their messages with what cut the window short and what makes them doubtful.

    The doubt is about the first estimate, and about others of the same unknowns.
    """
    cut = f"; window {max(ending.time, 0.0):.2f} s: {ending.why}" if ending else ""
    told = []
    for one in estimates:
        doubted = f"; {why.sentence}" if why and one.names == estimates[0].names else ""
        told.append(replace(one, message=f"{one.message}{cut}{doubted}"))
    return tuple(told)


def _speed(stretch: Segment, bicycle: Bicycle, settings: Settings) -> SpeedProfile:
    if "speed" in settings.fixed:
        return constant_speed(settings.fixed["speed"])
    speed = np.where(np.abs(stretch.speed) < FASTEST, stretch.speed, np.nan)
    if np.isfinite(speed).any():
        first_ns = stretch.time_ns[0]
        return fit_speed_profile(
            (stretch.speed_time_ns - first_ns) / NANOSECONDS,
            speed,
            stretch.speed_variance,
            settings.speed_model,
            float(stretch.time_ns[-1] - first_ns) / NANOSECONDS,
            coasting_loss(bicycle),
        )
    if not np.isfinite(stretch.nominal_speed):
        raise ParameterError(
            "speed: expected a topic bicycle/speed or a known speed, found none; use --fix speed=V"
        )
    return constant_speed(stretch.nominal_speed)
