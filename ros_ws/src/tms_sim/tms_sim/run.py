"""A simulated run: the bicycle rides as `tms_sim.protocol` says, and sensors measure it.

The motion is known at every instant, so every topic has its own rate without error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_bag import Record, conversion
from tms_bag.event import Event, event_records
from tms_bag.record import merged
from tms_bag.samples import (
    ImuSamples,
    LeanYawSamples,
    RunInfo,
    SpeedSamples,
    StateSamples,
    SteerTorqueSamples,
)
from tms_model import Bicycle, load_bicycle
from tms_model.frames import flip_axes, imu_to_rear_frame, quaternion, rear_frame_to_imu
from tms_model.imu import ideal_imu, lean_and_yaw_rate

from tms_sim import __version__
from tms_sim.imu_grade import load_imu, measure
from tms_sim.motion import Motion, Trajectory
from tms_sim.protocol import ride
from tms_sim.scenario import Scenario
from tms_sim.truth import rear_frame_motion, stamps, true_events, true_state

_AXES = np.array([1, 2, 4])  # flags of tms_msgs/LeanYaw: accelerometer x, y, z; gyroscopes are 8 times these


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """Samples of one run and what made it."""

    info: RunInfo
    state: StateSamples
    speed: SpeedSamples
    steer_torque: SteerTorqueSamples | None  # None: no torque acts
    imu: ImuSamples
    lean_yaw: LeanYawSamples
    events: tuple[Event, ...]  # of the truth
    trajectory: Trajectory  # the truth at every instant

    @property
    def fallen_at(self) -> float | None:
        """When the bicycle fell [s since the start]; None: it did not."""
        return self.trajectory.end if self.trajectory.ended_by == "fallen" else None

    def records(self) -> Iterator[Record]:
        """All messages in time order, the latched run information first."""
        torque = [conversion.steer_torque_records(self.steer_torque)] if self.steer_torque else []
        return merged(
            conversion.run_info_records(self.info),
            conversion.state_records(self.state),
            event_records(self.events),
            conversion.speed_records(self.speed),
            *torque,
            conversion.imu_records(self.imu),
            conversion.lean_yaw_records(self.lean_yaw),
        )

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
    # The motion draws from a generator of its own: the same noise of the sensors, whatever happens.
    trajectory = ride(scenario, rng.spawn(1)[0])
    bicycle = load_bicycle(scenario.text("bicycle"))
    start_ns = scenario.integer("start_time_ns")
    imu_time = stamps(scenario.number("imu.rate"), trajectory.end)
    motion = trajectory.at(imu_time / 1e9)
    imu, lean_yaw = _measure_imu(scenario, bicycle, motion, start_ns + imu_time, rng)
    speed_time = stamps(scenario.number("speed_sensor.rate"), trajectory.end)
    noise = scenario.number("speed_sensor.noise") * rng.standard_normal(len(speed_time))
    state_time = stamps(scenario.number("state_rate"), trajectory.end)
    gain = scenario.number("steer_torque.lean_rate_gain")
    return SimulatedRun(
        info=_info(scenario, bicycle),
        state=true_state(trajectory.at(state_time / 1e9), start_ns, state_time),
        events=true_events(trajectory, start_ns),
        speed=SpeedSamples(start_ns + speed_time, trajectory.at(speed_time / 1e9).speed + noise),
        steer_torque=SteerTorqueSamples(start_ns + imu_time, gain * motion.lean_rate) if gain else None,
        imu=imu,
        lean_yaw=lean_yaw,
        trajectory=trajectory,
    )


def _measure_imu(
    scenario: Scenario, bicycle: Bicycle, motion: Motion, time_ns: NDArray[np.int64], rng: np.random.Generator
) -> tuple[ImuSamples, LeanYawSamples]:
    position = flip_axes(np.array(scenario.triple("imu.position")))
    orientation = quaternion(*np.radians(scenario.triple("imu.orientation_deg")))
    grade, rate = load_imu(scenario.text("imu.grade")), scenario.number("imu.rate")
    true_rates, true_force = (
        rear_frame_to_imu(v, orientation)
        for v in ideal_imu(rear_frame_motion(motion), position, bicycle.gravity)
    )
    rates, rates_cut = measure(true_rates, grade.gyroscope_std(rate), grade.gyroscope_limit, rng)
    force, force_cut = measure(true_force, grade.accelerometer_std(rate), grade.accelerometer_limit, rng)
    # The sensor's own orientation is taken as exact here: it levels the gyroscopes by the true lean angle.
    lean_rate, level_yaw_rate = lean_and_yaw_rate(imu_to_rear_frame(rates, orientation), motion.lean)
    imu = ImuSamples(
        time_ns=time_ns,
        angular_velocity=rates,
        specific_force=force,
        angular_velocity_variance=np.full(3, grade.gyroscope_std(rate) ** 2),
        specific_force_variance=np.full(3, grade.accelerometer_std(rate) ** 2),
    )
    saturation = (force_cut @ _AXES + 8 * (rates_cut @ _AXES)).astype(np.uint8)
    return imu, LeanYawSamples(time_ns, motion.lean, lean_rate, level_yaw_rate, saturation)


def _info(scenario: Scenario, bicycle: Bicycle) -> RunInfo:
    return RunInfo(
        start_ns=scenario.integer("start_time_ns"),
        bicycle=scenario.text("bicycle"),
        parameters=bicycle.numbers,
        speed=scenario.number("speed_at_strike") or scenario.number("speed"),
        imu_position=np.array(scenario.triple("imu.position")),
        imu_orientation=quaternion(*np.radians(scenario.triple("imu.orientation_deg"))),
        simulated=True,
        seed=scenario.integer("seed"),
        source=f"tms_sim, scenario {scenario.name}",
        version=__version__,
        configuration=scenario.to_yaml(),
    )
