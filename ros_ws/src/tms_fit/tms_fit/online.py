"""Strikes and fits from samples as they come: live run, replayed bag and `fit run` go through one class.

What comes out depends on the samples and their time stamps alone, not on how the topics interleave: an IMU
sample is used once speed and steer torque are known up to its time, or are late by more than `PATIENCE`.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from tms_model import Bicycle, ParameterError
from tms_model.bicycle import Array
from tms_model.frames import imu_to_rear_frame

from tms_fit.estimate import Estimate
from tms_fit.estimators import ESTIMATORS, check_names
from tms_fit.estimators.least_squares import refine_start
from tms_fit.given_strikes import GivenStrikes
from tms_fit.projection import Problem, solve
from tms_fit.running_filter import FilterStep, RunningFilter
from tms_fit.settings import INITIAL, FitSettings
from tms_fit.speed_curve import SpeedCurve, constant_speed, speed_curve
from tms_fit.strike import NANOSECONDS, Rejected, Strike
from tms_fit.strikes import StrikeDetector
from tms_fit.window import Window, make_window

PATIENCE = NANOSECONDS // 2  # [ns], how long an IMU sample waits for a speed or a torque
MEMORY = 10 * NANOSECONDS  # [ns], how long after a strike its free response is told from a new strike
LOOK_BACK = NANOSECONDS  # [ns], the motion from which a change is predicted when no strike began it
LEAST_HISTORY = 3 * NANOSECONDS // 10  # [ns], at a recording's start, before a change can be judged
EXPLAINED = 0.5  # share of a change that the motion before must predict to be its cause; at most its inverse
SWINGING: tuple[str, ...] = (
    "initial_lean_rate",
    "initial_steer_rate",
    "lean_rate_bias",
)  # unknowns after a strike


@dataclass(frozen=True, eq=False)
class StrikeFit:
    """One strike and what each estimator says about it."""

    strike: Strike
    end_ns: int  # last sample used
    window: Window | None  # None: there was nothing to compare with, the estimates say why
    estimates: tuple[Estimate, ...]

    @property
    def start_ns(self) -> int:
        """Start of the free response."""
        return self.window.start_ns if self.window else self.strike.time_ns


@dataclass(frozen=True, eq=False)
class _Sample:
    time_ns: int
    angular_velocity: Array  # (3,) SAE axes of the rear frame
    variance: Array  # (3,)
    speed: float
    steer_torque: float


class _Series:
    """Samples of one slow topic, in ascending time."""

    def __init__(self) -> None:
        self.time: list[int] = []
        self.value: list[float] = []

    def add(self, time_ns: int, value: float) -> None:
        if not self.time or time_ns > self.time[-1]:
            self.time.append(time_ns)
            self.value.append(value)

    def at(self, time_ns: int) -> float:
        """The last value at or before a time; NaN before the first."""
        index = bisect_right(self.time, time_ns)
        return self.value[index - 1] if index else float("nan")

    def forget(self, before_ns: int) -> None:
        index = bisect_right(self.time, before_ns) - 1  # keeps the one that holds at before_ns
        if index > 1000:
            del self.time[:index], self.value[:index]


class OnlineFit:
    """Feed it samples (any order between topics, ascending within one); take what `results` returns."""

    def __init__(
        self,
        bicycle: Bicycle,
        settings: FitSettings,
        imu_orientation: Array,
        nominal_speed: float = float("nan"),
        running_filter: bool = True,
        strike_times: tuple[int, ...] = (),
    ) -> None:
        """Nothing is known yet.

        imu_orientation: quaternion x, y, z, w, imu -> rear frame (REP-103).
        nominal_speed [m/s]: used without a speed topic. strike_times [ns]: starts of the free responses
        that somebody states; without any they are looked for.
        """
        check_names(settings.estimators)
        self._bicycle, self._settings, self._orientation = bicycle, settings, imu_orientation
        self._nominal_speed = settings.fixed.get("speed", nominal_speed)
        self._filter = RunningFilter(bicycle, settings.gyroscope_noise) if running_filter else None
        self._detector = GivenStrikes(strike_times) if strike_times else StrikeDetector()
        self._waiting: deque[tuple[int, Array, Array]] = deque()
        self._speed, self._torque = _Series(), _Series()
        self._first_ns: int | None = None
        self._used: list[_Sample] = []
        self._strikes: list[Strike] = []
        self._latest: Strike | None = None
        self._results: list[StrikeFit | FilterStep] = []

    def add_imu(self, time_ns: int, angular_velocity: Array, variance: Array) -> None:
        """One sample: gyroscopes (3,) [rad/s] in imu axes, variances (3,); NaN: absent, unknown."""
        newest = self._waiting[-1][0] if self._waiting else self._used[-1].time_ns if self._used else None
        if newest is not None and time_ns <= newest:
            return  # a repeated or late sample; the recorder's and the player's reports count those
        self._first_ns = time_ns if self._first_ns is None else self._first_ns
        rotated = imu_to_rear_frame(angular_velocity[None, :], self._orientation)[0]
        self._waiting.append((time_ns, rotated, variance))
        self._release(finished=False)

    def add_speed(self, time_ns: int, speed: float) -> None:
        """Forward speed [m/s]."""
        self._speed.add(time_ns, speed)
        self._release(finished=False)

    def add_steer_torque(self, time_ns: int, steer_torque: float) -> None:
        """Known steer torque [N m], SAE sign, held until the next one."""
        self._torque.add(time_ns, steer_torque)
        self._release(finished=False)

    def finish(self) -> None:
        """No more samples will come: use what waits and fit what is open."""
        self._release(finished=True)
        while self._strikes:
            self._fit()

    @property
    def rejected(self) -> list[Rejected]:
        """The latest changes that were looked at and not taken for strikes."""
        return list(self._detector.rejected)

    def results(self) -> list[StrikeFit | FilterStep]:
        """What has become known since the last call, in order."""
        results, self._results = self._results, []
        return results

    def _release(self, finished: bool) -> None:
        while self._waiting:
            time_ns, angular_velocity, variance = self._waiting[0]
            if not finished and not self._complete(time_ns):
                return
            self._waiting.popleft()
            speed = self._settings.fixed.get("speed", self._speed.at(time_ns))
            self._use(_Sample(time_ns, angular_velocity, variance, speed, self._torque.at(time_ns)))

    def _complete(self, time_ns: int) -> bool:
        assert self._first_ns is not None
        newest = self._waiting[-1][0]
        if newest >= time_ns + PATIENCE:
            return True
        starting = (
            time_ns < self._first_ns + PATIENCE
        )  # which topics there are shows in the first half second
        return all(
            series.time[-1] >= time_ns if series.time else not starting
            for series in (self._speed, self._torque)
        )

    def _use(self, sample: _Sample) -> None:
        self._used.append(sample)
        strike = self._detector.push(sample.time_ns, float(sample.angular_velocity[0]))
        if strike is not None and strike.kind != "given" and self._is_free_response(strike):
            self._detector.withdraw("the bicycle's own motion, as the model continues what came before")
            strike = None
        if strike is not None:
            self._strikes.append(strike)
            self._latest = strike
        if self._filter is not None:
            self._run_filter(sample, strike)
        longest = round((self._settings.window + self._detector.latency) * NANOSECONDS)
        while self._strikes and (
            len(self._strikes) > 1 or sample.time_ns > self._strikes[0].time_ns + longest
        ):
            self._fit()
        if not self._strikes and self._used[0].time_ns < sample.time_ns - 2 * MEMORY:
            keep = sample.time_ns - MEMORY
            self._used = [one for one in self._used if one.time_ns > keep]
            self._speed.forget(keep)
            self._torque.forget(keep)

    def _run_filter(self, sample: _Sample, strike: Strike | None) -> None:
        """One step; a strike, known only some time after, is made good by filtering anew from it on."""
        assert self._filter is not None
        first = len(self._used) - 1
        if strike is not None:
            self._filter.restart(strike=True)
            first = next(index for index, one in enumerate(self._used) if one.time_ns >= strike.time_ns)
        step: FilterStep | None = None
        for index in range(first, len(self._used)):
            one = self._used[index]
            speed = one.speed if np.isfinite(one.speed) else self._nominal_speed
            if not speed > 0.0:
                return
            step = self._filter.step(
                one.time_ns, one.angular_velocity, one.variance, speed, self._held_torque(index)
            )
        if step is not None:
            self._results.append(step)

    def _held_torque(self, index: int) -> float:
        """Known torque [N m] since the sample before `index`, 0 when none is known."""
        torque = self._used[index - 1].steer_torque if index else 0.0
        return torque if np.isfinite(torque) and self._settings.steer_torque != "ignore" else 0.0

    def _is_free_response(self, strike: Strike) -> bool:
        """Whether the motion just before, as the bicycle continues it, explains half of this change."""
        last, assumed = self._latest, SWINGING
        since = strike.onset_ns - LOOK_BACK
        if last is not None and strike.onset_ns - last.time_ns <= MEMORY:
            since = last.time_ns
        else:  # whatever moves now, its beginning is not known
            assumed = (*INITIAL, "lean_rate_bias")
        samples = [one for one in self._used if since <= one.time_ns <= strike.time_ns]
        if last is None and not strike.sharp and strike.onset_ns < samples[0].time_ns + LEAST_HISTORY:
            return True  # a recording that begins in mid-swing looks like this
        try:
            window = self._window(samples)
        except ParameterError:
            return False
        before = np.array([one.time_ns <= strike.onset_ns for one in samples])
        known = replace(window, lean_rate=np.where(before, window.lean_rate, np.nan))
        known = replace(known, yaw_rate=np.where(before, window.yaw_rate, np.nan))
        problem = Problem(known, assumed)
        good = np.isfinite(known.measured)
        solution = solve(problem, lambda values: values[good])
        if solution.status == "not_observable":
            return False
        predicted = problem.predicted(solution.values)[:, 0]
        share = float(predicted[-1] - predicted[np.flatnonzero(before)[-1]]) / strike.change
        return EXPLAINED < share < 1.0 / EXPLAINED

    def _fit(self) -> None:
        """Fit the oldest open strike."""
        strike = self._strikes.pop(0)
        end_ns = strike.time_ns + round(self._settings.window * NANOSECONDS)
        if self._strikes:
            end_ns = min(end_ns, self._strikes[0].onset_ns)
        samples = [one for one in self._used if strike.time_ns <= one.time_ns <= end_ns]
        try:
            window = self._window(samples)
        except ParameterError as error:
            estimates = tuple(
                Estimate(name, "not_observable", str(error)) for name in self._settings.estimators
            )
            self._results.append(StrikeFit(strike, samples[-1].time_ns, None, estimates))
            return
        if strike.sharp:
            window = refine_start(window, self._settings, (strike.time_ns - strike.before_ns) / 1e9)
        elif strike.end_ns < strike.time_ns:
            delay = (strike.time_ns - strike.end_ns) / NANOSECONDS
            window = replace(window, delay=delay, delay_std=strike.end_std)
        estimates = tuple(ESTIMATORS[name](window, self._settings) for name in self._settings.estimators)
        self._results.append(StrikeFit(strike, samples[-1].time_ns, window, estimates))

    def _window(self, samples: list[_Sample]) -> Window:
        return make_window(
            self._bicycle,
            self._settings,
            np.array([one.time_ns for one in samples]),
            np.array([one.angular_velocity for one in samples]),
            self._window_speed(samples),
            self._window_torque(samples),
        )

    def _window_speed(self, samples: list[_Sample]) -> SpeedCurve:
        if "speed" in self._settings.fixed:
            return constant_speed(self._settings.fixed["speed"])
        first, last = (bisect_right(self._speed.time, one.time_ns) for one in (samples[0], samples[-1]))
        since = slice(max(first - 1, 0), last)
        speeds = np.array(self._speed.value[since])
        if np.isfinite(speeds).any():
            times = (np.array(self._speed.time[since]) - samples[0].time_ns) / NANOSECONDS
            return speed_curve(times, speeds, self._settings.speed_model)
        if not np.isfinite(self._nominal_speed):
            raise ParameterError(
                "speed: expected a topic bicycle/speed or a known speed, found none; use --fix speed=V"
            )
        return constant_speed(self._nominal_speed)

    def _window_torque(self, samples: list[_Sample]) -> Array | None:
        torque = np.array([one.steer_torque for one in samples])
        return torque if np.isfinite(torque).any() else None
