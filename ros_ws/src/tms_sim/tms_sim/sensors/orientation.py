"""The sensor's own orientation, by imufusion's filter (Madgwick's, github.com/xioTechnologies/Fusion).

Gyroscopes are integrated; accelerometers, taken for the vertical, and magnetometers, taken for north, pull
slowly. So the orientation is wrong in the ways of such filters: what is cut off at a limit is believed, and
in a long turn the accelerometers point along the frame instead of up. The filter runs on the spot until it
has settled, as a sensor does that is switched on before the run, and knows what its gyroscopes read at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tms_model import ParameterError
from tms_model.bicycle import Array
from tms_model.frames import compose, inverse, lean_and_heading, quaternion

from tms_sim.sensors.inertial import Felt, ImuReadings

STANDARD_GRAVITY = 9.80665  # [m/s^2], one g
SETTLING, SETTLING_STEP = 400, 0.05  # steps, and seconds each, before the run
# imufusion's world is x north, y west, z up here; its x east, y north setting is a quarter turn off its own
# compass in version 1.3. ROS wants x east, y north (REP-103).
_NORTH_WEST_TO_EAST_NORTH = quaternion(0.0, 0.0, np.pi / 2.0)


@dataclass(frozen=True)
class FilterSettings:
    """Settings of the filter, as imufusion has them."""

    gain: float  # [1/s] how fast accelerometers and magnetometers pull
    acceleration_rejection: float  # [rad] accelerometers farther off are not believed, 0: always believed
    magnetic_rejection: float  # [rad] likewise
    rejection_timeout: float  # [s] after which they are believed again


def orientations(
    readings: ImuReadings, rest: Felt, settings: FilterSettings, rate: float, gyroscope_limit: float
) -> Array:
    """Quaternions (n, 4) x, y, z, w of the sensor in the world (x east, y north, z up).

    rest: what acted on it before the run (1 row); rate: of the samples [Hz]; gyroscope_limit: [rad/s],
    infinite for none.
    """
    try:
        import imufusion  # here, since rosdep doesn't know it: everything else works without
    except ImportError as error:
        raise ParameterError(
            "imu.orientation: filter needs imufusion, which isn't installed: pip install imufusion, or choose"
            " imu.orientation: none"
        ) from error
    ahrs = imufusion.Ahrs()
    reach = np.degrees(gyroscope_limit) if np.isfinite(gyroscope_limit) else 0.0
    ahrs.set_settings(
        imufusion.AhrsSettings(
            sample_rate=rate,
            convention=imufusion.CONVENTION_NWU,
            gain=settings.gain,
            gyroscope_range=float(reach),
            acceleration_rejection=float(np.degrees(settings.acceleration_rejection)),
            magnetic_rejection=float(np.degrees(settings.magnetic_rejection)),
            rejection_timeout=settings.rejection_timeout,
        )
    )
    offset = readings.gyroscopes.imperfection.steady(rest.angular_velocity)
    up = readings.accelerometers.imperfection.steady(rest.specific_force)[0] / STANDARD_GRAVITY
    north = 1e6 * readings.magnetometers.imperfection.steady(rest.magnetic_field)[0]
    ahrs.set_sample_period(SETTLING_STEP)
    for _ in range(SETTLING):
        ahrs.update(np.zeros(3), up, north)
    ahrs.set_sample_period(1.0 / rate)
    turning = np.degrees(readings.gyroscopes.values - offset)
    forces, fields = (
        readings.accelerometers.values / STANDARD_GRAVITY,
        1e6 * readings.magnetometers.values,
    )
    found = np.empty((len(turning), 4))
    for row, (rates, force, field) in enumerate(zip(turning, forces, fields, strict=True)):
        ahrs.update(rates, force, field)
        found[row] = ahrs.get_quaternion()
    found = found[:, [1, 2, 3, 0]] / np.linalg.norm(found, axis=1, keepdims=True)
    return compose(_NORTH_WEST_TO_EAST_NORTH, found)


def frame_lean(orientation: Array, stated_mounting: Array) -> Array:
    """Lean of the rear frame (n,) [rad] by the sensor's orientation (n, 4) and the stated mounting (4,)."""
    return lean_and_heading(compose(orientation, inverse(stated_mounting)))[0]
