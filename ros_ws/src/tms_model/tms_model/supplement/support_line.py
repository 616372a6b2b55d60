"""How steering moves the line on which a bicycle stands: a_M = c_1 steer + c_2 steer rate.

M is the point of the ground midway between the wheels. With lateral velocities v (yaw + rear steer) and v
(yaw + front steer) of the wheels' contacts,

    yaw rate = v (front - rear) / w,    a_M = v yaw rate + v (front + rear)' / 2
    (2.1)-(2.4)

with steer angles as the ground sees them. Trail, which the supplement leaves out, sweeps the front contact
sideways too.

Reference: Kooijman et al. 2011, supplement (SOM), chapter 2, doi 10.1126/science.1201959.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tms_model.bicycle import Bicycle

STEERINGS = {  # angles of the front and of the rear wheel, per steer angle; positive turns the bicycle right
    "both": (1.0, -1.0),
    "parallel": (1.0, 1.0),
    "front": (1.0, 0.0),
    "rear": (0.0, -1.0),
}


@dataclass(frozen=True)
class SupportLine:
    """Lateral acceleration of the support line's midpoint, per steer and steer rate; to the right."""

    per_steer: float  # c_1 [m/s^2 per rad]
    per_steer_rate: float  # c_2 [m/s per rad]


def support_line(front: float, rear: float, wheelbase: float, speed: float) -> SupportLine:
    """c_1 and c_2 of a vehicle without trail whose wheels steer by `front` and `rear` per unit of steer.

    `STEERINGS` has those of chapter 2; wheelbase [m], speed [m/s], negative when it moves backward.
    """
    return SupportLine(speed**2 * (front - rear) / wheelbase, speed * (front + rear) / 2.0)


def support_line_of(bicycle: Bicycle, speed: float) -> SupportLine:
    """c_1 and c_2 (2.3) of a bicycle at a speed [m/s], its steer axis tilt and its trail included."""
    cos = math.cos(bicycle.steer_axis_tilt)
    ground = support_line(cos, 0.0, bicycle.wheelbase, speed)
    # The contact trails the steer axis by c: (c / w) cos(lambda) of yaw rate per steer rate (10.2), at speed
    # v.
    trail = speed * bicycle.trail / bicycle.wheelbase * cos
    return SupportLine(ground.per_steer, ground.per_steer_rate + trail)
