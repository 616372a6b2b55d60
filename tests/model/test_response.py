"""Motion in time: exact transitions against an integrator, identities, feedback and known torque."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from tms_model import (
    LinearSystem,
    ParameterError,
    bicycle_names,
    discretise,
    linear_system,
    load_bicycle,
    response,
    yaw_rate,
)
from tms_model.response import LEAN_RATE, with_heading

SPEED = 3.6
STRUCK = np.array([0.02, -0.01, 0.5, 0.3])


def integrated(system: LinearSystem, initial: np.ndarray, duration: float, torque: float = 0.0) -> np.ndarray:
    """State after `duration`, by a Runge-Kutta integrator that knows nothing of matrix exponentials."""

    def change(_: float, state: np.ndarray) -> np.ndarray:
        return system.a @ state + system.b * torque

    end = solve_ivp(change, (0.0, duration), initial, method="DOP853", rtol=1e-12, atol=1e-14)
    return np.asarray(end.y[:, -1])


@pytest.mark.parametrize("name", bicycle_names())
def test_transition_is_what_an_integrator_finds(name: str) -> None:
    system = linear_system(load_bicycle(name), SPEED)
    phi, gamma = discretise(system, 0.37)
    np.testing.assert_allclose(phi @ STRUCK + gamma * 1.7, integrated(system, STRUCK, 0.37, 1.7), rtol=1e-8)


@pytest.mark.parametrize("name", bicycle_names())
def test_two_steps_are_one(name: str) -> None:
    system = linear_system(load_bicycle(name), SPEED)
    (phi_a, gamma_a), (phi_b, gamma_b) = discretise(system, 0.013), discretise(system, 0.21)
    phi, gamma = discretise(system, 0.013 + 0.21)
    np.testing.assert_allclose(phi, phi_b @ phi_a, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(gamma, phi_b @ gamma_a + gamma_b, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("name", bicycle_names())
def test_volume_of_states_shrinks_with_the_trace(name: str) -> None:
    # Liouville: det phi(t) = exp(trace(a) t); no step: nothing moves.
    system = linear_system(load_bicycle(name), SPEED)
    phi, _ = discretise(system, 0.05)
    assert np.linalg.det(phi) == pytest.approx(np.exp(np.trace(system.a) * 0.05), rel=1e-10)
    phi, gamma = discretise(system, 0.0)
    np.testing.assert_array_equal(phi, np.eye(4))
    np.testing.assert_array_equal(gamma, 0.0)


@pytest.mark.parametrize("name", bicycle_names())
def test_response_at_irregular_times_under_held_torque(name: str) -> None:
    system = linear_system(load_bicycle(name), SPEED)
    times = np.array([0.0, 0.013, 0.05, 0.051, 0.3, 0.44, 1.0])
    torque = np.array([0.3, -0.2, 0.0, 0.7, 0.1, -0.4, 99.0])  # the last one holds after the last time
    states = response(system, STRUCK, times, torque)
    state = STRUCK
    np.testing.assert_array_equal(states[0], STRUCK)
    for k in range(1, len(times)):
        state = integrated(system, state, times[k] - times[k - 1], torque[k - 1])
        np.testing.assert_allclose(states[k], state, rtol=1e-7, atol=1e-10)


def test_first_torque_holds_from_time_zero() -> None:
    system = linear_system(load_bicycle("tms_eq_10_1"), SPEED)
    states = response(system, np.zeros(4), np.array([0.2, 0.3]), np.array([0.5, 0.0]))
    np.testing.assert_allclose(states[0], integrated(system, np.zeros(4), 0.2, 0.5), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(states[1], integrated(system, states[0], 0.1, 0.5), rtol=1e-9, atol=1e-12)


def test_many_responses_at_once_are_each_alone() -> None:
    system = linear_system(load_bicycle("benchmark"), SPEED)
    times = np.linspace(0.0, 2.0, 57)
    initial = np.random.default_rng(1).standard_normal((4, 5))
    torque = np.sin(times)
    together = response(system, initial, times, torque)
    assert together.shape == (57, 4, 5)
    yaw = yaw_rate(system, together)
    for k in range(5):
        alone = response(system, initial[:, k], times, torque)
        np.testing.assert_allclose(together[:, :, k], alone, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(yaw[:, k], yaw_rate(system, alone), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", bicycle_names())
def test_lean_rate_feedback_is_torque_closed_by_hand(name: str) -> None:
    bicycle, gain = load_bicycle(name), 2.3
    free, fed = linear_system(bicycle, SPEED), linear_system(bicycle, SPEED, gain)
    closed = free.a.copy()
    closed[:, LEAN_RATE] += free.b * gain
    np.testing.assert_allclose(fed.a, closed, rtol=1e-11, atol=1e-11)


def test_feedback_is_the_limit_of_a_fast_controller() -> None:
    # A digital controller holds k * lean rate for a step at a time. Half the step, half the distance to the
    # feedback in the matrix.
    bicycle, gain, start = load_bicycle("delft_sbw"), 7.0, np.array([0.0, 0.0, -0.7, 0.0])
    free, fed = linear_system(bicycle, 3.0), linear_system(bicycle, 3.0, gain)

    def after_a_second(step_count: int) -> np.ndarray:
        phi, gamma = discretise(free, 1.0 / step_count)
        state = start
        for _ in range(step_count):
            state = phi @ state + gamma * (gain * state[LEAN_RATE])
        return state

    limit = response(fed, start, np.array([1.0]))[0]
    coarse, fine = after_a_second(5_000) - limit, after_a_second(10_000) - limit
    assert 1e-4 < np.abs(fine).max() < 2e-3
    np.testing.assert_allclose(coarse, 2.0 * fine, rtol=0.02)


@pytest.mark.parametrize("name", bicycle_names())
def test_heading_is_the_integral_of_the_yaw_rate(name: str) -> None:
    system = linear_system(load_bicycle(name), SPEED)
    times = np.array([0.4, 1.1])
    states = response(with_heading(system), np.append(STRUCK, 0.25), times)

    def rate(time: float) -> float:
        return float(yaw_rate(system, response(system, STRUCK, np.array([time])))[0])

    for time, heading in zip(times, states[:, 4], strict=True):
        assert heading == pytest.approx(0.25 + quad(rate, 0.0, time, epsabs=1e-12)[0], rel=1e-8)
    np.testing.assert_allclose(states[:, :4], response(system, STRUCK, times), rtol=1e-12)


def test_yaw_rate_of_a_held_turn_by_hand() -> None:
    # Benchmark: w 1.02 m, tilt 18 deg. Steer 0.1 rad to the right, held, at 3.4 m/s: the ground sees the
    # steer angle times cos(18 deg), and the wheelbase divides it: 3.4 * 0.1 * 0.9510565 / 1.02 = 0.3170188
    # rad/s to the right. A steer rate of 1 rad/s sweeps the trail of 0.08 m: 0.08 * 0.9510565 / 1.02 =
    # 0.0745927 rad/s more.
    system = linear_system(load_bicycle("benchmark"), 3.4)
    held, turning = np.array([[0.0, 0.1, 0.0, 0.0]]), np.array([[0.0, 0.1, 0.0, 1.0]])
    assert yaw_rate(system, held)[0] == pytest.approx(0.3170188, abs=0.5e-7)
    assert yaw_rate(system, turning)[0] == pytest.approx(0.3170188 + 0.0745927, abs=1e-7)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_speed_must_be_positive(speed: float) -> None:
    with pytest.raises(ParameterError, match=f"speed: expected a positive number of m/s, .*found {speed:g}$"):
        linear_system(load_bicycle("benchmark"), speed)
