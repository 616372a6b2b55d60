"""The exponential of small matrices, against cases worked by hand and against scipy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.linalg
from tms_model import bicycle_names, load_bicycle
from tms_model.exponential import expm
from tms_model.response import state_matrix

KINDS = ("benchmark", "tms_table_8_1", "tms_eq_10_1", "counterexample_7_rear_steering")


def test_nothing_and_no_more_than_a_shear() -> None:
    np.testing.assert_array_equal(expm(np.zeros((3, 3))), np.eye(3))
    # N^2 = 0: exp(N) = 1 + N, and only that.
    np.testing.assert_allclose(expm(np.array([[0.0, 1e3], [0.0, 0.0]])), [[1.0, 1e3], [0.0, 1.0]], rtol=1e-14)


@pytest.mark.parametrize("angle", [1e-9, 0.3, 2.0, 40.0])
def test_a_rotation(angle: float) -> None:
    found = expm(np.array([[0.0, -angle], [angle, 0.0]]))
    expected = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-15 * (1.0 + 4.0 * angle))


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.quick_for(name=KINDS)
def test_many_at_once_agree_with_scipy(name: str) -> None:
    speeds = np.linspace(0.0, 12.0, 25)
    for step in (1e-4, 0.01, 0.1):
        exponents = step * state_matrix(load_bicycle(name), speeds)
        found = expm(exponents)
        for exponent, exponential in zip(exponents, found, strict=True):
            expected = scipy.linalg.expm(exponent)
            # Rounding the exponent alone changes the exponential by this share.
            share = 2.2e-16 * (10.0 + np.abs(exponent).sum(axis=0).max())
            np.testing.assert_allclose(exponential, expected, rtol=0.0, atol=share * np.abs(expected).max())
