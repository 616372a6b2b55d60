"""Exact kinematics of two knife-edge wheels that roll on a plane without slip, at any lean and steer.

Five speeds describe every velocity: the three free ones (lean rate, steer rate, and the speed of the rear
contact along its track) and two that the front contact makes dependent (yaw rate, pitch rate). A velocity of
the bicycle is `partials @ speeds`; its acceleration is `partials @ speeds' + bias`, where the bias is what
remains when the five speeds are constant. All vectors are resolved in SAE axes that are fixed in space and
agree with the rear wheel's heading at this instant: x along the rear wheel's track, z down.

The contact point of a wheel travels along the wheel's heading, so a wheel of radius zero (a skate) needs no
case of its own. Rotations are taken in the order yaw, lean, pitch, steer; pitch, about the rear axle, is what
the front contact's height makes of lean and steer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tms_model.bicycle import Array
from tms_model.errors import ParameterError
from tms_model.parameters import WhippleParameters

SPEEDS = ("lean_rate", "steer_rate", "speed", "yaw_rate", "pitch_rate")  # [rad/s], speed [m/s]
LEAN_RATE, STEER_RATE, SPEED, YAW_RATE, PITCH_RATE = range(5)
FREE = slice(0, 3)
DEPENDENT = slice(3, 5)

_PITCH_TOLERANCE = 1e-14  # [rad], the Newton step that is the last
_PITCH_STEPS = 30
_FORWARD = np.array([1.0, 0.0, 0.0])
_RIGHT = np.array([0.0, 1.0, 0.0])
_DOWN = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Posture:
    """Where everything points for one lean, steer and pitch, and how it moves per unit of each of the SPEEDS.

    Bodies stand in the order rear wheel, rear frame, front frame, front wheel. Levers are in space axes.
    """

    lean_rotation: Array  # (3, 3), columns: rear heading, rear axle (to the right), down along the rear wheel
    rear_rotation: Array  # (3, 3), rear frame axes in space axes
    front_rotation: Array  # (3, 3), front frame axes in space axes
    steer_axis: Array  # (3,), pointing down
    front_heading: Array  # (3,), level, along the front wheel's track
    front_side: Array  # (3,), level, to the right of it
    front_radius: Array  # (3,) [m], from the front wheel's centre to its contact
    levers: dict[str, Array]  # (3,) [m] each, see `_levers`
    leaning: Array  # (3, 5) [1], angular velocity of the axes of lean_rotation
    front_leaning: Array  # (3, 5), of the axes of front_heading, front axle and front_radius
    turning: Array  # (4, 3, 5), angular velocities of the bodies
    moving: Array  # (4, 3, 5), velocities of the bodies' centres of mass
    front_contact: Array  # (3, 5), velocity of the front contact point on its track
    rear_spin: Array  # (5,) rear wheel's rotation about its axle, relative to `leaning`
    front_spin: Array  # (5,) front wheel's, relative to `front_leaning`
    front_roll_back: Array  # (5,) of `front_leaning` about the front axle, relative to the front frame

    @property
    def constraint(self) -> Array:
        """(2, 5); times the speeds it must vanish: the front contact neither rises nor slips sideways."""
        return np.stack([self.front_contact[2], self.front_side @ self.front_contact])

    @property
    def front_speed(self) -> Array:
        """(5,), speed of the front contact along its track per unit of each of the SPEEDS."""
        return self.front_heading @ self.front_contact


@dataclass(frozen=True, eq=False)
class Bias:
    """Accelerations at constant SPEEDS; bodies in the order of Posture."""

    turning: Array  # (4, 3) [rad/s^2]
    moving: Array  # (4, 3) [m/s^2]
    constraint: Array  # (2,) [m/s^2]
    front_spin: float  # [rad/s^2]
    front_roll_back: float  # [rad/s^2]


def skew(vector: Array) -> Array:
    """Matrix (3, 3) that takes the cross product with a vector, from the left."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def posture(p: WhippleParameters, lean: float, steer: float, pitch: float) -> Posture:
    """Axes and partial velocities at these angles [rad], whether or not the front wheel touches ground."""
    lean_rotation = _about_x(lean)
    rear_rotation = lean_rotation @ _about_y(pitch)
    tilt = _about_y(p.steer_axis_tilt)
    front_rotation = rear_rotation @ tilt @ _about_z(steer) @ tilt.T
    steer_axis = rear_rotation @ tilt[:, 2]
    radius, levers = p.front_wheel_radius, _levers(p, lean_rotation, rear_rotation, front_rotation)

    leaning = _columns({LEAN_RATE: _FORWARD, YAW_RATE: _DOWN})
    rear = leaning + _columns({PITCH_RATE: lean_rotation[:, 1]})
    front = rear + _columns({STEER_RATE: steer_axis})
    rear_centre = _columns({SPEED: _FORWARD}) - skew(levers["rear_radius"]) @ leaning
    crown = rear_centre - skew(levers["crown"]) @ rear
    front_centre = crown - skew(levers["front_wheel"]) @ front

    axle = front_rotation[:, 1]
    level = math.hypot(axle[0], axle[1])  # cosine of the front wheel's lean
    heading = np.array([axle[1], -axle[0], 0.0]) / level
    side = np.array([-heading[1], heading[0], 0.0])
    roll_back = -(side @ front) / level  # keeps front_heading level
    front_leaning = front + np.outer(axle, roll_back)
    front_radius = radius * (skew(heading) @ axle)
    contact = front_centre - skew(front_radius) @ front_leaning
    rear_spin = np.array([0.0, 0.0, -_inverse(p.rear_wheel_radius), 0.0, 0.0])
    front_spin = -_inverse(radius) * (heading @ contact)
    return Posture(
        lean_rotation=lean_rotation,
        rear_rotation=rear_rotation,
        front_rotation=front_rotation,
        steer_axis=steer_axis,
        front_heading=heading,
        front_side=side,
        front_radius=front_radius,
        levers=levers,
        leaning=leaning,
        front_leaning=front_leaning,
        turning=np.stack(
            [
                leaning + np.outer(lean_rotation[:, 1], rear_spin),
                rear,
                front,
                front_leaning + np.outer(axle, front_spin),
            ]
        ),
        moving=np.stack(
            [
                rear_centre,
                rear_centre - skew(levers["rear_frame"]) @ rear,
                crown - skew(levers["front_frame"]) @ front,
                front_centre,
            ]
        ),
        front_contact=contact,
        rear_spin=rear_spin,
        front_spin=front_spin,
        front_roll_back=roll_back,
    )


def bias(p: WhippleParameters, at: Posture, speeds: Array) -> Bias:
    """Accelerations of everything in `at` while the five speeds (5,) stay as they are."""
    levers, yaw_rate = at.levers, speeds[YAW_RATE]
    leaning, front_leaning = at.leaning @ speeds, at.front_leaning @ speeds
    rear, front = at.turning[1] @ speeds, at.turning[2] @ speeds
    rear_axle_change = skew(leaning) @ at.lean_rotation[:, 1]
    turned = yaw_rate * _RIGHT  # change of the rear heading

    leaning_bias = speeds[LEAN_RATE] * turned
    rear_bias = leaning_bias + speeds[PITCH_RATE] * rear_axle_change
    front_bias = rear_bias + speeds[STEER_RATE] * (skew(rear) @ at.steer_axis)
    rear_centre = speeds[SPEED] * turned + _swing(leaning, leaning_bias, levers["rear_radius"])
    crown = rear_centre + _swing(rear, rear_bias, levers["crown"])
    front_centre = crown + _swing(front, front_bias, levers["front_wheel"])

    axle = at.front_rotation[:, 1]
    axle_change = skew(front) @ axle
    front_yaw_rate = front_leaning[2]
    heading_change, side_change = front_yaw_rate * at.front_side, -front_yaw_rate * at.front_heading
    # Derivative of: side . (front + roll_back axle) = 0, which keeps the heading level.
    roll_back = at.front_roll_back @ speeds
    roll_back_bias = -(
        side_change @ (front + roll_back * axle) + at.front_side @ (front_bias + roll_back * axle_change)
    ) / (at.front_side @ axle)
    front_leaning_bias = front_bias + roll_back_bias * axle + roll_back * axle_change
    contact_bias = front_centre + _swing(front_leaning, front_leaning_bias, at.front_radius)
    contact = at.front_contact @ speeds
    front_spin_bias = -_inverse(p.front_wheel_radius) * (
        heading_change @ contact + at.front_heading @ contact_bias
    )
    return Bias(
        turning=np.stack(
            [
                leaning_bias + (at.rear_spin @ speeds) * rear_axle_change,
                rear_bias,
                front_bias,
                front_leaning_bias + front_spin_bias * axle + (at.front_spin @ speeds) * axle_change,
            ]
        ),
        moving=np.stack(
            [
                rear_centre,
                rear_centre + _swing(rear, rear_bias, levers["rear_frame"]),
                crown + _swing(front, front_bias, levers["front_frame"]),
                front_centre,
            ]
        ),
        constraint=np.array([contact_bias[2], side_change @ contact + at.front_side @ contact_bias]),
        front_spin=float(front_spin_bias),
        front_roll_back=float(roll_back_bias),
    )


def touching_pitch(p: WhippleParameters, lean: float, steer: float) -> float:
    """Pitch [rad], nose up positive, with both wheels on the ground: the solution that leads to upright.

    Newton's method. Raises ParameterError when the front wheel can't reach the ground at this lean and steer.
    """
    tilt = _about_y(p.steer_axis_tilt)
    steering = tilt @ _about_z(steer) @ tilt.T
    ahead, axle = steering @ np.array([-p.trail, 0.0, -p.front_wheel_radius]), steering[:, 1].tolist()
    x, y, z = (ahead + np.array([p.wheelbase + p.trail, 0.0, p.rear_wheel_radius])).tolist()
    sin_lean, cos_lean = math.sin(lean), math.cos(lean)
    # To second order in lean and steer: by how much the trail raises or lowers the front.
    sin_steer, sin_tilt = math.sin(steer), math.sin(p.steer_axis_tilt)
    pitch = -p.trail * float(tilt[0, 0]) / p.wheelbase * (sin_lean + 0.5 * sin_tilt * sin_steer) * sin_steer
    for _ in range(_PITCH_STEPS):
        # Vertical parts of the rear frame's x and z axes; each is minus or plus the other's derivative.
        fore, down = -math.sin(pitch) * cos_lean, math.cos(pitch) * cos_lean
        dip = fore * axle[0] + sin_lean * axle[1] + down * axle[2]  # sine of the front wheel's lean
        level = math.sqrt(max(1.0 - dip**2, 0.0))
        depth = fore * x + sin_lean * y + down * z + p.front_wheel_radius * level
        depth -= p.rear_wheel_radius * cos_lean
        slope = fore * z - down * x
        if p.front_wheel_radius and level:
            slope -= p.front_wheel_radius * dip / level * (fore * axle[2] - down * axle[0])
        change = -depth / slope if slope else math.nan
        pitch += change
        if not abs(pitch) < math.pi:
            break
        if abs(change) < _PITCH_TOLERANCE:
            return pitch
    raise ParameterError(
        "lean and steer: expected angles at which both wheels can touch the ground, found"
        f" {math.degrees(lean):.4g} deg and {math.degrees(steer):.4g} deg"
    )


def _levers(p: WhippleParameters, lean: Array, rear: Array, front: Array) -> dict[str, Array]:
    # The crown is where the steer axis of the upright bicycle meets the ground: a point of both frames.
    crown_x = p.wheelbase + p.trail
    return {
        "rear_radius": -p.rear_wheel_radius * lean[:, 2],
        "rear_frame": rear @ np.array([p.rear_frame_x, 0.0, p.rear_frame_z + p.rear_wheel_radius]),
        "crown": rear @ np.array([crown_x, 0.0, p.rear_wheel_radius]),
        "front_frame": front @ np.array([p.front_frame_x - crown_x, 0.0, p.front_frame_z]),
        "front_wheel": front @ np.array([-p.trail, 0.0, -p.front_wheel_radius]),
    }


def _swing(turning: Array, turning_bias: Array, lever: Array) -> Array:
    across = skew(turning)
    return skew(turning_bias) @ lever + across @ (across @ lever)


def _columns(vectors: dict[int, Array]) -> Array:
    partials = np.zeros((3, 5))
    for index, vector in vectors.items():
        partials[:, index] = vector
    return partials


def _inverse(radius: float) -> float:
    # A wheel without radius has no spin inertia (WhippleParameters sees to it): its spin may be called zero.
    return 1.0 / radius if radius > 0.0 else 0.0


def _about_x(angle: float) -> Array:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])


def _about_y(angle: float) -> Array:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])


def _about_z(angle: float) -> Array:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
