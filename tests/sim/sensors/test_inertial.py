"""The sensor on the frame: cases worked by hand, mounting, vibration and its own orientation."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tms_model.imu import RearFrameMotion
from tms_sim.imu_grade import imu_names, load_imu
from tms_sim.sensors.inertial import EarthField, Felt, Mounting, at_rest, felt, mounting, read
from tms_sim.sensors.orientation import FilterSettings, frame_lean, orientations

G = 9.81
EAST = EarthField(49e-6, math.radians(67.0), math.radians(90.0))  # starts towards east
LEVEL = mounting((0.0, 0.0, 0.15), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
PLAIN = FilterSettings(gain=0.5, acceleration_rejection=0.0, magnetic_rejection=0.0, rejection_timeout=5.0)
RATE = 100.0


def motion(count: int = 1, **columns: object) -> RearFrameMotion:
    names = [entry.name for entry in dataclasses.fields(RearFrameMotion)]
    return RearFrameMotion(**{n: np.broadcast_to(columns.get(n, 0.0), count).astype(float) for n in names})


def test_at_rest_facing_east_by_hand() -> None:
    acting = at_rest(LEVEL, G, EAST)
    np.testing.assert_allclose(acting.angular_velocity, [[0.0, 0.0, 0.0]])
    np.testing.assert_allclose(acting.specific_force, [[0.0, 0.0, 9.81]])  # +g up (REP-145)
    # North is to the left: 49 uT cos 67 deg = 19.146 uT there, 49 uT sin 67 deg = 45.105 uT down.
    np.testing.assert_allclose(acting.magnetic_field, [[0.0, 19.146e-6, -45.105e-6]], atol=1e-9)


def test_steady_circle_by_hand() -> None:
    # 4 m/s, yawing right at 0.5 rad/s, upright: 2 m/s^2 to the right, -2 along the sensor's left axis.
    acting = felt(motion(yaw_rate=0.5, speed=4.0), LEVEL, G, EAST)
    np.testing.assert_allclose(acting.specific_force, [[0.0, -2.0, 9.81]], atol=1e-14)
    np.testing.assert_allclose(acting.angular_velocity, [[0.0, 0.0, -0.5]])  # to the left positive


def test_wrong_mounting_is_felt_but_not_stated() -> None:
    # Stated: turned 90 deg to the left, its x axis to the left. Really tilted 2 deg about that x besides.
    askew = mounting((0.0, 0.0, 0.0), (0.0, 0.0, 90.0), (2.0, 0.0, 0.0))
    stated = Rotation.from_quat(askew.stated).as_matrix()
    np.testing.assert_allclose(stated @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)
    acting = felt(motion(), askew, G, EAST)
    # Rolled about its x by 2 deg, its y axis rises: 9.81 sin 2 deg = 0.34237.
    np.testing.assert_allclose(acting.specific_force, [[0.0, 0.34237, 9.80402]], atol=1e-5)


def test_vibration_acts_along_the_frame() -> None:
    lean = math.radians(30.0)
    still, shaken = (
        felt(motion(2, lean=lean), LEVEL, G, EAST, v).specific_force for v in (None, np.array([0.7, -0.2]))
    )
    np.testing.assert_allclose(shaken - still, [[0.0, 0.0, 0.7], [0.0, 0.0, -0.2]], atol=1e-14)


@pytest.mark.parametrize("name", imu_names())
def test_saturation_flags_stand_where_a_reading_is_at_its_limit(name: str) -> None:
    grade = load_imu(name)
    violent = np.random.default_rng(5).normal(0.0, 200.0, (500, 3))
    reading = read(Felt(violent / 20.0, violent, violent / 1e6), grade, RATE, np.random.default_rng(1))
    flags = np.zeros(500, dtype=int)
    for axis in range(3):
        at = np.abs(reading.accelerometers.values[:, axis]) >= grade.accelerometer.limit
        flags += at * (1 << axis)
        at = np.abs(reading.gyroscopes.values[:, axis]) >= grade.gyroscope.limit
        flags += at * (8 << axis)
    np.testing.assert_array_equal(reading.saturation, flags)
    if name in ("pi_node", "consumer_mems"):
        assert flags.any()


def oriented(
    moving: RearFrameMotion, place: Mounting = LEVEL, grade: str = "ideal", **changes: float
) -> np.ndarray:
    sensor = load_imu(grade)
    limited = dataclasses.replace(
        sensor, accelerometer=dataclasses.replace(sensor.accelerometer, limit=changes.get("limit", math.inf))
    )
    acting = felt(moving, place, G, EAST)
    reading = read(acting, limited, RATE, np.random.default_rng(1))
    return orientations(reading, at_rest(place, G, EAST), PLAIN, RATE, math.inf)


@pytest.mark.parametrize("mounted", [(0.0, 0.0, 0.0), (20.0, -30.0, 110.0)])
@pytest.mark.parametrize("heading", [90.0, 0.0, 217.0])
def test_orientation_at_rest_is_the_mounting_in_the_world(mounted: tuple[float, ...], heading: float) -> None:
    # Heading clockwise from north; x of the world is east: the frame is turned left by 90 deg - heading.
    field = dataclasses.replace(EAST, heading=math.radians(heading))
    place = mounting((0.0, 0.0, 0.15), mounted, (0.0, 0.0, 0.0))
    acting = felt(motion(10), place, G, field)
    reading = read(acting, load_imu("ideal"), RATE, np.random.default_rng(1))
    found = orientations(reading, at_rest(place, G, field), PLAIN, RATE, math.inf)
    expected = Rotation.from_euler("z", 90.0 - heading, degrees=True) * Rotation.from_quat(place.stated)
    angle = (Rotation.from_quat(found) * expected.inv()).magnitude()
    assert np.degrees(angle).max() < 0.1  # the library's single precision, and its filter's last creep


def test_orientation_follows_a_swing_in_lean_and_heading() -> None:
    # Half a second there and back, so that the slow pull of accelerometers hardly matters.
    t = np.arange(200) / RATE
    lean, yaw = 0.2 * np.sin(2 * np.pi * t) ** 3, 0.3 * np.sin(np.pi * t) ** 3
    rates = [np.gradient(x, t, edge_order=2) for x in (lean, yaw)]
    accelerations = [np.gradient(x, t, edge_order=2) for x in rates]
    moving = motion(
        200, lean=lean, lean_rate=rates[0], lean_acceleration=accelerations[0], yaw=yaw, yaw_rate=rates[1],
        yaw_acceleration=accelerations[1],
    )  # fmt: skip
    place = mounting((0.0, 0.0, 0.0), (10.0, 20.0, 30.0), (0.0, 0.0, 0.0))
    found = frame_lean(oriented(moving, place), place.stated)
    assert np.degrees(np.abs(found - lean)).max() < 1.0
    turned = Rotation.from_quat(oriented(moving, place)[100]) * Rotation.from_quat(place.stated).inv()
    assert turned.as_euler("ZYX", degrees=True)[0] == pytest.approx(-math.degrees(yaw[100]), abs=1.5)


@pytest.mark.parametrize(("speed", "turn"), [(4.0, 0.5), (9.0, 0.2)])
def test_a_long_turn_pulls_the_orientation_towards_the_frame(speed: float, turn: float) -> None:
    # Balanced in a turn the force points along the frame. The filter turns its vertical with the gyroscopes
    # and pulls it there with the gain k, so that its error d in the level plane, as the frame sees it, obeys
    # d' = k (lean - d) - i turn d: it ends at lean k / (k + i turn), and the lean it tells is too small by
    # the real part of that, lean k^2 / (k^2 + turn^2).
    lean = math.atan(speed * turn / G)
    t = np.arange(2500) / RATE
    ramp = np.clip(t / 0.5, 0.0, 1.0)
    moving = motion(
        2500, lean=lean * ramp, lean_rate=np.where(t < 0.5, lean / 0.5, 0.0), yaw_rate=turn * ramp,
        yaw=np.cumsum(turn * ramp) / RATE, speed=speed,
    )  # fmt: skip
    place = mounting((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    found = frame_lean(oriented(moving, place), place.stated)
    assert found[60] == pytest.approx(lean, abs=math.radians(2.0))  # right after, hardly anything is lost
    share = PLAIN.gain**2 / (PLAIN.gain**2 + turn**2)
    assert lean - found[-1] == pytest.approx(share * lean, rel=0.05)


def test_a_saturated_accelerometer_spoils_the_orientation() -> None:
    # Upright, at rest, accelerometers cut off at half a g, mounted 40 deg askew: the force looks tilted.
    place = mounting((0.0, 0.0, 0.0), (40.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    fine, spoilt = (frame_lean(oriented(motion(1000), place, limit=x), place.stated) for x in (20.0, 4.9))
    assert np.degrees(np.abs(fine)).max() < 0.1
    # y cut from 6.31 to 4.9, z from 7.51 to 4.9: 45 deg instead of 40 deg.
    assert math.degrees(spoilt[-1]) == pytest.approx(5.0, abs=0.5)


def test_same_seed_same_orientation() -> None:
    moving = motion(100, lean=0.1, yaw_rate=0.3)
    np.testing.assert_array_equal(oriented(moving, grade="pi_node"), oriented(moving, grade="pi_node"))
