"""Stable speed ranges, solved for, against a scan; and the polynomial they come from."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval
from tms_model import (
    Bicycle,
    ParameterError,
    WhippleParameters,
    assemble,
    bicycle_names,
    characteristic_polynomial,
    eigenvalues,
    load_bicycle,
    stability,
)

KINDS = ("benchmark", "tms_table_8_1", "tms_eq_10_1", "counterexample_7_rear_steering")

ASSEMBLED = [name for name in bicycle_names() if load_bicycle(name).parameters is not None]


def assert_ranges_are_those_of_a_scan(bicycle: Bicycle, speeds: np.ndarray) -> None:
    ranges = stability(bicycle).stable_speed_ranges
    for speed in speeds:
        said = any(low < speed < high for low, high in ranges)
        assert said == (eigenvalues(bicycle, float(speed)).real < 0.0).all(), speed


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.quick_for(name=KINDS)
def test_ranges_are_those_of_a_scan(name: str) -> None:
    # 0.0137 m/s apart from an odd start: no speed of the scan lies on a bound.
    assert_ranges_are_those_of_a_scan(load_bicycle(name), np.arange(0.0071, 30.0, 0.0137))


@pytest.mark.parametrize("name", ASSEMBLED)
@pytest.mark.quick_for(name=KINDS)
def test_ranges_of_slightly_different_bicycles(name: str) -> None:
    # Every parameter off by a few percent: on a two-mass skate E_2 and X_6 vanish, and rounding must not make
    # up a range.
    parameters = load_bicycle(name).parameters
    assert parameters is not None
    rng = np.random.default_rng(2011)
    tried = 0
    while tried < 40:
        off = {key: value * (1.0 + 0.1 * rng.standard_normal()) for key, value in asdict(parameters).items()}
        try:
            bicycle = assemble("off", WhippleParameters(**off))
        except ParameterError:
            continue  # unphysical: its mass matrix is not positive definite
        tried += 1
        assert_ranges_are_those_of_a_scan(bicycle, np.append(np.arange(0.05, 14.0, 0.31), [30.0, 60.0]))


@pytest.mark.parametrize("name", bicycle_names())
def test_eigenvalues_are_roots_of_the_polynomial(name: str) -> None:
    bicycle = load_bicycle(name)
    coefficients = characteristic_polynomial(bicycle)
    for speed in (0.5, 2.2, 3.6, 8.0):
        quartic = np.array([polyval(speed, coefficients[letter]) for letter in "ABCDE"])
        for root in eigenvalues(bicycle, speed):
            assert abs(np.polyval(quartic, root)) < 1e-10 * np.polyval(np.abs(quartic), abs(root))


@pytest.mark.parametrize("name", bicycle_names())
def test_routh_determinant_is_bcd_add_ebb(name: str) -> None:
    coefficients = characteristic_polynomial(load_bicycle(name))
    for speed in (0.5, 2.2, 3.6, 8.0):
        a, b, c, d, e, x = (polyval(speed, coefficients[letter]) for letter in "ABCDEX")
        terms = [b * c * d, -a * d * d, -e * b * b]
        assert x == pytest.approx(sum(terms), abs=1e-11 * sum(map(abs, terms)))


@pytest.mark.parametrize("name", bicycle_names())
def test_eigenvalues_are_sorted_and_pair_up(name: str) -> None:
    for speed in (0.0, 1.0, 3.6, 6.0):
        roots = eigenvalues(load_bicycle(name), speed)
        assert [(r.real, r.imag) for r in roots] == sorted((r.real, r.imag) for r in roots)
        np.testing.assert_allclose(np.sort_complex(roots.conj()), np.sort_complex(roots), atol=1e-9)


# No unstable oscillation becomes stable: three never ride by themselves, one isn't lost to weave.
WEAVELESS = {
    "counterexample_1_no_gyro",
    "counterexample_2_negative_trail",
    "counterexample_3_mass_behind_axis",
    "counterexample_7_rear_steering",
}


@pytest.mark.parametrize("name", sorted(WEAVELESS))
def test_some_have_no_weave_speed(name: str) -> None:
    assert stability(load_bicycle(name)).weave_speed is None


@pytest.mark.parametrize("name", sorted(set(bicycle_names()) - WEAVELESS))
def test_at_weave_speed_a_pair_crosses_the_imaginary_axis(name: str) -> None:
    bicycle, answer = load_bicycle(name), stability(load_bicycle(name))
    assert answer.weave_speed is not None
    pair = [
        root
        for root in eigenvalues(bicycle, answer.weave_speed)
        if abs(root.imag) > 0.1 and abs(root.real) < 1e-6
    ]
    assert len(pair) == 2
    below, above = (
        max(root.real for root in eigenvalues(bicycle, answer.weave_speed + offset) if abs(root.imag) > 0.1)
        for offset in (-0.01, 0.01)
    )
    assert below > 0.0 > above


def test_weave_becomes_stable_where_capsize_is_not() -> None:
    # The benchmark bicycle with half its steer axis tilt capsizes before its weave is stable: no stable
    # range, but both speeds, as a scan finds them.
    parameters = load_bicycle("benchmark").parameters
    assert parameters is not None
    half = assemble("half", replace(parameters, steer_axis_tilt=math.radians(9.0)))
    answer = stability(half)
    scan = np.arange(0.05, 12.0, 0.01)
    roots = np.array([eigenvalues(half, float(speed)) for speed in scan])
    unstable, paired = roots.real > 0.0, np.abs(roots.imag) > 0.1
    assert answer.stable_speed_ranges == ()
    assert unstable.any(axis=1).all()
    weaves = np.flatnonzero((unstable & paired).any(axis=1))
    assert answer.weave_speed == pytest.approx(scan[weaves[-1]], abs=0.011)
    stands = scan > 2.0  # below, a bicycle falls over like a post, by real roots
    capsizes = np.flatnonzero((unstable & ~paired).any(axis=1) & stands)
    assert answer.capsize_speed == pytest.approx(scan[capsizes[0]], abs=0.011)
