"""A speed that was not measured over the window falls from when it was measured on; the interval knows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tms_bag.samples import SpeedSamples
from tms_fit.diagnostics.hypothesis_tests import run_hypothesis_tests
from tms_fit.estimators.least_squares import fit_window
from tms_fit.messages import estimate_records
from tms_fit.recording_fit import fit_recording
from tms_fit.response.discretization import speeds_at
from tms_fit.response.prediction import predict_by
from tms_fit.settings import Settings
from tms_fit.speed_profile import (
    ROLLING_RESISTANCE_PRIOR,
    STALE_STD_SHARE,
    UNSTATED_STD_SHARE,
    SpeedProfile,
    fit_speed_profile,
)
from tms_fit.streaming.live_fit import INPUTS, LiveFit
from tms_fit.streaming.synchronizer import Series
from tms_fit.strike_fit import StrikeFit
from tms_model.acceleration import coasting_loss
from tms_sim.run import SimulatedRun

CAMERA = {"speed_sensor__kind": "camera", "speed_sensor__camera_start": 3.3}  # 0.7 s before the strike
LOSS = 9.7  # [m/s^2]


def curve_of(time: list[float], speed: list[float], std: float = float("nan")) -> SpeedProfile:
    """What is made of samples of a window of 1.5 s."""
    variance = np.full(len(time), std**2)
    return fit_speed_profile(np.array(time), np.array(speed), variance, "auto", 1.5, LOSS)


@pytest.fixture(scope="module")
def filmed(make_run: Any) -> SimulatedRun:
    return make_run("gym_run", seed=2, **CAMERA)  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def strike(filmed: SimulatedRun, fit_run: Any) -> StrikeFit:
    (found,) = fit_run(filmed)
    return found  # type: ignore[no-any-return]


# The curve.


def test_one_speed_before_the_window_falls_as_on_some_floor() -> None:
    curve = curve_of([-0.6], [3.9], 0.02)
    assert (curve.extrapolated, curve.is_stale, curve.origin) == (True, False, -0.6)
    assert curve.at(-0.6) == 3.9
    assert curve.at(0.4) == pytest.approx(3.9 - ROLLING_RESISTANCE_PRIOR[0] * LOSS)
    np.testing.assert_allclose(np.sqrt(np.diag(curve.covariance)), [0.02, ROLLING_RESISTANCE_PRIOR[1] * LOSS])


def test_a_single_speed_without_a_stated_error_is_known_to_a_share() -> None:
    assert curve_of([-0.6], [4.0]).std == pytest.approx(UNSTATED_STD_SHARE * 4.0)


def test_a_speed_of_long_ago_is_a_guess() -> None:
    curve = curve_of([-30.0], [4.0], 0.02)
    assert (curve.is_stale, curve.origin, curve.std) == (True, 0.0, pytest.approx(STALE_STD_SHARE * 4.0))


def test_speeds_with_a_stated_error_tell_the_slope() -> None:
    # Two of 0.02 m/s one second apart: slope -0.5 +- 0.0283; the floor says -0.485 +- 0.485. Each by its
    # inverse variance: (-0.5 * 1250 - 0.485 * 4.2516) / 1254.25 = -0.49995.
    curve = curve_of([0.2, 1.2], [3.5, 3.0], 0.02)
    np.testing.assert_allclose(curve.coefficients, [3.25, -0.49995], rtol=1e-5)
    np.testing.assert_allclose(np.diag(curve.covariance), [0.0002, 1.0 / 1254.2516], rtol=1e-5)
    assert curve.origin == pytest.approx(0.7)
    assert curve.coefficients[1] != curve_of([0.2, 1.2], [3.5, 3.0]).coefficients[1]  # error not stated


def test_speeds_that_end_soon_after_the_strike_are_prolonged_by_a_straight_line() -> None:
    time = np.arange(0.0, 0.4, 0.02)
    rng = np.random.default_rng(5)
    noisy = 3.6 - 0.6 * time + 0.01 * rng.standard_normal(len(time))
    curve = curve_of(time.tolist(), noisy.tolist())
    assert curve.extrapolated
    assert len(curve.coefficients) == 2
    assert abs(float(curve.at(1.5)) - 2.7) < 3.0 * 1.3 * np.sqrt(curve.covariance[1, 1])
    assert np.sqrt(curve.covariance[1, 1]) == pytest.approx(0.01 / np.sqrt(len(time)) / time.std(), rel=0.4)


@pytest.mark.parametrize("slope", [0.0, -0.6])
def test_speeds_all_over_the_window_are_followed_as_ever(slope: float) -> None:
    time = np.arange(-0.02, 1.5, 0.02)
    rng = np.random.default_rng(6)
    curve = curve_of(time.tolist(), (3.6 + slope * time + 0.01 * rng.standard_normal(len(time))).tolist())
    assert not curve.extrapolated
    assert curve.origin == 0.0
    assert curve.constant == (slope == 0.0)


def test_of_two_topics_with_the_same_stamps_the_one_that_states_its_error_counts() -> None:
    nan = float("nan")
    one, other = Series(), Series()
    for series, order in ((one, ((5, 3.0, nan), (5, 3.0, 0.04))), (other, ((5, 3.0, 0.04), (5, 3.0, nan)))):
        for reading in order:
            series.add(*reading)
    assert (
        (one.time, one.value, one.variance)
        == (other.time, other.value, other.variance)
        == ([5], [3.0], [0.04])
    )


# The fit.


@pytest.mark.long
def test_speed_falls_from_when_it_was_measured(strike: StrikeFit) -> None:
    window, estimate = strike.window, strike.estimates[0]
    assert window is not None
    curve = window.speed
    fallen = estimate.parameters["rolling_resistance"] * coasting_loss(window.bicycle)
    lead = -window.delay - curve.origin
    assert 0.4 < lead < 0.7
    assert estimate.known["speed"] == pytest.approx(curve.coefficients[0] - fallen * lead, abs=1e-12)
    assert strike.speed == estimate.known["speed"]
    nonlinear = {"rolling_resistance": 0.06}
    later = speeds_at(window, nonlinear, np.array([curve.origin, curve.origin + 1.0]))
    np.testing.assert_allclose(later, curve.coefficients[0] - [0.0, 0.06 * coasting_loss(window.bicycle)])


def test_what_was_chosen_is_said_with_what_would_be_otherwise(
    strike: StrikeFit, filmed: SimulatedRun
) -> None:
    estimate = strike.estimates[0]
    (why,) = [one for one in estimate.chosen if one.startswith("rolling resistance found")]
    otherwise = float(why.rpartition("would be ")[2].removesuffix(" rad/s"))
    truth = float(filmed.trajectory.at(np.array([4.005])).lean_rate[0])
    assert abs(estimate.parameters["initial_lean_rate"] - truth) < 0.5 * abs(otherwise - truth)
    assert strike.window is not None
    lead = -strike.window.delay - strike.window.speed.origin
    assert f"{filmed.speed.speed[0]:.2f} m/s at {lead:.2f} s before the start on" in estimate.message


def test_band_and_jacobian_know_that_the_start_speed_follows_the_resistance(strike: StrikeFit) -> None:
    assert strike.window is not None
    estimate = strike.estimates[0]
    predicted, slopes = predict_by(strike.window, estimate)
    np.testing.assert_allclose(predicted, estimate.predicted, atol=1e-12)
    np.testing.assert_allclose(slopes, estimate.jacobian, atol=1e-6 * np.abs(estimate.jacobian).max())


def test_interval_holds_the_measured_speeds_uncertainty(strike: StrikeFit) -> None:
    # First order: var(p) = var(p at this speed) + (dp/dv)^2 var(v), dp/dv by refitting at two other speeds.
    # Of a window with a hundredth of its residuals: what a first order leaves out is in proportion to them.
    estimate = strike.estimates[0]
    assert strike.window is not None
    lean_rate, yaw_rate = (estimate.predicted + 0.01 * estimate.residual).T
    window = replace(strike.window, lean_rate=lean_rate, yaw_rate=yaw_rate)
    settings = Settings(free=estimate.names, noise="white", loss="squares")
    curve = replace(window.speed, covariance=np.diag([0.05**2, window.speed.covariance[1, 1]]))
    known = replace(curve, covariance=np.diag([0.0, curve.covariance[1, 1]]))

    def at(change: float) -> np.ndarray:
        moved = replace(known, coefficients=known.coefficients + np.array([change, 0.0]))
        return fit_window(replace(window, speed=moved), settings).values

    with_it, without = (fit_window(replace(window, speed=one), settings) for one in (curve, known))
    expected = without.std**2 + ((at(1e-3) - at(-1e-3)) / 2e-3 * 0.05) ** 2
    np.testing.assert_allclose(with_it.std**2, expected, rtol=0.02)
    index = with_it.names.index("rolling_resistance")
    assert with_it.std[index] > 1.05 * without.std[index]


@pytest.mark.parametrize("seeds", [(1,), pytest.param((1, 4, 7), marks=pytest.mark.long)])
@pytest.mark.long
def test_intervals_hold_where_a_constant_speed_would_not(
    make_run: Any, fit_run: Any, seeds: tuple[int, ...]
) -> None:
    missed = 0
    for seed in seeds:
        run = make_run("gym_run", seed=seed, **CAMERA)
        truth = float(run.trajectory.at(np.array([4.005])).lean_rate[0])
        (found,) = fit_run(run, estimators=("least_squares",))
        (constant,) = fit_run(run, estimators=("least_squares",), speed_model="constant")
        index = found.estimates[0].names.index("initial_lean_rate")
        low, high = found.estimates[0].ci95[index]
        assert low <= truth <= high
        assert found.estimates[0].std[index] < 0.05
        near, far = (one.estimates[0].parameters["initial_lean_rate"] - truth for one in (found, constant))
        assert abs(near) < 0.5 * abs(far)
        index = constant.estimates[0].names.index("initial_lean_rate")
        missed += bool(constant.estimates[0].ci95[index, 0] > truth)
    assert missed >= 2 * len(seeds) / 3


def test_where_the_fit_is_told_what_is_free_the_interval_still_knows(
    filmed: SimulatedRun, fit_run: Any
) -> None:
    start = ("initial_lean_rate", "initial_steer_rate", "initial_lean", "initial_steer")
    truth = float(filmed.trajectory.at(np.array([4.005])).lean_rate[0])
    (asked,) = fit_run(filmed, free=start, estimators=("least_squares",))
    (estimate,) = asked.estimates
    assert "rolling_resistance" not in estimate.names
    assert estimate.ci95[0, 0] <= truth <= estimate.ci95[0, 1]
    assert "C_r = 0.050 +- 0.050" in estimate.message


@pytest.mark.long
def test_a_known_resistance_narrows_the_interval(
    filmed: SimulatedRun, fit_run: Any, strike: StrikeFit
) -> None:
    free = strike.estimates[0]
    stds = [free.std[free.names.index("initial_lean_rate")]]
    for known in ({"priors": {"rolling_resistance": (0.06, 0.002)}}, {"fixed": {"rolling_resistance": 0.06}}):
        (found,) = fit_run(filmed, estimators=("least_squares",), **known)
        (estimate,) = found.estimates
        stds.append(estimate.std[estimate.names.index("initial_lean_rate")])
        assert estimate.chosen == () or "rolling resistance found" not in estimate.chosen[0]
    assert stds[2] <= stds[1] < stds[0]


@pytest.mark.long
def test_filter_and_smoother_agree_with_least_squares(filmed: SimulatedRun, fit_run: Any) -> None:
    (found,) = fit_run(filmed, noise="white", loss="squares")
    squares, smoothed = found.estimates
    assert squares.names == smoothed.names
    assert "smoother" in smoothed.message
    assert (np.abs(squares.values - smoothed.values) < 1e-6 * squares.std).all()
    np.testing.assert_allclose(smoothed.std, squares.std, rtol=1e-6)


@pytest.mark.long
def test_the_supplements_fit_keeps_its_constant_speed(filmed: SimulatedRun, fit_run: Any) -> None:
    (found,) = fit_run(filmed, estimators=("som2011",))
    (estimate,) = found.estimates
    assert estimate.names == ("initial_lean_rate",)
    assert estimate.known["speed"] == filmed.speed.speed[0]


@pytest.mark.long
def test_constant_speed_is_tested_by_the_rates_alone(strike: StrikeFit) -> None:
    assert strike.window is not None
    found = {one.hypothesis: one for one in run_hypothesis_tests(strike.window, Settings())}
    assert found["constant speed"].parameter == "rolling_resistance"


@pytest.mark.long
def test_live_is_offline_to_the_byte_with_the_cameras_speed(filmed: SimulatedRun) -> None:
    offline = fit_recording(filmed.recording()).strikes
    live = LiveFit(Settings(), preview_period=60.0)
    answers = [
        answer
        for record in filmed.records()
        if (topic := record.topic.removeprefix("/")) in INPUTS
        for answer in live.process(topic, record.data)
    ] + live.finish()
    expected = [record.data for one in offline for record in estimate_records(one)]
    assert [one.data for one in answers if one.topic == "/estimate"] == expected
    assert offline[0].window is not None
    assert offline[0].window.speed.std == pytest.approx(float(np.sqrt(filmed.speed.variance[0])))


def test_a_speed_of_the_passage_before_is_not_believed(make_run: Any, fit_run: Any) -> None:
    # Coasting at a constant 3.6 m/s; the only speed is from 3.5 s before the strike, and 10 % off.
    run = make_run("tms_strike", strike__time=5.0, duration=8.0)
    old = SpeedSamples(run.speed.time_ns[75:76], 1.1 * run.speed.speed[75:76])
    (found,) = fit_run(replace(run, speed=old), estimators=("least_squares",))
    (estimate,) = found.estimates
    assert {"speed", "rolling_resistance"} < {*estimate.names}
    values = dict(zip(estimate.names, estimate.ci95, strict=True))
    assert values["speed"][0] <= 3.6 <= values["speed"][1]
    assert values["initial_lean_rate"][0] <= 0.5 <= values["initial_lean_rate"][1]
    assert "no speed was measured within 3 s" in estimate.chosen[0]


def test_one_reading_of_no_speed_is_no_division_by_zero() -> None:
    # Known to 0.1 mm/s at best, also where a share of it would be nothing.
    curve = fit_speed_profile(np.array([-0.5]), np.zeros(1), np.full(1, np.nan), "auto", 1.5, 9.81)
    assert np.isfinite(curve.coefficients).all()
    assert np.isfinite(curve.covariance).all()
