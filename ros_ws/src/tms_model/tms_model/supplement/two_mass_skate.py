"""The theoretical two-mass skate: two point masses, no trail, no wheels; all in closed form.

Written for two points only, independently of the general algorithm in `tms_model.bicycle`, which must agree.

Reference: Kooijman et al. 2011, supplement (SOM), chapter 7, Eqs. (7.1)-(7.6), doi 10.1126/science.1201959.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from tms_model.bicycle import Array, Bicycle
from tms_model.errors import ParameterError
from tms_model.parameters import PARAMETER_NAMES, WhippleParameters

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TwoMassSkate:
    """A theoretical two-mass-skate bicycle. Axes as in WhippleParameters: z points down."""

    wheelbase: float  # w [m]
    steer_axis_tilt: float  # lambda_s [rad]
    rear_mass: float  # m_B [kg]
    rear_x: float  # x_B [m]
    rear_z: float  # z_B [m]
    front_mass: float  # m_H [kg]
    front_x: float  # x_H [m]
    front_z: float  # z_H [m]
    gravity: float = 9.81  # g [m/s^2]

    @property
    def front_arm(self) -> float:
        """Distance u_H of the front mass in front of the steer axis [m]."""
        return float(self.arm_of(self.front_x, self.front_z))

    @property
    def projected_wheelbase(self) -> float:
        """w / cos(lambda_s) [m]."""
        return self.wheelbase / math.cos(self.steer_axis_tilt)

    @property
    def parameters(self) -> WhippleParameters:
        """The same bicycle for the general algorithm; every other parameter is zero."""
        zeros = dict.fromkeys(PARAMETER_NAMES, 0.0)
        return WhippleParameters(
            **{
                **zeros,
                "wheelbase": self.wheelbase,
                "steer_axis_tilt": self.steer_axis_tilt,
                "gravity": self.gravity,
                "rear_frame_mass": self.rear_mass,
                "rear_frame_x": self.rear_x,
                "rear_frame_z": self.rear_z,
                "front_frame_mass": self.front_mass,
                "front_frame_x": self.front_x,
                "front_frame_z": self.front_z,
            }
        )

    def arm_of(self, x: float | Array, z: float | Array) -> float | Array:
        """Distance of points in front of the steer axis [m], any shape."""
        cos, sin = math.cos(self.steer_axis_tilt), math.sin(self.steer_axis_tilt)
        return (x - self.wheelbase) * cos - z * sin

    @property
    def lowest_tilt(self) -> float:
        """lambda_s,min [rad] (7.6): E_0 > 0 for tilts above it if u_H > 0, below it if u_H < 0."""
        return math.atan2(self.front_mass * (self.front_x - self.wheelbase), -self.rear_mass * self.rear_z)

    def most_front_mass(self, x: Array) -> Array:
        """m_H,max [kg] of a front mass at x [m]: with more, E_0 < 0. Infinite where there is no limit."""
        x = np.asarray(x, dtype=float)
        with np.errstate(divide="ignore"):
            limit = -self.rear_mass * self.rear_z * math.tan(self.steer_axis_tilt) / (x - self.wheelbase)
        return np.where(limit > 0.0, limit, math.inf)

    def conditions(self, x: Array, z: Array) -> dict[str, Mask]:
        """Where a front mass at (x, z) [m] leaves B_1, C_2, D_1 and, if light enough, E_0 positive.

        Together they make the allowed regions of Figure 7.3; X_4 is then positive too, so that the bicycle is
        self-stable above some speed. E_0 also asks for less than `most_front_mass`.
        """
        arm = np.asarray(self.arm_of(x, z))
        return {
            "B1": arm * (self.rear_x * z - x * self.rear_z) > 0.0,  # side of the line P - m_B
            "C2": arm * (z - self.rear_z) > 0.0,  # above or below m_B
            "D1": arm * (self.rear_x - x) > 0.0,  # in front of or behind m_B
            "E0": arm * math.sin(self.steer_axis_tilt) > 0.0,  # steering is unstable by itself
        }


def two_mass_skate(bicycle: Bicycle) -> TwoMassSkate:
    """The two-mass skate that a bicycle is. Raises ParameterError if it is more than one."""
    p = bicycle.parameters
    if p is None:
        raise ParameterError(f"bicycle {bicycle.name}: expected parameters, found matrices only")
    skate = TwoMassSkate(
        wheelbase=p.wheelbase,
        steer_axis_tilt=p.steer_axis_tilt,
        rear_mass=p.rear_frame_mass,
        rear_x=p.rear_frame_x,
        rear_z=p.rear_frame_z,
        front_mass=p.front_frame_mass,
        front_x=p.front_frame_x,
        front_z=p.front_frame_z,
        gravity=p.gravity,
    )
    more = [name for name, value in asdict(p).items() if value != asdict(skate.parameters)[name]]
    if more or bicycle.steer_elements.present:
        raise ParameterError(
            f"bicycle {bicycle.name}: expected a theoretical two-mass skate, found"
            f" {', '.join(more) or 'steer elements'} not zero"
        )
    return skate


def matrices(skate: TwoMassSkate) -> dict[str, Array]:
    """M, C1, K0, K2 by (7.1)-(7.4), each (2, 2)."""
    m_B, x_B, z_B = skate.rear_mass, skate.rear_x, skate.rear_z
    m_H, x_H, z_H = skate.front_mass, skate.front_x, skate.front_z
    u_H, w, sin = skate.front_arm, skate.projected_wheelbase, math.sin(skate.steer_axis_tilt)
    return {
        "M": np.array(  # (7.1)
            [[m_B * z_B**2 + m_H * z_H**2, -m_H * u_H * z_H], [-m_H * u_H * z_H, m_H * u_H**2]]
        ),
        "C1": np.array(  # (7.2)
            [[0.0, -(m_B * x_B * z_B + m_H * x_H * z_H) / w], [0.0, m_H * u_H * x_H / w]]
        ),
        "K0": np.array(  # (7.3)
            [[m_B * z_B + m_H * z_H, -m_H * u_H], [-m_H * u_H, -m_H * u_H * sin]]
        ),
        "K2": np.array(  # (7.4)
            [[0.0, -(m_B * z_B + m_H * z_H) / w], [0.0, m_H * u_H / w]]
        ),
    }


def closed_form_coefficients(skate: TwoMassSkate) -> dict[str, float]:
    """A0 ... X6 by (7.5), the first two terms of X2 corrected: see `x2_as_printed`."""
    g, m_B, x_B, z_B = skate.gravity, skate.rear_mass, skate.rear_x, skate.rear_z
    m_H, x_H, z_H = skate.front_mass, skate.front_x, skate.front_z
    u_H, w = skate.front_arm, skate.projected_wheelbase
    cos, sin = math.cos(skate.steer_axis_tilt), math.sin(skate.steer_axis_tilt)
    x4 = (x_B * z_H - x_H * z_B) * (x_B - x_H) * (z_B - z_H)
    return {
        "A0": m_B * m_H * u_H**2 * z_B**2,
        "B1": -m_B * m_H * u_H * z_B * (x_B * z_H - x_H * z_B) / w,
        "C0": -g * m_H * u_H * (m_B * sin * z_B**2 - m_B * u_H * z_B + m_H * sin * z_H**2 + m_H * u_H * z_H),
        "C2": m_B * m_H * u_H * z_B * (z_B - z_H) / w,
        "D1": -g * m_B * m_H * u_H * z_B * (x_B - x_H) / w,
        "D3": 0.0,
        "E0": -(g**2) * m_H * u_H * (m_H * (x_H - skate.wheelbase) * cos + m_B * z_B * sin),
        "E2": 0.0,
        "X2": _x2(skate, m_B * sin * x_B**2 * z_B * z_H + m_B * u_H * x_B**2 * z_B),
        "X4": g * m_B**3 * m_H**3 * u_H**3 * z_B**3 * x4 / w**3,
        "X6": 0.0,
    }


def x2_as_printed(skate: TwoMassSkate) -> float:
    """X_2 with the first two terms of its bracket as (7.5) prints them, x_B x_H in the place of x_B^2.

    The first of them, m_B sin x_B x_H z_H, hasn't even the dimension of the others. It is not what the
    matrices (7.1)-(7.4) give; kept to show the misprint.
    """
    m_B, x_B, z_B, x_H, z_H = skate.rear_mass, skate.rear_x, skate.rear_z, skate.front_x, skate.front_z
    sin = math.sin(skate.steer_axis_tilt)
    return _x2(skate, m_B * sin * x_B * x_H * z_H + m_B * skate.front_arm * x_B * x_H * z_B)


def _x2(skate: TwoMassSkate, first_two: float) -> float:
    m_B, x_B, z_B = skate.rear_mass, skate.rear_x, skate.rear_z
    m_H, x_H, z_H = skate.front_mass, skate.front_x, skate.front_z
    u_H, w, sin = skate.front_arm, skate.projected_wheelbase, math.sin(skate.steer_axis_tilt)
    bracket = first_two + (
        -m_B * sin * x_B * x_H * z_B**2
        - m_B * u_H * x_B * x_H * z_B
        + m_H * sin * x_B * x_H * z_H**2
        + m_H * u_H * x_B * x_H * z_H
        - m_H * sin * x_H**2 * z_B * z_H
        - m_H * u_H * x_H**2 * z_B
    )
    return -(skate.gravity**2) * m_B**2 * m_H**3 * u_H**3 * z_B**2 * (z_B - z_H) * bracket / w**2
