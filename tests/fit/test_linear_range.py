"""How far the linear equations hold, against the nonlinear bicycle."""

import json
from typing import Any

import numpy as np
import pytest
from tms_fit import Window, fit_window
from tms_fit.diagnostics.linear_range import (
    ERROR_PER_SQUARE_DEGREE,
    LARGEST_ANGLE_DEG,
    largest_angles,
    linear_range_warning,
)
from tms_fit.parameters import BIASES, INITIAL
from tms_fit.response.prediction import derivative
from tms_model import load_bicycle
from tms_model.nonlinear_response import nonlinear_response

TIME = np.arange(151) / 100.0
CASES = [
    ("tms_table_8_1", 3.6, 0.2), ("tms_table_8_1", 3.6, 0.3), ("tms_table_8_1", 3.6, 0.6),
    ("tms_table_7_1", 3.6, 0.3), ("tms_table_7_1", 3.6, 0.6), ("tms_table_8_1", 1.5, 0.1),
    ("benchmark", 5.0, 0.2), ("benchmark", 5.0, 0.4), ("benchmark", 5.0, 0.6),
]  # fmt: skip


def nonlinear_window(name: str, speed: float, lean_rate: float) -> tuple[Window, float]:
    """A free response of the nonlinear bicycle, nearly without noise, and its largest angle [deg]."""
    bicycle = load_bicycle(name)
    true = nonlinear_response(bicycle, np.array([0.0, 0.0, lean_rate, 0.0, speed]), TIME, tolerance=1e-8)
    noise = 1e-4 * np.random.default_rng(1).standard_normal((len(TIME), 2))
    rates = np.stack([true.states[:, 2], true.yaw_rate], axis=1) + noise
    window = Window.from_arrays(TIME, rates[:, 0], rates[:, 1], speed=speed, bicycle=bicycle)
    return window, float(np.degrees(np.abs(true.states[:, :2]).max()))


@pytest.mark.parametrize("free", [INITIAL[2:3], (*INITIAL[2:3], *BIASES), (*INITIAL, *BIASES)])
@pytest.mark.parametrize(("name", "speed", "lean_rate"), CASES)
def test_the_stated_error_bounds_that_of_a_linear_fit(
    free: tuple[str, ...], name: str, speed: float, lean_rate: float
) -> None:
    window, angle = nonlinear_window(name, speed, lean_rate)
    estimate = fit_window(window, free=free, noise="white")
    error = abs(estimate["initial_lean_rate"].value - lean_rate) / lean_rate
    assert error < ERROR_PER_SQUARE_DEGREE * angle**2
    if name == "tms_table_8_1" and lean_rate == 0.3 and free[0] == INITIAL[0]:
        assert error > 0.7 * ERROR_PER_SQUARE_DEGREE * angle**2  # the bound is no larger than it needs to be


@pytest.mark.parametrize(("name", "speed", "lean_rate"), CASES)
def test_a_response_beyond_the_range_is_told_and_one_within_is_not(
    name: str, speed: float, lean_rate: float
) -> None:
    window, angle = nonlinear_window(name, speed, lean_rate)
    estimate = fit_window(window, free=("initial_lean_rate",), noise="white")
    assert np.degrees(max(largest_angles(window, estimate))) == pytest.approx(angle, rel=0.25)
    text = linear_range_warning(window, estimate)
    if angle > 1.25 * LARGEST_ANGLE_DEG:
        assert "beyond 6 degrees the linear equations don't hold" in text
    elif angle < 0.8 * LARGEST_ANGLE_DEG:
        assert text == ""


@pytest.mark.parametrize(("lean_rate", "warned"), [(0.2, False), (0.8, True)])
def test_table_json_and_message_warn(
    make_run: Any, tmp_path: Any, command: Any, lean_rate: float, warned: bool
) -> None:
    make_run("benchmark_strike", strike__lean_rate=lean_rate, duration=4.0).write(tmp_path / "bag")
    words = ["run", tmp_path / "bag", "--estimator", "least_squares"]
    document = json.loads(command("tms_fit", *words, "--json").out)
    (strike,) = document["strikes"]
    text = "beyond 6 degrees the linear equations don't hold"
    assert any(text in one for one in document["warnings"]) == warned
    assert (text in strike["estimates"][0]["message"]) == warned
    assert (text in command("tms_fit", *words).out) == warned


def test_the_derivative_by_a_damper_of_any_size_is_finite() -> None:
    # At 1.5 m/s a search may run off to 1e11 N m s/rad, beside which a fixed step is rounding: 0 / 0.
    window, _ = nonlinear_window("tms_table_8_1", 1.5, 0.1)
    with np.errstate(invalid="raise", divide="raise"):
        slope = derivative(window, {"steer_damper": 2.3e11}, "steer_damper")
    assert np.isfinite(slope.columns).all()
