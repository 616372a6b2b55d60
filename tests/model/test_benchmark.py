"""The benchmark bicycle, to the digits that Meijaard et al. 2007 print."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.polynomial.polynomial import polyval
from tms_model import characteristic_polynomial, eigenvalues, load_bicycle, stability

PUBLISHED = yaml.safe_load((Path(__file__).parents[1] / "data" / "benchmark.yaml").read_text())
PRECISION = PUBLISHED["precision"]


@pytest.mark.parametrize("letter", ["M", "C1", "K0", "K2"])
def test_matrices(letter: str) -> None:
    ours = load_bicycle("benchmark").canonical[letter]
    np.testing.assert_allclose(ours, PUBLISHED[letter], rtol=PRECISION, atol=0.0)


@pytest.mark.parametrize("row", PUBLISHED["eigenvalues"], ids=lambda row: f"{row[0]}m_s")
def test_eigenvalues(row: list[float]) -> None:
    speed, castering, capsize, weave, other = row
    pair = [weave, other] if speed == 0 else [complex(weave, -other), complex(weave, other)]
    published = np.array([castering, capsize, *pair], dtype=complex)
    published = published[np.lexsort((published.imag, published.real))]
    # One unit of the last printed digit, 1e-14, is more than 1e-12 of the smallest root.
    np.testing.assert_allclose(
        eigenvalues(load_bicycle("benchmark"), speed), published, rtol=PRECISION, atol=1e-14
    )


def test_stable_between_weave_and_capsize_speed() -> None:
    answer = stability(load_bicycle("benchmark"))
    assert answer.weave_speed == pytest.approx(PUBLISHED["weave_speed"], rel=PRECISION)
    assert answer.capsize_speed == pytest.approx(PUBLISHED["capsize_speed"], rel=PRECISION)
    assert answer.stable_speed_ranges == ((answer.weave_speed, answer.capsize_speed),)


def test_double_root_where_weave_begins() -> None:
    # Two real roots meet and become the weave pair: the characteristic polynomial and its derivative vanish
    # together.
    speed, value = PUBLISHED["double_root"]["speed"], PUBLISHED["double_root"]["value"]
    coefficients = characteristic_polynomial(load_bicycle("benchmark"))
    quartic = np.array([polyval(speed, coefficients[letter]) for letter in "ABCDE"])
    for polynomial in (quartic, np.polyder(quartic)):
        assert abs(np.polyval(polynomial, value)) < PRECISION * np.polyval(np.abs(polynomial), value)
