"""JBike6's axes and principal inertias, by cases that one can picture and both ways."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tms_model import bicycle_names, load_bicycle, with_parameters
from tms_model.supplement.jbike6 import (
    BODIES,
    components,
    from_jbike6,
    inertia_from_jbike6,
    inertia_to_jbike6,
    jbike6_body,
    parameters_of_body,
    principal,
    to_jbike6,
)

ASSEMBLED = [name for name in bicycle_names() if load_bicycle(name).parameters is not None]


def test_axes() -> None:
    # The benchmark's down is JBike6's minus up, its right is JBike6's z.
    np.testing.assert_array_equal(to_jbike6(np.array([0.3, 0.0, -0.9])), [0.3, 0.9, 0.0])
    np.testing.assert_array_equal(to_jbike6(np.array([0.0, 1.0, 0.0])), [0.0, 0.0, 1.0])
    points = np.random.default_rng(6).standard_normal((5, 3))
    np.testing.assert_allclose(from_jbike6(to_jbike6(points)), points)
    np.testing.assert_allclose(to_jbike6(from_jbike6(points)), points)


def test_components_as_6_2_writes_them_out() -> None:
    b = np.array([[1.0, 0.2, 0.3], [0.2, 2.0, 0.5], [0.3, 0.5, 3.0]])  # xx, xy, xz; yy, yz; zz
    j = inertia_to_jbike6(b)
    written = {
        (0, 0): b[0, 0],
        (0, 1): -b[0, 2],
        (0, 2): b[0, 1],
        (1, 1): b[2, 2],
        (1, 2): -b[1, 2],
        (2, 2): b[1, 1],
    }
    for (row, column), value in written.items():
        assert j[row, column] == j[column, row] == value
    np.testing.assert_array_equal(inertia_from_jbike6(j), b)


def test_inertia_turns_with_its_body() -> None:
    # Of point masses, by their places: the tensor of the turned places is the turned tensor.
    places = np.random.default_rng(66).standard_normal((7, 3))

    def tensor(points: np.ndarray) -> np.ndarray:
        return sum(np.eye(3) * (p @ p) - np.outer(p, p) for p in points)

    np.testing.assert_allclose(inertia_to_jbike6(tensor(places)), tensor(to_jbike6(places)), atol=1e-12)


@pytest.mark.parametrize("angle_deg", [-80.0, -30.0, 0.0, 25.0, 45.0, 60.0, 90.0])
def test_rod_at_an_angle(angle_deg: float) -> None:
    # A thin rod along a direction 'angle' above x has no inertia about itself; the axis of the larger inertia
    # in the plane stands across it, 90 degrees further.
    along = math.radians(angle_deg - 90.0)
    c, s = math.cos(along), math.sin(along)
    xx, yy, xy = 2.0 * s * s, 2.0 * c * c, -2.0 * s * c  # of a rod with 2 kg m^2 across
    first, second, angle = principal(xx, yy, xy)
    assert first == pytest.approx(2.0)
    assert second == pytest.approx(0.0, abs=1e-15)
    assert math.degrees(angle) == pytest.approx(angle_deg)
    np.testing.assert_allclose(components(first, second, angle), (xx, yy, xy), atol=1e-15)


def test_printed_arctan_gives_the_other_axis_when_yy_is_larger() -> None:
    # (6.3)'s alpha for a rod along x, which has I_yy > I_xx: 0, though the axis of I_11 is y.
    xx, yy, xy = 0.0, 1.0, 0.0
    printed = 0.5 * math.atan(2.0 * xy / (xx - yy))
    assert abs(printed) == 0.0
    assert principal(xx, yy, xy)[2] == pytest.approx(math.pi / 2)
    # With I_xx > I_yy both agree.
    assert principal(2.0, 1.0, 0.3)[2] == pytest.approx(0.5 * math.atan(0.6))


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", ASSEMBLED)
def test_bodies_there_and_back(name: str, body: str) -> None:
    bicycle = load_bicycle(name)
    assert bicycle.parameters is not None
    told = jbike6_body(bicycle.parameters, body)
    matrix = np.array([[told.inertia_11, 0.0], [0.0, told.inertia_22]])
    c, s = math.cos(told.angle), math.sin(told.angle)
    turned = np.array([[c, -s], [s, c]]) @ matrix @ np.array([[c, s], [-s, c]])
    xx, xz, zz = (getattr(bicycle.parameters, f"{body}_inertia_{axes}") for axes in ("xx", "xz", "zz"))
    np.testing.assert_allclose(turned, [[xx, -xz], [-xz, zz]], atol=1e-12)
    again = with_parameters(bicycle, parameters_of_body(told, body))
    for letter, matrix in bicycle.canonical.items():
        np.testing.assert_allclose(again.canonical[letter], matrix, rtol=1e-11, atol=1e-13)
