"""The two-mass-skate bicycles, to the digits of the supplement (SOM) and of independent computations."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from tms_model import (
    WhippleParameters,
    assemble,
    characteristic_polynomial,
    eigenvalues,
    linear_system,
    load_bicycle,
    response,
    stability,
    yaw_rate,
)
from tms_model.response import LEAN_RATE, STEER, STEER_RATE

PUBLISHED = yaml.safe_load((Path(__file__).parents[1] / "data" / "two_mass_skate.yaml").read_text())
LETTERS = ("M", "C1", "K0", "K2")
THEORETICAL = ("tms_table_7_1", "tms_table_7_2")


def parameters(name: str) -> WhippleParameters:
    found = load_bicycle(name).parameters
    assert found is not None
    return found


@pytest.mark.parametrize("letter", LETTERS)
def test_equation_10_1_is_carried_as_printed(letter: str) -> None:
    np.testing.assert_array_equal(
        load_bicycle("tms_eq_10_1").canonical[letter], PUBLISHED["equation_10_1"][letter]
    )


@pytest.mark.parametrize("name", ["tms_eq_10_1", "tms_table_8_1"])
def test_yaw_rate_has_the_printed_coefficients(name: str) -> None:
    printed = PUBLISHED["equation_10_3"]
    system = linear_system(load_bicycle(name), 3.6)
    assert system.yaw[STEER] / 3.6 == pytest.approx(printed["steer"], abs=0.5e-4)
    assert system.yaw[STEER_RATE] == pytest.approx(printed["steer_rate"], abs=0.5e-7)
    assert system.yaw[LEAN_RATE] == 0.0


@pytest.mark.parametrize(("name", "speed"), PUBLISHED["onset"]["printed"].items())
def test_printed_onset_of_stability(name: str, speed: float) -> None:
    assert round(stability(load_bicycle(name)).stable_speed_ranges[0][0], 1) == speed


@pytest.mark.parametrize(("name", "speed"), PUBLISHED["onset"]["computed"].items())
def test_computed_onset_of_stability(name: str, speed: float) -> None:
    digits = len(str(speed).partition(".")[2])
    answer = stability(load_bicycle(name))
    assert answer.weave_speed == pytest.approx(speed, abs=0.51 * 10.0**-digits)
    ((low, high),) = answer.stable_speed_ranges
    assert low == answer.weave_speed
    assert high > 15.0


def test_onset_without_wheel_spin() -> None:
    still = replace(parameters("tms_table_8_1"), rear_wheel_inertia_yy=0.0, front_wheel_inertia_yy=0.0)
    expected = PUBLISHED["onset"]["computed_without_spin"]["tms_table_8_1"]
    assert stability(assemble("still", still)).weave_speed == pytest.approx(expected, abs=0.5e-7)


@pytest.mark.parametrize(
    "entry", PUBLISHED["table_8_1_computed"], ids=lambda e: f"{e['matrix']}_{e['row']}{e['column']}"
)
def test_table_8_1_misses_equation_10_1_as_known(entry: dict[str, float]) -> None:
    place = int(entry["row"]), int(entry["column"])
    ours = load_bicycle("tms_table_8_1").canonical[str(entry["matrix"])][place]
    printed = load_bicycle("tms_eq_10_1").canonical[str(entry["matrix"])][place]
    assert ours == pytest.approx(entry["value"], abs=0.51e-6)
    assert 100.0 * (ours / printed - 1.0) == pytest.approx(entry["percent"], abs=0.051)


def test_table_8_1_agrees_with_equation_10_1_elsewhere() -> None:
    table, printed = load_bicycle("tms_table_8_1").canonical, load_bicycle("tms_eq_10_1").canonical
    known = {(entry["matrix"], entry["row"], entry["column"]) for entry in PUBLISHED["table_8_1_computed"]}
    known |= {(matrix, column, row) for matrix, row, column in known if matrix in ("M", "K0")}  # symmetric
    assert table["C1"][1, 0] == pytest.approx(PUBLISHED["table_8_1_computed_C1_steer_lean"], abs=0.5e-6)
    compared = 0
    for letter in LETTERS:
        for place in np.ndindex(2, 2):
            if (letter, *place) not in known and (letter, *place) != ("C1", 1, 0):
                tolerance = PUBLISHED["table_8_1_computed_others_percent"] / 100.0
                assert table[letter][place] == pytest.approx(printed[letter][place], rel=tolerance, abs=0.0)
                compared += 1
    assert compared == 16 - 8  # 5 entries, two of them twice, and the one where Eq. (10.1) prints 0


@pytest.mark.parametrize(
    "case", PUBLISHED["equation_10_1_eigenvalues"], ids=lambda case: f"{case['speed']}m_s"
)
def test_eigenvalues_of_equation_10_1(case: dict[str, object]) -> None:
    expected = np.array([complex(*root) for root in case["values"]])  # type: ignore[attr-defined]
    ours = eigenvalues(load_bicycle("tms_eq_10_1"), float(case["speed"]))  # type: ignore[arg-type]
    np.testing.assert_allclose(ours.real, expected.real, rtol=0.0, atol=0.51e-9)
    np.testing.assert_allclose(ours.imag, expected.imag, rtol=0.0, atol=0.51e-9)


def test_response_to_an_initial_lean_rate() -> None:
    time, lean_rate, yaw = np.array(PUBLISHED["equation_10_1_response"]).T
    system = linear_system(load_bicycle("tms_eq_10_1"), 3.6)
    states = response(system, np.array([0.0, 0.0, 1.0, 0.0]), time)
    np.testing.assert_allclose(states[:, LEAN_RATE], lean_rate, rtol=0.0, atol=0.51e-6)
    np.testing.assert_allclose(yaw_rate(system, states), yaw, rtol=0.0, atol=0.51e-6)


@pytest.mark.parametrize("name", THEORETICAL)
def test_matrices_of_the_point_mass_bicycle(name: str) -> None:
    """SOM Eqs. (7.1)-(7.4), written for two point masses only, against the general algorithm."""
    p = parameters(name)
    m_b, x_b, z_b = p.rear_frame_mass, p.rear_frame_x, p.rear_frame_z
    m_h, x_h, z_h = p.front_frame_mass, p.front_frame_x, p.front_frame_z
    sin, cos = math.sin(p.steer_axis_tilt), math.cos(p.steer_axis_tilt)
    u_h, w = (x_h - p.wheelbase) * cos - z_h * sin, p.wheelbase / cos
    expected = {
        "M": [[m_b * z_b**2 + m_h * z_h**2, -m_h * u_h * z_h], [-m_h * u_h * z_h, m_h * u_h**2]],
        "C1": [[0.0, -(m_b * x_b * z_b + m_h * x_h * z_h) / w], [0.0, m_h * u_h * x_h / w]],
        "K0": [[m_b * z_b + m_h * z_h, -m_h * u_h], [-m_h * u_h, -m_h * u_h * sin]],
        "K2": [[0.0, -(m_b * z_b + m_h * z_h) / w], [0.0, m_h * u_h / w]],
    }
    for letter, matrix in expected.items():
        np.testing.assert_allclose(load_bicycle(name).canonical[letter], matrix, rtol=1e-13, atol=1e-15)


def test_point_mass_bicycle_by_hand() -> None:
    # Table 7.1: 10 kg at 0.4 m height and 1 kg at 0.2 m. About the ground line: 10 * 0.16 + 1 * 0.04 = 1.64
    # kg m^2; gravity tips it with 10 * 0.4 + 1 * 0.2 = 4.2 kg m, negative stiffness. Steering throws the same
    # 4.2 kg m outwards, v^2 cos(5 deg) / w each: 4.2 * 0.9961947 = 4.1840177.
    bicycle = load_bicycle("tms_table_7_1")
    assert bicycle.mass[0, 0] == pytest.approx(1.64, rel=1e-14)
    assert bicycle.stiffness0[0, 0] == pytest.approx(-4.2, rel=1e-14)
    assert bicycle.stiffness2[0, 1] == pytest.approx(4.1840177, abs=0.5e-7)


@pytest.mark.parametrize("name", THEORETICAL)
def test_polynomial_of_the_point_mass_bicycle(name: str) -> None:
    """SOM Eq. (7.5) for A_0 ... E_0, against the general polynomial; D_3, E_2 and X_6 vanish exactly."""
    p = parameters(name)
    g, m_b, x_b, z_b = p.gravity, p.rear_frame_mass, p.rear_frame_x, p.rear_frame_z
    m_h, x_h, z_h = p.front_frame_mass, p.front_frame_x, p.front_frame_z
    sin, cos = math.sin(p.steer_axis_tilt), math.cos(p.steer_axis_tilt)
    u_h, w = (x_h - p.wheelbase) * cos - z_h * sin, p.wheelbase / cos
    ours = characteristic_polynomial(load_bicycle(name))
    a_0 = m_b * m_h * u_h**2 * z_b**2
    b_1 = -m_b * m_h * u_h * z_b * (x_b * z_h - x_h * z_b) / w
    c_0 = -g * m_h * u_h * (m_b * sin * z_b**2 - m_b * u_h * z_b + m_h * sin * z_h**2 + m_h * u_h * z_h)
    c_2 = m_b * m_h * u_h * z_b * (z_b - z_h) / w
    d_1 = -g * m_b * m_h * u_h * z_b * (x_b - x_h) / w
    e_0 = -(g**2) * m_h * u_h * (m_h * (x_h - p.wheelbase) * cos + m_b * z_b * sin)
    for letter, expected in {
        "A": [a_0],
        "B": [0.0, b_1],
        "C": [c_0, 0.0, c_2],
        "D": [0.0, d_1, 0.0, 0.0],
        "E": [e_0, 0.0, 0.0],
    }.items():
        np.testing.assert_allclose(ours[letter], expected, rtol=1e-12, atol=0.0)
    # To the printed digits: half a unit of the third or fourth is 5e-4 at most.
    assert ours["X"][2] == pytest.approx(PUBLISHED["x_2"][name], rel=5e-4)
    assert ours["X"][6] == 0.0
