"""The equations before the wheels are made to roll: they are Eq. (3.1) once they do, and mechanics before."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tms_model import bicycle_names, load_bicycle
from tms_model.acceleration import (
    acceleration_stiffness,
    effective_mass,
    parameters_under_acceleration,
    resistance_load,
)
from tms_model.bicycle import Array, Bicycle
from tms_model.nonlinear_response import moving
from tms_model.rolling import YAW_RATE
from tms_model.sliding import SlidingEquations, front_moment, sliding_equations

G = 9.81


CHANGES = [
    (name, change)
    for name in bicycle_names()
    for change in (0.0, -0.5886, 0.3)
    if change == 0.0 or (sliding_equations(load_bicycle(name)).normal_forces > 0.0).all()
]  # a speed that the floor changes needs weight on both wheels


def rolled(equations: SlidingEquations, bicycle: Bicycle, speed: float, change: float) -> tuple[Array, ...]:
    """M, C, K of lean and steer: u = 0 and r = (v steer + c steer') cos / w, put in by hand at one speed."""
    turn = math.cos(bicycle.steer_axis_tilt) / bicycle.wheelbase
    on_rates = np.array([[0.0, 0.0], [0.0, bicycle.trail * turn], [1.0, 0.0], [0.0, 1.0]])
    on_angles = np.array([[0.0, 0.0], [0.0, speed * turn], [0.0, 0.0], [0.0, 0.0]])
    # [u' + v r, r', lean'', steer''] of angles, rates and accelerations
    of_angles = np.array([[0.0, speed * speed * turn], [0.0, change * turn], [0.0, 0.0], [0.0, 0.0]])
    of_rates = np.array([[0.0, speed * bicycle.trail * turn], [0.0, speed * turn], [0.0, 0.0], [0.0, 0.0]])
    acting = speed * equations.gyroscopic + equations.damping
    stiffness = equations.stiffness + speed**2 * equations.stiffness2
    project = on_rates.T
    return (
        project @ equations.mass @ on_rates,
        project @ (equations.mass @ of_rates + acting @ on_rates),
        project @ (equations.mass @ of_angles + acting @ on_angles + stiffness),
    )


@pytest.mark.parametrize(("name", "change"), CHANGES)
def test_rolling_wheels_give_equation_3_1(name: str, change: float) -> None:
    bicycle, speed = load_bicycle(name), 3.6
    mass, damping, stiffness = rolled(sliding_equations(bicycle, change), bicycle, speed, change)
    parameters, _ = parameters_under_acceleration(bicycle)
    expected = bicycle.stiffness_at(speed)
    if change:
        expected = expected + acceleration_stiffness(parameters, change)
    size = np.abs(expected).max()
    np.testing.assert_allclose(mass, bicycle.mass, rtol=0.0, atol=1e-10 * np.abs(bicycle.mass).max())
    np.testing.assert_allclose(damping, bicycle.damping_at(speed), rtol=0.0, atol=1e-10 * size)
    np.testing.assert_allclose(stiffness, expected, rtol=0.0, atol=1e-10 * size)


@pytest.mark.parametrize("name", bicycle_names())
def test_mass_is_symmetric_and_spin_does_no_work(name: str) -> None:
    equations = sliding_equations(load_bicycle(name))
    np.testing.assert_allclose(equations.mass, equations.mass.T, rtol=1e-12, atol=1e-15)
    # Zero where two point masses are all there is: four motions of two masses can't all move some.
    sizes = np.linalg.eigvalsh(equations.mass)
    assert sizes.min() > -1e-14 * sizes.max()
    if load_bicycle(name).parameters is not None:
        np.testing.assert_allclose(equations.gyroscopic, -equations.gyroscopic.T, atol=1e-18)


@pytest.mark.parametrize(
    ("name", "change"),
    [(name, change) for name, change in CHANGES if change and load_bicycle(name).parameters is not None],
)
def test_rows_of_a_changing_speed_by_hand(name: str, change: float) -> None:
    # Moments about the ground line and about the steer axis when the speed changes, wheels rolling with
    # moments R r about their axles: dN_F = the weight that moves to the front wheel, at (0, -c cos steer).
    bicycle = load_bicycle(name)
    p = bicycle.parameters
    assert p is not None
    equations = sliding_equations(bicycle, change)
    load = resistance_load(p, change)
    cos, sin = math.cos(p.steer_axis_tilt), math.sin(p.steer_axis_tilt)
    moment_z = -equations.mass[0, 2]
    shifted = change * (moment_z - p.rear_spin - p.front_spin)
    shifted -= p.rear_wheel_radius * load.rear_rolling + p.front_wheel_radius * load.front_rolling
    mu = p.trail / p.wheelbase * cos
    lean_steer = -mu * shifted + cos * p.front_wheel_radius * load.front_rolling + cos * p.front_spin * change
    steer_steer = -mu * shifted * sin - change * front_moment(p) * cos
    rows = equations.stiffness[2:] - sliding_equations(bicycle).stiffness[2:]
    expected = np.array([[0.0, lean_steer], [-mu * shifted, steer_steer]])
    np.testing.assert_allclose(rows, expected, atol=1e-12 * max(1.0, np.abs(expected).max()))


def test_pushed_at_rest_without_floor_it_moves_as_a_free_body() -> None:
    # A push at the centre of mass moves every point alike at first: no yaw, no lean, no steer, if the fork
    # takes part by its own weight, which a push at its centre of mass shares out.
    bicycle = load_bicycle("tms_table_8_1")
    p = bicycle.parameters
    assert p is not None
    equations = sliding_equations(bicycle)
    u_H = (p.front_frame_x - p.wheelbase - p.trail) * math.cos(p.steer_axis_tilt)
    u_H -= p.front_frame_z * math.sin(p.steer_axis_tilt)
    rear = np.array([1.0, p.rear_frame_x, -p.rear_frame_z, 0.0]) * p.rear_frame_mass
    front = np.array([1.0, p.front_frame_x, -p.front_frame_z, u_H]) * p.front_frame_mass
    np.testing.assert_allclose(
        np.linalg.solve(equations.mass, rear + front), [1.0, 0.0, 0.0, 0.0], rtol=0.0, atol=1e-12
    )


@pytest.mark.parametrize("name", ["benchmark", "tms_table_8_1", "tms_eq_10_1"])
def test_weights_add_up(name: str) -> None:
    bicycle = load_bicycle(name)
    p, _ = parameters_under_acceleration(bicycle)
    mass = p.rear_wheel_mass + p.rear_frame_mass + p.front_frame_mass + p.front_wheel_mass
    still, braked = sliding_equations(bicycle).normal_forces, sliding_equations(bicycle, -0.5).normal_forces
    assert still.sum() == pytest.approx(mass * G, rel=1e-12)
    assert braked.sum() == pytest.approx(mass * G, rel=1e-12)
    assert braked[1] > still[1]  # slowing down loads the front wheel
    assert effective_mass(p) >= mass


def test_front_weight_by_hand() -> None:
    # Table 8.1: m_B x_B + m_H x_H = 6.425 x 0.5044 + 2.412 x 0.7338 = 5.010696 kg m; / 0.75 m x 9.81 m/s^2
    assert sliding_equations(load_bicycle("tms_table_8_1")).normal_forces[1] == pytest.approx(
        65.5399, abs=1e-4
    )


@pytest.mark.parametrize("change", [0.0, -0.5])
@pytest.mark.parametrize("name", ["benchmark", "tms_table_8_1"])
def test_force_on_the_front_wheel_is_that_of_the_nonlinear_equations(name: str, change: float) -> None:
    # Kane's equations know neither these rows nor their letters; near upright both must need the same force.
    bicycle, speed = load_bicycle(name), 4.0
    assert bicycle.parameters is not None
    e, load = sliding_equations(bicycle, change), resistance_load(bicycle.parameters, change)
    for state in 1e-5 * np.random.default_rng(1).standard_normal((5, 4)):
        rolling = moving(bicycle, np.array([*state, speed]), load)
        turn, lean_and_steer = rolling.rates[YAW_RATE], rolling.accelerations[:2]
        changes = np.array([speed * turn, rolling.accelerations[YAW_RATE], *lean_and_steer])
        speeds = np.array([0.0, turn, *state[2:]])
        needed = e.mass @ changes + (speed * e.gyroscopic + e.damping) @ speeds + e.stiffness @ state[:2]
        front = needed[1] / e.contacts[1, 1]
        assert front == pytest.approx(rolling.front_contact_force[1], rel=1e-8)
        np.testing.assert_allclose(e.contacts.T @ [needed[0] - front, front], needed, atol=1e-8 * abs(front))
