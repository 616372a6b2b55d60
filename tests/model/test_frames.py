"""Signs and rotations, by cases that one can picture.

REP-103: x forward, y left, z up. SAE: x forward, y right, z down.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tms_model import ParameterError
from tms_model.frames import flip_axes, imu_to_rear_frame, quaternion, rear_frame_to_imu, rotation_matrix

RIGHT_ANGLE = np.pi / 2
LEVEL = quaternion(0.0, 0.0, 0.0)
G = 9.81


@pytest.mark.parametrize(
    ("reading", "expected"),
    [
        (
            [1.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
        ),  # to the right: about the forward axis, which both share
        (
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0],
        ),  # to the left: up is positive for the sensor, right for the model
        (
            [0.0, 1.0, 0.0],
            [0.0, -1.0, 0.0],
        ),  # about left for the sensor, about right for the model
    ],
    ids=["lean right", "yaw left", "nose down"],
)
def test_level_sensor(reading: list[float], expected: list[float]) -> None:
    np.testing.assert_allclose(imu_to_rear_frame(np.array([reading]), LEVEL)[0], expected, atol=1e-15)


def test_sensor_turned_to_the_left_sees_lean_on_its_y_axis() -> None:
    # Turned by 90 deg about up, its x axis points left and its y axis backward. A lean to the right is a turn
    # about forward, which is minus y.
    turned = quaternion(0.0, 0.0, RIGHT_ANGLE)
    np.testing.assert_allclose(
        imu_to_rear_frame(np.array([[0.0, -1.0, 0.0]]), turned)[0], [1, 0, 0], atol=1e-15
    )
    np.testing.assert_allclose(
        rear_frame_to_imu(np.array([[1.0, 0.0, 0.0]]), turned)[0], [0, -1, 0], atol=1e-15
    )


@pytest.mark.parametrize(
    ("orientation", "reading"),
    [
        ((0.0, 0.0, 0.0), [0.0, 0.0, G]),  # level: +g along the axis that points up
        ((np.pi, 0.0, 0.0), [0.0, 0.0, -G]),  # upside down
        ((0.0, RIGHT_ANGLE, 0.0), [-G, 0.0, 0.0]),  # nose down: its x axis points down
        ((RIGHT_ANGLE, 0.0, 0.0), [0.0, G, 0.0]),  # rolled to the right: its y axis, once left, points up
    ],
    ids=["level", "upside down", "nose down", "rolled right"],
)
def test_gravity_on_a_sensor_at_rest(orientation: tuple[float, float, float], reading: list[float]) -> None:
    upward_push = np.array([[0.0, 0.0, -G]])  # what the ground does to a bicycle at rest, SAE axes
    np.testing.assert_allclose(
        rear_frame_to_imu(upward_push, quaternion(*orientation))[0], reading, atol=1e-14
    )


def test_flip_is_its_own_inverse() -> None:
    vectors = np.random.default_rng(1).standard_normal((7, 3))
    np.testing.assert_array_equal(flip_axes(flip_axes(vectors)), vectors)
    np.testing.assert_array_equal(flip_axes(np.array([1.0, 2.0, 3.0])), [1.0, -2.0, -3.0])


def test_quaternion_and_matrix_are_those_of_scipy() -> None:
    for roll, pitch, yaw in np.random.default_rng(2).uniform(-3.0, 3.0, (20, 3)):
        theirs = Rotation.from_euler("xyz", [roll, pitch, yaw])  # fixed axes, as REP-103 has it
        ours = quaternion(roll, pitch, yaw)
        np.testing.assert_allclose(abs(ours @ theirs.as_quat()), 1.0, rtol=1e-12)  # q and -q are one rotation
        np.testing.assert_allclose(rotation_matrix(ours), theirs.as_matrix(), atol=1e-14)


def test_there_and_back() -> None:
    rng = np.random.default_rng(3)
    vectors = rng.standard_normal((50, 3))
    for angles in rng.uniform(-3.0, 3.0, (10, 3)):
        mounting = quaternion(*angles)
        np.testing.assert_allclose(
            imu_to_rear_frame(rear_frame_to_imu(vectors, mounting), mounting), vectors, atol=1e-14
        )


@pytest.mark.parametrize(
    ("orientation", "reading", "known"),
    [
        ((0.0, 0.0, 0.0), [0.4, np.nan, np.nan], [True, False, False]),  # a lean-rate gyroscope alone
        ((0.0, 0.0, RIGHT_ANGLE), [np.nan, 0.4, 0.1], [True, False, True]),  # its x is the bicycle's y
        ((0.0, 0.0, np.pi / 4), [np.nan, 0.4, 0.1], [False, False, True]),  # askew: x enters both
        ((0.0, 0.0, np.pi / 4), [0.3, 0.4, np.nan], [True, True, False]),
    ],
)
def test_absent_component_spoils_only_what_it_enters(
    orientation: tuple[float, float, float], reading: list[float], known: list[bool]
) -> None:
    mounting = quaternion(*orientation)
    turned = imu_to_rear_frame(np.array([reading]), mounting)[0]
    assert np.isfinite(turned).tolist() == known
    whole = imu_to_rear_frame(np.nan_to_num(np.array([reading]), nan=123.0), mounting)[0]
    np.testing.assert_allclose(turned[known], whole[known], rtol=1e-12)


@pytest.mark.parametrize(
    "bad", [[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.1], [np.nan, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
)
def test_quaternion_must_have_unit_length(bad: list[float]) -> None:
    with pytest.raises(ParameterError, match="expected a unit quaternion x, y, z, w, found"):
        rotation_matrix(np.array(bad))
