"""The linear equations at a changing speed, against the nonlinear bicycle that slows down."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from tms_model import Bicycle, ParameterError, bicycle_names, linear_system, load_bicycle, response, yaw_rate
from tms_model.acceleration import (
    STAND_INS,
    acceleration_stiffness,
    coasting_loss,
    effective_mass,
    parameters_under_acceleration,
    resistance_load,
)
from tms_model.nonlinear import motion, whipple_parameters
from tms_model.nonlinear_response import OK, SPEED, moving, nonlinear_response
from tms_model.resistance import RESISTANCES, Resistance
from tms_model.varying_speed import state_matrices, varying_response, varying_system, varying_yaw_rate

KINDS = ("benchmark", "tms_table_8_1", "tms_eq_10_1", "counterexample_7_rear_steering")

Array = NDArray[np.float64]

BY_MATRICES = [name for name in bicycle_names() if load_bicycle(name).parameters is None]


def known(name: str) -> bool:
    """Whether the nonlinear bicycle exists: inertias about y may be missing, or all (matrices only)."""
    parameters = load_bicycle(name).parameters
    return parameters is not None and not np.isnan(astuple(parameters)).any()


KNOWN = [name for name in bicycle_names() if known(name)]


def both_wheels_carry(name: str) -> bool:
    """Whether weight rests on both wheels at rest and at 2 m/s^2: else the ground can't resist there."""
    p = whipple_parameters(load_bicycle(name))
    masses = [p.rear_wheel_mass, p.rear_frame_mass, p.front_frame_mass, p.front_wheel_mass]
    places = [0.0, p.rear_frame_x, p.front_frame_x, p.wheelbase]
    heights = [p.rear_wheel_radius, -p.rear_frame_z, -p.front_frame_z, p.front_wheel_radius]
    shift = np.dot(masses, heights) * 2.0 / p.gravity
    front = (np.dot(masses, places) + np.array([-shift, 0.0, shift])) / (p.wheelbase * np.sum(masses))
    return bool((front > 0.05).all() and (front < 0.95).all())


ROLLING = [name for name in KNOWN if both_wheels_carry(name)]
TIPS_FORWARD = "tms_table_7_1"  # its mass stands ahead of its front contact
PAIRS = [
    (name, resistance)
    for name in KNOWN
    for resistance in RESISTANCES
    if name in ROLLING or resistance.endswith("brake")
]


@pytest.mark.parametrize(("name", "resistance"), PAIRS)
@pytest.mark.parametrize(("speed", "acceleration"), [(6.0, -2.0), (3.6, -0.5886), (2.0, 0.3)])
def test_its_matrices_are_the_nonlinear_bicycles(
    name: str, resistance: Resistance, speed: float, acceleration: float
) -> None:
    bicycle, size = load_bicycle(name), 1e-3
    load = resistance_load(whipple_parameters(bicycle), acceleration, resistance)
    upright = np.array([0.0, 0.0, 0.0, 0.0, speed])
    assert moving(bicycle, upright, load).accelerations[2] == pytest.approx(acceleration, rel=1e-12)
    columns = []
    for direction in np.eye(5)[:4]:
        ahead, back, far, behind = (
            moving(bicycle, upright + k * size * direction, load).accelerations[:2] for k in (1, -1, 2, -2)
        )
        columns.append((8.0 * (ahead - back) - (far - behind)) / (12.0 * size))
    expected = state_matrices(bicycle, np.array([speed]), np.array([acceleration]), resistance)[0, 2:]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(np.stack(columns, axis=1), expected, rtol=0.0, atol=1e-9 * scale)


@pytest.mark.parametrize(("name", "resistance"), PAIRS)
@pytest.mark.quick_for(name=KINDS)
def test_small_motions_of_both_are_the_same(name: str, resistance: Resistance) -> None:
    bicycle, deceleration = load_bicycle(name), 0.5886
    times = np.linspace(0.0, 1.0, 21)
    system = varying_system(bicycle, times, 3.6 - deceleration * times, resistance)
    states = varying_response(system, np.array([0.0, 0.1, 0.5, -0.2]))
    states *= 3e-4 / np.abs(states[:, :2]).max()  # nonlinear terms are below 1e-6 of the motion
    load = resistance_load(whipple_parameters(bicycle), -deceleration, resistance)
    exact = nonlinear_response(bicycle, np.append(states[0], 3.6), times, load, tolerance=1e-13)
    assert exact.status == OK
    np.testing.assert_allclose(exact.states[:, SPEED], system.speeds, atol=1e-6)
    scale = np.abs(states).max(axis=0)
    np.testing.assert_allclose(exact.states[:, :4] / scale, states / scale, atol=1e-5)
    yaw_rates = varying_yaw_rate(system, states)
    np.testing.assert_allclose(exact.yaw_rate, yaw_rates, atol=1e-5 * np.abs(yaw_rates).max())


@pytest.mark.parametrize(
    ("resistance", "size"), [("rolling", 0.30), ("rear_brake", 0.57), ("front_brake", 0.27)]
)
def test_leaving_the_terms_out_is_not_the_same(resistance: Resistance, size: float) -> None:
    # The table of docs/conventions.md: with v(t) put into Eq. (3.1) and nothing else, the lean rate is wrong
    # by so much of the first one within 2 s at C_r = 0.06.
    bicycle = load_bicycle("tms_eq_10_1")
    times = np.linspace(0.0, 2.0, 401)
    speeds, initial = 3.6 - 0.5886 * times, np.array([0.0, 0.0, 1.0, 0.0])
    complete = varying_response(varying_system(bicycle, times, speeds, resistance), initial)
    only_v = [initial]
    for middle, step in zip(0.5 * (speeds[1:] + speeds[:-1]), np.diff(times), strict=True):
        only_v.append(response(linear_system(bicycle, middle), only_v[-1], np.array([step]))[0])
    assert np.abs(np.array(only_v)[:, 2] - complete[:, 2]).max() == pytest.approx(size, abs=0.01)


@pytest.mark.parametrize("name", bicycle_names())
def test_at_constant_speed_it_is_the_exact_response(name: str) -> None:
    bicycle = load_bicycle(name)
    times = np.array([0.0, 0.01, 0.013, 0.5, 2.0])
    initial, torque = np.array([0.1, 0.0, 0.5, -0.3]), np.array([0.2, -0.1, 0.3, 0.0, 0.7])
    system = varying_system(bicycle, times, np.full(5, 4.2))
    constant = linear_system(bicycle, 4.2)
    # `response` holds its first torque until the first time, which is the start here: shift by one.
    expected = response(constant, initial, times, torque)
    found = varying_response(system, initial, torque)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(
        varying_yaw_rate(system, found), yaw_rate(constant, expected), rtol=1e-10, atol=1e-11
    )


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.quick_for(name=KINDS)
def test_any_speed_is_integrated_to_1e_9(name: str) -> None:
    bicycle = load_bicycle(name)
    times = np.array([0.0, 0.03, 0.5, 0.51, 1.2, 2.0])
    speeds = np.array([3.0, 3.05, 2.2, 2.2, 3.6, 3.2])
    initial = np.eye(4)
    resistance: Resistance = "rear_brake"
    found = varying_response(varying_system(bicycle, times, speeds, resistance), initial)
    state = initial.ravel()
    for k, slope in enumerate(np.diff(speeds) / np.diff(times)):

        def change(time: float, x: Array, k: int = k, slope: float = slope) -> Array:
            speed = np.array([speeds[k] + slope * (time - times[k])])
            a = state_matrices(bicycle, speed, np.array([slope]), resistance)[0]
            return (a @ x.reshape(4, 4)).ravel()

        state = solve_ivp(
            change, times[k : k + 2], state, method="DOP853", rtol=1e-12, atol=1e-14, max_step=0.02
        ).y[:, -1]
        scale = np.abs(found).max(axis=(0, 2))[:, None]
        np.testing.assert_allclose(found[k + 1] / scale, state.reshape(4, 4) / scale, atol=1e-9)


def test_a_held_torque_does_to_a_slowing_bicycle_what_the_nonlinear_one_feels() -> None:
    bicycle, times = load_bicycle("benchmark"), np.linspace(0.0, 1.0, 21)
    torque = 1e-3 * np.sin(5.0 * times)
    load = resistance_load(whipple_parameters(bicycle), -1.0, "front_brake")
    # The nonlinear response holds each torque until the next time, the first from time zero on, as here.
    exact = nonlinear_response(bicycle, np.array([0.0, 0.0, 0.0, 0.0, 5.0]), times, load, torque, 1e-13)
    system = varying_system(bicycle, times, 5.0 - times, "front_brake")
    states = varying_response(system, np.zeros(4), torque)
    np.testing.assert_allclose(exact.states[:, :4], states, atol=1e-5 * np.abs(states).max())


def test_steer_elements_act_at_a_changing_speed() -> None:
    bicycle = load_bicycle("benchmark")
    sprung = replace(bicycle, steer_elements=replace(bicycle.steer_elements, steer_damper=3.0, lean_gain=2.0))
    plain, with_them = (
        state_matrices(b, np.array([4.0]), np.array([-1.0]))[0, 2:] for b in (bicycle, sprung)
    )
    added = np.linalg.solve(bicycle.mass, [[0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, -3.0]])
    np.testing.assert_allclose(with_them - plain, added, atol=1e-9)


@pytest.mark.parametrize("name", ROLLING)
@pytest.mark.parametrize("acceleration", [-1.0, -0.2, 0.4])
@pytest.mark.parametrize("resistance", ["rolling", "normal_ahead"])
def test_the_grounds_resistance_divides_as_the_nonlinear_contact_forces_do(
    name: str, acceleration: float, resistance: Resistance
) -> None:
    p = whipple_parameters(load_bicycle(name))
    load = resistance_load(p, acceleration, resistance)
    up, aside = motion(p, np.array([0.0, 0.0, 0.0, 0.0, 3.0]), load).front_contact_force
    weight = p.gravity * (p.rear_wheel_mass + p.rear_frame_mass + p.front_frame_mass + p.front_wheel_mass)
    front, rear = load.front_rolling + load.front_ahead, load.rear_rolling + load.rear_ahead
    assert front / (front + rear) == pytest.approx(up / weight)
    assert front + rear == pytest.approx(-effective_mass(p) * acceleration)
    assert aside == pytest.approx(0.0, abs=1e-9)


def test_terms_add_up_in_order_of_acceleration() -> None:
    p = whipple_parameters(load_bicycle("tms_table_8_1"))
    one, two = acceleration_stiffness(p, np.array([-1.0, -2.0]), "rear_brake")
    np.testing.assert_allclose(two, 2.0 * one, rtol=1e-12)
    np.testing.assert_array_equal(one, acceleration_stiffness(p, -1.0, "rear_brake"))
    np.testing.assert_array_equal(acceleration_stiffness(p, 0.0), np.zeros((2, 2)))


@pytest.mark.parametrize("name", BY_MATRICES)
def test_a_bicycle_by_matrices_takes_the_terms_of_its_stand_in(name: str) -> None:
    bicycle = load_bicycle(name)
    parameters, source = parameters_under_acceleration(bicycle)
    assert source == STAND_INS[name]
    assert parameters == load_bicycle(source).parameters
    slowing, steady = (state_matrices(bicycle, np.array([3.6]), np.array([a]))[0] for a in (-0.5, 0.0))
    expected = -np.linalg.solve(bicycle.mass, acceleration_stiffness(parameters, -0.5))
    np.testing.assert_allclose((slowing - steady)[2:, :2], expected, rtol=1e-9, atol=1e-9)
    # It is the same bicycle to the digits that its tables print.
    assert parameters.wheelbase == pytest.approx(bicycle.wheelbase, rel=1e-3)


def test_matrices_without_a_stand_in_are_refused_only_when_the_speed_changes() -> None:
    unknown = replace(load_bicycle(BY_MATRICES[0]), name="somebody's")
    times = np.array([0.0, 1.0])
    varying_system(unknown, times, np.array([3.0, 3.0]))
    with pytest.raises(ParameterError, match="somebody's: expected masses and geometry"):
        varying_system(unknown, times, np.array([3.0, 2.9]))


def refusals() -> dict[str, tuple[Bicycle, list[float], list[float], str, str]]:
    bicycle, tipping = load_bicycle("benchmark"), load_bicycle(TIPS_FORWARD)
    return {
        "stops": (bicycle, [0.0, 1.0, 2.0], [1.0, 0.5, -0.1], "rolling", "found -0.1 at 2 s"),
        "not a number": (bicycle, [0.0, 1.0], [1.0, np.nan], "rolling", "found nan at 1 s"),
        "times descend": (bicycle, [0.0, 0.0], [1.0, 1.0], "rolling", "ascending"),
        "one time": (bicycle, [0.0], [1.0], "rolling", "two or more"),
        "shapes": (bicycle, [0.0, 1.0], [1.0, 1.0, 1.0], "rolling", r"shapes \(2,\) and \(3,\)"),
        "resistance": (
            bicycle,
            [0.0, 1.0],
            [2.0, 1.0],
            "parachute",
            "one of rolling, normal_ahead, rear_brake",
        ),
        "lifts off": (tipping, [0.0, 1.0], [2.0, 1.0], "rolling", "both wheels to carry weight"),
    }


@pytest.mark.parametrize("case", refusals())
def test_bad_input_is_refused_with_a_reason(case: str) -> None:
    bicycle, times, speeds, resistance, message = refusals()[case]
    with pytest.raises(ParameterError, match=message):
        varying_system(bicycle, np.array(times), np.array(speeds), resistance)  # type: ignore[arg-type]


def test_the_skate_of_table_7_1_tips_forward() -> None:
    assert TIPS_FORWARD not in ROLLING


def test_a_skate_that_tips_forward_may_still_roll_at_constant_speed() -> None:
    p = whipple_parameters(load_bicycle(TIPS_FORWARD))
    np.testing.assert_array_equal(acceleration_stiffness(p, 0.0), np.zeros((2, 2)))


def test_rolling_resistance_slows_what_spins_less() -> None:
    # By hand: m_eff v' = -C_r m g. Without spin of the wheels m_eff is m; the benchmark's wheels have
    # I/r^2 = 0.12/0.3^2 + 0.28/0.35^2 = 3.619 kg beside 94 kg.
    assert coasting_loss(load_bicycle("tms_unrounded_8_1")) == load_bicycle("tms_unrounded_8_1").gravity
    benchmark = load_bicycle("benchmark")
    assert coasting_loss(benchmark) == pytest.approx(benchmark.gravity * 94.0 / 97.619047619, rel=1e-9)
