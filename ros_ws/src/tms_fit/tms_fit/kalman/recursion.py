"""Kalman recursion of filterpy for two channels of which either can be missing.

The arithmetic is that of `filterpy.kalman.KalmanFilter`, for extended filters as well: `predict` takes the
Jacobian of the transition as F, `update` that of the measurement as H. filterpy's `ExtendedKalmanFilter`
computes the same and takes 92 us a sample instead of 49 (four states, two channels), because it inverts S by
scipy and has no attribute for another inverse.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from tms_model.bicycle import Array


def kalman_filter(state_count: int) -> Any:
    """Filter of filterpy with `state_count` states and two channels."""
    from filterpy.kalman import KalmanFilter  # here, because it imports scipy.stats

    kalman = KalmanFilter(dim_x=state_count, dim_z=2, dim_u=1)
    kalman.inv = inverse
    return kalman


def update(kalman: Any, z: Array, h: Array, r: Array, present: Sequence[bool]) -> None:
    """Update with the channels that are present; without any, nothing changes.

    z: measurement (2, 1), h: its Jacobian (2, s), r: its covariance (2, 2). Columns are needed: filterpy
    makes a matrix of the state where z has one dimension.
    """
    if all(present):
        kalman.R = r  # as an argument it costs a test of its type
        kalman.update(z, H=h)
    elif any(present):
        rows = np.array(present)
        kalman.update(z[rows], R=r[np.ix_(rows, rows)], H=h[rows])


def inverse(matrix: Array) -> Array:
    """Inverse of a covariance: (2, 2) in closed form, any other or a nearly singular one by numpy."""
    if matrix.shape == (2, 2):
        (a, b), (c, d) = matrix.tolist()
        determinant = a * d - b * c
        if 1e-300 < determinant < 1e300:
            return np.array(((d / determinant, -b / determinant), (-c / determinant, a / determinant)))
    return np.asarray(np.linalg.inv(matrix))
