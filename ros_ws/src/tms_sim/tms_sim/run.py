"""A simulated run: the bicycle rolls upright at constant speed, is struck, moves freely; sensors measure it.

The motion is exact between samples (matrix exponentials), so every topic has its own rate without error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_bag import Record, conversion
from tms_bag.record import merged
from tms_bag.samples import (
    ImuSamples,
    LeanYawSamples,
    RunInfo,
    SpeedSamples,
    StateSamples,
    SteerTorqueSamples,
)
from tms_model import Bicycle, linear_system, load_bicycle, response, yaw_rate
from tms_model.bicycle import Array
from tms_model.frames import flip_axes, imu_to_rear_frame, quaternion, rear_frame_to_imu
from tms_model.imu import RearFrameMotion, ideal_imu, lean_and_yaw_rate
from tms_model.response import LEAN, LEAN_RATE, LinearSystem, with_heading

from tms_sim import __version__
from tms_sim.imu_grade import load_imu, measure
from tms_sim.scenario import Scenario

FALLEN = 1.0  # [rad] of lean; beyond it linear theory means nothing and the run ends
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
    fallen_at: float | None  # [s] when the bicycle fell, None: it did not

    def records(self) -> Iterator[Record]:
        """All messages in time order, the latched run information first."""
        torque = [conversion.steer_torque_records(self.steer_torque)] if self.steer_torque else []
        return merged(
            conversion.run_info_records(self.info),
            conversion.state_records(self.state),
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
    """Run a scenario. Raises ParameterError for an unknown bicycle or sensor."""
    bicycle = load_bicycle(scenario.text("bicycle"))
    gain = scenario.number("steer_torque.lean_rate_gain")
    system = linear_system(bicycle, scenario.number("speed"), gain)
    end, fallen_at = _end(scenario, system)
    imu_time = _stamps(scenario.number("imu.rate"), end)
    states = _states(scenario, system, imu_time)[:, :4]
    imu, lean_yaw = _measure_imu(scenario, bicycle, system, imu_time, states, rng)
    speed_time = _stamps(scenario.number("speed_sensor.rate"), end)
    noise = scenario.number("speed_sensor.noise") * rng.standard_normal(len(speed_time))
    start_ns = scenario.integer("start_time_ns")
    return SimulatedRun(
        info=_info(scenario, bicycle),
        state=_truth(scenario, system, _stamps(scenario.number("state_rate"), end), gain),
        speed=SpeedSamples(start_ns + speed_time, system.speed + noise),
        steer_torque=SteerTorqueSamples(start_ns + imu_time, gain * states[:, LEAN_RATE]) if gain else None,
        imu=imu,
        lean_yaw=lean_yaw,
        fallen_at=fallen_at,
    )


def _stamps(rate: float, end: float) -> NDArray[np.int64]:
    """Times [ns since the start] of samples at `rate` [Hz], from 0 up to and with `end` [s]."""
    count = math.floor(end * rate + 1e-9) + 1
    return np.round(np.arange(count) * (1e9 / rate)).astype(np.int64)


def _states(scenario: Scenario, system: LinearSystem, time_ns: NDArray[np.int64]) -> Array:
    """States and heading (n, 5): at rest before the strike, free response from its very instant on."""
    since = (time_ns - round(scenario.number("strike.time") * 1e9)) / 1e9
    after = since >= 0.0
    states = np.zeros((len(time_ns), 5))
    struck = np.array(
        [0.0, 0.0, scenario.number("strike.lean_rate"), scenario.number("strike.steer_rate"), 0.0]
    )
    states[after] = response(with_heading(system), struck, since[after])
    return states


def _end(scenario: Scenario, system: LinearSystem) -> tuple[float, float | None]:
    """When the run ends [s], and when the bicycle fell, if it did."""
    time_ns = _stamps(1000.0, scenario.number("duration"))
    for first in range(0, len(time_ns), 5000):  # not far beyond a fall, where numbers grow without bound
        block = time_ns[first : first + 5000]
        fallen = np.abs(_states(scenario, system, block)[:, LEAN]) > FALLEN
        if fallen.any():
            when = float(block[np.argmax(fallen)]) / 1e9
            return when, when
    return scenario.number("duration"), None


def _measure_imu(
    scenario: Scenario,
    bicycle: Bicycle,
    system: LinearSystem,
    time_ns: NDArray[np.int64],
    states: Array,
    rng: np.random.Generator,
) -> tuple[ImuSamples, LeanYawSamples]:
    changes = states @ system.a.T
    motion = RearFrameMotion(
        lean=states[:, LEAN],
        lean_rate=states[:, LEAN_RATE],
        lean_acceleration=changes[:, LEAN_RATE],
        yaw_rate=yaw_rate(system, states),
        yaw_acceleration=yaw_rate(system, changes),
        speed=np.full(len(states), system.speed),
        acceleration=np.zeros(len(states)),
    )
    position = flip_axes(np.array(scenario.triple("imu.position")))
    orientation = quaternion(*np.radians(scenario.triple("imu.orientation_deg")))
    grade, rate = load_imu(scenario.text("imu.grade")), scenario.number("imu.rate")
    true_rates, true_force = (
        rear_frame_to_imu(v, orientation) for v in ideal_imu(motion, position, bicycle.gravity)
    )
    rates, rates_cut = measure(true_rates, grade.gyroscope_std(rate), grade.gyroscope_limit, rng)
    force, force_cut = measure(true_force, grade.accelerometer_std(rate), grade.accelerometer_limit, rng)
    stamps = scenario.integer("start_time_ns") + time_ns
    # The sensor's own orientation is taken as exact here: it levels the gyroscopes by the true lean angle.
    lean_rate, level_yaw_rate = lean_and_yaw_rate(imu_to_rear_frame(rates, orientation), motion.lean)
    imu = ImuSamples(
        time_ns=stamps,
        angular_velocity=rates,
        specific_force=force,
        angular_velocity_variance=np.full(3, grade.gyroscope_std(rate) ** 2),
        specific_force_variance=np.full(3, grade.accelerometer_std(rate) ** 2),
    )
    saturation = (force_cut @ _AXES + 8 * (rates_cut @ _AXES)).astype(np.uint8)
    return imu, LeanYawSamples(stamps, motion.lean, lean_rate, level_yaw_rate, saturation)


def _truth(scenario: Scenario, system: LinearSystem, time_ns: NDArray[np.int64], gain: float) -> StateSamples:
    states = _states(scenario, system, time_ns)
    return StateSamples(
        time_ns=scenario.integer("start_time_ns") + time_ns,
        speed=np.full(len(states), system.speed),
        state=states[:, :4],
        yaw=states[:, 4],
        yaw_rate=yaw_rate(system, states[:, :4]),
        steer_torque=gain * states[:, LEAN_RATE],
    )


def _info(scenario: Scenario, bicycle: Bicycle) -> RunInfo:
    return RunInfo(
        start_ns=scenario.integer("start_time_ns"),
        bicycle=scenario.text("bicycle"),
        parameters=bicycle.numbers,
        speed=scenario.number("speed"),
        imu_position=np.array(scenario.triple("imu.position")),
        imu_orientation=quaternion(*np.radians(scenario.triple("imu.orientation_deg"))),
        simulated=True,
        seed=scenario.integer("seed"),
        source=f"tms_sim, scenario {scenario.name}",
        version=__version__,
        configuration=scenario.to_yaml(),
    )
