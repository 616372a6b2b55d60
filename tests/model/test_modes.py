"""Modes: eigenvectors, names, and curves that don't swap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from tms_model import ParameterError, bicycle_names, eigenvalues, follow_modes, load_bicycle, modes
from tms_model.response import state_matrix
from tms_model.stability import double_roots

KINDS = ("tms_eq_10_1", "counterexample_7_rear_steering")

PUBLISHED = yaml.safe_load((Path(__file__).parents[1] / "data" / "benchmark.yaml").read_text())


@pytest.mark.parametrize("row", PUBLISHED["eigenvalues"], ids=lambda row: f"{row[0]}m_s")
def test_published_names_of_the_benchmark(row: list[float]) -> None:
    speed, castering, capsize, weave, other = row
    course = follow_modes(load_bicycle("benchmark"), np.array([float(speed)]))
    assert course.names == (("castering", "capsize", "weave", "weave"),)
    pair = [weave, other] if speed == 0 else [complex(weave, -other), complex(weave, other)]
    np.testing.assert_allclose(course.eigenvalues[0], [castering, capsize, *pair], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.quick_for(name=KINDS)
def test_curves_are_the_eigenvalues_and_continuous(name: str) -> None:
    bicycle = load_bicycle(name)
    speeds = np.arange(0.0, 12.0, 0.004)
    course = follow_modes(bicycle, speeds)
    for speed, row in list(zip(speeds, course.eigenvalues, strict=True))[::97]:
        np.testing.assert_allclose(
            np.sort_complex(row), np.sort_complex(eigenvalues(bicycle, float(speed))), rtol=1e-6
        )
    # Away from double roots, where a square root begins, a curve goes on as it has come: a swap is a leap.
    step, bend = np.diff(course.eigenvalues, axis=0), np.abs(np.diff(course.eigenvalues, n=2, axis=0))
    calm = np.all(
        [np.abs(speeds[1:-1] - root.speed) > 0.05 for root in double_roots(bicycle)] + [speeds[1:-1] > 0], 0
    )
    assert bend[calm].max() < 0.02 * np.abs(course.eigenvalues).max() * 0.05
    assert np.abs(step).max() < 0.1 * np.abs(course.eigenvalues).max()


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.quick_for(name=KINDS)
def test_curves_do_not_depend_on_the_speeds_asked_for(name: str) -> None:
    bicycle = load_bicycle(name)
    speeds = np.linspace(0.0, 14.0, 141)
    together = follow_modes(bicycle, speeds)
    for k in (0, 3, 40, 77, 140):
        alone = follow_modes(bicycle, speeds[k : k + 1])
        np.testing.assert_array_equal(alone.eigenvalues[0], together.eigenvalues[k])
        assert alone.names[0] == together.names[k]


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.parametrize("speed", [0.6, 3.6, 7.0])
def test_modes_are_eigenvectors(name: str, speed: float) -> None:
    bicycle = load_bicycle(name)
    found = modes(bicycle, speed)
    assert sum(1 + (mode.eigenvalue.imag > 0.0) for mode in found) == 4
    for mode in found:
        np.testing.assert_allclose(
            state_matrix(bicycle, speed) @ mode.vector, mode.eigenvalue * mode.vector, rtol=1e-7, atol=1e-7
        )
        assert np.abs(mode.vector[:2]).max() == pytest.approx(1.0, rel=1e-12)
        assert mode.vector[np.argmax(np.abs(mode.vector[:2]))].imag == 0.0


def test_castering_and_capsize_become_one_oscillation() -> None:
    # Eq. (10.1): real ones of -12.28 and -1.79 at 3 m/s; at 5 m/s the pair -13.44 +- 5.32i instead.
    bicycle = load_bicycle("tms_eq_10_1")
    before, after = follow_modes(bicycle, np.array([3.0, 5.0])).names
    assert before == ("castering", "capsize", "weave", "weave")
    assert after == ("castering-capsize", "castering-capsize", "weave", "weave")
    by_name = {mode.name: mode.eigenvalue for mode in modes(bicycle, 5.0)}
    assert by_name["castering-capsize"] == pytest.approx(-13.440397763 + 5.322000736j, abs=1e-8)
    assert by_name["weave"] == pytest.approx(-0.665712741 + 0.664948197j, abs=1e-8)


def test_capsize_at_its_speed_is_a_steady_turn() -> None:
    # SOM chapter 5: the mode of the zero eigenvalue is a turn of constant lean and steer.
    bicycle = load_bicycle("benchmark")
    (capsize,) = (m for m in modes(bicycle, PUBLISHED["capsize_speed"]) if m.name == "capsize")
    assert abs(capsize.eigenvalue) < 1e-11
    stiffness = bicycle.stiffness_at(PUBLISHED["capsize_speed"])
    np.testing.assert_allclose(stiffness @ capsize.vector[:2].real, 0.0, atol=1e-8)
    np.testing.assert_allclose(capsize.vector[2:], 0.0, atol=1e-10)


@pytest.mark.parametrize("speeds", [[1.0, 0.5], [-1.0], [float("nan")]])
def test_speeds_must_ascend(speeds: list[float]) -> None:
    with pytest.raises(ParameterError, match="ascending"):
        follow_modes(load_bicycle("benchmark"), np.array(speeds))
