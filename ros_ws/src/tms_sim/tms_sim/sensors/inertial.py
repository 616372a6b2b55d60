"""The inertial sensor at its place on the rear frame: gyroscopes, accelerometers, magnetometers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array
from tms_model.frames import compose, flip_axes, quaternion, rear_frame_to_imu
from tms_model.imu import RearFrameMotion, ideal_imu, magnetic_field

from tms_sim.imu_grade import ImuGrade
from tms_sim.sensors.errors import Readings, measure

_AXES = np.array([1, 2, 4])  # flags of tms_msgs/LeanYaw: accelerometer x, y, z; gyroscopes are 8 times these


@dataclass(frozen=True, eq=False)
class Mounting:
    """Where the sensor sits on the rear frame, as run_info states it, and how it really sits."""

    position: Array  # (3,) [m] from the rear contact, REP-103 axes of the rear frame
    stated: Array  # (4,) quaternion x, y, z, w, imu -> rear frame
    true: Array  # (4,)


def mounting(
    position: tuple[float, ...], orientation_deg: tuple[float, ...], misalignment_deg: tuple[float, ...]
) -> Mounting:
    """Mounting from roll, pitch, yaw [deg] as stated, and those by which it is really turned from there."""
    stated = quaternion(*np.radians(orientation_deg))
    return Mounting(np.array(position), stated, compose(stated, quaternion(*np.radians(misalignment_deg))))


@dataclass(frozen=True)
class EarthField:
    """The Earth's magnetic field where the run is."""

    flux_density: float  # [T]
    inclination: float  # [rad] downward from the horizontal
    heading: float  # [rad] of the run's first heading, clockwise from magnetic north

    def at_start(self) -> Array:
        """The field (3,) [T] in SAE axes at the start: ahead, to the right, down."""
        level = self.flux_density * math.cos(self.inclination)
        down = self.flux_density * math.sin(self.inclination)
        return np.array([level * math.cos(self.heading), -level * math.sin(self.heading), down])


@dataclass(frozen=True, eq=False)
class Felt:
    """What acts on the sensor, in its own true axes (REP-103); each (n, 3)."""

    angular_velocity: Array  # [rad/s]
    specific_force: Array  # [m/s^2]
    magnetic_field: Array  # [T]


@dataclass(frozen=True, eq=False)
class ImuReadings:
    """What the three triads read."""

    gyroscopes: Readings  # [rad/s]
    accelerometers: Readings  # [m/s^2]
    magnetometers: Readings  # [T]

    @property
    def saturation(self) -> NDArray[np.uint8]:
        """Flags of tms_msgs/LeanYaw (n,): which axes stand at their limit."""
        flags: NDArray[np.uint8] = (
            self.accelerometers.cut @ _AXES + 8 * (self.gyroscopes.cut @ _AXES)
        ).astype(np.uint8)
        return flags


def felt(
    motion: RearFrameMotion,
    place: Mounting,
    gravity: float,
    field: EarthField,
    vibration: Array | None = None,
) -> Felt:
    """What acts on the sensor. vibration: (n,) [m/s^2], along the frame's up axis."""
    rate, force = ideal_imu(motion, flip_axes(place.position), gravity)
    if vibration is not None:
        force = force - vibration[:, None] * np.array([0.0, 0.0, 1.0])  # SAE: z down
    flux = magnetic_field(motion, field.at_start())
    return Felt(*(rear_frame_to_imu(vectors, place.true) for vectors in (rate, force, flux)))


def read(acting: Felt, grade: ImuGrade, rate: float, rng: np.random.Generator) -> ImuReadings:
    """What a sensor of this grade reads, sampled at `rate` [Hz]."""
    gyroscope, accelerometer, magnetometer = rng.spawn(3)
    return ImuReadings(
        measure(acting.angular_velocity, grade.gyroscope, rate, gyroscope),
        measure(acting.specific_force, grade.accelerometer, rate, accelerometer),
        measure(acting.magnetic_field, grade.magnetometer, rate, magnetometer),
    )


def at_rest(place: Mounting, gravity: float, field: EarthField) -> Felt:
    """What acts on the sensor (1 row) while the bicycle stands upright before the run."""
    still = RearFrameMotion(*np.zeros((7, 1)))
    return felt(still, place, gravity, field)
