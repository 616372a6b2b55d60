"""Fits and filter states of one live run, from samples in the order of their arrival."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from tms_model import Bicycle
from tms_model.bicycle import Array

from tms_fit.estimators import check_names
from tms_fit.gyroscopes import Gyroscopes, Vector
from tms_fit.kalman.ekf import FilterStep, make_filter
from tms_fit.segment import FreeResponse
from tms_fit.settings import Settings
from tms_fit.speed_profile import FIXED, MEASURED, NOMINAL, PRIOR
from tms_fit.streaming.live_filter import LiveFilter
from tms_fit.streaming.samples import Samples
from tms_fit.streaming.synchronizer import Sample, SampleSynchronizer
from tms_fit.streaming.tracker import StrikeTracker
from tms_fit.strike_fit import StrikeFit, fit_strike
from tms_fit.strikes.strike import NANOSECONDS, Rejected


class LiveRun:
    """Synchroniser, running filter, strike tracker and fits of one run."""

    def __init__(
        self,
        bicycle: Bicycle,
        settings: Settings,
        imu_orientation: Array,
        nominal_speed: float = float("nan"),
        reorder_window: float = 0.0,
        preview_period: float | None = None,
    ) -> None:
        """Raises ParameterError for an unknown estimator.

        imu_orientation: quaternion x, y, z, w, imu -> rear frame (REP-103).
        nominal_speed [m/s]: used without a speed topic. reorder_window [s]: how late an IMU sample may be.
        preview_period [s]: how often an unfolding response is fitted, by the first estimator; None: never.
        """
        check_names(settings.estimators)
        self.bicycle, self._settings = bicycle, settings
        stated = settings.stated_speed
        nominal_speed = stated if math.isfinite(stated) else nominal_speed
        self._gyroscopes = Gyroscopes(imu_orientation, settings.gyroscope_range)
        self._synchronizer = SampleSynchronizer(self._gyroscopes, reorder_window, settings.fixed.get("speed"))
        self._samples = Samples(self._synchronizer.speed, nominal_speed)
        self._tracker = StrikeTracker(self._samples, bicycle, settings)
        uses_torque = settings.steer_torque != "ignore"
        running = make_filter(bicycle, settings)
        self._filter: LiveFilter | None = LiveFilter(running, nominal_speed, uses_torque)
        self._preview_ns = round(preview_period * NANOSECONDS) if preview_period else None
        self._previewed_ns = 0
        self._discarded_ns = 0  # samples before were discarded
        self._results: list[StrikeFit | FilterStep] = []
        self._last_step: FilterStep | None = None

    def add_imu(
        self, time_ns: int, angular_velocity: Sequence[float] | Array, variance: Sequence[float] | Array
    ) -> None:
        """One sample: gyroscopes (3,) [rad/s] in imu axes, variances (3,); NaN: absent, unknown."""
        self._synchronizer.add_imu(time_ns, vector(angular_velocity), vector(variance))
        self._process()

    def add_saturation(self, time_ns: int, flags: int) -> None:
        """Axes at their limit in the IMU sample of this stamp: flags of tms_msgs/LeanYaw."""
        self._synchronizer.add_flags(time_ns, flags)

    def add_speed(self, time_ns: int, speed: float, variance: float = math.nan) -> None:
        """Forward speed [m/s] and its variance [m^2/s^2], NaN: unknown."""
        self._synchronizer.speed.add(time_ns, speed, variance)
        self._process()

    def add_steer_torque(self, time_ns: int, steer_torque: float) -> None:
        """Known steer torque [N m], SAE sign, held until the next one."""
        self._synchronizer.steer_torque.add(time_ns, steer_torque)
        self._process()

    def finish(self) -> None:
        """Use the samples that wait and fit the responses that are open."""
        self._process(finished=True)
        self._fit(self._tracker.finish())

    @property
    def last_step(self) -> FilterStep | None:
        """The latest step of the running filter."""
        return self._last_step

    @property
    def rejected(self) -> list[Rejected]:
        """The latest changes that were rejected, with the reason."""
        return self._tracker.rejected

    @property
    def speed_source(self) -> str:
        """Source of the speed so far: fixed, measured, prior or run_info; empty: there is none."""
        if "speed" in self._settings.fixed:
            return FIXED
        if self._samples.speed.time:
            return MEASURED
        if "speed" in self._settings.priors:
            return PRIOR
        return NOMINAL if math.isfinite(self._samples.nominal_speed) else ""

    @property
    def counts(self) -> Counter[str]:
        """IMU samples left out: repeated, late; saturated, missing an axis; flags that came too late."""
        return +self._synchronizer.counts

    def results(self) -> list[StrikeFit | FilterStep]:
        """Fits and filter steps since the last call, in order."""
        results, self._results = self._results, []
        return results

    def refit(self, fit: StrikeFit, bicycle: Bicycle, settings: Settings) -> StrikeFit:
        """Fit of a strike with other settings; a longer window reaches as far as samples are kept.

        Raises ParameterError for an unknown estimator.
        """
        check_names(settings.estimators)
        response = FreeResponse(fit.strike, fit.segment, fit.window_end)
        return fit_strike(self._tracker.resized(response, settings.window), bicycle, settings)

    def forget(self) -> None:
        """Release all samples; windows can't become longer any more."""
        self._tracker.forget()
        self._samples.clear()
        self._synchronizer, self._filter = SampleSynchronizer(self._gyroscopes, 0.0), None

    def _process(self, finished: bool = False) -> None:
        for sample in self._synchronizer.ready(finished):
            self._use(sample)

    def _use(self, sample: Sample) -> None:
        self._samples.append(sample)
        strike = self._tracker.process(sample.time_ns, sample.angular_velocity[0])
        step = self._filter.process(sample, strike) if self._filter else None
        if step is not None:
            self._last_step = step
            self._results.append(step)
        self._fit(self._tracker.completed())
        if self._tracker.open_strikes:
            self._preview(sample.time_ns)
        elif self._tracker.first_ns > self._discarded_ns:
            self._discarded_ns = self._tracker.first_ns
            self._samples.discard(self._discarded_ns)
            self._synchronizer.discard(self._discarded_ns)

    def _fit(self, responses: list[FreeResponse]) -> None:
        self._results.extend(fit_strike(one, self.bicycle, self._settings) for one in responses)

    def _preview(self, now_ns: int) -> None:
        """Fit the oldest open response with the samples so far, once in every preview period."""
        if self._preview_ns is None or now_ns < self._previewed_ns + self._preview_ns:
            return
        self._previewed_ns = now_ns
        first = replace(self._settings, estimators=self._settings.estimators[:1])
        response = self._tracker.response(self._tracker.open_strikes[0], now_ns)
        self._results.append(fit_strike(response, self.bicycle, first, final=False))


def vector(values: Sequence[float] | Array) -> Vector:
    """Three numbers as floats."""
    x, y, z = values if type(values) is tuple else map(float, values)
    return x, y, z
