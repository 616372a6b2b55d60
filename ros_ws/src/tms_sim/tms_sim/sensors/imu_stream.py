"""What the inertial sensor of a scenario sends, and what of it arrives."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from tms_bag.samples import ImuSamples, LeanYawSamples, MagneticSamples
from tms_model.bicycle import Array
from tms_model.frames import imu_to_rear_frame
from tms_model.imu import lean_and_yaw_rate

from tms_sim.imu_grade import ImuGrade, error_names, load_imu
from tms_sim.motion import Event, Motion
from tms_sim.scenario import Scenario
from tms_sim.sensors.inertial import EarthField, ImuReadings, Mounting, at_rest, felt, mounting, read
from tms_sim.sensors.orientation import FilterSettings, frame_lean, orientations
from tms_sim.sensors.vibration import Padding, floor_vibration
from tms_sim.sensors.wireless import Delivery, Link, deliver
from tms_sim.truth import rear_frame_motion


@dataclass(frozen=True, eq=False)
class ImuStream:
    """The packets of the inertial sensor that arrive; a duplicate stands twice.

    A packet holds a raw sample, and each n-th all else.
    """

    raw: ImuSamples  # m of them
    whole: NDArray[np.bool_]  # (m,) which packets hold the rest, too
    oriented: ImuSamples | None  # with the sensor's own orientation; None: it finds none
    magnetic: MagneticSamples | None
    lean_yaw: LeanYawSamples
    saturation: NDArray[np.uint8]  # (m,) flags of tms_msgs/LeanYaw
    arrival_ns: NDArray[np.int64] | None  # (m,) [ns] by the host's clock; None: at their stamps
    events: tuple[Event, ...]  # packets that never came


def imu_stream(
    scenario: Scenario, motion: Motion, time_ns: NDArray[np.int64], gravity: float, rng: np.random.Generator
) -> ImuStream:
    """The sensor's packets. Raises ParameterError.

    motion: at the sensor's samples, at times (n,) [ns since the start].
    """
    shaking, reading, radio = rng.spawn(3)
    grade = load_imu(scenario.text("imu.grade")).only(error_names(scenario.text("imu.errors")))
    rate, place, field = scenario.imu_raw_rate, sensor_mounting(scenario), _field(scenario)
    padding = Padding(scenario.number("padding.natural_frequency"), scenario.number("padding.damping_ratio"))
    shake = floor_vibration(motion.speed, rate, scenario.number("floor_vibration.rms"), padding, shaking)
    acting = felt(rear_frame_motion(motion), place, gravity, field, shake)
    readings = read(acting, grade, rate, reading)
    own = None
    if scenario.switch("fusion.enabled"):
        own = orientations(
            readings, at_rest(place, gravity, field), _filter(scenario), rate, grade.gyroscope.limit
        )
    start_ns = scenario.integer("start_time_ns")
    distance = np.hypot(motion.rear_contact[:, 0], motion.rear_contact[:, 1])
    delivery = deliver(start_ns + time_ns, distance, link_of(scenario), start_ns, radio)
    lean = motion.lean if own is None else frame_lean(own, place.stated)
    return _arrived(readings, own, lean, grade, rate, place, delivery, time_ns, scenario.imu_every)


def sensor_mounting(scenario: Scenario) -> Mounting:
    """Where the sensor sits, as stated and really."""
    return mounting(
        scenario.triple("imu.position"),
        scenario.triple("imu.orientation_deg"),
        scenario.triple("imu.misalignment_deg"),
    )


def _arrived(
    readings: ImuReadings,
    own: Array | None,
    lean: Array,
    grade: ImuGrade,
    rate: float,
    place: Mounting,
    delivery: Delivery,
    time_ns: NDArray[np.int64],
    every: int,
) -> ImuStream:
    whole = delivery.rows % every == 0
    raw = _raw(readings, delivery.rows, delivery.stamp_ns, grade, rate)
    rows, stamps = delivery.rows[whole], delivery.stamp_ns[whole]
    rates = raw.angular_velocity[whole]
    lean_rate, yaw_rate = lean_and_yaw_rate(imu_to_rear_frame(rates, place.stated), lean[rows])
    oriented = magnetic = None
    if own is not None:
        oriented = replace(_raw(readings, rows, stamps, grade, rate), orientation=own[rows])
        magnetic = MagneticSamples(
            stamps,
            readings.magnetometers.values[rows],
            np.full(3, grade.magnetometer.noise_std(rate) ** 2),
        )
    summary = LeanYawSamples(stamps, lean[rows], lean_rate, yaw_rate, readings.saturation[rows])
    late = None if np.array_equal(delivery.arrival_ns, delivery.stamp_ns) else delivery.arrival_ns
    flags = readings.saturation[delivery.rows]
    events = _losses(delivery, time_ns, rate)
    return ImuStream(raw, whole, oriented, magnetic, summary, flags, late, events)


def _raw(
    readings: ImuReadings,
    rows: NDArray[np.int64],
    stamps: NDArray[np.int64],
    grade: ImuGrade,
    rate: float,
) -> ImuSamples:
    return ImuSamples(
        time_ns=stamps,
        angular_velocity=readings.gyroscopes.values[rows],
        specific_force=readings.accelerometers.values[rows],
        angular_velocity_variance=np.full(3, grade.gyroscope.noise_std(rate) ** 2),
        specific_force_variance=np.full(3, grade.accelerometer.noise_std(rate) ** 2),
    )


def _losses(delivery: Delivery, time_ns: NDArray[np.int64], rate: float) -> tuple[Event, ...]:
    """One event for each run of packets that never came."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], delivery.lost.astype(np.int8), [0]])))
    return tuple(
        Event(
            time=float(time_ns[first]) / 1e9,
            kind="loss",
            text=f"{last - first} packet{'s' if last - first > 1 else ''} of the inertial sensor lost",
            duration=float(last - first) / rate,
            figures={"packets": float(last - first)},
        )
        for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    )


def _field(scenario: Scenario) -> EarthField:
    return EarthField(
        scenario.number("magnetic_field.flux_density"),
        math.radians(scenario.number("magnetic_field.inclination_deg")),
        math.radians(scenario.number("magnetic_field.heading_deg")),
    )


def _filter(scenario: Scenario) -> FilterSettings:
    return FilterSettings(
        scenario.number("fusion.gain"),
        math.radians(scenario.number("fusion.acceleration_rejection_deg")),
        math.radians(scenario.number("fusion.magnetic_rejection_deg")),
        scenario.number("fusion.rejection_timeout"),
    )


def link_of(scenario: Scenario) -> Link:
    """The radio link of a scenario."""
    names = ("loss", "burst_start", "burst_end", "burst_loss", "latency", "jitter", "duplicates")
    return Link(
        reach=scenario.number("wireless.range") or math.inf,
        clock_offset=scenario.number("wireless.clock_offset"),
        clock_drift=scenario.number("wireless.clock_drift"),
        **{name: scenario.number(f"wireless.{name}") for name in names},
    )
