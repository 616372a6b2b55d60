"""The linear equations before the wheels are made to roll: both contacts may move sideways over the floor.

Coordinates are lean and steer; speeds are the lateral velocity u of the rear contact, the yaw rate r, the
lean rate and the steer rate. With the lateral forces F of the floor on the rear and the front wheel,

    M4 [u' + v r, r', lean'', steer''] + (v G + D) [u, r, lean', steer'] + (K + v^2 L) [lean, steer]
        = J^T F + Q,       J [u, r, lean', steer'] = slip + [0, v cos(lambda_s) steer].

slip: lateral velocity of each contact over the floor, along the wheel's axle. Both zero gives u = 0, Eq.
(10.2) for r, and Eq. (3.1) of the supplement for lean and steer, to the last digit (a test). The first row of
M4 is lateral momentum, the second angular momentum about the rear contact; M4 is made of the moments of
Meijaard et al. 2007, appendix A (doi 10.1098/rspa.2007.1857), of which Eq. (3.1) is their projection. K holds
gravity, which does not ask whether wheels slip (both stay on the floor), the steer elements, and what a
change of speed adds: see `tms_model.acceleration`, of whose K' this is the form with four rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tms_model.acceleration import (
    acceleration_stiffness,
    normal_forces,
    parameters_under_acceleration,
    resistance_load,
)
from tms_model.bicycle import Array, Bicycle
from tms_model.parameters import WhippleParameters
from tms_model.resistance import Resistance


@dataclass(frozen=True, eq=False)
class SlidingEquations:
    """The equations of the module's head at one rate of change of the speed. SAE signs."""

    mass: Array  # M4 (4, 4), symmetric, columns u' + v r, r', lean'', steer''
    gyroscopic: Array  # G (4, 4), times speed
    damping: Array  # D (4, 4)
    stiffness: Array  # K (4, 2)
    stiffness2: Array  # L (4, 2), times speed squared; zero but for a bicycle given by matrices
    contacts: Array  # J (2, 4), rear and front
    heading: float  # cos(lambda_s): heading of the front wheel per steer angle
    normal_forces: Array  # (2,) [N] on the rear and the front wheel

    def slip(self, speed: float, steer: float, speeds: Array) -> Array:
        """Lateral velocity (2,) [m/s] of both contacts over the floor; speeds (4,): u, r, lean', steer'."""
        slip: Array = self.contacts @ speeds - np.array([0.0, speed * self.heading * steer])
        return slip


def sliding_equations(
    bicycle: Bicycle, acceleration: float = 0.0, resistance: Resistance = "rolling"
) -> SlidingEquations:
    """The equations of a bicycle whose speed changes at `acceleration` [m/s^2].

    A bicycle given by matrices takes what they don't say from its stand-in; the difference in their last
    digits is put into the rows of lean and steer, so that rolling gives its own matrices. Raises
    ParameterError without a stand-in, and as `acceleration_stiffness` does.
    """
    p, _ = parameters_under_acceleration(bicycle)
    cos = math.cos(bicycle.steer_axis_tilt)
    mass, gyroscopic = _mass(p), _gyroscopic(p)
    stiffness, stiffness2 = np.zeros((4, 2)), np.zeros((4, 2))
    stiffness[2:] = bicycle.gravity * bicycle.stiffness0 + bicycle.steer_elements.stiffness
    if acceleration != 0.0:
        stiffness += _acceleration_rows(bicycle, p, acceleration, resistance, mass)
    damping = np.zeros((4, 4))
    damping[2:, 2:] = bicycle.steer_elements.damping
    contacts = np.array([[1.0, 0.0, 0.0, 0.0], [1.0, bicycle.wheelbase, 0.0, -bicycle.trail * cos]])
    if bicycle.parameters is None:
        rolled_mass, rolled_damping, rolled_stiffness2 = _rolled(bicycle, mass, gyroscopic)
        mass[2:, 2:] += bicycle.mass - rolled_mass
        gyroscopic[2:, 2:] += bicycle.damping - rolled_damping
        stiffness2[2:] = bicycle.stiffness2 - rolled_stiffness2
    forces = np.array(normal_forces(p, acceleration, resistance))
    return SlidingEquations(mass, gyroscopic, damping, stiffness, stiffness2, contacts, cos, forces)


def _mass(p: WhippleParameters) -> Array:
    """M4: the whole bicycle about the rear contact, and the front assembly about the steer axis."""
    cos, sin = math.cos(p.steer_axis_tilt), math.sin(p.steer_axis_tilt)
    x_B, z_B, m_B = p.rear_frame_x, p.rear_frame_z, p.rear_frame_mass
    x_H, z_H, m_H = p.front_frame_x, p.front_frame_z, p.front_frame_mass
    w, r_R, r_F, m_R, m_F = (
        p.wheelbase, p.rear_wheel_radius, p.front_wheel_radius, p.rear_wheel_mass, p.front_wheel_mass,
    )  # fmt: skip
    m_T = m_R + m_B + m_H + m_F
    mx_T = x_B * m_B + x_H * m_H + w * m_F
    mz_T = -r_R * m_R + z_B * m_B + z_H * m_H - r_F * m_F
    I_Rxx, I_Fxx = p.rear_wheel_inertia_xx, p.front_wheel_inertia_xx
    I_Txx = I_Rxx + p.rear_frame_inertia_xx + p.front_frame_inertia_xx + I_Fxx
    I_Txx += m_R * r_R**2 + m_B * z_B**2 + m_H * z_H**2 + m_F * r_F**2
    I_Txz = p.rear_frame_inertia_xz + p.front_frame_inertia_xz
    I_Txz += m_F * w * r_F - m_B * x_B * z_B - m_H * x_H * z_H
    I_Tzz = I_Rxx + p.rear_frame_inertia_zz + p.front_frame_inertia_zz + I_Fxx
    I_Tzz += m_B * x_B**2 + m_H * x_H**2 + m_F * w**2
    # A point (x, z) of the front assembly moves to the side by its distance ahead of the steer axis.
    u_H, u_F = (x_H - w - p.trail) * cos - z_H * sin, -p.trail * cos + r_F * sin
    I_xx, I_xz, I_zz = (
        p.front_frame_inertia_xx + I_Fxx, p.front_frame_inertia_xz, p.front_frame_inertia_zz + I_Fxx,
    )  # fmt: skip
    mu_A = m_H * u_H + m_F * u_F
    I_Alx = -m_H * u_H * z_H + m_F * u_F * r_F + I_xx * sin + I_xz * cos
    I_Alz = m_H * u_H * x_H + m_F * u_F * w + I_xz * sin + I_zz * cos
    I_All = m_H * u_H**2 + m_F * u_F**2 + I_xx * sin**2 + 2.0 * I_xz * sin * cos + I_zz * cos**2
    return np.array(
        [
            [m_T, mx_T, -mz_T, mu_A],
            [mx_T, I_Tzz, I_Txz, I_Alz],
            [-mz_T, I_Txz, I_Txx, I_Alx],
            [mu_A, I_Alz, I_Alx, I_All],
        ]
    )


def _gyroscopic(p: WhippleParameters) -> Array:
    """G: what the wheels' spin does to lean, yaw and steer; skew-symmetric."""
    cos, sin = math.cos(p.steer_axis_tilt), math.sin(p.steer_axis_tilt)
    S_F = p.front_spin
    S_T = p.rear_spin + S_F
    matrix = np.zeros((4, 4))
    matrix[1, 2:] = -S_T, -S_F * sin
    matrix[2, 1], matrix[2, 3] = S_T, S_F * cos
    matrix[3, 1:3] = S_F * sin, -S_F * cos
    return matrix


def _acceleration_rows(
    bicycle: Bicycle, p: WhippleParameters, acceleration: float, resistance: Resistance, mass: Array
) -> Array:
    """What v' adds to K (4, 2): K' of the rolling bicycle, its turn and its yaw row taken apart.

    The yaw row: masses and spinning wheels beside the track, and the ground's pull at the front wheel, which
    acts along that wheel and where the trail puts it. The lateral row: the side component of that pull.
    """
    cos, sin = math.cos(p.steer_axis_tilt), math.sin(p.steer_axis_tilt)
    per_steer = math.cos(bicycle.steer_axis_tilt) / bicycle.wheelbase
    mu = bicycle.trail * per_steer
    load = resistance_load(p, acceleration, resistance)
    rear, front = load.rear_rolling, load.front_rolling
    pull = -(front + load.front_ahead + load.front_brake)
    pull -= p.front_spin / p.front_wheel_radius * acceleration if p.front_spin else 0.0
    rows = np.zeros((4, 2))
    rows[0] = 0.0, -pull * cos
    S_F = p.front_spin
    rows[1, 0] = acceleration * (-mass[0, 2] - p.rear_spin - S_F)
    rows[1, 1] = -acceleration * (mass[0, 3] + S_F * sin) - pull * (p.wheelbase + p.trail) * cos
    rows[1] -= rear * p.rear_wheel_radius * np.array([1.0, 0.0])
    rows[1] -= front * p.front_wheel_radius * np.array([1.0, sin])
    turn = acceleration * per_steer * np.array([mass[2, 1], mass[3, 1] + mu * mass[1, 1]])
    rows[2:] = acceleration_stiffness(p, acceleration, resistance)
    rows[2:, 1] -= turn
    rows[3] -= mu * rows[1]
    return rows


def _rolled(bicycle: Bicycle, mass: Array, gyroscopic: Array) -> tuple[Array, Array, Array]:
    """M, C1 and K2 of the rolling bicycle: u = 0 and Eq. (10.2) put into the four equations."""
    per_steer = math.cos(bicycle.steer_axis_tilt) / bicycle.wheelbase
    project = np.zeros((4, 2))
    project[1, 1] = bicycle.trail * per_steer
    project[2, 0] = project[3, 1] = 1.0
    turn = np.zeros((4, 2))  # yaw rate per v steer
    turn[1, 1] = per_steer
    sideways = np.zeros((4, 4))  # u' + v r: yaw rate times speed in the first place
    sideways[0, 1] = 1.0
    damping = mass @ (turn + sideways @ project) + gyroscopic @ project
    stiffness2 = (mass @ sideways + gyroscopic) @ turn
    return project.T @ mass @ project, project.T @ damping, project.T @ stiffness2


def front_moment(p: WhippleParameters) -> float:
    """First moment m_A u_A [kg m] of the front assembly, ahead of its steer axis."""
    return float(_mass(p)[0, 3])
