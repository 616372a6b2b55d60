"""A simulated run: the bicycle rides as `tms_sim.protocol` says, and sensors measure it.

The motion is known at every instant, so every topic has its own rate without error.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tms_bag import BagWriter, Record, Recording, conversion, topics
from tms_bag.event import Event, event_records
from tms_bag.record import arriving, merged
from tms_bag.samples import (
    ImuSamples,
    LeanYawSamples,
    MagneticSamples,
    RunInfo,
    SpeedSamples,
    StateSamples,
    SteerTorqueSamples,
)
from tms_model import Bicycle, load_bicycle

from tms_sim import __version__
from tms_sim.fault_injection import Request, parse_requests, with_faults
from tms_sim.motion import Motion, Trajectory
from tms_sim.protocol import ride
from tms_sim.scenario import Scenario
from tms_sim.sensors.imu_stream import imu_stream, sensor_mounting
from tms_sim.sensors.speed_stream import speed_stream
from tms_sim.truth import stamps, true_events, true_state


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """Samples of one run and what made it."""

    info: RunInfo
    state: StateSamples
    speed: SpeedSamples
    steer_torque: SteerTorqueSamples | None  # None: no torque acts
    imu: ImuSamples
    lean_yaw: LeanYawSamples
    oriented: ImuSamples | None  # with the sensor's own orientation; None: it finds none
    magnetic: MagneticSamples | None
    events: tuple[Event, ...]  # of the truth, but for the faults
    trajectory: Trajectory  # the truth at every instant
    saturation: NDArray[np.uint8]  # of each packet of the sensor: flags of tms_msgs/LeanYaw
    imu_arrival_ns: NDArray[np.int64] | None = None  # of each packet; None: at its stamp
    arrival_ns: NDArray[np.int64] | None = None  # of those that hold more than imu/data_raw
    speed_arrival_ns: NDArray[np.int64] | None = None  # of each speed; None: at its stamp
    faults: tuple[Request, ...] = ()  # put into the messages, not into the samples here
    fault_seed: int = 0

    @property
    def fallen_at(self) -> float | None:
        """When the bicycle fell [s since the start]; None: it did not."""
        return self.trajectory.end if self.trajectory.ended_by == "fallen" else None

    def records(self) -> Iterator[Record]:
        """All messages in the order of their arrival, the latched run information first."""
        made = merged(
            conversion.run_info_records(self.info),
            conversion.state_records(self.state),
            event_records(self.events),
            *(_arrived(records, self.speed_arrival_ns) for records in self._speeds()),
            *([conversion.steer_torque_records(self.steer_torque)] if self.steer_torque else []),
            _arrived(conversion.imu_records(self.imu), self.imu_arrival_ns),
            *(_arrived(records, self.arrival_ns) for records in self._packets()),
        )
        if not self.faults:
            return made
        return with_faults(made, self.faults, self.info.start_ns, np.random.default_rng(self.fault_seed))

    def _speeds(self) -> Iterator[Iterable[Record]]:
        yield conversion.speed_records(self.speed)
        if not np.isnan(self.speed.variance).all():
            yield conversion.speed_covariance_records(self.speed)

    def _packets(self) -> Iterator[Iterable[Record]]:
        yield conversion.lean_yaw_records(self.lean_yaw)
        if self.oriented is not None:
            yield conversion.imu_records(self.oriented)
        if self.magnetic is not None:
            yield conversion.magnetic_records(self.magnetic)

    def recording(self) -> Recording:
        """The samples as a recording; faults are in the messages only."""
        return Recording(
            path=Path(self.info.source or "simulated run"),
            imu=self.imu,
            speed=self.speed,
            steer_torque=self.steer_torque,
            lean_yaw=self.lean_yaw,
            state=self.state,
            run_info=self.info,
            start_ns=self.info.start_ns,
            custom_data=self.custom_data(),
        )

    def write(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the run into a bag, as `sim run` does. Raises RecordingError for a place that is taken."""
        with BagWriter(path, self.custom_data(), overwrite=overwrite) as bag:
            for record in self.records():
                bag.write(record, topics.qos_of(record.topic))

    def custom_data(self) -> dict[str, str]:
        """What made the run, for the metadata of a bag."""
        return {
            "configuration": self.info.configuration,
            "seed": str(self.info.seed),
            "source": self.info.source,
            "source_sha256": self.info.source_sha256,
            "version": self.info.version,
        }


def simulate(scenario: Scenario, rng: np.random.Generator) -> SimulatedRun:
    """Run a scenario. Raises ParameterError for an unknown bicycle, sensor, floor or the like."""
    # Each draws from a generator of its own: the same noise of one, whatever the others do.
    moving, sensing, rolling, failing = rng.spawn(4)
    trajectory = ride(scenario, moving)
    bicycle = load_bicycle(scenario.text("bicycle"))
    start_ns = scenario.integer("start_time_ns")
    imu_time = stamps(scenario.imu_raw_rate, trajectory.end)
    motion = trajectory.at(imu_time / 1e9)
    inertial = imu_stream(scenario, motion, imu_time, bicycle.gravity, sensing)
    speed = speed_stream(scenario, trajectory, rolling)
    state_time = stamps(scenario.number("state_rate"), trajectory.end)
    late = inertial.arrival_ns
    return SimulatedRun(
        info=_info(scenario, bicycle),
        state=true_state(trajectory.at(state_time / 1e9), start_ns, state_time),
        events=true_events((*trajectory.events, *inertial.events), start_ns),
        speed=speed.samples,
        steer_torque=_steer_torque(scenario, motion, start_ns + imu_time),
        imu=inertial.raw,
        lean_yaw=inertial.lean_yaw,
        oriented=inertial.oriented,
        magnetic=inertial.magnetic,
        trajectory=trajectory,
        saturation=inertial.saturation,
        imu_arrival_ns=late,
        arrival_ns=None if late is None else late[inertial.whole],
        speed_arrival_ns=speed.arrival_ns,
        faults=tuple(parse_requests(scenario.text("faults"))),
        fault_seed=int(failing.integers(2**63)),
    )


def _steer_torque(
    scenario: Scenario, motion: Motion, time_ns: NDArray[np.int64]
) -> SteerTorqueSamples | None:
    gain, every = scenario.number("steer_torque.lean_rate_gain"), scenario.imu_every
    return SteerTorqueSamples(time_ns[::every], gain * motion.lean_rate[::every]) if gain else None


def _arrived(records: Iterable[Record], arrival_ns: NDArray[np.int64] | None) -> Iterable[Record]:
    return records if arrival_ns is None else arriving(records, arrival_ns.tolist())


def _info(scenario: Scenario, bicycle: Bicycle) -> RunInfo:
    return RunInfo(
        start_ns=scenario.integer("start_time_ns"),
        bicycle=scenario.text("bicycle"),
        parameters=bicycle.numbers,
        speed=scenario.number("speed_at_strike") or scenario.number("speed"),
        imu_position=np.array(scenario.triple("imu.position")),
        imu_orientation=sensor_mounting(scenario).stated,
        simulated=True,
        seed=scenario.integer("seed"),
        source=f"tms_sim, scenario {scenario.name}",
        version=__version__,
        configuration=scenario.to_yaml(),
    )
