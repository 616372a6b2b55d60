"""Where the parts of a bicycle are, for viewers: frames of REP-103, from the state in SAE signs.

rear_frame has its origin at the rear wheel contact, yawed and leaned with the rear frame; the pitch, which is
of second order, is left out, as in `tms_model.imu`. front_frame has its origin on the steer axis, where the
front wheel's centre is nearest, z along the axis, and turns about it. Wheel frames stand at the wheels'
centres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tms_model.bicycle import Array
from tms_model.frames import compose, flip_axes, quaternion
from tms_model.parameters import WhippleParameters


@dataclass(frozen=True, eq=False)
class Pose:
    """Place and orientation of one frame in another, REP-103."""

    position: Array  # (3,) [m]
    orientation: Array  # (4,) quaternion x, y, z, w


def rear_frame_pose(rear_contact: Array, lean: float, yaw: float) -> Pose:
    """rear_frame in world.

    rear_contact: (2,) [m] on the floor, x forward and y right; lean, yaw [rad]; all SAE.
    """
    place = flip_axes(np.array([rear_contact[0], rear_contact[1], 0.0]))
    return Pose(place, quaternion(lean, 0.0, -yaw))


def steer_axis_foot(p: WhippleParameters) -> Array:
    """Origin of front_frame in rear_frame (3,) [m]."""
    along = p.trail * math.sin(p.steer_axis_tilt) + p.front_wheel_radius * math.cos(p.steer_axis_tilt)
    return np.array(
        [
            p.wheelbase + p.trail - along * math.sin(p.steer_axis_tilt),
            0.0,
            along * math.cos(p.steer_axis_tilt),
        ]
    )


def fork_offset(p: WhippleParameters) -> float:
    """Distance [m] of the front wheel's centre before the steer axis."""
    return p.front_wheel_radius * math.sin(p.steer_axis_tilt) - p.trail * math.cos(p.steer_axis_tilt)


def front_frame_pose(p: WhippleParameters, steer: float) -> Pose:
    """front_frame in rear_frame. steer [rad], SAE sign."""
    tilt, turn = quaternion(0.0, -p.steer_axis_tilt, 0.0), quaternion(0.0, 0.0, -steer)
    return Pose(steer_axis_foot(p), compose(tilt, turn))


def rear_wheel_pose(p: WhippleParameters, angle: float) -> Pose:
    """Rear wheel in rear_frame. angle [rad] that it has turned, forward positive."""
    return Pose(np.array([0.0, 0.0, p.rear_wheel_radius]), quaternion(0.0, angle, 0.0))


def front_wheel_pose(p: WhippleParameters, angle: float) -> Pose:
    """Front wheel in front_frame. angle [rad] that it has turned, forward positive."""
    return Pose(np.array([fork_offset(p), 0.0, 0.0]), quaternion(0.0, angle, 0.0))
