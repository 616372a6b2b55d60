"""The characteristic polynomial, the Routh test and the speeds found from them, against exact arithmetic."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import yaml
from tms_model import Bicycle, SteerElements, bicycle_names, eigenvalues, load_bicycle, stability
from tms_model.characteristic import NAMES, coefficients, routh
from tms_model.roots import positive_roots
from tms_model.stability import boundaries, double_roots

KINDS = ("benchmark", "tms_table_8_1", "tms_eq_10_1", "counterexample_7_rear_steering")

PUBLISHED = yaml.safe_load((Path(__file__).parents[1] / "data" / "benchmark.yaml").read_text())
PRECISION = Fraction(1, 10**12)
SPRUNG = SteerElements(steer_spring=-1.3, steer_damper=0.4, lean_gain=2.1, lean_rate_gain=0.7)

Polynomial = list[Fraction]


def times(p: Polynomial, q: Polynomial) -> Polynomial:
    product = [Fraction(0)] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(q):
            product[i + j] += a * b
    return product


def quartic_at(bicycle: Bicycle, speed: Fraction) -> Polynomial:
    """A...E as fractions, by expanding the determinant of (3.3) entry by entry at one speed."""
    m, c1, k0, k2 = (
        [[Fraction(float(x)) for x in row] for row in matrix] for matrix in bicycle.canonical.values()
    )
    spring, damper = (
        [[Fraction(float(x)) for x in row] for row in matrix]
        for matrix in (bicycle.steer_elements.stiffness, bicycle.steer_elements.damping)
    )
    g = Fraction(bicycle.gravity)

    def entry(i: int, j: int) -> Polynomial:
        stiffness = g * k0[i][j] + speed**2 * k2[i][j] + spring[i][j]
        return [m[i][j], speed * c1[i][j] + damper[i][j], stiffness]

    first, second = times(entry(0, 0), entry(1, 1)), times(entry(0, 1), entry(1, 0))
    return [a - b for a, b in zip(first, second, strict=True)]


def routh_determinant(bicycle: Bicycle, speed: Fraction) -> Fraction:
    a, b, c, d, e = quartic_at(bicycle, speed)
    return b * c * d - a * d**2 - e * b**2


def sylvester(bicycle: Bicycle, speed: Fraction) -> Fraction:
    """Resultant of the quartic and its derivative, by Sylvester's matrix: zero at a double root."""
    p = quartic_at(bicycle, speed)
    slope = [coefficient * power for coefficient, power in zip(p[:4], (4, 3, 2, 1), strict=True)]
    rows = [[Fraction(0)] * k + p + [Fraction(0)] * (2 - k) for k in range(3)]
    rows += [[Fraction(0)] * k + slope + [Fraction(0)] * (3 - k) for k in range(4)]
    determinant = Fraction(1)
    for k in range(7):
        pivot = next((r for r in range(k, 7) if rows[r][k]), None)
        if pivot is None:
            return Fraction(0)
        if pivot != k:
            rows[k], rows[pivot], determinant = rows[pivot], rows[k], -determinant
        determinant *= rows[k][k]
        for r in range(k + 1, 7):
            factor = rows[r][k] / rows[k][k]
            rows[r] = [x - factor * y for x, y in zip(rows[r], rows[k], strict=True)]
    return determinant


def around(speed: float) -> tuple[Fraction, Fraction]:
    return Fraction(speed) * (1 - PRECISION), Fraction(speed) * (1 + PRECISION)


@pytest.mark.parametrize("name", bicycle_names())
def test_boundaries_are_right_to_1e_12(name: str) -> None:
    # In exact arithmetic, E or X changes its sign between 1e-12 below and 1e-12 above.
    bicycle = load_bicycle(name)
    for boundary in boundaries(bicycle):
        low, high = around(boundary.speed)
        if boundary.condition == "E":
            assert quartic_at(bicycle, low)[4] * quartic_at(bicycle, high)[4] < 0
        else:
            assert routh_determinant(bicycle, low) * routh_determinant(bicycle, high) < 0


@pytest.mark.parametrize("name", bicycle_names())
def test_double_root_speeds_are_right_to_1e_12(name: str) -> None:
    bicycle = load_bicycle(name)
    for root in double_roots(bicycle):
        low, high = around(root.speed)
        assert sylvester(bicycle, low) * sylvester(bicycle, high) < 0
        # A little to either side, two real eigenvalues on one side and a pair on the other.
        near = [eigenvalues(bicycle, root.speed * factor) for factor in (1 - 1e-6, 1 + 1e-6)]
        assert sorted((np.abs(e.imag) < 1e-9).sum() for e in near) in ([0, 2], [2, 4])
        for roots in near:
            assert np.sort(np.abs(roots - root.eigenvalue))[1] < 0.02 * abs(root.eigenvalue)


def test_double_root_of_the_benchmark_is_the_published_one() -> None:
    (root,) = double_roots(load_bicycle("benchmark"))
    assert root.speed == pytest.approx(PUBLISHED["double_root"]["speed"], rel=1e-12)
    assert root.eigenvalue == pytest.approx(PUBLISHED["double_root"]["value"], rel=1e-12)


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.quick_for(name=KINDS)
def test_every_change_of_the_eigenvalues_kind_is_a_double_root(name: str) -> None:
    bicycle = load_bicycle(name)
    speeds = np.arange(0.0052, 15.0, 0.0104)
    kinds = [int((np.abs(eigenvalues(bicycle, v).imag) > 1e-7).sum()) for v in speeds]
    crossings = [
        0.5 * (a + b) for a, b, k, j in zip(speeds, speeds[1:], kinds, kinds[1:], strict=False) if k != j
    ]
    found = [root.speed for root in double_roots(bicycle) if 0.0052 < root.speed < speeds[-1]]
    np.testing.assert_allclose(found, crossings, atol=0.0053)


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.parametrize("elements", [SteerElements(), SPRUNG], ids=["free", "sprung"])
def test_polynomials_are_those_of_the_determinant(name: str, elements: SteerElements) -> None:
    bicycle = replace(load_bicycle(name), steer_elements=elements)
    for speed in (0.0, 0.5, 3.6, 8.0):
        test, exact = routh(bicycle, speed), quartic_at(bicycle, Fraction(speed))
        a, b, c, d, e = exact
        terms = [b * c * d, -a * d * d, -e * b * b]
        for letter, value in zip("ABCDE", exact, strict=True):
            assert test.values[letter] == pytest.approx(float(value), rel=1e-9, abs=1e-9)
        assert test.values["X"] == pytest.approx(
            float(sum(terms)), abs=1e-11 * float(sum(map(abs, terms))) + 1e-15
        )


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.parametrize("elements", [SteerElements(), SPRUNG], ids=["free", "sprung"])
@pytest.mark.quick_for(name=KINDS)
def test_routh_says_what_the_eigenvalues_say(name: str, elements: SteerElements) -> None:
    bicycle = replace(load_bicycle(name), steer_elements=elements)
    for speed in np.arange(0.31, 12.0, 0.47):
        test = routh(bicycle, float(speed))
        assert test.stable == (eigenvalues(bicycle, float(speed)).real < 0.0).all()
        assert test.stable == (not test.failed)


@pytest.mark.parametrize("name", bicycle_names())
def test_coefficients_by_name_make_the_polynomial(name: str) -> None:
    bicycle, speed = load_bicycle(name), 2.7
    c = coefficients(bicycle)
    assert tuple(c) == NAMES
    if bicycle.steer_elements.steer_damper or bicycle.steer_elements.lean_rate_gain:
        pytest.skip("a damper adds powers of speed that (4.2) does not name")
    values = routh(bicycle, speed).values
    assert values["C"] == pytest.approx(c["C0"] + c["C2"] * speed**2, rel=1e-12)
    assert values["D"] == pytest.approx(c["D1"] * speed + c["D3"] * speed**3, rel=1e-12)
    assert values["E"] == pytest.approx(c["E0"] + c["E2"] * speed**2, rel=1e-12)
    x = c["X2"] * speed**2 + c["X4"] * speed**4 + c["X6"] * speed**6
    assert values["X"] == pytest.approx(x, rel=1e-9)


def test_signs_of_a_conventional_design() -> None:
    # SOM chapter 4: 'B1, C2, D3, E0 are positive and C0, D1, E2 are negative'.
    c = coefficients(load_bicycle("benchmark"))
    assert all(c[name] > 0.0 for name in ("A0", "B1", "C2", "D3", "E0"))
    assert all(c[name] < 0.0 for name in ("C0", "D1", "E2"))


@pytest.mark.parametrize("name", bicycle_names())
def test_near_a_boundary_the_eigenvalue_is_as_the_text_estimates_it(name: str) -> None:
    # SOM chapter 4: near E = 0, lambda = -E / D; at X = 0 the pair stands at omega^2 = D / B = Q (4.5).
    bicycle = load_bicycle(name)
    for boundary in boundaries(bicycle):
        if boundary.condition == "E":
            near = boundary.speed * (1.0 + 1e-6)
            values = routh(bicycle, near).values
            smallest = min(eigenvalues(bicycle, near), key=abs)
            assert smallest.real == pytest.approx(-values["E"] / values["D"], rel=1e-3)
        else:
            values = routh(bicycle, boundary.speed).values
            pair = min(eigenvalues(bicycle, boundary.speed), key=lambda root: abs(root.real))
            assert abs(pair.real) < 1e-6
            assert pair.imag**2 == pytest.approx(values["D"] / values["B"], rel=1e-6)
            assert abs(pair.imag) == pytest.approx(boundary.frequency, rel=1e-6)
            # (4.5): P Q = E with P = C - A Q.
            q = values["D"] / values["B"]
            assert (values["C"] - values["A"] * q) * q == pytest.approx(values["E"], rel=1e-6)


@pytest.mark.parametrize("name", bicycle_names())
def test_stability_is_lost_at_e_or_x_only(name: str) -> None:
    # SOM chapter 4: 'X or E will vanish before B, C, or D'.
    bicycle = load_bicycle(name)
    speeds = [boundary.speed for boundary in boundaries(bicycle)]
    for low, high in stability(bicycle).stable_speed_ranges:
        assert low == 0.0 or low in speeds
        assert math.isinf(high) or high in speeds


@pytest.mark.parametrize("name", bicycle_names())
def test_boundaries_of_a_sprung_bicycle_are_those_of_a_scan(name: str) -> None:
    bicycle = replace(load_bicycle(name), steer_elements=SPRUNG)
    ranges = stability(bicycle).stable_speed_ranges
    for speed in np.arange(0.0071, 15.0, 0.0537):
        said = any(low < speed < high for low, high in ranges)
        assert said == (eigenvalues(bicycle, float(speed)).real < 0.0).all(), speed


def test_roots_by_hand() -> None:
    # (x - 1/3)(x - 2)(x + 5) = x^3 + 8/3 x^2 - 11 x + 10/3; even: (x^2 - 9)(x^2 + 4); odd: x (x^2 - 2).
    assert positive_roots([Fraction(10, 3), Fraction(-11), Fraction(8, 3), Fraction(1)]) == [1 / 3, 2.0]
    assert positive_roots([Fraction(-36), Fraction(0), Fraction(-5), Fraction(0), Fraction(1)]) == [3.0]
    assert positive_roots([Fraction(0), Fraction(-2), Fraction(0), Fraction(1)]) == [math.sqrt(2.0)]
    assert positive_roots([Fraction(7)]) == []
    assert positive_roots([Fraction(0), Fraction(0), Fraction(3)]) == []
    assert positive_roots([Fraction(1), Fraction(0), Fraction(1)]) == []
