"""The one place where signs change: SAE model axes and REP-103.

SAE: x forward, y right, z down. REP-103: x forward, y left, z up. The two differ by half a turn about x. A
vector keeps x and flips y and z; lean and lean rate (about x) keep their sign, steer, yaw and yaw rate (about
z) flip.
"""

from __future__ import annotations

import numpy as np

from tms_model.bicycle import Array
from tms_model.errors import ParameterError

_FLIP = np.array([1.0, -1.0, -1.0])


def flip_axes(vectors: Array) -> Array:
    """Vectors (..., 3) from SAE to REP-103 axes, or back: the change is its own inverse."""
    flipped: Array = np.asarray(vectors, dtype=float) * _FLIP
    return flipped


def rotation_matrix(quaternion: Array) -> Array:
    """Rotation matrix (3, 3) of a quaternion x, y, z, w (ROS order). ParameterError unless of unit length."""
    q = np.asarray(quaternion, dtype=float)
    # Components first: the square of a huge one overflows.
    if q.shape != (4,) or not (np.abs(q) < 1.1).all() or not abs(float(q @ q) - 1.0) < 1e-6:
        raise ParameterError(f"orientation: expected a unit quaternion x, y, z, w, found {q.tolist()}")
    x, y, z, w = q / np.sqrt(q @ q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion(roll: float, pitch: float, yaw: float) -> Array:
    """Quaternion x, y, z, w of REP-103 fixed-axis roll, pitch, yaw [rad]."""
    cr, sr = np.cos(roll / 2), np.sin(roll / 2)
    cp, sp = np.cos(pitch / 2), np.sin(pitch / 2)
    cy, sy = np.cos(yaw / 2), np.sin(yaw / 2)
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def matrix_quaternion(rotation: Array) -> Array:
    """Quaternion x, y, z, w of a rotation matrix (3, 3), w not negative: an eigenvector.

    I. Y. Bar-Itzhack, J. Guidance, Control, and Dynamics 23 (2000) 1085, doi:10.2514/2.4654.
    """
    m = rotation
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
            [m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]],
            [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]],
        ]
    )  # fmt: skip
    vector = np.linalg.eigh(k / 3.0)[1][:, -1]
    return np.asarray(vector if vector[3] >= 0.0 else -vector)


def roll_pitch_yaw(rotation: Array) -> Array:
    """Fixed-axis roll, pitch, yaw (3,) [rad] of a rotation matrix (3, 3); roll 0 at a pitch of 90 degrees."""
    pitch = np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0))
    if np.hypot(rotation[2, 1], rotation[2, 2]) < 1e-9:
        return np.array([0.0, pitch, np.arctan2(-rotation[0, 1], rotation[1, 1])])
    return np.array(
        [
            np.arctan2(rotation[2, 1], rotation[2, 2]),
            pitch,
            np.arctan2(rotation[1, 0], rotation[0, 0]),
        ]
    )


def compose(outer: Array, inner: Array) -> Array:
    """Quaternion x, y, z, w of `inner` followed by `outer`: the rotation matrices multiply as outer @ inner.

    Each (4,) or (n, 4).
    """
    ax, ay, az, aw = np.moveaxis(np.asarray(outer, dtype=float), -1, 0)
    bx, by, bz, bw = np.moveaxis(np.asarray(inner, dtype=float), -1, 0)
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def inverse(quaternions: Array) -> Array:
    """Inverse of unit quaternions x, y, z, w, (4,) or (n, 4)."""
    conjugate: Array = np.asarray(quaternions, dtype=float) * [-1.0, -1.0, -1.0, 1.0]
    return conjugate


def lean_and_heading(quaternions: Array) -> tuple[Array, Array]:
    """Lean and yaw [rad], SAE signs, each (n,), of frames given as quaternions (n, 4) in a REP-103 world.

    The order of turning is yaw, pitch, lean.
    """
    x, y, z, w = np.moveaxis(np.asarray(quaternions, dtype=float), -1, 0)
    lean = np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    return lean, -np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))


def imu_to_rear_frame(vectors: Array, orientation: Array) -> Array:
    """Vectors (n, 3) in REP-103 axes of the imu frame -> SAE axes of the rear frame.

    A component that is not finite is absent: NaN, with all that it enters.
    orientation: quaternion x, y, z, w of the imu frame in the rear frame (REP-103), as in tms_msgs/RunInfo.
    """
    return flip_axes(_rotate(vectors, rotation_matrix(orientation)))


def rear_frame_to_imu(vectors: Array, orientation: Array) -> Array:
    """Vectors (n, 3) in SAE axes of the rear frame -> REP-103 axes of the imu frame."""
    return _rotate(flip_axes(vectors), rotation_matrix(orientation).T)


def _rotate(vectors: Array, rotation: Array) -> Array:
    # An absent component must spoil only the components it enters: 0 * NaN would spoil them all.
    absent = ~np.isfinite(vectors)
    rotated = np.where(absent, 0.0, vectors) @ rotation.T
    spoilt = (absent.astype(float) @ (np.abs(rotation.T) > 1e-12)) > 0
    return np.where(spoilt, np.nan, rotated)
