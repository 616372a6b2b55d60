"""The nonlinear bicycle against SymBRiM's Whipple bicycle, derived by other people in another way.

SymBRiM builds the bicycle symbolically from sympy's bodies and joints, in the coordinates of J. K. Moore's
dissertation (2012): the frames' axes are turned by the steer axis tilt, Kane's method is sympy's. Its
derivation takes ten seconds, once for all tests here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tms_model import WhippleParameters, load_bicycle
from tms_model.nonlinear import Load, motion

symbrim = pytest.importorskip("symbrim", reason="SymBRiM, a development dependency, is not installed")
sympy = pytest.importorskip("sympy")
mechanics = pytest.importorskip("sympy.physics.mechanics")

Array = NDArray[np.float64]
Oracle = Callable[[WhippleParameters, Array, Array, float], Array]

# Lean, steer, lean rate, steer rate, speed.
STATES = [
    [0.0, 0.0, 0.5, 0.0, 3.6],
    [0.3, -0.2, 0.4, 0.6, 4.0],
    [-0.7, 1.1, -1.0, 2.0, 2.0],
    [1.0, 0.4, 0.0, -3.0, 7.0],
]


@pytest.fixture(scope="module")
def oracle() -> Oracle:
    """Its eight accelerations for parameters, angles (8,), rates (8,) and a steer torque."""
    bicycle = symbrim.WhippleBicycle("bicycle")
    bicycle.rear_frame = symbrim.RigidRearFrame.from_convention("moore", "rear_frame")
    bicycle.front_frame = symbrim.RigidFrontFrame.from_convention("moore", "front_frame")
    bicycle.rear_wheel = symbrim.KnifeEdgeWheel("rear_wheel")
    bicycle.front_wheel = symbrim.KnifeEdgeWheel("front_wheel")
    bicycle.rear_tire = symbrim.NonHolonomicTire("rear_tire")
    bicycle.front_tire = symbrim.NonHolonomicTire("front_tire")
    bicycle.ground = symbrim.FlatGround("ground")
    bicycle.define_all()
    system = bicycle.to_system()
    gravity, torque = sympy.symbols("g T")
    system.apply_uniform_gravity(-gravity * bicycle.ground.get_normal(bicycle.ground.origin))
    rear_axes, front_axes = bicycle.rear_frame.steer_hub.frame, bicycle.front_frame.steer_hub.frame
    axis = bicycle.rear_frame.steer_hub.axis
    system.add_actuators(mechanics.TorqueActuator(torque, axis, front_axes, rear_axes))
    q, u = bicycle.q, bicycle.u
    system.q_ind, system.q_dep = [*q[:4], *q[5:]], [q[4]]
    system.u_ind, system.u_dep = [u[3], u[6], u[7]], [u[0], u[1], u[2], u[4], u[5]]
    system.form_eoms(constraint_solver="CRAMER")
    constants = _constants(bicycle)
    mass, forcing = system.mass_matrix_full, system.forcing_full
    evaluate = sympy.lambdify([list(q), list(u), [gravity, torque, *constants]], [mass, forcing], cse=True)
    order = [list(system.u).index(one) for one in u]

    def accelerations(p: WhippleParameters, angles: Array, rates: Array, steer_torque: float) -> Array:
        numbers = [p.gravity, steer_torque, *_numbers(p)]
        matrix, right = evaluate(angles, rates, numbers)
        rates_of_change = np.linalg.solve(matrix, np.ravel(right))
        found: Array = rates_of_change[8:][order]
        return found

    return accelerations


def _constants(bicycle) -> list:  # type: ignore[no-untyped-def,type-arg]
    """Its symbols, in the order of `_numbers`."""
    rear, front = bicycle.rear_frame, bicycle.front_frame
    symbols = [rear.symbols[name] for name in ("d1", "l1", "l2")]
    symbols += [front.symbols[name] for name in ("d2", "d3", "l3", "l4")]
    for frame in (rear, front):
        inertia = frame.body.central_inertia.to_matrix(frame.body.frame)
        symbols += [frame.body.mass, inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 2]]
    for wheel in (bicycle.rear_wheel, bicycle.front_wheel):
        inertia = wheel.body.central_inertia.to_matrix(wheel.body.frame)
        symbols += [wheel.radius, wheel.body.mass, inertia[0, 0], inertia[1, 1]]
    return symbols


def _numbers(p: WhippleParameters) -> list[float]:
    """Moore's parameters: lengths along and across the steer axis, inertias in axes turned by its tilt."""
    cos, sin = math.cos(p.steer_axis_tilt), math.sin(p.steer_axis_tilt)
    r_R, r_F = p.rear_wheel_radius, p.front_wheel_radius

    def turned(x: float, z: float) -> tuple[float, float]:
        return x * cos - z * sin, x * sin + z * cos

    def inertias(mass: float, xx: float, xz: float, yy: float, zz: float) -> list[float]:
        turn = np.array([[cos, sin], [-sin, cos]])
        (a, b), (_, d) = turn.T @ np.array([[xx, xz], [xz, zz]]) @ turn
        return [mass, float(a), yy, float(d), float(b)]

    d1, _ = turned(p.wheelbase + p.trail, r_R)
    d3, _ = turned(-p.trail, -r_F)
    _, d2 = turned(p.wheelbase, r_R - r_F)
    rear = turned(p.rear_frame_x, p.rear_frame_z + r_R)
    front = turned(p.front_frame_x - p.wheelbase, p.front_frame_z + r_F)
    return [
        *(d1, *rear, d2, d3, *front),
        *inertias(
            p.rear_frame_mass,
            p.rear_frame_inertia_xx,
            p.rear_frame_inertia_xz,
            p.rear_frame_inertia_yy,
            p.rear_frame_inertia_zz,
        ),
        *inertias(
            p.front_frame_mass,
            p.front_frame_inertia_xx,
            p.front_frame_inertia_xz,
            p.front_frame_inertia_yy,
            p.front_frame_inertia_zz,
        ),
        *(r_R, p.rear_wheel_mass, p.rear_wheel_inertia_xx, p.rear_wheel_inertia_yy),
        *(r_F, p.front_wheel_mass, p.front_wheel_inertia_xx, p.front_wheel_inertia_yy),
    ]


@pytest.mark.parametrize("name", ["benchmark", "delft_sbw", "tms_table_8_1"])
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("steer_torque", [0.0, 0.5])
@pytest.mark.long
def test_all_accelerations_are_symbrims(
    oracle: Oracle, name: str, state: list[float], steer_torque: float
) -> None:
    p = load_bicycle(name).parameters
    assert p is not None
    # Where the inertias about y aren't published, any will do: both models get the same.
    p = replace(p, rear_frame_inertia_yy=1.5, front_frame_inertia_yy=0.07)
    now = motion(p, np.array(state), Load(steer_torque=steer_torque))
    lean_rate, steer_rate, speed, yaw_rate, pitch_rate = now.rates
    rear, front = now.wheel_rates
    # Its order is Moore's: contact x, y, yaw, lean, pitch with the tilt, rear wheel, steer, front wheel (its
    # own description of the sixth and eighth, in 0.1.0, has the wheels the other way round).
    angles = np.array([0.0, 0.0, 0.0, now.lean, now.pitch + p.steer_axis_tilt, 0.0, now.steer, 0.0])
    rates = np.array([speed, 0.0, yaw_rate, lean_rate, pitch_rate, rear, steer_rate, front])
    expected = oracle(p, angles, rates, steer_torque)
    lean, steer, forward, yaw, pitch = now.accelerations
    rear, front = now.wheel_accelerations
    found = np.array([forward, speed * yaw_rate, yaw, lean, pitch, rear, steer, front])
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())
