"""JBike6's coordinates and its principal form of inertias, both ways.

JBike6 has x forward, y up, z to the right; this project x forward, y right, z down. It is told a body's
inertia by its three principal values and the angle alpha of the first axis above x.

Reference: Kooijman et al. 2011, supplement (SOM), chapter 6, Eqs. (6.1)-(6.3), doi 10.1126/science.1201959.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tms_model.bicycle import Array
from tms_model.parameters import WhippleParameters

T = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # x_benchmark = T x_jbike6 (6.1)
BODIES = ("rear_frame", "front_frame")


@dataclass(frozen=True)
class JBike6Body:
    """A frame as JBike6's input has it."""

    mass: float  # [kg]
    x: float  # [m], forward of the rear contact
    y: float  # [m], above the ground
    inertia_11: float  # I_11 [kg m^2], the larger of the two in the plane of symmetry
    inertia_22: float  # I_22 [kg m^2]
    inertia_zz: float  # I_zz [kg m^2], across that plane
    angle: float  # alpha [rad], of the first axis above x, in (-pi/2, pi/2]


def to_jbike6(vectors: Array) -> Array:
    """Vectors (..., 3) from benchmark axes into JBike6's (6.1)."""
    return np.asarray(vectors @ T)


def from_jbike6(vectors: Array) -> Array:
    """Vectors (..., 3) from JBike6's axes into the benchmark's (6.1)."""
    return np.asarray(vectors @ T.T)


def inertia_to_jbike6(inertia: Array) -> Array:
    """Inertia matrix (3, 3) from benchmark axes into JBike6's (6.2)."""
    return np.asarray(T.T @ inertia @ T)


def inertia_from_jbike6(inertia: Array) -> Array:
    """Inertia matrix (3, 3) from JBike6's axes into the benchmark's (6.2)."""
    return np.asarray(T @ inertia @ T.T)


def principal(inertia_xx: float, inertia_yy: float, inertia_xy: float) -> tuple[float, float, float]:
    """I_11 >= I_22 [kg m^2] and alpha [rad] in (-pi/2, pi/2] by (6.3), from components in JBike6's axes.

    The angle is taken by atan2: the arctan that (6.3) prints gives the first axis only while I_xx > I_yy, and
    the second one otherwise.
    """
    mean, half = (inertia_xx + inertia_yy) / 2.0, (inertia_xx - inertia_yy) / 2.0
    radius = math.hypot(inertia_xy, half)
    angle = 0.5 * math.atan2(2.0 * inertia_xy, inertia_xx - inertia_yy)
    return mean + radius, mean - radius, angle if angle > -math.pi / 2 else math.pi / 2


def components(inertia_11: float, inertia_22: float, angle: float) -> tuple[float, float, float]:
    """I_xx, I_yy, I_xy [kg m^2] in JBike6's axes: the way back from `principal`."""
    mean, half = (inertia_11 + inertia_22) / 2.0, (inertia_11 - inertia_22) / 2.0
    return (
        mean + half * math.cos(2.0 * angle),
        mean - half * math.cos(2.0 * angle),
        half * math.sin(2.0 * angle),
    )


def jbike6_body(parameters: WhippleParameters, body: str) -> JBike6Body:
    """One of `BODIES` as JBike6's input has it."""
    xx, xz, yy, zz = (getattr(parameters, f"{body}_inertia_{axes}") for axes in ("xx", "xz", "yy", "zz"))
    first, second, angle = principal(xx, zz, -xz)  # (6.2): I_yy there is I_zz here, I_xy is -I_xz
    return JBike6Body(
        mass=getattr(parameters, f"{body}_mass"),
        x=getattr(parameters, f"{body}_x"),
        y=-getattr(parameters, f"{body}_z"),
        inertia_11=first,
        inertia_22=second,
        inertia_zz=yy,
        angle=angle,
    )


def parameters_of_body(told: JBike6Body, body: str) -> dict[str, float]:
    """The parameters of one of `BODIES` by name, from JBike6's input: for `with_parameters`."""
    xx, zz, xy = components(told.inertia_11, told.inertia_22, told.angle)
    return {
        f"{body}_mass": told.mass,
        f"{body}_x": told.x,
        f"{body}_z": -told.y,
        f"{body}_inertia_xx": xx,
        f"{body}_inertia_xz": -xy,
        f"{body}_inertia_yy": told.inertia_zz,
        f"{body}_inertia_zz": zz,
    }
