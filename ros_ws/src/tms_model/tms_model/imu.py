"""What an ideal inertial sensor on the rear frame feels, and how lean and yaw rate are read back from it.

The rear frame yaws about the vertical and leans about the ground line through its wheel contact; its pitch is
of second order and left out. Body axes: SAE axes of the rear frame. With R = Rz(yaw) Rx(lean):

    angular velocity = (lean', yaw' sin lean, yaw' cos lean)
    velocity of the contact point, yawing axes = (v, s, 0)              (s: lateral slip of the rear wheel)
    acceleration of the contact point, yawing axes = (v' - s yaw', v yaw' + s', 0)
    specific force = acceleration - gravity; upright at rest (0, 0, -g) in SAE axes, +g up
    magnetic field in the frame = R^T times the field in the axes of yaw 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tms_model.bicycle import Array


def _zero() -> Array:
    return np.zeros(1)


@dataclass(frozen=True, eq=False)
class RearFrameMotion:
    """Motion of the rear frame; each field (n,), SAE signs. Slip and heading are 0 unless given."""

    lean: Array  # [rad]
    lean_rate: Array  # [rad/s]
    lean_acceleration: Array  # [rad/s^2]
    yaw_rate: Array  # [rad/s]
    yaw_acceleration: Array  # [rad/s^2]
    speed: Array  # [m/s]
    acceleration: Array  # v' [m/s^2]
    rear_slip: Array = field(
        default_factory=_zero
    )  # s [m/s], lateral speed of the rear contact, to the right
    rear_slip_acceleration: Array = field(default_factory=_zero)  # s' [m/s^2]
    yaw: Array = field(default_factory=_zero)  # [rad]


def ideal_imu(motion: RearFrameMotion, position: Array, gravity: float) -> tuple[Array, Array]:
    """Angular velocity [rad/s] and specific force [m/s^2], each (n, 3), in SAE axes of the rear frame.

    position: (3,) [m], of the sensor from the rear wheel contact, SAE axes of the rear frame (z negative
    above ground).
    """
    sin, cos = np.sin(motion.lean), np.cos(motion.lean)
    rate = np.stack([motion.lean_rate, motion.yaw_rate * sin, motion.yaw_rate * cos], axis=1)
    rate_change = np.stack(
        [
            motion.lean_acceleration,
            motion.yaw_acceleration * sin + motion.yaw_rate * motion.lean_rate * cos,
            motion.yaw_acceleration * cos - motion.yaw_rate * motion.lean_rate * sin,
        ],
        axis=1,
    )
    sideways = motion.speed * motion.yaw_rate + motion.rear_slip_acceleration
    forward = motion.acceleration - motion.rear_slip * motion.yaw_rate
    contact = np.stack([forward, sideways * cos, -sideways * sin], axis=1)
    weight = gravity * np.stack([np.zeros_like(sin), sin, cos], axis=1)
    lever = np.cross(rate_change, position) + np.cross(rate, np.cross(rate, position))
    return rate, contact + lever - weight


def magnetic_field(motion: RearFrameMotion, field_at_start: Array) -> Array:
    """Magnetic flux density (n, 3) [T] in SAE axes of the rear frame.

    field_at_start: (3,) [T], in SAE axes of the upright frame at yaw 0 (x along the heading, z down).
    """
    sin, cos = np.sin(motion.lean), np.cos(motion.lean)
    along, across, down = field_at_start
    forward = along * np.cos(motion.yaw) + across * np.sin(motion.yaw) + np.zeros_like(sin)
    right = across * np.cos(motion.yaw) - along * np.sin(motion.yaw)
    return np.stack([forward, right * cos + down * sin, down * cos - right * sin], axis=1)


def lean_and_yaw_rate(angular_velocity: Array, lean: Array) -> tuple[Array, Array]:
    """Lean rate and yaw rate [rad/s], each (n,), from the gyroscopes (n, 3) in SAE axes of the rear frame.

    The yaw rate is the part of the angular velocity about the vertical: w_y sin(lean) + w_z cos(lean), which
    needs the lean angle (n,) [rad] to first order only. Without w_y, w_z / cos(lean) stands for it. Readings
    that are not finite are absent: NaN.
    """
    lean_rate, w_y, w_z = np.where(np.isfinite(angular_velocity), angular_velocity, np.nan).T
    level = np.where(np.isnan(w_y), w_z / np.cos(lean), w_y * np.sin(lean) + w_z * np.cos(lean))
    return lean_rate.copy(), level
