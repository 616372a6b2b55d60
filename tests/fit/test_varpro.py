"""The generic solver on decaying exponentials: own and shared unknowns, bounds, priors, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares as brute_force
from tms_fit.least_squares.block_arrowhead import Block
from tms_fit.least_squares.varpro import ResidualBlock, Status, Unknowns, solve

TIME = np.linspace(0.0, 2.0, 40)
DELAYS = (0.1, -0.2)  # own nonlinear unknown of each block
AMPLITUDES = (1.0, 2.0)  # own linear unknown of each block
OFFSET, RATE = 0.3, 1.5  # shared linear and nonlinear unknown
NONE = np.inf


def predicted(amplitude: float, delay: float, offset: float, rate: float) -> np.ndarray:
    """An exponential whose growth with time squared depends on the block's own unknown."""
    return amplitude * np.exp(-rate * TIME + delay * TIME**2) + offset


def measured() -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    clean = [predicted(a, d, OFFSET, RATE) for a, d in zip(AMPLITUDES, DELAYS, strict=True)]
    return [one + 0.01 * rng.standard_normal(len(TIME)) for one in clean]


def block(rows: np.ndarray, low: float = -np.inf, prior: tuple[float, float] = (0.0, NONE)) -> ResidualBlock:
    """One decay with its own amplitude; prior: mean and standard deviation of its own nonlinear unknown."""

    def decay(nonlinear: np.ndarray) -> np.ndarray:
        shape: np.ndarray = np.exp(-nonlinear[1] * TIME + nonlinear[0] * TIME**2)
        return shape

    def linear(nonlinear: np.ndarray) -> Block:
        return Block(decay(nonlinear)[:, None], np.ones((len(TIME), 1)), rows)

    def slopes(nonlinear: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shape = values[0] * decay(nonlinear)
        return (shape * TIME**2)[:, None], (-shape * TIME)[:, None]

    one = np.array([low]), np.array([np.inf])
    own = Unknowns(1, np.zeros(1), *one, np.array([0.0, prior[0]]), np.array([NONE, prior[1]]))
    return ResidualBlock(own, linear, slopes)


def shared() -> Unknowns:
    return Unknowns(
        1, np.ones(1), np.array([-np.inf]), np.array([np.inf]), np.zeros(2), np.array([NONE, NONE])
    )


@pytest.mark.parametrize("prior", [(0.0, NONE), (0.05, 1e-2)])
def test_it_is_the_minimum_over_all_unknowns(prior: tuple[float, float]) -> None:
    rows = measured()
    found = solve([block(rows[0], prior=prior), block(rows[1])], shared())

    def residual(x: np.ndarray) -> np.ndarray:
        off = [predicted(*x[2 * k : 2 * k + 2], *x[4:]) - rows[k] for k in range(2)]
        return np.concatenate([*off, [(x[1] - prior[0]) / prior[1]]])

    best = brute_force(residual, [1.0, 0.0, 1.0, 0.0, 0.0, 1.0], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert found.status is Status.OK
    assert found.arrow is not None
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    std = 0.01 * np.sqrt(np.diag(covariance))
    ours = np.concatenate([*found.own, found.shared])
    np.testing.assert_allclose((ours - best.x) / std, 0.0, atol=1e-4)
    np.testing.assert_allclose(found.arrow.shared_inverse, covariance[4:, 4:], rtol=1e-4)
    np.testing.assert_allclose(found.arrow.own_inverse[1], covariance[2:4, 2:4], rtol=1e-4)


def test_a_bound_is_reached_to_the_last_digit() -> None:
    rows = measured()
    found = solve([block(rows[0]), block(rows[1], low=-0.1)], shared())  # -0.2 lies beyond it
    assert found.status is Status.OK
    assert found.own[1][1] == -0.1
    assert found.own[0][1] > -0.1


def test_what_the_rows_do_not_determine_is_not_observable() -> None:
    found = solve([block(np.zeros(len(TIME)))], shared())  # no amplitude: nothing depends on the shape
    assert found.status is Status.NOT_OBSERVABLE
    assert found.arrow is None
    assert found.own == ()
