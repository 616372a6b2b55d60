"""Steady turns, and what they say about self-stability: torque, capsize speed, necessary conditions.

Reference: Kooijman et al. 2011, supplement (SOM), chapter 5, Eqs. (5.1)-(5.10), doi 10.1126/science.1201959;
letters of Meijaard et al. 2007, doi 10.1098/rspa.2007.1857.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from tms_model.bicycle import Bicycle
from tms_model.characteristic import routh
from tms_model.errors import ParameterError
from tms_model.parameters import WhippleParameters

STEEPEST = math.radians(89.0)  # tilts that are searched


@dataclass(frozen=True)
class SteadyTurn:
    """A turn of constant lean and steer, all per steer angle; SAE signs."""

    speed: float  # [m/s]
    lean_per_steer: float  # [rad/rad], the first line of (5.1)
    torque_per_steer: float  # T_delta / delta [N m/rad] that holds it, (5.2)
    yaw_rate_per_steer: float  # [1/s]


@dataclass(frozen=True)
class CapsizeTerms:
    """E_0 and E_2 in closed form (5.8), and what they are made of."""

    static_moment: float  # S_A = m_A u_A + mu m_T x_T [kg m]
    total_moment: float  # m_T z_T [kg m], negative
    e0: float  # E_0 [N^2 m^2]
    e2: float  # E_2 [N^2 s^2]

    @property
    def capsize_speed(self) -> float | None:
        """Speed [m/s] at which E = 0 (5.10); None if there is none."""
        squared = -self.e0 / self.e2 if self.e2 else -1.0
        return math.sqrt(squared) if squared > 0.0 else None

    @property
    def region(self) -> str:
        """Which quadrant of Figure 5.2: at which speeds E > 0 lets the bicycle be self-stable."""
        if self.e0 > 0.0:
            return "below the capsize speed" if self.e2 < 0.0 else "at all speeds"
        return "above the capsize speed" if self.e2 > 0.0 else "never"


@dataclass(frozen=True)
class NecessaryConditions:
    """The five conditions at the end of SOM section 5.1 at one speed, each evaluated by itself.

    The text calls them equivalent. Four are. The second is not: K is not symmetric, and det(K) > 0 leaves two
    positive eigenvalues possible. K_2 of positive trace makes them so above some speed, though the bicycle
    may be self-stable there, as the two-mass skate of table 7.1 is at 40 m/s.
    """

    polynomial: bool  # 1: E > 0
    stiffness_eigenvalues: bool  # 2: both eigenvalues of K are negative
    determinant: bool  # 3: det(K) > 0
    steady_turn: bool  # 4: the torque that holds a steady turn opposes the steer angle
    release: bool  # 5: released from a steady turn, the bicycle turns more at first


def steady_turn(bicycle: Bicycle, speed: float) -> SteadyTurn:
    """The steady turn at a speed [m/s] without lean torque: K [lean, steer] = [0, T_steer] (5.1), (5.2)."""
    stiffness = bicycle.stiffness_at(speed)
    lean = -stiffness[0, 1] / stiffness[0, 0]
    torque = stiffness[1, 0] * lean + stiffness[1, 1]
    yaw = speed * math.cos(bicycle.steer_axis_tilt) / bicycle.wheelbase
    return SteadyTurn(speed, float(lean), float(torque), yaw)


def steer_acceleration_per_torque(bicycle: Bicycle) -> float:
    """First steer acceleration after a sudden steer torque, I_Txx / det M (5.6) [1/(kg m^2)]; positive."""
    return float(bicycle.mass[0, 0] / np.linalg.det(bicycle.mass))


def necessary_conditions(bicycle: Bicycle, speed: float) -> NecessaryConditions:
    """The five necessary conditions of self-stability at a speed [m/s], each by its own way."""
    stiffness = bicycle.stiffness_at(speed)
    turn = steady_turn(bicycle, speed)
    held = np.array([turn.lean_per_steer, 1.0])  # a turn to the right, steer 1
    released = np.linalg.solve(bicycle.mass, -stiffness @ held)
    return NecessaryConditions(
        polynomial=routh(bicycle, speed).values["E"] > 0.0,
        stiffness_eigenvalues=bool((np.linalg.eigvals(stiffness).real < 0.0).all()),
        determinant=bool(np.linalg.det(stiffness) > 0.0),
        steady_turn=turn.torque_per_steer < 0.0,
        release=bool(released[1] > 0.0),
    )


def capsize_terms(parameters: WhippleParameters) -> CapsizeTerms:
    """E_0 and E_2 by (5.8), from the 25 parameters and not from the matrices."""
    p, g = parameters, parameters.gravity
    cos, sin = math.cos(p.steer_axis_tilt), math.sin(p.steer_axis_tilt)
    m_A = p.front_frame_mass + p.front_wheel_mass
    x_A_m_A = p.front_frame_mass * p.front_frame_x + p.front_wheel_mass * p.wheelbase
    z_A_m_A = p.front_frame_mass * p.front_frame_z - p.front_wheel_mass * p.front_wheel_radius
    m_T_x_T = p.rear_frame_mass * p.rear_frame_x + x_A_m_A
    m_T_z_T = p.rear_frame_mass * p.rear_frame_z - p.rear_wheel_mass * p.rear_wheel_radius + z_A_m_A
    m_A_u_A = (x_A_m_A - m_A * (p.wheelbase + p.trail)) * cos - z_A_m_A * sin
    S_A = m_A_u_A + p.trail / p.wheelbase * cos * m_T_x_T
    S_F, S_R = p.front_spin, p.rear_spin
    return CapsizeTerms(
        static_moment=S_A,
        total_moment=m_T_z_T,
        e0=-(g**2) * S_A * (m_T_z_T * sin + S_A),
        e2=g * cos * (S_F * m_T_z_T * sin + (S_F + S_R) * S_A) / p.wheelbase,
    )


def tilt_without_capsize(parameters: WhippleParameters, *, turn_front_frame: bool = False) -> float:
    """Steer axis tilt [rad] nearest to upright at which E_2 = 0 (5.9): no capsize speed.

    All other parameters stay as they are: places of masses, trail and all. With turn_front_frame, the front
    frame's centre of mass turns with the steer axis about the front contact instead, as it would on a bicycle
    whose fork is tilted: this gives the supplement's 'close to 2.6 degrees' for the benchmark, the former
    gives 1.69. Raises ParameterError if there is no such tilt.
    """

    def e2(tilt: float) -> float:
        return capsize_terms(tilted(parameters, tilt, turn_front_frame=turn_front_frame)).e2

    tilts = sorted(np.linspace(-STEEPEST, STEEPEST, 2001), key=abs)
    step = 2.0 * STEEPEST / 2000
    for tilt in tilts:
        low, high = max(tilt - step, -STEEPEST), min(tilt + step, STEEPEST)
        if e2(low) * e2(high) < 0.0:
            return float(brentq(e2, low, high, xtol=1e-15, rtol=1e-14))
    raise ParameterError(
        "steer_axis_tilt: expected a tilt at which E_2 vanishes, found none; is there any wheel spin?"
    )


def tilted(
    parameters: WhippleParameters, tilt: float, *, turn_front_frame: bool = False
) -> WhippleParameters:
    """The same parameters at another steer axis tilt [rad], trail kept.

    With turn_front_frame, the front frame's centre of mass turns with the axis about the front contact; its
    inertia keeps its axes.
    """
    if not turn_front_frame:
        return replace(parameters, steer_axis_tilt=tilt)
    # More tilt leans the axis back: what is above the ground moves backward.
    angle = tilt - parameters.steer_axis_tilt
    cos, sin = math.cos(angle), math.sin(angle)
    x, z = parameters.front_frame_x - parameters.wheelbase, parameters.front_frame_z
    return replace(
        parameters,
        steer_axis_tilt=tilt,
        front_frame_x=parameters.wheelbase + x * cos + z * sin,
        front_frame_z=-x * sin + z * cos,
    )
