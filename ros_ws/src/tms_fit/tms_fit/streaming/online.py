"""Strikes and fits from samples as they come: live run, replayed bag and `fit run` go through one class."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from tms_model import Bicycle, ParameterError
from tms_model.bicycle import Array
from tms_model.response import FASTEST

from tms_fit.estimators import check_names
from tms_fit.kalman.extended_filter import ExtendedFilter, InitialState, ProcessNoise
from tms_fit.kalman.running_filter import FilterStep, RunningFilter
from tms_fit.least_squares.varpro import Problem, solve
from tms_fit.parameters import INITIAL
from tms_fit.settings import Settings
from tms_fit.streaming.gyroscopes import Gyroscopes, Vector
from tms_fit.streaming.synchronizer import PATIENCE, Sample, SampleSynchronizer
from tms_fit.strike_fit import Segment, StrikeFit, fit_strike, stretch_of, window_of
from tms_fit.strikes.detector import StrikeDetector
from tms_fit.strikes.manual import ManualStrikes
from tms_fit.strikes.strike import NANOSECONDS, Rejected, Strike
from tms_fit.strikes.strike_time import AFTER, BEFORE, is_impulsive, refine_strike_time
from tms_fit.strikes.window_end import STAND, WindowEnd, find_window_end
from tms_fit.window import Window

__all__ = ["PATIENCE", "OnlineFit", "StrikeFit"]

MEMORY = 10 * NANOSECONDS  # [ns], how long after a strike its free response is told from a new strike
LOOK_BACK = NANOSECONDS  # [ns], the motion from which a change is predicted when no strike began it
LEAST_HISTORY = 3 * NANOSECONDS // 10  # [ns], at a recording's start, before a change can be judged
PUSHED_ON = NANOSECONDS // 10  # [ns] for which a hand pushes on beyond the peak
SAME = NANOSECONDS // 20  # [ns]; what ends a motion up to this long after a change is that change
EXPLAINED = 0.5  # share of a change that the motion before must predict to be its cause; at most its inverse
SWINGING: tuple[str, ...] = (
    "initial_lean_rate",
    "initial_steer_rate",
    "lean_rate_bias",
)  # unknowns after a strike


class OnlineFit:
    """Feed it samples as they arrive (see `tms_fit.streaming.synchronizer`); take what `results` returns."""

    def __init__(
        self,
        bicycle: Bicycle,
        settings: Settings,
        imu_orientation: Array,
        nominal_speed: float = float("nan"),
        running_filter: bool = True,
        strike_times: tuple[int, ...] = (),
        reorder_window: float = 0.0,
        preview_period: float | None = None,
    ) -> None:
        """Nothing is known yet.

        imu_orientation: quaternion x, y, z, w, imu -> rear frame (REP-103).
        nominal_speed [m/s]: used without a speed topic. strike_times [ns]: starts of the free responses
        that somebody states; without any they are looked for.
        reorder_window [s]: how late an IMU sample may be.
        preview_period [s]: how often an unfolding response is fitted, by the first estimator; None: not.
        """
        check_names(settings.estimators)
        self.bicycle, self._settings = bicycle, settings
        stated = settings.stated_speed
        self._nominal_speed = stated if math.isfinite(stated) else nominal_speed
        self._filter = _filter(bicycle, settings) if running_filter else None
        self._gyroscopes = Gyroscopes(imu_orientation, settings.gyroscope_range)
        self._detector = ManualStrikes(strike_times) if strike_times else StrikeDetector()
        self._aligned = SampleSynchronizer(self._gyroscopes, reorder_window, settings.fixed.get("speed"))
        self._longest_ns = round((settings.window + self._detector.latency) * NANOSECONDS)
        self._preview_ns = round(preview_period * NANOSECONDS) if preview_period else None
        self._previewed_ns = 0
        self._used: list[Sample] = []
        self._strikes: list[Strike] = []
        self._onsets: list[int] = []  # [ns] of strikes, as far back as samples are kept
        self._strike_count = 0
        self._latest: Strike | None = None
        self._results: list[StrikeFit | FilterStep] = []
        self._last_step: FilterStep | None = None

    def add_imu(
        self, time_ns: int, angular_velocity: Sequence[float] | Array, variance: Sequence[float] | Array
    ) -> None:
        """One sample: gyroscopes (3,) [rad/s] in imu axes, variances (3,); NaN: absent, unknown."""
        self._aligned.add_imu(time_ns, _vector(angular_velocity), _vector(variance))
        self._release()

    def add_saturation(self, time_ns: int, flags: int) -> None:
        """Which axes stood at their limit in the IMU sample of this stamp: flags of tms_msgs/LeanYaw."""
        self._aligned.add_flags(time_ns, flags)

    def add_speed(self, time_ns: int, speed: float, variance: float = math.nan) -> None:
        """Forward speed [m/s] and its variance [m^2/s^2], NaN: unknown."""
        self._aligned.speed.add(time_ns, speed, variance)
        self._release()

    def add_steer_torque(self, time_ns: int, steer_torque: float) -> None:
        """Known steer torque [N m], SAE sign, held until the next one."""
        self._aligned.steer_torque.add(time_ns, steer_torque)
        self._release()

    def finish(self) -> None:
        """No more samples will come: use what waits and fit what is open."""
        self._release(finished=True)
        while self._strikes:
            self._fit()

    @property
    def last_step(self) -> FilterStep | None:
        """What the running filter said last."""
        return self._last_step

    @property
    def rejected(self) -> list[Rejected]:
        """The latest changes that were looked at and not taken for strikes."""
        return list(self._detector.rejected)

    def results(self) -> list[StrikeFit | FilterStep]:
        """What has become known since the last call, in order."""
        results, self._results = self._results, []
        return results

    @property
    def counts(self) -> Counter[str]:
        """IMU samples left out: repeated, late; saturated ones; flags that came too late to mark theirs."""
        return +self._aligned.counts

    @property
    def strike_count(self) -> int:
        """Strikes found so far."""
        return self._strike_count

    def refit(self, fit: StrikeFit, bicycle: Bicycle, settings: Settings) -> StrikeFit:
        """Fit a strike once more with other settings; a longer window ends where the memory does.

        Raises ParameterError for an unknown estimator.
        """
        check_names(settings.estimators)
        first_ns = int(fit.stretch.time_ns[0])
        end_ns = first_ns + round(settings.window * NANOSECONDS)
        end_ns = min([end_ns, *(onset for onset in self._onsets if onset > first_ns)])
        over = fit.ending is not None and fit.ending.kind != "recording"
        if not over and end_ns > fit.end_ns and self._used and self._used[0].time_ns <= first_ns:
            stretch, ending = self._response(fit.strike, end_ns)
        else:
            stretch, ending = fit.stretch.until(end_ns), fit.ending if end_ns >= fit.end_ns else None
        return fit_strike(fit.strike, stretch, bicycle, settings, ending=ending)

    def forget(self) -> None:
        """Let go of all samples; a window can't become longer any more."""
        self._used, self._filter, self._detector = [], None, ManualStrikes(())
        self._aligned = SampleSynchronizer(self._gyroscopes, 0.0)

    def _release(self, finished: bool = False) -> None:
        for sample in self._aligned.ready(finished):
            self._use(sample)

    def _use(self, sample: Sample) -> None:
        self._used.append(sample)
        strike = self._detector.push(sample.time_ns, sample.angular_velocity[0])
        if strike is not None and strike.kind != "given" and (why := self._is_no_strike(strike)):
            self._detector.withdraw(why)
            strike = None
        if strike is not None and strike.kind != "given":
            strike = self._dated(strike)
        if strike is not None:
            self._strikes.append(strike)
            self._onsets.append(strike.onset_ns)
            self._strike_count += 1
            self._latest = strike
        if self._filter is not None:
            self._run_filter(sample, strike)
        while self._strikes and sample.time_ns > self._strikes[0].time_ns + self._longest_ns:
            self._fit()
        if self._strikes:
            self._preview(sample.time_ns)
        elif self._used[0].time_ns < sample.time_ns - 2 * MEMORY:
            keep = sample.time_ns - MEMORY
            del self._used[: bisect_right(self._used, keep, key=_stamp)]
            self._onsets = [onset for onset in self._onsets if onset > keep]
            self._aligned.speed.forget(keep)
            self._aligned.steer_torque.forget(keep)

    def _run_filter(self, sample: Sample, strike: Strike | None) -> None:
        """One step; a strike, known only some time after, is made good by filtering anew from it on."""
        assert self._filter is not None
        first = len(self._used) - 1
        if strike is not None:
            self._filter.restart(strike=True)
            first = bisect_left(self._used, strike.time_ns, key=_stamp)
        step: FilterStep | None = None
        for index in range(first, len(self._used)):
            one = self._used[index]
            speed = one.speed if math.isfinite(one.speed) else self._nominal_speed
            if not 0.0 < speed <= FASTEST:
                return
            step = self._filter.step(
                one.time_ns, one.unsaturated, one.variance, speed, self._held_torque(index), one.speed_ns
            )
        if step is not None:
            self._last_step = step
            self._results.append(step)

    def _held_torque(self, index: int) -> float:
        """Known torque [N m] since the sample before `index`, 0 when none is known."""
        torque = self._used[index - 1].steer_torque if index else 0.0
        return torque if math.isfinite(torque) and self._settings.steer_torque != "ignore" else 0.0

    def _is_no_strike(self, strike: Strike) -> str:
        """What a change is instead of a strike; an empty text: nothing else."""
        speed, _ = self._aligned.speed.at(strike.onset_ns)
        if "speed" not in self._settings.fixed and abs(speed) < STAND:
            return "the bicycle stands"
        if caught := self._caught(strike):
            return caught
        if self._is_free_response(strike):
            return "the bicycle's own motion, as the model continues what came before"
        return ""

    def _dated(self, strike: Strike) -> Strike | None:
        """The strike as bicycle and yaw rate tell it; None where they tell of none."""
        window = self._around(strike)
        found = strike if window is None else refine_strike_time(strike, window, self._detector.least_change)
        if isinstance(found, Strike):
            return found
        self._detector.withdraw(found)
        return None

    def _surely_struck(self, strike: Strike) -> bool:
        """Whether the lean itself was struck or pushed, which the lean rate alone can't tell."""
        window = self._around(strike)
        return window is not None and is_impulsive(strike, window, self._detector.least_change)

    def _around(self, strike: Strike) -> Window | None:
        """The motion around a strike since the last one, as far as is known; None without a speed."""
        since = strike.onset_ns - BEFORE
        if self._latest is not None:
            since = max(since, self._latest.time_ns + (PUSHED_ON if self._latest.kind == "push" else 0))
        samples = self._between(min(since, strike.before_ns), strike.time_ns + AFTER)
        try:
            return window_of(self._stretch_of(samples), self.bicycle, self._settings)
        except ParameterError:
            return None

    def _caught(self, strike: Strike) -> str:
        """How a change comes from the end of the free motion, as far as is known now; or an empty text."""
        since = strike.onset_ns - LOOK_BACK
        ending = self._ending(since, self._used[-1].time_ns)
        ended = ending is not None and since + round(ending.time * NANOSECONDS) < strike.time_ns + SAME
        return ending.why if ending is not None and ended else ""

    def _is_free_response(self, strike: Strike) -> bool:
        """Whether the motion just before, as the bicycle continues it, explains half of this change."""
        last, assumed = self._latest, SWINGING
        since = strike.onset_ns - LOOK_BACK
        if last is not None and strike.onset_ns - last.time_ns <= MEMORY:
            since = last.time_ns
        else:  # whatever moves now, its beginning is not known
            assumed = (*INITIAL, "lean_rate_bias")
        samples = self._between(since, strike.time_ns)
        if last is None and not strike.sharp and strike.onset_ns < samples[0].time_ns + LEAST_HISTORY:
            return not self._surely_struck(strike)  # a recording that begins in mid-swing looks like this
        try:
            window = window_of(self._stretch_of(samples), self.bicycle, self._settings)
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
        """Fit the oldest open strike; of all that are open drop what turns out to be hands that caught it."""
        for strike in [one for one in self._strikes if one.kind != "given"]:
            if why := self._caught(strike):
                self._detector.rejected.append(Rejected(strike.time_ns, strike.change, why))
                self._strike_count -= 1
                self._strikes.remove(strike)
                self._onsets.remove(strike.onset_ns)
        if not self._strikes:
            return
        strike = self._strikes.pop(0)
        end_ns = strike.time_ns + round(self._settings.window * NANOSECONDS)
        stretch, ending = self._response(strike, end_ns)
        self._results.append(fit_strike(strike, stretch, self.bicycle, self._settings, ending=ending))

    def _response(self, strike: Strike, end_ns: int) -> tuple[Segment, WindowEnd | None]:
        """What belongs to the free response after a strike, up to a time, and what ended it sooner."""
        first_ns, newest_ns = strike.time_ns, self._used[-1].time_ns
        following = [onset for onset in self._onsets if first_ns < onset < end_ns]
        ending: WindowEnd | None = None
        if following:
            end_ns = following[0]
            ending = WindowEnd("next_strike", (end_ns - first_ns) / NANOSECONDS, "the next strike begins")
        elif newest_ns < end_ns:
            ending = WindowEnd("recording", (newest_ns - first_ns) / NANOSECONDS, "nothing more was recorded")
        found = self._ending(first_ns, following[0] if following else newest_ns)
        if found is not None and first_ns + round(found.time * NANOSECONDS) < end_ns:
            ending = found
            end_ns = first_ns + max(round(found.time * NANOSECONDS), 0)
        return self._stretch(first_ns, end_ns), ending

    def _ending(self, first_ns: int, last_ns: int) -> WindowEnd | None:
        """What ends the free motion between two times; its time is in seconds since the first."""
        stretch = self._stretch(first_ns, last_ns)
        return find_window_end(
            (stretch.time_ns - first_ns) / NANOSECONDS,
            stretch.angular_velocity[:, ::2],
            (stretch.speed_time_ns - first_ns) / NANOSECONDS,
            stretch.speed,
        )

    def _preview(self, now_ns: int) -> None:
        """Fit the open strike with what has come so far, every now and then."""
        if self._preview_ns is None or now_ns < self._previewed_ns + self._preview_ns:
            return
        self._previewed_ns = now_ns
        strike = self._strikes[0]
        quick = replace(self._settings, estimators=self._settings.estimators[:1])
        stretch, _ = self._response(strike, now_ns)
        self._results.append(fit_strike(strike, stretch, self.bicycle, quick, final=False))

    def _stretch(self, first_ns: int, last_ns: int) -> Segment:
        return self._stretch_of(self._between(first_ns, last_ns))

    def _between(self, first_ns: int, last_ns: int) -> list[Sample]:
        """Samples that are kept, from a time to another."""
        used = self._used
        return used[bisect_left(used, first_ns, key=_stamp) : bisect_right(used, last_ns, key=_stamp)]

    def _stretch_of(self, samples: list[Sample]) -> Segment:
        flagged = None
        if any(one.flags for one in samples):
            flagged = np.array([self._gyroscopes.flagged(one.flags) for one in samples])
        return stretch_of(samples, self._aligned.speed, self._nominal_speed, flagged)


def _vector(values: Sequence[float] | Array) -> Vector:
    x, y, z = values if type(values) is tuple else map(float, values)
    return x, y, z


def _stamp(sample: Sample) -> int:
    return sample.time_ns


def _filter(bicycle: Bicycle, settings: Settings) -> RunningFilter:
    """The filter of the settings; what they fix is known to it."""
    if settings.filter == "linear":
        return RunningFilter(bicycle, settings.gyroscope_noise)
    guess, wandering = InitialState(), ProcessNoise()
    resistance = settings.fixed.get("rolling_resistance", 0.0 if "speed" in settings.fixed else None)
    if resistance is not None:
        guess = replace(guess, rolling_resistance=resistance, rolling_resistance_std=0.0)
        wandering = replace(wandering, rolling_resistance=0.0)
    if "speed" in settings.fixed:
        guess, wandering = replace(guess, speed_share=0.0), replace(wandering, speed=0.0)
    return ExtendedFilter(bicycle, settings.gyroscope_noise, guess, wandering)
