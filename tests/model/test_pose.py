"""Where the parts of a bicycle are, and its URDF, which must say the same."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray
from tms_model import WhippleParameters, bicycle_names, load_bicycle
from tms_model.frames import quaternion, rotation_matrix
from tms_model.pose import (
    Pose,
    front_frame_pose,
    front_wheel_pose,
    rear_frame_pose,
    rear_wheel_pose,
)
from tms_model.urdf import JOINTS, urdf

Array = NDArray[np.float64]
BICYCLES = [name for name in bicycle_names() if load_bicycle(name).parameters is not None]


def matrix(pose: Pose) -> Array:
    answer = np.eye(4)
    answer[:3, :3], answer[:3, 3] = rotation_matrix(pose.orientation), pose.position
    return answer


def parameters(name: str) -> WhippleParameters:
    found = load_bicycle(name).parameters
    assert found is not None
    return found


def test_rear_frame_by_hand() -> None:
    # 2 m forward, 1 m to the right, heading a quarter turn to the right, upright: REP-103 has y to the left.
    pose = rear_frame_pose(np.array([2.0, 1.0]), 0.0, math.pi / 2.0)
    assert pose.position == pytest.approx([2.0, -1.0, 0.0])
    assert rotation_matrix(pose.orientation) @ [1.0, 0.0, 0.0] == pytest.approx([0.0, -1.0, 0.0])
    # leaned to the right, what is above goes to the right: minus y
    leaned = rotation_matrix(rear_frame_pose(np.zeros(2), 0.1, 0.0).orientation) @ [0.0, 0.0, 1.0]
    assert leaned == pytest.approx([0.0, -math.sin(0.1), math.cos(0.1)])


@pytest.mark.parametrize("name", BICYCLES)
def test_front_wheel_stands_on_the_floor_a_wheelbase_ahead(name: str) -> None:
    p = parameters(name)
    centre = (matrix(front_frame_pose(p, 0.0)) @ matrix(front_wheel_pose(p, 0.0)))[:3, 3]
    assert centre == pytest.approx([p.wheelbase, 0.0, p.front_wheel_radius], abs=1e-12)
    # the steer axis passes through the floor at w + c
    axis = matrix(front_frame_pose(p, 0.0))
    height = axis[2, 3] / axis[2, 2]
    assert (axis[:3, 3] - height * axis[:3, 2])[0] == pytest.approx(p.wheelbase + p.trail, abs=1e-12)


def test_steer_to_the_right_turns_the_wheel_to_the_right() -> None:
    p = parameters("benchmark")
    forward = matrix(front_frame_pose(p, 0.2))[:3, 0]
    assert forward[1] < -0.1  # y is to the left


def test_wheels_roll_forward() -> None:
    # What is on top of a wheel goes forward when it turns by a positive angle.
    top = rotation_matrix(rear_wheel_pose(parameters("benchmark"), 0.1).orientation) @ [0.0, 0.0, 1.0]
    assert top[0] > 0.09


@pytest.mark.parametrize("name", BICYCLES)
def test_urdf_has_the_same_poses(name: str) -> None:
    p = parameters(name)
    mounting = np.array([0.05, 0.01, 0.3])
    turned = quaternion(0.1, -0.2, 0.3)
    robot = ElementTree.fromstring(urdf(p, name, mounting, turned))
    angles = {"steer": -0.3, "rear_axle": 1.0, "front_axle": 2.0}
    found = {joint.attrib["name"]: placed(joint, angles) for joint in robot.iter("joint")}
    assert found["steer"] == pytest.approx(matrix(front_frame_pose(p, 0.3)), abs=1e-8)
    assert found["rear_axle"] == pytest.approx(matrix(rear_wheel_pose(p, 1.0)), abs=1e-8)
    assert found["front_axle"] == pytest.approx(matrix(front_wheel_pose(p, 2.0)), abs=1e-8)
    assert found["imu_mounting"] == pytest.approx(matrix(Pose(mounting, turned)), abs=1e-8)
    assert set(JOINTS) == {
        joint.attrib["name"] for joint in robot.iter("joint") if joint.attrib["type"] != "fixed"
    }


@pytest.mark.parametrize("name", BICYCLES)
def test_urdf_is_one_tree_of_drawable_links(name: str) -> None:
    robot = ElementTree.fromstring(urdf(parameters(name), name))
    links = {link.attrib["name"] for link in robot.findall("link")}
    children = [joint.find("child").attrib["link"] for joint in robot.findall("joint")]  # type: ignore[union-attr]
    assert links - set(children) == {"rear_frame"}
    assert len(set(children)) == len(children)
    colours = {material.attrib["name"] for material in robot.findall("material")}
    for visual in robot.iter("visual"):
        assert visual.find("material").attrib["name"] in colours  # type: ignore[union-attr]
        shape = visual.find("geometry")[0]  # type: ignore[index]
        sizes = [float(x) for key in ("radius", "length", "size") for x in shape.attrib.get(key, "").split()]
        assert sizes
        assert all(size > 0.0 for size in sizes)


def test_names_are_escaped() -> None:
    robot = ElementTree.fromstring(urdf(parameters("benchmark"), 'a"<b>&'))
    assert robot.attrib["name"] == 'a"<b>&'


def placed(joint: ElementTree.Element, angles: dict[str, float]) -> Array:
    origin = joint.find("origin")
    assert origin is not None
    roll, pitch, yaw = (float(x) for x in origin.attrib["rpy"].split())
    answer = matrix(
        Pose(np.array([float(x) for x in origin.attrib["xyz"].split()]), quaternion(roll, pitch, yaw))
    )
    axis = joint.find("axis")
    if axis is not None:
        turn = np.array([float(x) for x in axis.attrib["xyz"].split()]) * angles[joint.attrib["name"]]
        answer = answer @ matrix(Pose(np.zeros(3), quaternion(*turn)))
    return answer
