"""A run that goes on while one looks at it, in which one may still strike the bicycle and spoil its sensors.

All of a run is known beforehand. A strike on the way makes it anew with that strike among the scenario's:
nothing that happens later changes any draw of noise before, so what has been sent agrees with the new run
(to 1e-8 rad/s, since the steps of the motion end where a strike begins). So do other faults, to the last bit,
and are refused where they don't. The scenario as it stands at the
end, which run_info tells, gives the same run once more.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from tms_bag import Record, RecordingError, topics
from tms_bag.event import Event
from tms_model import ParameterError

from tms_sim.fault_injection import timed
from tms_sim.keys import checked
from tms_sim.run import SimulatedRun, simulate
from tms_sim.scenario import Scenario

# [ns] of simulated time sent at once: a late look must not outrun the subscribers' history.
LARGEST_STEP = 250_000_000
_RUN_INFO = f"/{topics.RUN_INFO}"


class LiveRun:
    """One run of a scenario, sent bit by bit."""

    run: SimulatedRun
    records: list[Record]

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.reset()

    def reset(self) -> None:
        """Back to the start."""
        self._make()
        self.sent = 0
        self.now_ns = self._due_ns = self.scenario.integer("start_time_ns")

    @property
    def finished(self) -> bool:
        """Whether all has been sent."""
        return self.sent >= len(self.records)

    @property
    def elapsed(self) -> float:
        """Time since the run's start [s]."""
        return (self.now_ns - self.scenario.integer("start_time_ns")) / 1e9

    def sensor_figures(self) -> dict[str, float]:
        """The inertial sensor so far: packets arrived, with an axis at its limit, lost by the link."""
        arrival = self.run.imu_arrival_ns
        come = (self.run.imu.time_ns if arrival is None else arrival) <= self.now_ns
        packets, saturated = int(come.sum()), int((self.run.saturation[come] > 0).sum())
        lost = sum(_lost(one, self.now_ns) for one in self.run.events if one.kind == "loss")
        return {
            "packets": packets,
            "saturated": saturated,
            "saturated_share": saturated / max(packets, 1),
            "lost": lost,
            "lost_share": lost / max(packets + lost, 1),
        }

    def advance(self, elapsed_ns: int) -> list[Record]:
        """What becomes due as time goes on; only what fits into LARGEST_STEP, the rest at the next calls."""
        self._due_ns += elapsed_ns
        self.now_ns = min(self._due_ns, self.now_ns + LARGEST_STEP)
        first = self.sent
        while not self.finished and self.records[self.sent].time_ns <= self.now_ns:
            self.sent += 1
        return self.records[first : self.sent]

    def strike(self, lean_rate: float, steer_rate: float, time_ns: int = 0) -> Record:
        """Strike the bicycle at a time of the run, 0: now. Returns what the run is from now on (run_info).

        Raises ParameterError for a time that is past or after the run's end, or a strike out of range; the
        run then goes on as it was.
        """
        start_ns = self.scenario.integer("start_time_ns")
        first = (self.now_ns + 1 - start_ns) / 1e9
        when = (time_ns - start_ns) / 1e9 if time_ns else first
        if when < first:
            raise ParameterError(
                f"time: expected after now, {first:.3f} s since the start, found {when:.3f} s"
            )
        before = self.scenario
        try:
            self.scenario = _with_strike(self.scenario, when, lean_rate, steer_rate)
            self._make()
        except ParameterError:
            self.scenario = before
            raise
        self.sent = sum(record.time_ns <= self.now_ns for record in self.records)
        return self._info()

    def timed(self, faults: str) -> str:
        """The text of some faults, those that don't say when beginning as soon as they still can."""
        if not self.sent:
            return faults
        # A sensor's clock may be ahead of the host's: what bears a later stamp than now has been sent, too.
        sent = (record.publish_time_ns or record.time_ns for record in self.records[: self.sent])
        latest = max(self.now_ns, *sent) - self.scenario.integer("start_time_ns")
        return timed(faults, math.floor(latest / 1e3 + 1.0) / 1e6)

    def change_faults(self, faults: str) -> Record:
        """Go on with other faults in what is still to come. Returns what the run is from now on (run_info).

        Raises ParameterError for what is no fault, or would change what has been sent, RecordingError for a
        fault of a topic that isn't there; the run then goes on as it was.
        """
        before = self.scenario, self.run, self.records
        told = self._told()
        self.scenario = replace(
            self.scenario, values={**self.scenario.values, "faults": checked("faults", faults)}
        )
        try:
            self._make()
            if self._told() != told:
                raise ParameterError(
                    "faults: expected faults that begin after what has been sent, and those that have begun"
                    f" as they are, which is {before[0].text('faults')!r}; found {faults!r}"
                )
        except (ParameterError, RecordingError):
            self.scenario, self.run, self.records = before
            raise
        self.sent = sum(record.time_ns <= self.now_ns for record in self.records) if self.sent else 0
        return self._info()

    def _told(self) -> list[Record]:
        """What has been sent of the run as it is now, but for what says what it is."""
        if not self.sent:
            return []
        return [one for one in self.records if one.time_ns <= self.now_ns and one.topic != _RUN_INFO]

    def _info(self) -> Record:
        return next(record for record in self.records if record.topic == _RUN_INFO)

    def _make(self) -> None:
        rng = np.random.default_rng(self.scenario.integer("seed"))
        self.run = simulate(self.scenario, rng)
        self.records = list(self.run.records())


def _lost(burst: Event, now_ns: int) -> int:
    """Packets of a burst of losses that were due by now."""
    share = (now_ns - burst.time_ns) / 1e9 / burst.duration
    return min(math.floor(share * burst.figures["packets"] + 1.0), int(burst.figures["packets"])) * (
        share >= 0
    )


def _with_strike(scenario: Scenario, when: float, lean_rate: float, steer_rate: float) -> Scenario:
    if not when < scenario.number("duration"):
        raise ParameterError(
            f"time: expected before the run's end at {scenario.number('duration'):g} s, found {when:.3f} s"
        )
    new = {"strike.time": when, "strike.lean_rate": lean_rate, "strike.steer_rate": steer_rate}
    count = len(scenario.numbers("strike.time"))
    strikes = [scenario.numbers(key) for key in new]
    rows = [values if len(values) == count else values * count for values in strikes]  # one for all
    order = sorted([*zip(*rows, strict=True), tuple(new.values())])
    columns = zip(*order, strict=True)
    changed = {key: checked(key, list(column)) for key, column in zip(new, columns, strict=True)}
    return replace(scenario, values={**scenario.values, **changed})
