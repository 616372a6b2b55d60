"""SOM chapter 5 and what chapters 1 and 5 say in words: steady turns, capsize, countersteering."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from tms_model import (
    Boundary,
    ParameterError,
    WhippleParameters,
    assemble,
    bicycle_names,
    boundaries,
    eigenvalues,
    linear_system,
    load_bicycle,
    response,
    stability,
)
from tms_model.characteristic import coefficients
from tms_model.response import LEAN, LEAN_RATE, STEER, STEER_RATE, state_matrix
from tms_model.supplement.steady_turn import (
    capsize_terms,
    necessary_conditions,
    steady_turn,
    steer_acceleration_per_torque,
    tilt_without_capsize,
    tilted,
)
from tms_model.supplement.torque_step import torque_step

DATA = Path(__file__).parents[1] / "data"
PUBLISHED = yaml.safe_load((DATA / "steady_turn.yaml").read_text())
BENCHMARK = yaml.safe_load((DATA / "benchmark.yaml").read_text())
ASSEMBLED = [
    name
    for name in bicycle_names()
    if load_bicycle(name).parameters is not None and not load_bicycle(name).steer_elements.present
]


def parameters(name: str) -> WhippleParameters:
    found = load_bicycle(name).parameters
    assert found is not None
    return found


@pytest.mark.parametrize("name", ASSEMBLED)
def test_closed_form_of_e0_and_e2(name: str) -> None:
    # (5.8), from the parameters, is det(g K0 + v^2 K2) of the assembled matrices (5.3).
    terms, general = capsize_terms(parameters(name)), coefficients(load_bicycle(name))
    g = load_bicycle(name).gravity
    size = g**2 * terms.static_moment**2 + abs(g**2 * terms.static_moment * terms.total_moment)
    assert terms.e0 == pytest.approx(general["E0"], rel=1e-12, abs=1e-13 * size)
    assert terms.e2 == pytest.approx(general["E2"], rel=1e-11, abs=1e-14 * size)
    capsizes = [b.speed for b in _e_boundaries(name)]
    if terms.capsize_speed is None:
        assert not capsizes
    else:
        assert capsizes == [pytest.approx(terms.capsize_speed, rel=1e-11)]


def _e_boundaries(name: str) -> list[Boundary]:
    return [b for b in boundaries(load_bicycle(name)) if b.condition == "E"]


def test_capsize_speed_of_the_benchmark() -> None:
    # (5.10) to the published digits; there the steady turn needs no torque.
    speed = capsize_terms(parameters("benchmark")).capsize_speed
    assert speed == pytest.approx(BENCHMARK["capsize_speed"], rel=1e-12)
    turn = steady_turn(load_bicycle("benchmark"), BENCHMARK["capsize_speed"])
    assert abs(turn.torque_per_steer) < 1e-11


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.parametrize("speed", [1.0, 3.6, 7.0, 20.0])
def test_torque_of_a_steady_turn(name: str, speed: float) -> None:
    # (5.2): E / (g m_T z_T); and the lean and steer that a constant torque holds come from (5.1).
    bicycle = load_bicycle(name)
    turn = steady_turn(bicycle, speed)
    stiffness = bicycle.stiffness_at(speed)
    expected = np.linalg.det(stiffness) / stiffness[0, 0]
    size = abs(stiffness[1, 1]) + abs(stiffness[0, 1] * stiffness[1, 0] / stiffness[0, 0])
    assert turn.torque_per_steer == pytest.approx(expected, abs=1e-12 * size)
    held = np.array([turn.lean_per_steer, 1.0, 0.0, 0.0])
    command = turn.torque_per_steer / bicycle.steer_elements.steer_torque_gain  # of which so much arrives
    acceleration = state_matrix(bicycle, speed) @ held + linear_system(bicycle, speed).b * command
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-8 * np.abs(state_matrix(bicycle, speed)).max())


@pytest.mark.parametrize("name", bicycle_names())
def test_a_self_stable_bicycle_is_held_back_in_a_turn(name: str) -> None:
    # (5.4): self-stability implies a torque that opposes the steer angle.
    bicycle = load_bicycle(name)
    for low, high in stability(bicycle).stable_speed_ranges:
        for speed in np.linspace(low, min(high, low + 20.0), 7)[1:-1]:
            assert steady_turn(bicycle, float(speed)).torque_per_steer < 0.0


@pytest.mark.parametrize("name", bicycle_names())
def test_necessary_conditions_are_equivalent_but_for_the_second(name: str) -> None:
    bicycle = load_bicycle(name)
    for speed in (0.5, 2.0, 4.0, 5.5, 8.0, 15.0, 40.0):
        found = necessary_conditions(bicycle, speed)
        assert found.polynomial == found.determinant == found.steady_turn == found.release
        # The second follows from them while the trace of K is negative, and implies them always.
        if np.trace(bicycle.stiffness_at(speed)) < 0.0:
            assert found.stiffness_eigenvalues == found.determinant
        assert found.determinant or not found.stiffness_eigenvalues


def test_a_stable_bicycle_whose_stiffness_has_positive_eigenvalues() -> None:
    # SOM section 5.1 calls its second condition necessary. Table 7.1 at 40 m/s: K2's 1 kg * u_H 0.0374 m *
    # cos(5 deg) * 1600 = 59 N m is more than the 4.2 kg m * 9.81 = 41 N m of gravity, det(K) = E_0 = 1.18 > 0
    # as at any speed: two positive eigenvalues, and stable all the same.
    bicycle = load_bicycle("tms_table_7_1")
    assert (eigenvalues(bicycle, 40.0).real < 0.0).all()
    found = necessary_conditions(bicycle, 40.0)
    assert found.determinant
    assert not found.stiffness_eigenvalues
    assert (np.linalg.eigvals(bicycle.stiffness_at(40.0)).real > 0.0).all()


def test_regions_of_figure_5_2() -> None:
    # One bicycle in each quadrant: the benchmark; its wheels turned backward; trail negative, which makes the
    # potential energy a saddle, with either spin.
    p = parameters("benchmark")
    saddle = replace(p, trail=-0.05)

    def backward(q: WhippleParameters) -> WhippleParameters:
        return replace(
            q,
            rear_wheel_inertia_yy=-q.rear_wheel_inertia_yy,
            front_wheel_inertia_yy=-q.front_wheel_inertia_yy,
        )

    regions = [capsize_terms(q).region for q in (p, backward(p), backward(saddle), saddle)]
    assert regions == ["below the capsize speed", "at all speeds", "above the capsize speed", "never"]
    for q in (p, backward(p), backward(saddle), saddle):
        terms, bicycle = capsize_terms(q), assemble("quadrant", q)
        for speed in (0.2, 3.0, 9.0, 50.0):
            e = np.linalg.det(bicycle.stiffness_at(speed))
            limit = terms.capsize_speed or 0.0
            possible = {
                "below the capsize speed": speed < limit,
                "at all speeds": True,
                "above the capsize speed": speed > limit,
                "never": False,
            }[terms.region]
            assert (e > 0.0) == possible


def test_vertical_steer_axis_has_a_saddle() -> None:
    # 'E_0 cannot be positive if the tilt is zero because then E_0 = -(g S_A)^2'.
    terms = capsize_terms(replace(parameters("benchmark"), steer_axis_tilt=0.0))
    assert terms.e0 == pytest.approx(-((9.81 * terms.static_moment) ** 2), rel=1e-12)


def test_tilt_at_which_capsize_goes_away() -> None:
    # With all else kept, 1.694 degrees and not the printed 2.6; with the front frame's mass turning with the
    # steer axis, as a fork does, 2.63.
    p = parameters("benchmark")
    kept, turned = tilt_without_capsize(p), tilt_without_capsize(p, turn_front_frame=True)
    assert math.degrees(kept) == pytest.approx(PUBLISHED["tilt_without_capsize_computed_deg"], abs=0.5e-3)
    assert round(math.degrees(turned), 1) == PUBLISHED["tilt_without_capsize_deg"]
    for tilt, turn in ((kept, False), (turned, True)):
        q = tilted(p, tilt, turn_front_frame=turn)
        terms = capsize_terms(q)
        # (5.9), and what the text says follows: E_0 = g^2 S_A^2 S_R / S_F.
        ratio = (q.front_spin + q.rear_spin) / q.front_spin
        assert math.sin(tilt) == pytest.approx(-ratio * terms.static_moment / terms.total_moment, rel=1e-9)
        expected = 9.81**2 * terms.static_moment**2 * q.rear_spin / q.front_spin
        assert terms.e0 == pytest.approx(expected, rel=1e-9)
        assert coefficients(assemble("tilted", q))["E2"] == pytest.approx(0.0, abs=1e-9)


def test_front_frame_turns_with_its_axis() -> None:
    p = parameters("benchmark")
    q = tilted(p, math.radians(3.0), turn_front_frame=True)
    # Distances from the front contact, along and across the steer axis, are those of before.
    for a, b in zip(_along_and_across(p), _along_and_across(q), strict=True):
        assert a == pytest.approx(b, rel=1e-12)
    assert tilted(p, 0.1).front_frame_x == p.front_frame_x


def _along_and_across(p: WhippleParameters) -> tuple[float, float]:
    cos, sin = math.cos(p.steer_axis_tilt), math.sin(p.steer_axis_tilt)
    x, z = p.front_frame_x - p.wheelbase, p.front_frame_z
    return x * sin + z * cos, x * cos - z * sin


def test_no_tilt_without_spin() -> None:
    with pytest.raises(ParameterError, match="steer_axis_tilt: expected a tilt at which E_2 vanishes"):
        tilt_without_capsize(parameters("tms_table_7_1"))


def test_figure_5_1() -> None:
    published = PUBLISHED["figure_5_1"]
    bicycle, times = load_bicycle("benchmark"), np.linspace(0.0, 30.0, 3001)
    step = torque_step(bicycle, published["speed"], published["steer_torque"], times)
    # Torque to the left; the handlebars go left, then the bicycle turns right, 2 cm of track to the left.
    assert round(step.countersteer_dip, 2) == published["countersteer_dip"]
    early = step.steer[(times > 0.0) & (times < 0.1)]
    assert (early < 0.0).all()
    assert step.steer[-1] > 0.0
    assert step.lean[-1] > 0.0
    # The end is the steady turn of (5.2).
    turn = steady_turn(bicycle, published["speed"])
    assert step.steer[-1] == pytest.approx(published["steer_torque"] / turn.torque_per_steer, rel=1e-3)
    assert step.lean[-1] == pytest.approx(turn.lean_per_steer * step.steer[-1], rel=1e-3)
    settled = step.lean[times >= published["settled"]]
    assert (settled > 0.97 * step.lean[-1]).all()


def test_tracks_in_a_steady_circle() -> None:
    # Long after the step the rear contact runs on a circle of radius v / yaw rate; the front one is w ahead.
    bicycle = load_bicycle("benchmark")
    times = np.linspace(0.0, 90.0, 9001)
    step = torque_step(bicycle, 5.0, -0.05, times)
    turn = steady_turn(bicycle, 5.0)
    radius = 5.0 / (turn.yaw_rate_per_steer * step.steer[-1])
    late = step.rear_contact[times > 60.0]
    centre = late[-1] + radius * np.array([-math.sin(step.heading[-1]), math.cos(step.heading[-1])])
    np.testing.assert_allclose(np.hypot(*(late - centre).T), radius, rtol=1e-5)
    gap = np.hypot(*(step.front_contact - step.rear_contact).T)
    np.testing.assert_allclose(gap, np.hypot(1.02, 0.08 * math.cos(math.pi / 10) * step.steer), rtol=1e-12)
    distance = np.hypot(*np.diff(step.rear_contact, axis=0).T).sum()
    assert distance == pytest.approx(5.0 * 90.0, rel=1e-6)


@pytest.mark.parametrize("times", [[0.0], [0.1, 0.2], [0.0, 0.2, 0.1]])
def test_times_of_a_step_begin_at_zero(times: list[float]) -> None:
    with pytest.raises(ParameterError, match="times: expected two or more in ascending order"):
        torque_step(load_bicycle("benchmark"), 5.0, -0.1, np.array(times))


@pytest.mark.parametrize("name", bicycle_names())
def test_first_motion_after_a_torque_step(name: str) -> None:
    # (5.6): steer goes where the torque pushes, with I_Txx / det M; lean the other way if M_lean_steer > 0.
    bicycle = load_bicycle(name)
    per_torque = steer_acceleration_per_torque(bicycle)
    assert per_torque > 0.0
    system = linear_system(bicycle, 3.6)
    command = 1.0 / bicycle.steer_elements.steer_torque_gain  # of which 1 N m arrives
    assert system.b[STEER_RATE] * command == pytest.approx(per_torque, rel=1e-10)
    after = response(system, np.zeros(4), np.array([1e-6]), np.array([command]))[0]
    assert after[STEER_RATE] == pytest.approx(per_torque * 1e-6, rel=1e-3)


@pytest.mark.parametrize("name", bicycle_names())
def test_released_from_a_steady_turn_it_turns_more(name: str) -> None:
    # 'If steer control is suddenly removed from a state of steady turning, the first motion is to turn more'.
    bicycle = load_bicycle(name)
    for low, high in stability(bicycle).stable_speed_ranges:
        speed = 0.5 * (low + min(high, low + 4.0))
        turn = steady_turn(bicycle, speed)
        held = np.array([turn.lean_per_steer, 1.0, 0.0, 0.0])
        system = linear_system(bicycle, speed)
        soon = response(system, held, np.array([1e-4]))[0]
        assert soon[STEER] > held[STEER]
        slowest = -1.0 / eigenvalues(bicycle, speed).real.max()
        late = response(system, held, np.array([20.0 * slowest]))[0]
        assert np.abs(late[:2]).max() < 1e-3 * np.abs(held).max()  # and then it returns


@pytest.mark.parametrize("name", bicycle_names())
def test_with_locked_steering_it_falls_at_any_speed_alike(name: str) -> None:
    # SOM chapter 1: 'a bicycle with locked steering falls over when moving forward exactly as it does when
    # not rolling'. Lean alone: M_lean_lean lean'' = -g K0_lean_lean lean, no speed in it.
    bicycle = load_bicycle(name)
    expected = math.sqrt(-bicycle.gravity * bicycle.stiffness0[0, 0] / bicycle.mass[0, 0])
    for speed in (0.0, 2.0, 9.0):
        damping, stiffness = bicycle.damping_at(speed)[0, 0], bicycle.stiffness_at(speed)[0, 0]
        locked = np.roots([bicycle.mass[0, 0], damping, stiffness])
        np.testing.assert_allclose(np.sort(locked), [-expected, expected], rtol=1e-12)
        # The same by a steer spring that yields less and less: two of the four eigenvalues become these.
        stiff = replace(bicycle, steer_elements=replace(bicycle.steer_elements, steer_spring=1e9))
        slow = np.sort(np.abs(eigenvalues(stiff, speed)))[:2]
        np.testing.assert_allclose(slow, expected, rtol=1e-3)


def test_locked_steering_in_time() -> None:
    # The lean of a locked bicycle grows like cosh, whatever the speed.
    stiff = load_bicycle("benchmark")
    stiff = replace(stiff, steer_elements=replace(stiff.steer_elements, steer_spring=1e10))
    lean = [
        response(linear_system(stiff, speed), np.array([0.01, 0.0, 0.0, 0.0]), np.array([0.5]))[0]
        for speed in (0.5, 9.0)
    ]
    rate = math.sqrt(9.81 * 80.95 / 80.81722)
    for state in lean:
        assert state[LEAN] == pytest.approx(0.01 * math.cosh(0.5 * rate), rel=1e-5)
        assert state[LEAN_RATE] == pytest.approx(0.01 * rate * math.sinh(0.5 * rate), rel=1e-4)
