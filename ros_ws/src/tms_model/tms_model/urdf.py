"""A bicycle as a URDF, for viewers such as RViz and Foxglove: frames and joints to scale, bodies as symbols.

Links and joints are those of `tms_model.pose`. Masses are drawn as spheres of lead at the centres of mass; no
<inertial> is written, since nothing here is meant for a physics engine.
"""

from __future__ import annotations

import math
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from tms_model.bicycle import Array
from tms_model.frames import flip_axes, roll_pitch_yaw, rotation_matrix
from tms_model.parameters import WhippleParameters
from tms_model.pose import fork_offset, steer_axis_foot

JOINTS = ("rear_axle", "steer", "front_axle")  # in this order in joint_states
LEAD = 11_340.0  # [kg/m^3]
_COLOURS = {"frame": "0.15 0.35 0.60 1", "wheel": "0.20 0.20 0.20 1", "mass": "0.80 0.45 0.10 1"}
_TUBE, _RIM = 0.008, 0.01  # [m] radius of drawn tubes, half width of drawn wheels


def urdf(
    p: WhippleParameters, name: str, imu_position: Array | None = None, imu_orientation: Array | None = None
) -> str:
    """URDF text.

    imu_position: (3,) [m] of imu_link in rear_frame, REP-103 axes; imu_orientation: quaternion x, y, z, w.
    Without them there is no imu_link.
    """
    robot = Element("robot", name=name)
    for colour, rgba in _COLOURS.items():
        SubElement(SubElement(robot, "material", name=colour), "color", rgba=rgba)
    foot, offset = steer_axis_foot(p), fork_offset(p)
    rear = SubElement(robot, "link", name="rear_frame")
    axle = np.array([0.0, 0.0, p.rear_wheel_radius])
    body = flip_axes(np.array([p.rear_frame_x, 0.0, p.rear_frame_z]))
    _tube(rear, axle, body)
    _tube(rear, body, foot)
    _sphere(rear, body, p.rear_frame_mass)
    front = SubElement(robot, "link", name="front_frame")
    _tube(front, np.zeros(3), np.array([offset, 0.0, 0.0]))
    mass = _in_front_frame(p, np.array([p.front_frame_x, 0.0, p.front_frame_z]), foot)
    _tube(front, np.zeros(3), mass)
    _sphere(front, mass, p.front_frame_mass)
    _wheel(robot, "rear_wheel", p.rear_wheel_radius)
    _wheel(robot, "front_wheel", p.front_wheel_radius)
    steer = _joint(robot, "steer", "revolute", "rear_frame", "front_frame", foot, -p.steer_axis_tilt, "0 0 1")
    limit = _number(math.pi)
    SubElement(steer, "limit", lower=f"-{limit}", upper=limit, effort="0", velocity="0")
    _joint(robot, "rear_axle", "continuous", "rear_frame", "rear_wheel", axle, 0.0, "0 1 0")
    centre = np.array([offset, 0.0, 0.0])
    _joint(robot, "front_axle", "continuous", "front_frame", "front_wheel", centre, 0.0, "0 1 0")
    if imu_position is not None and imu_orientation is not None:
        SubElement(robot, "link", name="imu_link")
        mounting = _joint(robot, "imu_mounting", "fixed", "rear_frame", "imu_link", imu_position, 0.0, None)
        origin = mounting.find("origin")
        assert origin is not None
        origin.set("rpy", _vector(roll_pitch_yaw(rotation_matrix(imu_orientation))))
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode") + "\n"


def _in_front_frame(p: WhippleParameters, place: Array, foot: Array) -> Array:
    """A point of the front assembly, SAE from the rear contact with straight handlebars, in front_frame."""
    sin, cos = math.sin(p.steer_axis_tilt), math.cos(p.steer_axis_tilt)
    x, _, z = flip_axes(place) - foot
    return np.array([cos * x + sin * z, 0.0, -sin * x + cos * z])


def _wheel(robot: Element, name: str, radius: float) -> None:
    link = SubElement(robot, "link", name=name)
    visual = _visual(link, np.zeros(3), np.array([math.pi / 2.0, 0.0, 0.0]), "wheel")
    # a skate has wheels of no size, and viewers refuse those
    SubElement(visual, "cylinder", radius=_number(max(radius, _RIM)), length=_number(2.0 * _RIM))
    spoke = _visual(link, np.zeros(3), np.zeros(3), "mass")
    SubElement(spoke, "box", size=_vector(np.array([1.8 * max(radius, _RIM), 2.2 * _RIM, _RIM])))


def _tube(link: Element, start: Array, end: Array) -> None:
    length = float(np.linalg.norm(end - start))
    if length < 1e-6:
        return
    x, _, z = (end - start) / length
    visual = _visual(link, 0.5 * (start + end), np.array([0.0, math.atan2(x, z), 0.0]), "frame")
    SubElement(visual, "cylinder", radius=_number(_TUBE), length=_number(length))


def _sphere(link: Element, centre: Array, mass: float) -> None:
    if mass > 0.0:
        radius = (3.0 * mass / (4.0 * math.pi * LEAD)) ** (1.0 / 3.0)
        visual = _visual(link, centre, np.zeros(3), "mass")
        SubElement(visual, "sphere", radius=_number(radius))


def _visual(link: Element, place: Array, rpy: Array, colour: str) -> Element:
    """The <geometry> to put a shape into."""
    visual = SubElement(link, "visual")
    SubElement(visual, "origin", xyz=_vector(place), rpy=_vector(rpy))
    geometry = SubElement(visual, "geometry")
    SubElement(visual, "material", name=colour)
    return geometry


def _joint(
    robot: Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    place: Array,
    pitch: float,
    axis: str | None,
) -> Element:
    joint = SubElement(robot, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=_vector(place), rpy=_vector(np.array([0.0, pitch, 0.0])))
    if axis:
        SubElement(joint, "axis", xyz=axis)
    return joint


def _vector(values: Array) -> str:
    return " ".join(_number(float(value)) for value in values)


def _number(value: float) -> str:
    return repr(round(value, 9) + 0.0)  # + 0.0: no negative zero
