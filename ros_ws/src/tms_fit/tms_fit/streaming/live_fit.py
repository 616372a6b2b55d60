"""Live fit of messages in the order of their arrival: serialised messages in, records out.

Until the bicycle is known (from `run_info`, or given), messages wait. When time jumps back or a new run is
announced, a new run begins.
"""

from __future__ import annotations

from collections import Counter, deque

import numpy as np
from tms_bag import Record, RecordingError, conversion, topics
from tms_bag.samples import RunInfo
from tms_model import Bicycle, ParameterError, load_bicycle

from tms_fit.estimators import check_names
from tms_fit.imu_orientation import live_orientation
from tms_fit.kalman.ekf import PARAMETER_STATES
from tms_fit.messages import estimate_records, filter_state_record
from tms_fit.run_info import stated_bicycle
from tms_fit.settings import Settings
from tms_fit.streaming.live_run import LiveRun
from tms_fit.strike_fit import StrikeFit

INPUTS = (
    topics.RUN_INFO,
    topics.SPEED,
    topics.SPEED_COVARIANCE,
    topics.STEER_TORQUE,
    topics.LEAN_YAW,
    topics.IMU,
)
JUMP_BACK_NS = 1_000_000_000  # [ns]; an earlier stamp than this is a new run, not a late sample
GAP_NS = 500_000_000  # [ns] between IMU samples that is counted as one
RUN_INFO_WAIT_SAMPLES = 100  # IMU samples before a run with a given bicycle starts without run_info
HELD_MESSAGES_LIMIT = 100_000  # messages kept while the bicycle is unknown; the oldest are discarded first
KEPT_STRIKES = 100  # that can be refitted
KEPT_RUNS = 10  # whose samples are kept, for longer windows
SAME_STRIKE_NS = 100_000_000  # [ns], largest distance of a requested start from that of its strike
REORDER_WINDOW_S = 0.1  # [s]
PREVIEW_PERIOD_S = 0.25  # [s]


class LiveFit:
    """Estimates and filter states of the messages of one or more runs."""

    def __init__(
        self,
        settings: Settings,
        bicycle: str = "",
        reorder_window: float = REORDER_WINDOW_S,
        preview_period: float = PREVIEW_PERIOD_S,
    ) -> None:
        """Raises ParameterError for an unknown bicycle or estimator, and for the imu_orientation auto.

        bicycle: name or file; empty: the one that run_info states. reorder_window, preview_period [s]: see
        `LiveRun`.
        """
        self.settings = settings
        self._reorder_window, self._preview_period = reorder_window, preview_period
        check_names(settings.estimators)
        live_orientation(None, settings)  # refuses auto
        self._given = load_bicycle(bicycle) if bicycle else None
        self._announced: Bicycle | None = None  # by run_info, which is never opened as a file
        self.counts: Counter[str] = Counter()
        self._info: RunInfo | None = None
        self._run: LiveRun | None = None
        self._held: deque[tuple[str, Record]] = deque(maxlen=HELD_MESSAGES_LIMIT)
        self._strikes: deque[tuple[LiveRun, StrikeFit]] = deque(maxlen=KEPT_STRIKES)
        self._runs: deque[LiveRun] = deque()  # the latest that have ended
        self._pending: list[Record] = []  # of a run that has ended, for the next call
        self._newest_ns = 0

    def process(self, topic: str, data: bytes) -> list[Record]:
        """Process one message of a topic of INPUTS; return the records to publish."""
        self.counts[topic] += 1
        record = Record(f"/{topic}", topics.TYPES[topic], 0, data)
        if topic == topics.RUN_INFO:
            return self._announce(conversion.run_info(record))
        if self._run is None:
            self.counts["forgotten"] += len(self._held) == HELD_MESSAGES_LIMIT
            self._held.append((topic, record))
            waited = self._given and sum(kind == topics.IMU for kind, _ in self._held) > RUN_INFO_WAIT_SAMPLES
            return self._begin() if waited else []
        self._add(topic, record)
        return self._results()

    def finish(self) -> list[Record]:
        """Fit the open responses; the next sample begins a new run."""
        if self._run is None:
            return self._begin() + self.finish() if self._given and self._held else []
        self._run.finish()
        records = self._results()
        self._restart()
        return records

    def refit(self, strike_ns: int, settings: Settings, bicycle: str = "") -> StrikeFit:
        """Fit, with other settings, of the strike that starts at `strike_ns` (to 0.1 s); 0: of the last one.

        Raises ParameterError for an unknown bicycle or estimator, and where there is no such strike.
        """
        near = [one for one in self._strikes if abs(one[1].start_ns - strike_ns) <= SAME_STRIKE_NS]
        found = near or ([] if strike_ns else [*self._strikes])
        if not found:
            starts = ", ".join(f"{fit.start_ns / 1e9:.3f}" for _, fit in self._strikes) or "none"
            raise ParameterError(f"strike: expected one of {starts} [s], found {strike_ns / 1e9:.3f}")
        run, fit = found[-1]
        return run.refit(fit, load_bicycle(bicycle) if bicycle else run.bicycle, settings)

    def _announce(self, info: RunInfo) -> list[Record]:
        records = self.finish() if self._run is not None and self._newest_ns else []
        self._info, self._announced = info, None
        try:
            self._announced = stated_bicycle(info)
        except ParameterError:
            if info.bicycle and self._given is None:
                self.counts["unknown_bicycle"] += 1
        return records + self._begin()

    def _begin(self) -> list[Record]:
        self._restart()
        if self._run is None:
            return []
        while self._held:
            self._add(*self._held.popleft())
        return self._results()

    @property
    def bicycle(self) -> str:
        """Name of the bicycle; empty while it is unknown."""
        bicycle = self._given or self._announced
        return bicycle.name if bicycle else ""

    @property
    def speed_source(self) -> str:
        """Source of the speed of this run: fixed, measured, prior or run_info; empty: there is none yet."""
        return self._run.speed_source if self._run else ""

    @property
    def diagnostics(self) -> dict[str, int]:
        """Numbers of messages processed, and left out, by reason."""
        return dict(self.counts + self._run.counts if self._run else self.counts)

    @property
    def parameter_states(self) -> dict[str, str]:
        """Latest biases, speed and C_r of the extended filter with standard deviations, SI units, as text."""
        step = self._run.last_step if self._run else None
        if step is None or step.parameters is None or step.parameter_covariance is None:
            return {}
        std = np.sqrt(np.diag(step.parameter_covariance))
        return {
            name: f"{value:.4g} +- {one:.2g}"
            for name, value, one in zip(PARAMETER_STATES, step.parameters, std, strict=True)
        }

    def _restart(self) -> None:
        if self._run is not None:
            self.counts.update(self._run.counts)
            if self._newest_ns:
                self._runs.append(self._run)
            if len(self._runs) > KEPT_RUNS:
                self._runs.popleft().forget()
        bicycle = self._given or self._announced
        self._newest_ns = 0
        self._run = None
        if bicycle:
            speed = self._info.speed if self._info else float("nan")
            self._run = LiveRun(
                bicycle,
                self.settings,
                live_orientation(self._info, self.settings),
                speed,
                reorder_window=self._reorder_window,
                preview_period=self._preview_period,
            )

    def _add(self, topic: str, record: Record) -> None:
        assert self._run is not None
        try:
            if topic == topics.IMU:
                self._add_imu(record)
            elif topic == topics.SPEED:
                self._run.add_speed(*conversion.speed_reading(record))
            elif topic == topics.SPEED_COVARIANCE:
                self._run.add_speed(*conversion.speed_covariance_reading(record))
            elif topic == topics.LEAN_YAW:
                self._run.add_saturation(*conversion.saturation_reading(record))
            else:
                self._run.add_steer_torque(*conversion.steer_torque_reading(record))
        except RecordingError:
            self.counts["unreadable"] += 1

    def _add_imu(self, record: Record) -> None:
        time_ns, angular_velocity, variance = conversion.imu_reading(record)
        if self._newest_ns and time_ns < self._newest_ns - JUMP_BACK_NS:
            self.counts["jumps_back"] += 1
            assert self._run is not None
            self._run.finish()
            self._pending = self._results()
            self._restart()
        elif self._newest_ns and time_ns > self._newest_ns + GAP_NS:
            self.counts["gaps"] += 1
        self._newest_ns = max(self._newest_ns, time_ns)
        assert self._run is not None
        self._run.add_imu(time_ns, angular_velocity, variance)

    def _results(self) -> list[Record]:
        assert self._run is not None
        records, self._pending = self._pending, []
        for result in self._run.results():
            if isinstance(result, StrikeFit):
                if result.final:
                    self.counts["strikes"] += 1
                    self._strikes.append((self._run, result))
                records.extend(estimate_records(result))
            else:
                records.append(filter_state_record(result))
        return records
