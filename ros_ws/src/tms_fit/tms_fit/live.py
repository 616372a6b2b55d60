"""A live fit over messages as they arrive: bytes in, messages out. The estimator node only carries them.

Until the bicycle is known (from `run_info`, or given), messages wait. When time jumps back or a new run is
announced, the fit begins anew.
"""

from __future__ import annotations

from collections import Counter

from tms_bag import Record, RecordingError, conversion, topics
from tms_bag.samples import RunInfo
from tms_model import load_bicycle

from tms_fit.estimators import check_names
from tms_fit.messages import estimate_records, filter_state_record
from tms_fit.offline import orientation_of
from tms_fit.online import OnlineFit, StrikeFit
from tms_fit.settings import FitSettings

INPUTS = (topics.RUN_INFO, topics.SPEED, topics.STEER_TORQUE, topics.IMU)
JUMP_BACK = 1_000_000_000  # [ns]; an earlier stamp than this is a new run, not a late sample
WAIT_FOR_RUN_INFO = 100  # IMU samples to wait for a run_info when the bicycle was given


class LiveFit:
    """Takes messages, gives estimates and filter states. Raises ParameterError for an unknown bicycle."""

    def __init__(self, settings: FitSettings, bicycle: str = "") -> None:
        self._settings, self._given = settings, bicycle
        check_names(settings.estimators)
        if bicycle:
            load_bicycle(bicycle)
        self.counts: Counter[str] = Counter()
        self.bicycle = ""
        self._info: RunInfo | None = None
        self._online: OnlineFit | None = None
        self._held: list[tuple[str, Record]] = []
        self._pending: list[Record] = []  # of a run that has ended, to be given with the next answers
        self._newest_ns = 0

    def take(self, topic: str, data: bytes) -> list[Record]:
        """Use one message of a topic of INPUTS; return the messages to publish."""
        self.counts[topic] += 1
        record = Record(f"/{topic}", topics.TYPES[topic], 0, data)
        if topic == topics.RUN_INFO:
            return self._announce(conversion.run_info(record))
        if self._online is None:
            self._held.append((topic, record))
            waited = self._given and sum(kind == topics.IMU for kind, _ in self._held) > WAIT_FOR_RUN_INFO
            return self._begin() if waited else []
        self._add(topic, record)
        return self._answers()

    def finish(self) -> list[Record]:
        """No more samples for now: fit what is open, and begin anew with the next sample."""
        if self._online is None:
            return self._begin() + self.finish() if self._given and self._held else []
        self._online.finish()
        answers = self._answers()
        self._restart()
        return answers

    def _announce(self, info: RunInfo) -> list[Record]:
        answers = self.finish() if self._online is not None and self._newest_ns else []
        self._info = info
        return answers + self._begin()

    def _begin(self) -> list[Record]:
        self._restart()
        if self._online is None:
            return []
        held, self._held = self._held, []
        for topic, record in held:
            self._add(topic, record)
        return self._answers()

    def _restart(self) -> None:
        name = self._given or (self._info.bicycle if self._info else "")
        self._newest_ns = 0
        self._online = None
        if name:
            self.bicycle = name
            speed = self._info.speed if self._info else float("nan")
            self._online = OnlineFit(load_bicycle(name), self._settings, orientation_of(self._info), speed)

    def _add(self, topic: str, record: Record) -> None:
        assert self._online is not None
        try:
            if topic == topics.IMU:
                self._add_imu(record)
            elif topic == topics.SPEED:
                speed = conversion.speed_samples([record])
                self._online.add_speed(int(speed.time_ns[0]), float(speed.speed[0]))
            else:
                torque = conversion.steer_torque_samples([record])
                self._online.add_steer_torque(int(torque.time_ns[0]), float(torque.steer_torque[0]))
        except RecordingError:
            self.counts["unreadable"] += 1

    def _add_imu(self, record: Record) -> None:
        imu = conversion.imu_samples([record])
        time_ns = int(imu.time_ns[0])
        if self._newest_ns and time_ns < self._newest_ns - JUMP_BACK:
            assert self._online is not None
            self._online.finish()
            self._pending = self._answers()
            self._restart()
        self._newest_ns = max(self._newest_ns, time_ns)
        assert self._online is not None
        self._online.add_imu(time_ns, imu.angular_velocity[0], imu.angular_velocity_variance)

    def _answers(self) -> list[Record]:
        assert self._online is not None
        answers, self._pending = self._pending, []
        for result in self._online.results():
            if isinstance(result, StrikeFit):
                self.counts["strikes"] += 1
                answers.extend(estimate_records(result, self.bicycle))
            else:
                answers.append(filter_state_record(result))
        return answers
