"""Residual tests: as others compute them, silent on noise, and named after what is there."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.diagnostic import acorr_ljungbox
from tms_bag import read_recording
from tms_fit.diagnostics.hypothesis_tests import _no_slip, impulse_ratio, run_hypothesis_tests
from tms_fit.diagnostics.residual_tests import diagnose_residuals, fisher_g, fit_percent, ljung_box
from tms_fit.diagnostics.stated_noise import StatedNoise, stated_noise
from tms_fit.estimators.least_squares import fit_window
from tms_fit.parameters import CHANNELS, DEFAULT_FREE
from tms_fit.response.prediction import predictor
from tms_fit.settings import Settings
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window
from tms_model import linear_system, load_bicycle, response, yaw_rate
from tms_model.steer_elements import SteerElements

BAGS = Path(__file__).parents[2] / "bags"
SETTINGS = Settings(free=DEFAULT_FREE, steer_torque="ignore")


def made(
    seed: int,
    start: tuple[float, ...] = (0.0, 0.0, 0.5, 0.0),
    noise: float = 0.02,
    steer_damper: float = 0.0,
) -> Window:
    """A free response of 1.5 s at 100 Hz, its steering damped more than the window's bicycle says."""
    bicycle = load_bicycle("tms_eq_10_1")
    damped = replace(bicycle, steer_elements=SteerElements(steer_damper=steer_damper))
    system = linear_system(damped, 3.6)
    time = np.arange(151) / 100.0
    states = response(system, np.array(start), time)
    rates = np.stack([states[:, 2], yaw_rate(system, states)], axis=1)
    rates += noise * np.random.default_rng(seed).standard_normal(rates.shape)
    return Window(0, time, rates[:, 0], rates[:, 1], bicycle, constant_speed(3.6, 0.005))


@pytest.mark.parametrize("lags", [1, 5, 20])
def test_ljung_box_is_that_of_statsmodels(lags: int) -> None:
    values = np.random.default_rng(1).standard_normal(150)
    values[1:] += 0.2 * values[:-1]
    theirs = acorr_ljungbox(values, lags=[lags])
    q, p = ljung_box(values, lags)
    assert q == pytest.approx(float(theirs["lb_stat"].iloc[0]), rel=1e-10)
    assert p == pytest.approx(float(theirs["lb_pvalue"].iloc[0]), rel=1e-8)


def test_ljung_box_with_missing_samples_is_no_more_often_alarmed() -> None:
    # Under white noise its probabilities are uniform, whether samples are missing or not.
    rng = np.random.default_rng(2)
    found = []
    for _ in range(400):
        values = rng.standard_normal(200)
        values[rng.random(200) < 0.2] = np.nan
        found.append(ljung_box(values, 10)[1])
    assert stats.kstest(found, "uniform").pvalue > 1e-3


def test_fisher_by_hand_and_by_chance() -> None:
    # Three ordinates, the largest with half of the sum: 3 (1 - 1/2)^2 - 3 (1 - 1)^2 = 3/4.
    assert fisher_g(np.array([2.0, 1.0, 1.0])) == pytest.approx(0.75)
    rng = np.random.default_rng(3)
    found = [fisher_g(rng.exponential(size=75)) for _ in range(400)]
    assert stats.kstest(found, "uniform").pvalue > 1e-3


def test_fit_percent_by_hand() -> None:
    # Residuals half as long as the deviations from the mean: 50 %.
    window = made(1)
    estimate = fit_window(window, SETTINGS)
    residual = 0.5 * (window.measured - window.measured.mean(axis=0))
    assert fit_percent(window, replace(estimate, residual=residual)) == pytest.approx(
        {"lean_rate": 50.0, "yaw_rate": 50.0}
    )


def test_nothing_speaks_against_the_right_model() -> None:
    # 60 runs of 8 tests at 1e-3 each: 0.5 alarms are expected; 5 or more come by chance once in 6000.
    alarms = 0
    for seed in range(60):
        window = made(seed)
        found = diagnose_residuals(
            window, fit_window(window, SETTINGS), StatedNoise(dict.fromkeys(CHANNELS, 0.02), "noise_std")
        )
        assert len(found.tests) == 8
        alarms += sum(not test.passed for test in found.tests)
    assert alarms < 5


def test_reduced_chi_square_is_one_where_the_noise_is_as_stated() -> None:
    # 120 runs of some 150 squares each: their mean is 1 within 0.0105.
    stated = StatedNoise({"lean_rate": 0.02, "yaw_rate": 0.02}, "noise_std")
    found = [
        diagnose_residuals(made(seed), fit_window(made(seed), SETTINGS), stated).reduced_chi_square
        for seed in range(120)
    ]
    for channel in CHANNELS:
        assert np.mean([one[channel] for one in found]) == pytest.approx(1.0, abs=0.03)
    quiet = diagnose_residuals(made(3), fit_window(made(3), SETTINGS))
    assert quiet.reduced_chi_square == {}
    assert "not stated" in quiet.size


def test_the_stated_noise_is_that_of_the_axes_that_enter() -> None:
    recording = read_recording(BAGS / "tms_strike")
    assert recording.run_info is not None
    # Turned by 90 degrees about the upward axis, the sensor's y is the bicycle's x.
    turned = replace(
        recording,
        run_info=replace(
            recording.run_info, imu_orientation=np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
        ),
        imu=replace(recording.imu, angular_velocity_variance=np.array([np.nan, 0.01**2, 0.03**2])),
    )
    found = stated_noise(turned, Settings())
    assert found is not None
    assert found.std == pytest.approx({"lean_rate": 0.01, "yaw_rate": 0.03})
    unknown = replace(recording, imu=replace(recording.imu, angular_velocity_variance=np.full(3, np.nan)))
    assert stated_noise(unknown, Settings()) is None
    assert stated_noise(unknown, Settings(noise_std=0.5)) == StatedNoise(
        {"lean_rate": 0.5, "yaw_rate": 0.5}, "noise_std"
    )


def test_the_command_line_tells_the_size_of_the_residuals(command: Any, refused: Any) -> None:
    bag = BAGS / "tms_strike"
    document = json.loads(command("tms_fit", "run", bag, "--json").out)
    for estimate in document["strikes"][0]["estimates"]:
        told = estimate["criticism"]
        assert told["stated_noise"]["by"] == "recording"
        assert 0.6 < told["reduced_chi_square"]["lean_rate"] < 1.5
    stated = told["stated_noise"]["std"]["lean_rate"]
    half = json.loads(command("tms_fit", "run", bag, "--noise-std", str(stated / 2.0), "--json").out)
    last = half["strikes"][0]["estimates"][-1]["criticism"]
    assert last["reduced_chi_square"]["lean_rate"] == pytest.approx(
        4.0 * told["reduced_chi_square"]["lean_rate"]
    )
    assert "larger than the stated noise allows" in last["verdict"]
    assert "reduced chi-square: " in command("tms_fit", "run", bag).out
    assert "noise std: expected a positive number" in refused("tms_fit", "run", bag, "--noise-std", "-1")


def test_each_flaw_is_named() -> None:
    window = made(4)
    wave = replace(window, yaw_rate=window.yaw_rate + 0.08 * np.sin(2.0 * np.pi * 20.0 * window.time))
    # Under white noise: an autoregressive process would take the shimmy for noise, as it should.
    estimate = fit_window(wave, replace(SETTINGS, noise="white"))
    found = diagnose_residuals(wave, estimate)
    assert any("a shimmy of 19.9 Hz" in t.sentence or "a shimmy of 20" in t.sentence for t in found.tests)
    assert "shimmy" in found.verdict
    loud = diagnose_residuals(
        window, fit_window(window, SETTINGS), StatedNoise(dict.fromkeys(CHANNELS, 0.01), "noise_std")
    )
    assert {test.name for test in loud.tests if not test.passed} == {"chi_square"}
    spikes = window.lean_rate.copy()
    spikes[::30] += 0.3
    spiked = diagnose_residuals(window, fit_window(replace(window, lean_rate=spikes), SETTINGS))
    assert any(test.name == "normality" and not test.passed for test in spiked.tests)


@pytest.mark.long
def test_the_right_model_is_seldom_rejected() -> None:
    # 20 runs, 6 true hypotheses: 0.12 rejections at 1e-3 are expected, 3 or more come once in 4000.
    rejected = 0
    for seed in range(20):
        for verdict in run_hypothesis_tests(made(seed), SETTINGS):
            if not verdict.hypothesis.startswith("the steer rate of a roll impulse"):
                rejected += verdict.rejected
    assert rejected < 3


@pytest.mark.long
def test_a_steer_kick_is_told_from_none_and_an_impulse_recognised() -> None:
    bicycle = load_bicycle("tms_eq_10_1")
    ratio = impulse_ratio(bicycle)
    assert ratio == pytest.approx(-2.03, abs=0.005)  # published beside Eq. (10.1)'s matrices
    told = {
        verdict.hypothesis: verdict
        for verdict in run_hypothesis_tests(made(5, (0.0, 0.0, 0.5, 0.5 * ratio)), SETTINGS)
    }
    assert told["no steer rate at the start"].rejected
    assert told["no steer rate at the start"].delta_bic < -10.0
    assert "is rejected (p < 1e-6); a steer rate of -" in told["no steer rate at the start"].sentence
    (impulse,) = (one for name, one in told.items() if name.startswith("the steer rate of a roll impulse"))
    assert not impulse.rejected
    assert impulse.delta_aic == pytest.approx(2.0 - impulse.statistic**2, abs=0.05)
    (other,) = (
        v
        for v in run_hypothesis_tests(made(5), SETTINGS)
        if v.hypothesis.startswith("the steer rate of a roll")
    )
    assert other.rejected
    assert other.delta_bic < -10.0


@pytest.mark.long
def test_steering_that_is_damped_more_than_the_bicycle_says_is_told() -> None:
    damped = made(5, steer_damper=0.005)
    (told,) = (v for v in run_hypothesis_tests(damped, SETTINGS) if v.parameter == "steer_damper")
    assert told.rejected
    assert abs(told.value - 0.005) < 3.0 * told.std
    assert told.hypothesis == "no more steer damping than the bicycle has"
    (quiet,) = (v for v in run_hypothesis_tests(made(5), SETTINGS) if v.parameter == "steer_damper")
    assert not quiet.rejected


def test_information_criteria_of_a_constraint_are_those_of_the_fit_under_it() -> None:
    # The steer rate of an impulse is one linear constraint; by hand: one column, both together.
    window, bicycle = replace(made(5), speed=constant_speed(3.6)), load_bicycle("tms_eq_10_1")
    (told,) = (
        v
        for v in run_hypothesis_tests(window, SETTINGS)
        if v.hypothesis.startswith("the steer rate of a roll")
    )
    free = ("initial_lean_rate", "initial_steer_rate", "lean_rate_bias", "yaw_rate_bias")
    matrix = predictor(window).select(free).reshape(-1, 4)
    together = np.column_stack([matrix[:, 0] + impulse_ratio(bicycle) * matrix[:, 1], matrix[:, 2:]])
    sums = [
        float(np.linalg.lstsq(columns, window.measured.ravel(), rcond=None)[1][0])
        for columns in (matrix, together)
    ]
    gain = len(matrix) * math.log(sums[1] / sums[0])
    assert told.delta_aic == pytest.approx(2.0 - gain, abs=1e-6)
    assert told.delta_bic == pytest.approx(math.log(len(matrix)) - gain, abs=1e-6)


def test_a_slip_at_the_start_is_seen() -> None:
    window = made(6)
    slipping = replace(window, yaw_rate=window.yaw_rate - 0.3 * np.exp(-window.time / 0.05))
    (slip,) = (v for v in run_hypothesis_tests(slipping, SETTINGS) if v.parameter == "slip")
    assert slip.rejected
    assert slip.value == pytest.approx(0.3 * math.sqrt(0.05 / 2.0 / 0.4), rel=0.5)  # its mean square by hand


@pytest.mark.parametrize("runs", [5, pytest.param(20, marks=pytest.mark.long)])
def test_coloured_noise_is_no_slip(runs: int) -> None:
    # 20 runs with noise correlated over 0.2 s: at 1e-3 none is expected, 2 come once in 5000. By residuals
    # that are not made white 4 of these were rejected.
    kept, rng = math.exp(-0.01 / 0.2), np.random.default_rng(5)
    noise = rng.standard_normal((20, 151, 2))
    for k in range(1, 151):
        noise[:, k] = kept * noise[:, k - 1] + math.sqrt(1.0 - kept**2) * noise[:, k]
    quiet = made(0, noise=0.0)
    rejected = 0
    for one in 0.02 * noise[:runs]:
        window = replace(
            quiet,
            speed=constant_speed(3.6),
            lean_rate=quiet.lean_rate + one[:, 0],
            yaw_rate=quiet.yaw_rate + one[:, 1],
        )
        verdict = _no_slip(window, SETTINGS, fit_window(window, SETTINGS))
        assert verdict is not None
        rejected += verdict.rejected
    assert rejected < 2
