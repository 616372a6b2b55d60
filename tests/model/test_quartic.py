"""Eigenvalues of many at once are those of each, and what is known of the roots by hand."""

from __future__ import annotations

import numpy as np
import pytest
from tms_model import bicycle_names, double_roots, eigenvalues, load_bicycle
from tms_model.quartic import quadratic_eigenvalues

IDENTITY = np.eye(2)


def of_factors(*factors: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """C and K, each (1, 2, 2), of two oscillators s^2 + c s + k that don't know of each other."""
    damping, stiffness = np.array(factors).T
    return np.diag(damping)[None], np.diag(stiffness)[None]


@pytest.mark.parametrize(
    ("factors", "roots", "bound"),
    [
        (((3.0, 2.0), (-7.0, 12.0)), [-2.0, -1.0, 3.0, 4.0], 1e-14),
        (((2.0, 5.0), (0.0, 9.0)), [-1.0 - 2.0j, -1.0 + 2.0j, -3.0j, 3.0j], 1e-14),
        (((4.0, 3.0), (2.0, 10.0)), [-3.0, -1.0 - 3.0j, -1.0 + 3.0j, -1.0], 1e-14),
        (((0.0, -4.0), (0.0, -9.0)), [-3.0, -2.0, 2.0, 3.0], 1e-14),  # even: q = 0 in Ferrari's solution
        (((1001.0, 1000.0), (1e-3, -2e-6)), [-1000.0, -1.0, -2e-3, 1e-3], 1e-14),  # far apart
        (((2.0, 1.0), (2.0, 1.0)), [-1.0] * 4, 1e-3),  # all the same: numpy's own way
        (((0.0, 0.0), (3.0, 2.0)), [-2.0, -1.0, 0.0, 0.0], 1e-7),
        (((0.0, 0.0), (0.0, 0.0)), [0.0] * 4, 1e-14),
    ],
)
def test_roots_known_by_hand(
    factors: tuple[tuple[float, float], ...], roots: list[complex], bound: float
) -> None:
    # A double root is known to half of the digits, a fourfold one to a quarter.
    found = quadratic_eigenvalues(IDENTITY, *of_factors(*factors))[0]
    for root in roots:
        assert np.abs(found - root).min() <= bound * max(1.0, abs(root))
    np.testing.assert_allclose(found.sum(), sum(roots), rtol=1e-12, atol=1e-12)
    assert (np.diff(found.real) >= 0.0).all()


def test_one_bad_row_harms_no_other() -> None:
    damping, stiffness = (
        np.concatenate(parts)
        for parts in zip(
            of_factors((3.0, 2.0), (-7.0, 12.0)), of_factors((2.0, 1.0), (2.0, 1.0)), strict=True
        )
    )
    both = quadratic_eigenvalues(IDENTITY, damping, stiffness)
    np.testing.assert_allclose(both[0], [-2.0, -1.0, 3.0, 4.0], rtol=1e-14)
    np.testing.assert_allclose(both[1], -1.0, atol=1e-3)


def test_random_ones_make_the_determinant_vanish() -> None:
    generator = np.random.default_rng(2)
    count = 3000
    half, damping, stiffness = generator.normal(size=(3, count, 2, 2))
    mass = half @ np.swapaxes(half, 1, 2) + 0.05 * IDENTITY
    roots = quadratic_eigenvalues(mass, damping, stiffness)
    for s in roots.T:
        s = s[:, None, None]
        singular = np.linalg.svd(mass * s**2 + damping * s + stiffness, compute_uv=False)
        size = np.linalg.norm(mass * abs(s) ** 2 + abs(damping * s) + abs(stiffness), axis=(1, 2))
        assert (singular[:, 1] / size).max() < 1e-9
    # Distinct roots, all of them: their sum is the trace.
    trace = -np.trace(np.linalg.solve(mass, damping), axis1=1, axis2=2)
    np.testing.assert_allclose(roots.sum(axis=1), trace, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", bicycle_names())
def test_eigenvalues_at_many_speeds_are_those_at_each(name: str) -> None:
    bicycle = load_bicycle(name)
    meetings = [meeting.speed for meeting in double_roots(bicycle)]
    speeds = np.concatenate([np.linspace(0.0, 12.0, 49), meetings, [1e-9, 1e3]])
    at_once = eigenvalues(bicycle, speeds)
    assert at_once.shape == (len(speeds), 4)
    for speed, found in zip(speeds, at_once, strict=True):
        expected = eigenvalues(bicycle, float(speed))
        # Where roots meet, half of the digits is all that the matrices determine.
        meets = min((abs(speed - meeting) for meeting in meetings), default=1.0) < 1e-9 * (1.0 + speed)
        bound = (1e-6 if meets else 1e-9) * np.abs(expected).max()
        for root in expected:
            assert np.abs(found - root).min() < bound, (speed, root)
        for root in found:
            assert np.abs(expected - root).min() < bound, (speed, root)
