"""Claims about the nonlinear bicycle that need no second model: mechanics, symmetry, linear limit."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import root
from tms_model import Bicycle, ParameterError, assemble, bicycle_names, load_bicycle, stability
from tms_model.acceleration import effective_mass
from tms_model.imu import RearFrameMotion, ideal_imu
from tms_model.nonlinear import Load, generalised_force, motion, sensor, whipple_parameters
from tms_model.nonlinear_response import (
    NONLINEAR_STATE,
    OK,
    SPEED,
    YAW,
    moving,
    nonlinear_response,
    rates,
)
from tms_model.rolling import touching_pitch

KINDS = ("benchmark", "tms_table_8_1", "tms_eq_10_1", "counterexample_7_rear_steering")

Array = NDArray[np.float64]


def known(name: str) -> bool:
    """Whether the bicycle has every parameter; inertias about y may be missing, or all (matrices only)."""
    parameters = load_bicycle(name).parameters
    return parameters is not None and not np.isnan(astuple(parameters)).any()


KNOWN = [name for name in bicycle_names() if known(name)]
NOT_KNOWN = [name for name in bicycle_names() if not known(name)]
LEANING = np.array([0.3, -0.2, 0.4, 0.6, 4.0])  # lean, steer, lean rate, steer rate, speed


@pytest.fixture(params=KNOWN)
def bicycle(request: pytest.FixtureRequest) -> Bicycle:
    return load_bicycle(request.param)


def derivative(function, at: float, step: float = 1e-3) -> Array:  # type: ignore[no-untyped-def]
    """Central difference of sixth order."""
    weights = {1: 45.0, 2: -9.0, 3: 1.0}
    terms = [w * (function(at + k * step) - function(at - k * step)) for k, w in weights.items()]
    return sum(terms) / (60.0 * step)  # type: ignore[return-value]


def jacobian(bicycle: Bicycle, speed: float, load: Load | None = None) -> Array:
    """(2, 4): lean and steer acceleration by lean, steer, lean rate, steer rate, about upright."""
    columns = []
    for index in range(4):
        direction = np.eye(5)[index]

        def accelerations(size: float, direction: Array = direction) -> Array:
            state = size * direction
            state[SPEED] = speed
            return moving(bicycle, state, load).accelerations[:2]

        columns.append(derivative(accelerations, 0.0, 2e-3))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("speed", [0.7, 3.6, 8.0])
def test_linearised_it_is_the_linear_bicycle(bicycle: Bicycle, speed: float) -> None:
    # Independent of the assembler of Meijaard et al.'s appendix A, and so a check of it, wheel by wheel.
    found = jacobian(bicycle, speed)
    expected = -np.linalg.solve(
        bicycle.mass, np.hstack([bicycle.stiffness_at(speed), bicycle.damping_at(speed)])
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_a_steer_torque_starts_the_linear_accelerations(bicycle: Bicycle) -> None:
    upright = np.array([0.0, 0.0, 0.0, 0.0, 3.0])
    found = motion(whipple_parameters(bicycle), upright, Load(lean_torque=0.3, steer_torque=-0.1))
    expected = np.linalg.solve(bicycle.mass, [0.3, -0.1])
    # The rear-steered bicycle's heavy front assembly hardly moves with the steering: M loses three digits.
    np.testing.assert_allclose(found.accelerations[:2], expected, rtol=1e-11)


@pytest.mark.quick_for(bicycle=KINDS)
def test_energy_is_conserved_over_seconds_of_wide_motion(bicycle: Bicycle) -> None:
    initial = np.array([0.05, 0.1, 0.2, 0.0, 4.0])
    bare = replace(bicycle, steer_elements=type(bicycle.steer_elements)())
    found = nonlinear_response(bare, initial, np.linspace(0.0, 3.0, 31))
    kept = found.states[~np.isnan(found.states[:, 0])]
    energies = [motion(whipple_parameters(bare), state[:5]) for state in kept]
    total = np.array([m.kinetic_energy + m.potential_energy for m in energies])
    assert len(kept) > 10
    assert np.ptp(kept[:, SPEED]) > 1e-3  # lean and steer do exchange energy with the forward motion
    np.testing.assert_allclose(total, total[0], rtol=1e-8)


@pytest.mark.parametrize("field", list(Load.__dataclass_fields__))
def test_power_of_each_load_is_the_change_of_energy(field: str) -> None:
    p = whipple_parameters(load_bicycle("benchmark"))
    load = Load(**{field: 3.0})
    now = motion(p, LEANING, load)

    def energy(time: float) -> Array:
        state = LEANING.copy()
        state[:2] += time * LEANING[2:4] + 0.5 * time**2 * now.accelerations[:2]
        state[2:5] += time * now.accelerations[:3]
        at = motion(p, state, load)
        return np.array(at.kinetic_energy + at.potential_energy)

    power = generalised_force(p, now.posture, load) @ now.rates
    assert power == pytest.approx(float(derivative(energy, 0.0)), rel=1e-7)


def test_left_and_right_are_alike(bicycle: Bicycle) -> None:
    p = whipple_parameters(bicycle)
    mirror = np.array([-1.0, -1.0, -1.0, -1.0, 1.0])
    here, there = motion(p, LEANING), motion(p, mirror * LEANING)
    signs = np.array([-1.0, -1.0, 1.0, -1.0, 1.0])  # of lean, steer, speed, yaw, pitch
    np.testing.assert_allclose(there.accelerations, signs * here.accelerations, rtol=1e-12, atol=1e-12)
    assert there.pitch == pytest.approx(here.pitch, abs=1e-14)


def test_wheels_touch_and_roll_without_slip(bicycle: Bicycle) -> None:
    p = whipple_parameters(bicycle)
    now = motion(p, LEANING)
    contact = now.posture.front_contact @ now.rates
    assert contact[2] == pytest.approx(0.0, abs=1e-12)
    assert now.posture.front_side @ contact == pytest.approx(0.0, abs=1e-12)

    def pitch(time: float) -> Array:
        return np.array(touching_pitch(p, *(LEANING[:2] + time * LEANING[2:4])))

    assert float(derivative(pitch, 0.0)) == pytest.approx(now.rates[4], abs=1e-9)


def rear_frame_axes(bicycle: Bicycle, state: Array) -> Array:
    """Columns in the world (3, 3): yaw, then lean, then pitch; written out here, not taken from the model."""
    yaw, lean, pitch = state[YAW], state[0], touching_pitch(whipple_parameters(bicycle), state[0], state[1])
    cos, sin = np.cos([yaw, lean, pitch]), np.sin([yaw, lean, pitch])
    yawed = np.array([[cos[0], -sin[0], 0.0], [sin[0], cos[0], 0.0], [0.0, 0.0, 1.0]])
    leaned = np.array([[1.0, 0.0, 0.0], [0.0, cos[1], -sin[1]], [0.0, sin[1], cos[1]]])
    pitched = np.array([[cos[2], 0.0, sin[2]], [0.0, 1.0, 0.0], [-sin[2], 0.0, cos[2]]])
    return yawed @ leaned @ pitched


def sensor_position(bicycle: Bicycle, state: Array, position: Array) -> Array:
    """Place in the world (3,): from the rear contact up the leaning wheel to its axle, then by the frame."""
    axle = np.array([0.0, 0.0, -whipple_parameters(bicycle).rear_wheel_radius])
    across = -axle[2] * np.sin(state[0])  # the axle stands beside the contact, on the side of the lean
    centre = np.array([-np.sin(state[YAW]) * across, np.cos(state[YAW]) * across, axle[2] * np.cos(state[0])])
    contact = np.array([state[6], state[7], 0.0])
    return contact + centre + rear_frame_axes(bicycle, state) @ (position - axle)


def test_specific_force_is_the_second_derivative_of_the_sensors_path(bicycle: Bicycle) -> None:
    position, step = np.array([0.2, 0.05, -0.6]), 0.004
    start = np.array([0.1, 0.05, 0.5, -0.3, 4.0, 0.7, 1.0, 2.0])
    found = nonlinear_response(bicycle, start, np.arange(9) * step, tolerance=1e-13)
    assert found.status == OK
    path = np.array([sensor_position(bicycle, state, position) for state in found.states])
    second = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
    in_the_world = second @ path / step**2 - [0.0, 0.0, bicycle.gravity]
    now = moving(bicycle, found.states[4])
    rate, force = sensor(whipple_parameters(bicycle), now, position)
    axes = rear_frame_axes(bicycle, found.states[4])
    np.testing.assert_allclose(axes @ force, in_the_world, atol=5e-7)
    # The axes turn with the angular velocity that the gyroscopes feel.
    first = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280]) / step
    turned = np.einsum("t,tij->ij", first, [rear_frame_axes(bicycle, state) for state in found.states])
    spin = axes.T @ turned
    np.testing.assert_allclose(rate, [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-8)


def test_the_linear_imu_is_the_limit_of_the_exact_one() -> None:
    # It leaves out pitch and what is of second order: at a tenth of the motion the error is a hundredth.
    bicycle, position = load_bicycle("tms_table_8_1"), np.array([0.3, 0.0, -0.5])
    errors = []
    for size in (0.02, 0.002):
        state = np.array([size, -0.5 * size, 2.0 * size, size, 3.0])
        now = moving(bicycle, state)
        exact = np.concatenate(sensor(whipple_parameters(bicycle), now, position))
        fields = [now.lean, now.rates[0], now.accelerations[0], now.rates[3], now.accelerations[3]]
        fields += [now.rates[2], now.accelerations[2]]
        linear = RearFrameMotion(*(np.array([value]) for value in fields))
        ideal = np.concatenate([part[0] for part in ideal_imu(linear, position, bicycle.gravity)])
        errors.append(np.abs(exact - ideal).max())
    assert errors[1] < 0.011 * errors[0]


def test_circular_motions_begin_at_the_capsize_speed() -> None:
    # Basu-Mandal et al. 2007, abstract: the handlebar-forward family of hands-free circular motions starts
    # from the capsize bifurcation of straight motion. Steady: nothing accelerates, at a small lean.
    bicycle = load_bicycle("benchmark")
    p, speeds = whipple_parameters(bicycle), []
    for lean in (0.02, 0.01):

        def turning(unknown: Array, lean: float = lean) -> Array:
            return motion(p, np.array([lean, unknown[0], 0.0, 0.0, unknown[1]])).accelerations

        steer, speed = root(lambda x: turning(x)[:2], [lean, 6.0], tol=1e-13).x
        assert np.abs(turning(np.array([steer, speed]))).max() < 1e-9
        speeds.append(speed)
    # The speed changes with the square of the lean: Richardson's step to lean zero.
    assert (4.0 * speeds[1] - speeds[0]) / 3.0 == pytest.approx(6.02426201538837, abs=1e-5)
    assert stability(bicycle).capsize_speed == pytest.approx(6.02426201538837, abs=1e-12)


def test_a_stable_bicycle_comes_back_upright_and_goes_faster_than_it_started() -> None:
    # The energy of the first lean rate ends up in forward speed: Meijaard et al. 2007, figure 4, 4.6 m/s and
    # 0.5 rad/s.
    bicycle = load_bicycle("benchmark")
    found = nonlinear_response(bicycle, np.array([0.0, 0.0, 0.5, 0.0, 4.6]), np.linspace(0.0, 12.0, 13))
    assert found.status == OK
    assert np.abs(found.states[-1, :4]).max() < 0.01
    p = whipple_parameters(bicycle)
    before = motion(p, found.states[0, :5])
    gained = 0.5 * effective_mass(p) * (found.states[-1, SPEED] ** 2 - 4.6**2)
    assert gained == pytest.approx(before.kinetic_energy - 0.5 * effective_mass(p) * 4.6**2, rel=0.01)
    assert before.kinetic_energy - 0.5 * effective_mass(p) * 4.6**2 == pytest.approx(
        0.5 * bicycle.mass[0, 0] * 0.5**2, rel=1e-9
    )


def test_a_held_steer_torque_acts_between_the_samples() -> None:
    bicycle = load_bicycle("benchmark")
    times = np.array([0.0, 0.1, 0.2])
    start = np.array([0.0, 0.0, 0.0, 0.0, 5.0])
    stepped = nonlinear_response(bicycle, start, times, steer_torque=np.array([1.0, -2.0, 7.0]))
    first = nonlinear_response(bicycle, start, times[:2], Load(steer_torque=1.0))
    second = nonlinear_response(bicycle, first.states[-1], times[:2], Load(steer_torque=-2.0))
    np.testing.assert_allclose(stepped.states[1], first.states[1], atol=1e-9)
    np.testing.assert_allclose(stepped.states[2], second.states[1], atol=1e-9)


def test_a_falling_bicycle_ends_with_a_status() -> None:
    found = nonlinear_response(
        load_bicycle("benchmark"), np.array([0.0, 0.0, 0.5, 0.0, 1.0]), np.linspace(0.0, 3.0, 31)
    )
    assert found.status == "fallen"
    assert np.isnan(found.states[-1]).all()
    assert np.isfinite(found.states[5]).all()


def test_a_braked_bicycle_rolls_to_a_stop() -> None:
    p = whipple_parameters(load_bicycle("benchmark"))
    load = Load(rear_rolling=effective_mass(p))
    start = np.array([0.0, 0.0, 0.0, 0.0, 0.5])
    found = nonlinear_response(load_bicycle("benchmark"), start, np.linspace(0.0, 1.0, 11), load)
    assert found.status == "stopped"
    np.testing.assert_allclose(found.states[:4, SPEED], [0.5, 0.4, 0.3, 0.2], atol=1e-12)


def test_steer_elements_act_on_the_nonlinear_bicycle_as_on_the_linear_one() -> None:
    plain = load_bicycle("benchmark")
    elements = replace(
        plain.steer_elements, steer_spring=-10.0, steer_damper=2.0, lean_gain=5.0, lean_rate_gain=-3.0
    )
    sprung = replace(plain, steer_elements=elements)
    expected = -np.linalg.solve(sprung.mass, np.hstack([sprung.stiffness_at(5.0), sprung.damping_at(5.0)]))
    np.testing.assert_allclose(jacobian(sprung, 5.0), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", NOT_KNOWN)
def test_a_bicycle_without_all_parameters_is_refused(name: str) -> None:
    with pytest.raises(ParameterError, match=f"bicycle {name}: expected .* for the nonlinear equations"):
        nonlinear_response(load_bicycle(name), LEANING, np.array([0.0, 1.0]))


def test_a_posture_that_cannot_touch_the_ground_is_refused() -> None:
    p = whipple_parameters(load_bicycle("benchmark"))
    long_trail = assemble("long", replace(p, trail=1.5))
    with pytest.raises(ParameterError, match="both wheels can touch"):
        nonlinear_response(long_trail, np.array([1.5, 1.5, 0.0, 0.0, 1.0]), np.array([0.0, 1.0]))


def test_the_state_rates_are_those_of_its_names() -> None:
    found = rates(load_bicycle("benchmark"), np.array([0.0, 0.0, 0.1, 0.2, 3.0, np.pi / 2, 0.0, 0.0]), Load())
    by_name = dict(zip(NONLINEAR_STATE, found, strict=True))
    assert by_name["lean"] == 0.1
    assert by_name["steer"] == 0.2
    assert by_name["x"] == pytest.approx(0.0, abs=1e-15)
    assert by_name["y"] == pytest.approx(3.0)
