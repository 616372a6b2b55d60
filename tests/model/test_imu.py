"""What an ideal inertial sensor feels, derived again without the formulas of `tms_model.imu`.

Simulator and estimator share those formulas, so that a wrong sign would cancel. Here the sensor's position in
the world is written down, in REP-103 axes, from rotation matrices and the path of the rear contact; its
acceleration and its turning come by numerical differentiation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tms_model.frames import (
    compose,
    flip_axes,
    inverse,
    lean_and_heading,
    quaternion,
    rear_frame_to_imu,
    rotation_matrix,
)
from tms_model.imu import RearFrameMotion, ideal_imu, lean_and_yaw_rate, magnetic_field

G = 9.81
STEP = 4e-3  # [s] of the five-point differences: errors of about 1e-9
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)


class Ride:
    """A swerving, braking, leaning, skidding ride: angles and speeds as functions of time; SAE signs."""

    def lean(self, t: float) -> float:
        return 0.35 * math.sin(1.7 * t + 0.3)

    def yaw(self, t: float) -> float:
        return 0.8 * math.sin(1.1 * t) + 0.3 * t

    def speed(self, t: float) -> float:
        return 3.0 + 0.6 * math.sin(0.9 * t)

    def slip(self, t: float) -> float:
        return 0.3 * math.sin(2.3 * t)

    def motion(self, t: float) -> RearFrameMotion:
        columns = {
            "lean": self.lean(t),
            "lean_rate": 0.35 * 1.7 * math.cos(1.7 * t + 0.3),
            "lean_acceleration": -0.35 * 1.7**2 * math.sin(1.7 * t + 0.3),
            "yaw_rate": 0.8 * 1.1 * math.cos(1.1 * t) + 0.3,
            "yaw_acceleration": -0.8 * 1.1**2 * math.sin(1.1 * t),
            "speed": self.speed(t),
            "acceleration": 0.6 * 0.9 * math.cos(0.9 * t),
            "rear_slip": self.slip(t),
            "rear_slip_acceleration": 0.3 * 2.3 * math.cos(2.3 * t),
            "yaw": self.yaw(t),
        }
        return RearFrameMotion(**{name: np.array([value]) for name, value in columns.items()})

    def contact(self, t: float) -> np.ndarray:
        """Where the rear wheel touches the ground: speed along, slip across the heading, integrated."""
        place = np.zeros(3)
        edges = np.linspace(0.0, t, 8)
        for low, high in pairwise(edges):
            for node, weight in zip(NODES, WEIGHTS, strict=True):
                s = low + 0.5 * (high - low) * (node + 1.0)
                heading = -self.yaw(s)  # to the left positive
                direction = np.array([math.cos(heading), math.sin(heading), 0.0])
                to_the_right = np.array([math.sin(heading), -math.cos(heading), 0.0])
                velocity = self.speed(s) * direction + self.slip(s) * to_the_right
                place += 0.5 * (high - low) * weight * velocity
        return place

    def orientation(self, t: float) -> Rotation:
        """Rear frame in the world: yawed about up, then leaned about its own forward axis."""
        return Rotation.from_euler("Z", -self.yaw(t)) * Rotation.from_euler("X", self.lean(t))


def first_derivative(f: Callable[[float], np.ndarray], t: float) -> np.ndarray:
    return (f(t - 2 * STEP) - 8 * f(t - STEP) + 8 * f(t + STEP) - f(t + 2 * STEP)) / (12 * STEP)


def second_derivative(f: Callable[[float], np.ndarray], t: float) -> np.ndarray:
    outer, inner = f(t - 2 * STEP) + f(t + 2 * STEP), f(t - STEP) + f(t + STEP)
    return (-outer + 16 * inner - 30 * f(t)) / (12 * STEP**2)


@pytest.mark.parametrize("mounting_deg", [(0.0, 0.0, 0.0), (20.0, -35.0, 110.0)], ids=["level", "askew"])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.4, -0.1, 0.9)], ids=["at the contact", "on the frame"])
@pytest.mark.parametrize("time", [0.7, 2.9, 4.4])
def test_along_a_known_ride(mounting_deg: tuple[float, ...], place: tuple[float, ...], time: float) -> None:
    ride, mounting = Ride(), Rotation.from_euler("xyz", mounting_deg, degrees=True)

    def sensor(t: float) -> np.ndarray:
        return ride.contact(t) + ride.orientation(t).apply(place)

    def attitude(t: float) -> np.ndarray:
        return (ride.orientation(t) * mounting).as_matrix()

    into_sensor = attitude(time).T
    expected_force = into_sensor @ (second_derivative(sensor, time) + np.array([0.0, 0.0, G]))
    spin = into_sensor @ first_derivative(
        attitude, time
    )  # R^T R' is the cross-product matrix of the angular velocity
    expected_rate = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])

    rate, force = ideal_imu(ride.motion(time), flip_axes(np.array(place)), G)
    orientation = quaternion(*np.radians(mounting_deg))
    np.testing.assert_allclose(rear_frame_to_imu(rate, orientation)[0], expected_rate, atol=1e-8)
    np.testing.assert_allclose(rear_frame_to_imu(force, orientation)[0], expected_force, atol=1e-7)


@pytest.mark.parametrize("time", [0.0, 0.7, 2.9, 4.4])
def test_magnetic_field_stays_where_it_is_while_the_frame_turns(time: float) -> None:
    # In the world (x forward at the start, y left, z up) the field is the same at all times.
    ride, at_start = Ride(), np.array([18e-6, -5e-6, 45e-6])  # SAE
    field = flip_axes(magnetic_field(ride.motion(time), at_start))[0]
    np.testing.assert_allclose(ride.orientation(time).apply(field), flip_axes(at_start), atol=1e-19)


def test_quaternions_compose_and_invert_as_rotations_do() -> None:
    first, second = quaternion(0.3, -0.7, 2.0), quaternion(-1.1, 0.2, 0.4)
    np.testing.assert_allclose(
        rotation_matrix(compose(first, second)), rotation_matrix(first) @ rotation_matrix(second), atol=1e-15
    )
    np.testing.assert_allclose(compose(first, inverse(first)), [0.0, 0.0, 0.0, 1.0], atol=1e-15)


def test_lean_and_heading_are_read_back() -> None:
    ride = Ride()
    times = np.array([0.2, 0.9, 2.9])
    found = lean_and_heading(np.array([ride.orientation(t).as_quat() for t in times]))
    np.testing.assert_allclose(found[0], [ride.lean(t) for t in times], atol=1e-14)
    np.testing.assert_allclose(found[1], [ride.yaw(t) for t in times], atol=1e-14)


def motion(**values: float) -> RearFrameMotion:
    names = (
        "lean",
        "lean_rate",
        "lean_acceleration",
        "yaw_rate",
        "yaw_acceleration",
        "speed",
        "acceleration",
        "rear_slip",
        "rear_slip_acceleration",
        "yaw",
    )
    return RearFrameMotion(**{name: np.array([values.get(name, 0.0)]) for name in names})


def test_upright_at_rest_feels_the_ground_push_up() -> None:
    rate, force = ideal_imu(motion(), np.array([0.3, 0.0, -0.8]), G)
    np.testing.assert_array_equal(rate, [[0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(flip_axes(force), [[0.0, 0.0, G]])  # +g up (REP-145)


def test_leaned_to_the_right_at_rest() -> None:
    # At 30 deg to the right, the sensor's left axis points half upward: 9.81 * sin(30 deg) = 4.905 to the
    # left, 9.81 * cos(30 deg) = 8.4957 along its own up.
    _, force = ideal_imu(motion(lean=math.radians(30.0)), np.zeros(3), G)
    np.testing.assert_allclose(flip_axes(force)[0], [0.0, 4.905, 8.4957], atol=5e-5)


def test_balanced_steady_turn_by_hand() -> None:
    # 4 m/s, yawing right at 0.5 rad/s: a circle of 8 m, 2 m/s^2 to the right. Balanced, tan(lean) = 2 / 9.81:
    # at the contact the push is along the frame, sqrt(9.81^2 + 2^2) = 10.0118. 1 m up the frame the circle is
    # smaller by 1 m * sin(lean), which takes 0.5^2 * sin(lean) = 0.04994 m/s^2 off the 2 m/s^2, horizontally:
    # along the frame's right axis that is -0.04994 * cos(lean) = -0.04893, up the frame -0.04994 * sin(lean)
    # = -0.00998.
    lean = math.atan2(2.0, G)
    turn = motion(lean=lean, yaw_rate=0.5, speed=4.0)
    _, at_contact = ideal_imu(turn, np.zeros(3), G)
    np.testing.assert_allclose(at_contact[0], [0.0, 0.0, -10.0118], atol=5e-5)
    _, on_frame = ideal_imu(turn, np.array([0.0, 0.0, -1.0]), G)
    np.testing.assert_allclose(on_frame[0] - at_contact[0], [0.0, -0.04893, 0.00998], atol=5e-6)


def test_braking_pulls_back() -> None:
    _, force = ideal_imu(motion(speed=4.0, acceleration=-0.6), np.zeros(3), G)
    np.testing.assert_allclose(force[0], [-0.6, 0.0, -G])


def test_pure_yaw_pulls_the_sensor_to_the_axis_and_swings_it() -> None:
    # Spinning on the spot at 3 rad/s, faster by 2 rad/s^2: 0.4 m ahead of the axis 3^2 * 0.4 = 3.6 m/s^2
    # backward and 2 * 0.4 = 0.8 m/s^2 to the right. The height above the ground does not matter.
    rate, force = ideal_imu(motion(yaw_rate=3.0, yaw_acceleration=2.0), np.array([0.4, 0.0, -0.8]), G)
    np.testing.assert_allclose(rate[0], [0.0, 0.0, 3.0])
    np.testing.assert_allclose(force[0], [-3.6, 0.8, -G])


def test_skidding_rear_wheel_is_felt() -> None:
    # Sliding to the right at 0.5 m/s, faster by 1.2 m/s^2, while yawing right at 2 rad/s without rolling: the
    # slide turns with the frame, 0.5 * 2 = 1 m/s^2 backward.
    _, force = ideal_imu(motion(yaw_rate=2.0, rear_slip=0.5, rear_slip_acceleration=1.2), np.zeros(3), G)
    np.testing.assert_allclose(force[0], [-1.0, 1.2, -G])


def test_tipping_over_swings_the_sensor_sideways() -> None:
    # Upright, lean acceleration 2 rad/s^2 to the right: 0.8 m up the frame moves right at 1.6 m/s^2.
    _, force = ideal_imu(motion(lean_acceleration=2.0), np.array([0.3, 0.0, -0.8]), G)
    np.testing.assert_allclose(force[0], [0.0, 1.6, -G])


def test_yaw_rate_is_read_back_at_any_lean() -> None:
    lean = np.linspace(-0.9, 0.9, 13)
    still = np.zeros(13)
    turning = RearFrameMotion(lean, still + 0.2, still, still + 0.7, still, still + 4.0, still)
    rate, _ = ideal_imu(turning, np.zeros(3), G)
    lean_rate, yaw = lean_and_yaw_rate(rate, lean)
    np.testing.assert_allclose(lean_rate, 0.2, rtol=1e-14)
    np.testing.assert_allclose(yaw, 0.7, rtol=1e-13)
    rate[:, 1] = np.nan  # without the gyroscope about the frame's right axis
    np.testing.assert_allclose(lean_and_yaw_rate(rate, lean)[1], 0.7, rtol=1e-13)
    rate[:, 2] = np.nan
    assert np.isnan(lean_and_yaw_rate(rate, lean)[1]).all()


def test_lean_angle_is_needed_to_first_order_only() -> None:
    # Leaned by 0.1 rad and taken as upright: w_z = 0.7 cos(0.1) is short by 0.1^2 / 2, 0.5 %.
    rate, _ = ideal_imu(motion(lean=0.1, yaw_rate=0.7), np.zeros(3), G)
    assert lean_and_yaw_rate(rate, np.zeros(1))[1][0] == pytest.approx(0.7 * (1.0 - 0.005), rel=1e-4)
