"""The nonlinear Whipple bicycle: exact accelerations at any lean and steer, without linearisation.

Four rigid bodies, knife-edge wheels that roll without slip. Kane's equations with the speeds of
`tms_model.rolling`: the generalised forces of gravity, inertia and the applied torques are formed for all
five speeds, then projected on the three free ones through the rolling constraint of the front wheel.

Reproduces table 1 of P. Basu-Mandal, A. Chatterjee and J. M. Papadopoulos, "Hands-free circular motions of a
benchmark bicycle", Proc. R. Soc. A 463 (2007), doi 10.1098/rspa.2007.1849, to the digits printed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tms_model.bicycle import Array, Bicycle
from tms_model.errors import ParameterError
from tms_model.parameters import MAY_BE_UNKNOWN, WhippleParameters
from tms_model.rolling import (
    DEPENDENT,
    FREE,
    LEAN_RATE,
    PITCH_RATE,
    SPEED,
    STEER_RATE,
    Posture,
    bias,
    posture,
    skew,
    touching_pitch,
)


@dataclass(frozen=True)
class Load:
    """Torques on the bicycle and forces that slow it down; positive forces brake, negative ones drive.

    Each force is a moment, force x radius, on a wheel. Rolling: from the ground, about the wheel's axle, as
    of a contact force that acts ahead of the contact and lies in the wheel's plane. Ahead: from the ground,
    about a level axis, as of a vertical normal force that acts ahead of the contact. Brake: from the frame
    that carries the wheel.
    """

    lean_torque: float = 0.0  # [N m], on the rear frame about the line of its heading
    steer_torque: float = 0.0  # [N m], on the front frame, reaction on the rear frame
    rear_rolling: float = 0.0  # [N]
    front_rolling: float = 0.0  # [N]
    rear_ahead: float = 0.0  # [N]
    front_ahead: float = 0.0  # [N]
    rear_brake: float = 0.0  # [N]
    front_brake: float = 0.0  # [N]


@dataclass(frozen=True, eq=False)
class Motion:
    """Where the bicycle is at an instant and how it moves; SAE signs.

    `rates` and `accelerations` are in the order of `tms_model.rolling.SPEEDS`; those of lean, steer, yaw and
    pitch are derivatives of these angles.
    """

    posture: Posture
    lean: float  # [rad]
    steer: float  # [rad]
    pitch: float  # [rad], nose up positive
    rates: Array  # (5,)
    accelerations: Array  # (5,)
    wheel_rates: Array  # (2,) [rad/s], rear and front wheel against their frames, about the axle to the right
    wheel_accelerations: Array  # (2,) [rad/s^2]
    angular_acceleration: Array  # (3,) [rad/s^2], of the rear frame, space axes of `tms_model.rolling`
    rear_centre_acceleration: Array  # (3,) [m/s^2], of the rear wheel's centre, same axes
    front_contact_force: Array  # (2,) [N], of the ground on the front wheel: up, and to its right
    kinetic_energy: float  # [J]
    potential_energy: float  # [J], zero at ground level


def whipple_parameters(bicycle: Bicycle) -> WhippleParameters:
    """The parameters that the nonlinear equations need. Raises ParameterError if any of them isn't known."""
    if bicycle.parameters is None:
        raise ParameterError(
            f"bicycle {bicycle.name}: expected masses, inertias and geometry for the nonlinear equations,"
            " found only the matrices of the linear ones; take a bicycle with parameters, such as"
            " tms_table_8_1"
        )
    unknown = [name for name in MAY_BE_UNKNOWN if math.isnan(getattr(bicycle.parameters, name))]
    if unknown:
        raise ParameterError(
            f"bicycle {bicycle.name}: expected {' and '.join(unknown)} for the nonlinear equations, found"
            " that they aren't known (the linear ones don't ask for them); set them, or take a bicycle that"
            " has them, such as benchmark"
        )
    return bicycle.parameters


def motion(p: WhippleParameters, state: Array, load: Load | None = None) -> Motion:
    """The instant's motion, accelerations included.

    state: (5,) lean, steer [rad], lean rate, steer rate [rad/s], speed of the rear contact [m/s]. Raises
    ParameterError as `touching_pitch` does.
    """
    lean, steer = float(state[0]), float(state[1])
    pitch = touching_pitch(p, lean, steer)
    at = posture(p, lean, steer, pitch)
    constraint = at.constraint
    free = np.zeros((5, 3))  # speeds = free @ (lean rate, steer rate, speed)
    free[FREE] = np.eye(3)
    inverse = _inverse(constraint[:, DEPENDENT])
    free[DEPENDENT] = -inverse @ constraint[:, FREE]
    rates = free @ state[2:5]
    steady = bias(p, at, rates)
    held = np.zeros(5)  # accelerations of the dependent speeds while the free ones are constant
    held[DEPENDENT] = -inverse @ steady.constraint

    masses, inertias = _masses(p), _inertias(p, at)
    turning = at.turning.reshape(12, 5)
    moving, weights = at.moving.reshape(12, 5), np.repeat(masses, 3)
    angular_momentum = (inertias @ at.turning).reshape(12, 5)
    mass = moving.T @ (weights[:, None] * moving) + turning.T @ angular_momentum
    gyroscopic = [
        skew(rate) @ momentum
        for rate, momentum in zip(
            (turning @ rates).reshape(4, 3), (angular_momentum @ rates).reshape(4, 3), strict=True
        )
    ]
    torque = (inertias @ steady.turning[:, :, None]).reshape(12) + np.concatenate(gyroscopic)
    weight = p.gravity * masses @ at.moving[:, 2, :]
    force = generalised_force(p, at, load or Load()) + weight
    force -= moving.T @ (weights * steady.moving.reshape(12)) + turning.T @ torque
    accelerations = held + free @ np.linalg.solve(free.T @ mass @ free, free.T @ (force - mass @ held))
    reaction = inverse.T @ (mass @ accelerations - force)[DEPENDENT]
    relative = np.stack([at.rear_spin, at.front_spin + at.front_roll_back])
    relative[0, PITCH_RATE] -= 1.0
    relative_bias = np.array([0.0, steady.front_spin + steady.front_roll_back])
    return Motion(
        posture=at,
        lean=lean,
        steer=steer,
        pitch=pitch,
        rates=rates,
        accelerations=accelerations,
        wheel_rates=relative @ rates,
        wheel_accelerations=relative @ accelerations + relative_bias,
        angular_acceleration=at.turning[1] @ accelerations + steady.turning[1],
        rear_centre_acceleration=at.moving[0] @ accelerations + steady.moving[0],
        front_contact_force=reaction * np.array([-1.0, 1.0]),
        kinetic_energy=float(0.5 * rates @ mass @ rates),
        potential_energy=float(-p.gravity * masses @ centre_heights(at)),
    )


def generalised_force(p: WhippleParameters, at: Posture, load: Load) -> Array:
    """(5,) forces of `load` per unit of each of the speeds: their power is force @ speeds."""
    force = np.zeros(5)
    force[LEAN_RATE] += load.lean_torque
    force[STEER_RATE] += load.steer_torque
    force[SPEED] -= load.rear_rolling + load.rear_ahead + load.rear_brake
    force += load.rear_rolling * p.rear_wheel_radius * (at.lean_rotation[:, 1] @ at.leaning)
    force[PITCH_RATE] -= load.rear_brake * p.rear_wheel_radius
    force -= (load.front_rolling + load.front_ahead + load.front_brake) * at.front_speed
    force += load.front_rolling * p.front_wheel_radius * (at.front_rotation[:, 1] @ at.front_leaning)
    force += load.front_brake * p.front_wheel_radius * at.front_roll_back
    return force


def centre_heights(at: Posture) -> Array:
    """(4,) [m], z of the bodies' centres of mass: negative above ground."""
    levers = {name: lever[2] for name, lever in at.levers.items()}
    rear, crown = levers["rear_radius"], levers["rear_radius"] + levers["crown"]
    return np.array(
        [rear, rear + levers["rear_frame"], crown + levers["front_frame"], crown + levers["front_wheel"]]
    )


def sensor(p: WhippleParameters, moving: Motion, position: Array) -> tuple[Array, Array]:
    """What an ideal inertial sensor on the rear frame measures, nothing left out.

    position: (3,) [m], of the sensor from the rear contact of the upright bicycle, SAE axes of the rear
    frame. Returns angular velocity [rad/s] and specific force [m/s^2], each (3,), in these axes.
    """
    axes = moving.posture.rear_rotation
    rate = moving.posture.turning[1] @ moving.rates
    lever = axes @ (position + np.array([0.0, 0.0, p.rear_wheel_radius]))
    acceleration = moving.rear_centre_acceleration + skew(moving.angular_acceleration) @ lever
    acceleration += skew(rate) @ (skew(rate) @ lever)
    acceleration[2] -= p.gravity
    return axes.T @ rate, axes.T @ acceleration


def _inverse(matrix: Array) -> Array:
    # Of (2, 2), written out: twenty times faster than a solver's call, and this is the innermost loop.
    (a, b), (c, d) = matrix.tolist()
    determinant = a * d - b * c
    return np.array([[d / determinant, -b / determinant], [-c / determinant, a / determinant]])


def _masses(p: WhippleParameters) -> Array:
    return np.array([p.rear_wheel_mass, p.rear_frame_mass, p.front_frame_mass, p.front_wheel_mass])


def _inertias(p: WhippleParameters, at: Posture) -> Array:
    """(4, 3, 3) [kg m^2], about the bodies' centres of mass, space axes."""
    rear, front = at.rear_rotation, at.front_rotation
    return np.stack(
        [
            _wheel_inertia(p.rear_wheel_inertia_xx, p.rear_wheel_inertia_yy, at.lean_rotation[:, 1]),
            rear
            @ _frame_inertia(
                p.rear_frame_inertia_xx,
                p.rear_frame_inertia_xz,
                p.rear_frame_inertia_yy,
                p.rear_frame_inertia_zz,
            )
            @ rear.T,
            front
            @ _frame_inertia(
                p.front_frame_inertia_xx,
                p.front_frame_inertia_xz,
                p.front_frame_inertia_yy,
                p.front_frame_inertia_zz,
            )
            @ front.T,
            _wheel_inertia(p.front_wheel_inertia_xx, p.front_wheel_inertia_yy, front[:, 1]),
        ]
    )


def _frame_inertia(xx: float, xz: float, yy: float, zz: float) -> Array:
    return np.array([[xx, 0.0, xz], [0.0, yy, 0.0], [xz, 0.0, zz]])


def _wheel_inertia(across: float, spin: float, axle: Array) -> Array:
    return across * np.eye(3) + (spin - across) * np.outer(axle, axle)
