"""Variable projection: the same minimum as brute force on all parameters; bounds, priors, refusals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares as brute_force
from tms_fit.estimators.least_squares import fit_window
from tms_fit.parameters import INITIAL, NONLINEAR, PARAMETERS
from tms_fit.response.prediction import STEPS, derivative, predictor
from tms_fit.settings import Settings
from tms_fit.speed_profile import SpeedProfile, constant_speed
from tms_fit.window import Window
from tms_model import load_bicycle

TRUTH = {
    "initial_lean_rate": 0.5,
    "initial_steer_rate": -0.4,
    "lean_rate_bias": 0.01,
    "yaw_rate_bias": -0.02,
    "speed": 3.6,
    "rolling_resistance": 0.06,
    "strike_time": -0.004,
    "lean_rate_gain": 0.15,
    "steer_damper": 0.01,
    "mounting_pitch": 0.05,
}
# With Coulomb friction the response isn't linear in the initial state.
RUBBING = {"steer_coulomb_friction": 0.05, **{name: TRUTH.get(name, 0.02) for name in INITIAL}}


def made_window(truth: Mapping[str, float], seed: int = 1, count: int = 150, noise: float = 0.02) -> Window:
    """A window that measures what `truth` predicts, with noise, every 10 ms."""
    time = np.arange(count) * 0.01
    absent = np.full(count, np.nan)
    window = Window(0, time, absent, absent, load_bicycle("tms_eq_10_1"), constant_speed(truth["speed"]))
    nonlinear = {name: value for name, value in truth.items() if name in NONLINEAR}
    rates = predictor(window, nonlinear).predict(truth)
    rates = rates + noise * np.random.default_rng(seed).standard_normal(rates.shape)
    return replace(window, lean_rate=rates[:, 0], yaw_rate=rates[:, 1])


FREE = {
    "speed": ("initial_lean_rate", "speed"),
    "speed and resistance": (
        "initial_lean_rate",
        "lean_rate_bias",
        "yaw_rate_bias",
        "speed",
        "rolling_resistance",
    ),
    "start": ("strike_time", "initial_lean_rate"),
    "gain": ("initial_lean_rate", "initial_steer_rate", "lean_rate_gain", "speed"),
    "damper": ("initial_lean_rate", "steer_damper", "rolling_resistance"),
    "mounting": ("initial_lean_rate", "mounting_pitch", "rolling_resistance"),
    "nothing linear": ("speed",),
}


@pytest.mark.parametrize("free", FREE.values(), ids=FREE)
@pytest.mark.parametrize(
    "priors", [{}, {"speed": (3.5, 0.02), "initial_lean_rate": (0.52, 0.01)}], ids=["", "priors"]
)
def test_it_is_the_minimum_over_all_parameters(
    free: tuple[str, ...], priors: dict[str, tuple[float, float]]
) -> None:
    window = made_window(TRUTH)
    fixed = {name: value for name, value in TRUTH.items() if name not in free}
    held = {name: prior for name, prior in priors.items() if name in free}
    estimate = fit_window(window, Settings(free=free, fixed=fixed, priors=held, noise="white"))
    assert (estimate.status, estimate.names) == ("ok", free)
    sigma = estimate.noise["noise_std"]

    def residual(scaled: np.ndarray) -> np.ndarray:
        values = {**fixed, **dict(zip(free, scaled * estimate.std + estimate.values, strict=True))}
        nonlinear = {name: value for name, value in values.items() if name in NONLINEAR}
        rates = predictor(window, nonlinear).predict(values)
        offs = [(values[name] - mean) / std for name, (mean, std) in held.items()]
        return np.concatenate([((window.measured - rates) / sigma).ravel(), offs])

    # In standard errors from our answer; from two of them away.
    found = brute_force(residual, np.full(len(free), 2.0), xtol=1e-12, ftol=1e-12, gtol=1e-12, jac="3-point")
    np.testing.assert_allclose(found.x, 0.0, atol=2e-4)
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    np.testing.assert_allclose(covariance, estimate.correlation, atol=2e-3)


@pytest.mark.parametrize("name", STEPS)
def test_derivatives_are_exact(name: str) -> None:
    # Against Richardson's extrapolation of wider differences, whose error is of fourth order.
    window = made_window(TRUTH)
    nonlinear = {key: value for key, value in TRUTH.items() if key in NONLINEAR}
    if name in RUBBING:
        # Undamped, the steering stops at the same samples all over the wider differences, too.
        nonlinear |= {**RUBBING, "steer_damper": 0.0}

    def difference(step: float) -> np.ndarray:
        ends = [
            predictor(window, {**nonlinear, name: nonlinear[name] + sign * step}).predict(TRUTH)
            for sign in (-1.0, 1.0)
        ]
        return np.asarray((ends[1] - ends[0]) / (2.0 * step))

    step = 1e-3 if name != "strike_time" else 2e-4
    exact = (4.0 * difference(step) - difference(2.0 * step)) / 3.0
    ours = derivative(window, nonlinear, name).predict({**TRUTH, "lean_rate_bias": 0.0, "yaw_rate_bias": 0.0})
    np.testing.assert_allclose(ours, exact, atol=2e-7 * np.abs(exact).max())


def test_damping_of_the_run_is_damping_of_the_bicycle() -> None:
    window = made_window(TRUTH)
    own = replace(window.bicycle.steer_elements, steer_damper=0.01)
    damped = replace(window, bicycle=replace(window.bicycle, steer_elements=own))
    ours, theirs = predictor(window, {"steer_damper": 0.01}), predictor(damped)
    np.testing.assert_array_equal(ours.columns, theirs.columns)
    assert np.abs(ours.columns - predictor(window).columns).max() > 1e-3


def bounds_when_decelerating() -> list[np.ndarray]:
    """Standard errors at 4 s of the initial lean rate alone, and of it, speed and resistance [1e-3 SI]."""
    window = made_window(
        {"initial_lean_rate": 0.5, "speed": 3.6, "rolling_resistance": 0.06}, count=400, noise=1e-6
    )
    lean_rate = Settings(free=("initial_lean_rate",), fixed={"speed": 3.6, "rolling_resistance": 0.06})
    both = Settings(free=("initial_lean_rate", "speed", "rolling_resistance"))
    found = [fit_window(window, settings) for settings in (lean_rate, both)]
    return [1e3 * 0.02 * one.std / one.noise["noise_std"] for one in found]


def test_speed_and_resistance_cost_little() -> None:
    # With v(t) in Eq. (3.1) and all terms in v'.
    alone, both = bounds_when_decelerating()
    assert alone[0] == pytest.approx(0.97, abs=0.005)
    assert both[0] == pytest.approx(1.40, abs=0.01)
    assert both[2] / 60.0 == pytest.approx(0.0070, abs=0.0001)


def test_bounds_without_the_terms_in_the_acceleration(monkeypatch: pytest.MonkeyPatch) -> None:
    # Computed by others with v(t) put into Eq. (3.1) and nothing else: 0.97 -> 1.18 mrad/s, C_r to 0.15 %.
    monkeypatch.setattr(
        "tms_model.varying_speed.acceleration_stiffness", lambda p, changes, r: np.zeros((len(changes), 2, 2))
    )
    alone, both = bounds_when_decelerating()
    assert alone[0] == pytest.approx(0.97, abs=0.005)
    assert both[0] == pytest.approx(1.18, abs=0.01)
    assert both[2] / 60.0 == pytest.approx(0.0015, abs=0.00005)


def test_a_speed_curve_is_followed() -> None:
    # A curve that falls by 0.5886 m/s per second is C_r = 0.06.
    falling = SpeedProfile(np.array([3.6, -0.06 * 9.81]), np.zeros((2, 2)))
    window = replace(made_window(TRUTH), speed=falling)
    by_curve = fit_window(window, Settings(free=("initial_lean_rate",)))
    by_number = fit_window(
        replace(window, speed=constant_speed(3.6)),
        Settings(free=("initial_lean_rate",), fixed={"rolling_resistance": 0.06}),
    )
    np.testing.assert_allclose(by_curve.predicted, by_number.predicted, atol=1e-10)
    assert "speed as measured" in by_curve.message


def test_a_slipping_wheel_is_left_out_or_found() -> None:
    # For 0.2 s the yaw rate is off by an amount that fades.
    truth = {"initial_lean_rate": 0.5, "speed": 3.6}
    window = made_window(truth, noise=0.002)
    off = -0.8 * np.maximum(1.0 - window.time / 0.2, 0.0)
    slipping = replace(window, yaw_rate=window.yaw_rate + off)
    free = ("initial_lean_rate",)
    ignored = fit_window(slipping, Settings(free=free))
    left_out = fit_window(slipping, Settings(free=free, slip_window=0.2))
    found = fit_window(slipping, Settings(free=free, slip_window=0.2, slip="yaw_offset"))
    assert abs(ignored.values[0] - 0.5) > 5.0 * ignored.std[0] or ignored.residual_std > 0.05
    assert abs(left_out.values[0] - 0.5) < 4.0 * left_out.std[0]
    assert "without the first 0.2 s" in left_out.message
    assert found.parameters["slip_yaw_rate"] == pytest.approx(-0.8, abs=4.0 * found.std[1])
    assert found.parameters["initial_lean_rate"] == pytest.approx(0.5, abs=4.0 * found.std[0])


def test_a_falling_speed_that_nobody_measured_is_found_in_a_long_run() -> None:
    truth = {"initial_lean_rate": 0.5, "speed": 3.6, "rolling_resistance": 0.06}
    falling = fit_window(made_window(truth, count=300), Settings())
    constant = fit_window(made_window({**truth, "rolling_resistance": 0.0}, count=300), Settings())
    assert {"speed", "rolling_resistance"} <= set(falling.names)
    assert "a constant speed is far less likely" in falling.message
    low, high = falling.ci95[falling.names.index("rolling_resistance")]
    assert low < 0.06 < high
    assert "speed" not in constant.names


def test_what_shapes_nothing_is_not_observable() -> None:
    still = made_window({"speed": 3.6}, noise=0.0)
    answer = fit_window(still, Settings(free=("speed",)))
    assert (answer.status, answer.names) == ("not_observable", ())


def test_a_bicycle_of_matrices_only_has_no_changing_speed() -> None:
    window = made_window(TRUTH)
    nameless = replace(window, bicycle=replace(window.bicycle, name="mine"))
    answer = fit_window(nameless, Settings(free=("initial_lean_rate", "rolling_resistance")))
    assert answer.status == "not_observable"
    assert "masses and geometry" in answer.message


def test_all_names_have_a_place() -> None:
    assert set(TRUTH) <= set(PARAMETERS)
    assert set(STEPS) == {*NONLINEAR, *INITIAL}


@pytest.mark.parametrize("speed", [2.5, 3.5, 4.5])
@pytest.mark.parametrize("start_known", [True, False])
def test_a_feedback_gain_is_found_though_the_bicycle_falls_without(speed: float, start_known: bool) -> None:
    # Without feedback this bicycle is unstable at these speeds; its best response is then nearly none, and no
    # slope leads to the controller's gain 2 (6.5 - v). Lean rate only, as its logs have it.
    truth = {"initial_lean_rate": -0.8, "lean_rate_gain": 2.0 * (6.5 - speed), "lean_rate_bias": 0.002}
    time, absent = np.arange(151) * 0.01, np.full(151, np.nan)
    window = Window(0, time, absent, absent, load_bicycle("delft_sbw"), constant_speed(speed))
    rates = predictor(window, {"lean_rate_gain": truth["lean_rate_gain"]}).predict(truth)[:, 0]
    noise = 0.02 * np.random.default_rng(3).standard_normal(151)
    free = ("initial_lean_rate", "lean_rate_gain", "lean_rate_bias")
    if not start_known:
        free = (*free, "initial_lean", "initial_steer")
    found = fit_window(replace(window, lean_rate=rates + noise), Settings(free=free))
    assert found.status == "ok"
    for name, std in zip(found.names, found.std, strict=True):
        assert found.parameters[name] == pytest.approx(truth.get(name, 0.0), abs=3.5 * std)


@pytest.mark.parametrize("gain", [-1e6, -1e200])
def test_a_bicycle_that_falls_beyond_all_numbers_is_no_defect(gain: float) -> None:
    window = made_window(TRUTH)
    found = fit_window(window, Settings(fixed={"lean_rate_gain": gain}))
    assert found.status == "not_observable"
    assert "such a bicycle falls at once" in found.message
