"""Coulomb friction of the steering: against another integration, and found again with honest intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tms_calibrate.pooled_fit import SHAREABLE
from tms_fit.estimators import ESTIMATORS
from tms_fit.estimators.least_squares import fit_window
from tms_fit.parameters import FRICTION
from tms_fit.response.friction import CREEP_RATE
from tms_fit.response.prediction import predictor
from tms_fit.settings import Settings
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window
from tms_model import Bicycle, ParameterError, load_bicycle
from tms_model.response import state_matrix, yaw_row

START = {"initial_lean_rate": 0.5, "initial_steer_rate": -1.0}
SPEED = 3.6


def friction_column(bicycle: Bicycle) -> np.ndarray:
    """Change of the state per second and N m on the steering, from M q'' = (0, T)."""
    return np.concatenate([np.zeros(2), np.linalg.solve(bicycle.mass, [0.0, 1.0])])


def integrated(time: np.ndarray, start: np.ndarray, friction: float, smooth: float) -> np.ndarray:
    """Lean and yaw rate (n, 2) by a general integrator with steps of its own."""
    bicycle = load_bicycle("tms_eq_10_1")
    matrix, column = state_matrix(bicycle, SPEED), friction_column(bicycle)

    def change(_: float, state: np.ndarray) -> np.ndarray:
        return matrix @ state - column * (friction * np.clip(state[3] / smooth, -1.0, 1.0))

    found = solve_ivp(
        change, (0.0, time[-1]), start, "LSODA", t_eval=time, rtol=1e-9, atol=1e-11, max_step=1e-3
    )
    return np.stack([found.y[2], yaw_row(bicycle, SPEED) @ found.y], axis=1)


def window_of(rates: np.ndarray, time: np.ndarray) -> Window:
    bicycle = load_bicycle("tms_eq_10_1")
    return Window(0, time, rates[:, 0], rates[:, 1], bicycle, constant_speed(SPEED))


def predicted(window: Window, values: dict[str, float]) -> np.ndarray:
    return predictor(window, values).predict(values)


@pytest.mark.parametrize("friction", [0.02, 0.05, 0.2])
def test_it_is_the_equation_as_told(friction: float) -> None:
    time = np.arange(150) * 0.01
    rates = integrated(time, np.array([0.0, 0.0, 0.5, -1.0]), friction, CREEP_RATE)
    found = predicted(window_of(rates, time), {**START, FRICTION: friction})
    np.testing.assert_allclose(found, rates, atol=2e-4 * np.abs(rates).max())


def test_creeping_instead_of_sticking_changes_little() -> None:
    # A tenth of the rate below which the friction is proportional: as good as Coulomb's law itself.
    time = np.arange(150) * 0.01
    start = np.array([0.0, 0.0, 0.5, -1.0])
    smooth, sharp = (integrated(time, start, 0.1, rate) for rate in (CREEP_RATE, 0.1 * CREEP_RATE))
    none = integrated(time, start, 0.0, CREEP_RATE)
    assert np.abs(smooth - sharp).max() < 5e-4 * np.abs(none - sharp).max()


def test_no_friction_is_the_linear_response() -> None:
    time = np.arange(150) * 0.01
    window = window_of(np.zeros((150, 2)), time)
    np.testing.assert_allclose(
        predicted(window, {**START, FRICTION: 0.0}), predicted(window, START), rtol=0.0, atol=1e-11
    )


def test_a_known_torque_and_irregular_samples() -> None:
    # Linear without friction, so the known torque must enter as it does there; steps are whole nanoseconds.
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.004, 0.017, 120)) - 0.004
    window = replace(
        window_of(np.zeros((120, 2)), time), steer_torque=0.3 * rng.standard_normal(120), delay=0.003
    )
    np.testing.assert_allclose(
        predicted(window, {**START, FRICTION: 0.0}), predicted(window, START), rtol=0.0, atol=1e-5
    )


@pytest.mark.long
def test_it_is_found_within_its_standard_error() -> None:
    # Truth by the general integrator, friction ten times as sharp; 15 or less of 20 come once in 400.
    rng, time = np.random.default_rng(12), np.arange(150) * 0.01
    clean = integrated(time, np.array([0.0, 0.0, 0.5, -1.0]), 0.05, 0.1 * CREEP_RATE)
    settings = Settings(free=("initial_lean_rate", "initial_steer_rate", FRICTION))
    scores, held = [], []
    for _ in range(20):
        answer = fit_window(window_of(clean + 0.02 * rng.standard_normal(clean.shape), time), settings)
        assert answer.status == "ok"
        assert answer.names == settings.free
        off = answer.values - np.array([0.5, -1.0, 0.05])
        scores.append(off / answer.std)
        held.append((answer.ci95[:, 0] <= answer.values - off) & (answer.values - off <= answer.ci95[:, 1]))
    assert (np.sum(held, axis=0) >= 16).all()
    assert (np.abs(np.mean(scores, axis=0)) < 3.3 / np.sqrt(20.0)).all()
    assert 0.6 < np.std(scores) < 1.4


def test_fixed_and_with_a_prior() -> None:
    rng, time = np.random.default_rng(13), np.arange(150) * 0.01
    clean = integrated(time, np.array([0.0, 0.0, 0.5, 0.0]), 0.1, CREEP_RATE)
    window = window_of(clean + 0.02 * rng.standard_normal(clean.shape), time)
    wrong = fit_window(window, Settings(free=("initial_lean_rate",)))
    right = fit_window(window, Settings(free=("initial_lean_rate",), fixed={FRICTION: 0.1}))
    assert right.residual_std < 0.022 < wrong.residual_std
    assert abs(right.values[0] - 0.5) < 3.0 * right.std[0]
    asked = Settings(
        free=("initial_lean_rate", FRICTION), priors={FRICTION: (0.08, 1e-6)}, noise="white", loss="squares"
    )
    held = fit_window(window, asked)
    assert held.parameters[FRICTION] == pytest.approx(0.08, abs=1e-5)
    assert held.std[1] == pytest.approx(1e-6, rel=0.05)


def test_none_is_found_where_there_is_none() -> None:
    rng, time = np.random.default_rng(14), np.arange(150) * 0.01
    clean = integrated(time, np.array([0.0, 0.0, 0.5, -1.0]), 0.0, CREEP_RATE)
    window = window_of(clean + 0.02 * rng.standard_normal(clean.shape), time)
    answer = fit_window(window, Settings(free=("initial_lean_rate", "initial_steer_rate", FRICTION)))
    assert answer.parameters[FRICTION] >= 0.0
    assert answer.parameters[FRICTION] < 3.0 * answer.std[2]


@pytest.mark.parametrize("name", [name for name in ESTIMATORS if name != "strike"])  # which refuses it
def test_every_estimator_takes_it_or_leaves_it(name: str) -> None:
    time = np.arange(150) * 0.01
    rates = integrated(time, np.array([0.0, 0.0, 0.5, 0.0]), 0.1, CREEP_RATE)
    noise = 0.02 * np.random.default_rng(15).standard_normal(rates.shape)
    answer = ESTIMATORS[name](window_of(rates + noise, time), Settings(fixed={FRICTION: 0.1}))
    assert answer.status == "ok"


def test_it_can_not_push() -> None:
    with pytest.raises(ParameterError, match="expected 0 N m or more"):
        Settings(fixed={FRICTION: -0.1})
    assert FRICTION not in SHAREABLE
