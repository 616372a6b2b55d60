"""Into a turn by a step of steer torque: what Figure 5.1 shows, with the wheels' tracks on the ground.

Lean and steer follow the linear equations; the tracks are drawn with the heading as it is, however large.

Reference: Kooijman et al. 2011, supplement (SOM), section 5.1 and Figure 5.1, doi 10.1126/science.1201959.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tms_model.bicycle import Array, Bicycle
from tms_model.errors import ParameterError
from tms_model.response import LEAN, STEER, linear_system, response, with_heading, yaw_rate

FIGURE_5_1_SPEED = 5.0  # [m/s]
FIGURE_5_1_LEAN = 0.140781  # [rad] to the right, which 'about 0.13 Nm' to the left hold on the benchmark


@dataclass(frozen=True, eq=False)
class TorqueStep:
    """Motion after a step of steer torque at time zero, from upright straight running; y to the right."""

    times: Array  # (n,) [s], from 0
    steer_torque: float  # [N m]
    lean: Array  # (n,) [rad]
    steer: Array  # (n,) [rad]
    heading: Array  # (n,) [rad]
    rear_contact: Array  # (n, 2) x, y [m], from 0, 0
    front_contact: Array  # (n, 2) x, y [m]

    @property
    def countersteer_dip(self) -> float:
        """How far the front track first goes to the other side of the turn [m]; 0 if it doesn't."""
        side = np.sign(self.heading[-1])
        return max(0.0, float(-(side * self.front_contact[:, 1]).min()))


def torque_step(bicycle: Bicycle, speed: float, steer_torque: float, times: Array) -> TorqueStep:
    """Response to a known steer torque [N m] held from time zero on, at a speed [m/s].

    What of it arrives at the fork is the bicycle's `steer_torque_gain`, 1 unless it says so. times: (n,) [s],
    ascending from 0, close enough for the heading to change little between two. Raises ParameterError for
    times that don't begin at 0 or don't ascend.
    """
    if len(times) < 2 or times[0] != 0.0 or not (np.diff(times) > 0.0).all():
        raise ParameterError("times: expected two or more in ascending order, the first 0")
    system = with_heading(linear_system(bicycle, speed))
    states = response(system, np.zeros(5), times, np.full(len(times), steer_torque))
    heading, turning = states[:, 4], yaw_rate(system, states)
    cos, sin = np.cos(heading), np.sin(heading)
    rear = speed * np.column_stack(
        [_integral(times, cos, -sin * turning), _integral(times, sin, cos * turning)]
    )
    # The front contact is w ahead of the rear one, less what trail takes it aside when steered.
    aside = -bicycle.trail * math.cos(bicycle.steer_axis_tilt) * states[:, STEER]
    front = (
        rear + bicycle.wheelbase * np.column_stack([cos, sin]) + aside[:, None] * np.column_stack([-sin, cos])
    )
    return TorqueStep(times, steer_torque, states[:, LEAN], states[:, STEER], heading, rear, front)


def _integral(times: Array, values: Array, slopes: Array) -> Array:
    """Integral from the first time on, by cubics through values and slopes: fourth order."""
    step = np.diff(times)
    pieces = step * (values[1:] + values[:-1]) / 2.0 + step**2 * (slopes[:-1] - slopes[1:]) / 12.0
    return np.concatenate([[0.0], np.cumsum(pieces)])
