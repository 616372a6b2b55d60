"""Strike as a force of unknown onset, duration and size: force response, posterior, estimator."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from tms_bag import recording_from_arrays
from tms_fit.estimators.strike import estimate
from tms_fit.impulse.force import SHAPES, ForcedBicycle
from tms_fit.impulse.posterior import (
    REFINEMENTS,
    UNKNOWNS,
    ImpulsePosterior,
    StrikeSamples,
    coarse_grid,
    evaluate,
    refined_grid,
)
from tms_fit.impulse.prior import impulse_prior, kick_ratio
from tms_fit.recording_fit import fit_recording
from tms_fit.settings import DEFAULT_PRIORS, Settings
from tms_fit.window import Window
from tms_model import ParameterError, linear_system, load_bicycle
from tms_model.bicycle import Array
from tms_model.exponential import expm
from tms_model.response import LEAN_RATE, STEER_RATE

BICYCLE, SPEED = "tms_eq_10_1", 3.6
NOISE = 0.02  # [rad/s]
UNIT = np.eye(4)[:, [LEAN_RATE, STEER_RATE]]


def forced(name: str = BICYCLE, speed: float = SPEED) -> ForcedBicycle:
    return ForcedBicycle(linear_system(load_bicycle(name), speed))


def course(u: Array, duration: float) -> Array:
    """The three shapes (n, 3) of a force at times u since its onset, written out from their definition."""
    w = math.pi / duration
    half_sine = np.sin(w * u)
    flat = np.sin(3.0 * w * u) - half_sine / 3.0
    return math.pi / (2.0 * duration) * np.stack([half_sine, np.sin(2.0 * w * u), flat], axis=1)


@pytest.mark.parametrize(("name", "speed"), [(BICYCLE, 3.6), ("benchmark", 5.0), ("benchmark", 1.0)])
@pytest.mark.parametrize("since", [0.013, 0.05, 0.3])
def test_response_to_a_force_is_the_integral_over_its_course(name: str, speed: float, since: float) -> None:
    bicycle, duration = forced(name, speed), 0.05
    points, weights = leggauss(40)
    length = min(since, duration)
    u = 0.5 * length * (points + 1.0)
    moved = expm(bicycle.system.a * (since - u)[:, None, None]) @ UNIT
    expected = np.einsum("n,nk,nsw->skw", 0.5 * length * weights, course(u, duration), moved).reshape(4, -1)
    found = bicycle.forced_state(np.array(since), np.array(duration), SHAPES)
    assert np.abs(found - expected).max() < 1e-9


def test_a_force_has_unit_integral_and_its_other_shapes_none() -> None:
    points, weights = leggauss(40)
    duration = 0.2
    u = 0.5 * duration * (points + 1.0)
    assert np.allclose(0.5 * duration * weights @ course(u, duration), [1.0, 0.0, 0.0], atol=1e-12)


def test_an_impulse_is_the_limit_of_a_short_force() -> None:
    bicycle = forced()
    since = np.array([-0.001, 0.001, 0.2])
    instant = bicycle.forced(since, np.zeros(3), 1)
    short = bicycle.forced(since, np.full(3, 1e-6), 1)
    assert np.abs(instant - short).max() < 1e-3
    assert not instant[0].any()


def test_a_pitched_sensor_sees_lean_rate_in_its_yaw_rate() -> None:
    pitch, since = 0.1, np.array([0.1])
    level = forced().forced(since, np.zeros(1), 1)[0]
    pitched = replace(forced(), pitch=pitch).forced(since, np.zeros(1), 1)[0]
    assert np.allclose(pitched[0], math.cos(pitch) * level[0] - math.sin(pitch) * level[1])
    assert np.allclose(pitched[1], math.sin(pitch) * level[0] + math.cos(pitch) * level[1])


def struck(
    rng: np.random.Generator, duration: float, ratio: float, noise: float = NOISE, rate: float = 100.0
) -> tuple[Array, Array, float, float]:
    """Times, lean and yaw rate around a strike, its change of the lean rate, and its onset [s]."""
    change = float(rng.uniform(0.2, 0.6) * rng.choice([-1.0, 1.0]))
    onset = 0.5 + float(rng.uniform(0.0, 1.0 / rate))
    time = np.arange(round(1.0 * rate)) / rate
    response = forced().forced(time - onset, np.full(len(time), duration), 1)
    rates = response @ np.array([change, ratio * change])
    return time, rates + noise * rng.standard_normal(rates.shape), change, onset


def posterior(time: Array, rates: Array, change: float, noise: float = NOISE) -> ImpulsePosterior:
    samples = StrikeSamples(forced(), time, rates, impulse_prior(load_bicycle(BICYCLE), Settings(), change))
    good = np.isfinite(rates)
    found = evaluate(samples, coarse_grid(0.44, 0.6, 0.01), lambda values: values[good] / noise)
    for _ in range(REFINEMENTS):
        found = evaluate(samples, refined_grid(found), lambda values: values[good] / noise)
    return found


@pytest.mark.parametrize("duration", [0.0, 0.005, 0.02, 0.05])
@pytest.mark.parametrize("ratio", [0.0, -7.0])
def test_posterior_holds_size_and_onset(duration: float, ratio: float) -> None:
    rng, runs = np.random.default_rng(5), 25
    errors = np.empty((runs, 2))
    for run in range(runs):
        time, rates, change, onset = struck(rng, duration, ratio)
        found = posterior(time, rates, change)
        mean, covariance = found.at(0.9)
        middle, std = found.moments(0.5 * (found.hypotheses.onset + found.hypotheses.end))
        errors[run, 0] = (mean[UNKNOWNS] - change) / math.sqrt(covariance[UNKNOWNS, UNKNOWNS])
        errors[run, 1] = (middle - onset - 0.5 * duration) / std
    # A jump between two samples that turns no steering is the same anywhere between them.
    known = errors if ratio or duration else errors[:, :1]
    # The mean square of 25 standard normal values exceeds 1.75 once in a hundred times.
    assert (np.mean(known**2, axis=0) < 1.75).all()
    assert np.abs(known).max() < 3.5


def test_with_little_noise_the_force_is_found_to_its_digits() -> None:
    time, rates, change, onset = struck(np.random.default_rng(1), 0.02, -7.0, noise=1e-5)
    found = posterior(time, rates, change, noise=1e-5)
    mean, _ = found.at(0.9)
    assert abs(mean[UNKNOWNS] - change) < 2e-4
    assert abs(found.moments(found.hypotheses.onset)[0] - onset) < 2e-4


def test_weights_sum_to_one_and_refining_keeps_the_answer() -> None:
    time, rates, change, _ = struck(np.random.default_rng(2), 0.01, 0.0)
    found = posterior(time, rates, change)
    good = np.isfinite(rates)
    finer = evaluate(found.samples, refined_grid(found), lambda values: values[good] / NOISE)
    (mean, covariance), (other, _) = found.at(0.9), finer.at(0.9)
    assert found.weight.sum() == pytest.approx(1.0)
    assert np.all(np.abs(mean - other) < 0.1 * np.sqrt(np.diag(covariance)))


@pytest.mark.parametrize("name", [BICYCLE, "benchmark", "delft_sbw"])
def test_kick_of_a_blow_is_by_the_whole_mass_matrix(name: str) -> None:
    bicycle = load_bicycle(name)
    ratio, spread = kick_ratio(bicycle)
    lever = bicycle.trail / bicycle.wheelbase * math.cos(bicycle.steer_axis_tilt)
    height = bicycle.mass[0, 0] / -bicycle.stiffness0[0, 0]
    changes = np.linalg.solve(bicycle.mass, [height, 0.5 * bicycle.wheelbase * lever])
    assert ratio == pytest.approx(changes[1] / changes[0])
    assert spread >= abs(ratio)  # a hand may hold the handlebars


def recording(
    duration: float, seed: int, kick: float = -7.0, rate: float = 100.0
) -> tuple[Any, float, float]:
    """A recorded run, its change of the lean rate, and its onset [s]."""
    rng = np.random.default_rng(seed)
    change, onset = float(rng.uniform(0.2, 0.5)), 1.5 + float(rng.uniform(0.0, 0.01))
    time = np.arange(round(3.5 * rate)) / rate
    response = forced().forced(time - onset, np.full(len(time), duration), 1)
    lean, yaw = (response @ np.array([change, kick * change])).T
    noise = NOISE * rng.standard_normal((len(time), 3))
    angle = np.cumsum(lean) / rate
    readings = np.stack([lean, -yaw * np.sin(angle), -yaw * np.cos(angle)], axis=1) + noise
    return recording_from_arrays(time, readings, SPEED), change, onset


def fitted(record: Any, **options: Any) -> Any:
    settings = Settings(estimators=("strike",), fixed={"speed": SPEED}, **options)
    (strike,) = fit_recording(record, load_bicycle(BICYCLE), settings).strikes
    return strike


@pytest.mark.parametrize("duration", [0.005, 0.3])
def test_interval_of_a_kicked_strike_holds_its_size(duration: float) -> None:
    for seed in range(4):
        record, change, onset = recording(duration, seed)
        strike = fitted(record)
        found = strike["strike_lean_rate"]
        assert abs(found.value - change) < 3.5 * found.std
        assert found.std < 0.1 * change + 0.02
        start = (strike.start_ns - int(record.imu.time_ns[0])) / 1e9
        assert start > onset + 0.8 * duration
        truth = forced().forced_state(np.array(start - onset), np.array(duration), 1) @ [
            change,
            -7.0 * change,
        ]
        initial = strike["initial_lean_rate"]
        assert abs(initial.value - truth[LEAN_RATE]) < 3.5 * initial.std


def test_what_is_assumed_narrows_the_interval() -> None:
    record, change, _ = recording(0.0, 3, kick=0.0)
    plain, assumed = fitted(record), fitted(record, assume=("upright", "no_kick"))
    assert assumed["strike_lean_rate"].std < 0.6 * plain["strike_lean_rate"].std
    assert abs(assumed["strike_lean_rate"].value - change) < 4.0 * assumed["strike_lean_rate"].std
    assert abs(assumed["strike_steer_rate"].value) < 1e-3


def test_priors_of_a_user_replace_those_of_the_table() -> None:
    assert set(DEFAULT_PRIORS) >= {"onset_lean", "onset_steer_rate", "yaw_rate_bias"}
    record, _, _ = recording(0.005, 1)
    found = fitted(record, priors={"strike_steer_rate": (0.0, 1e-4), "yaw_rate_bias": (0.05, 1e-4)})
    assert abs(found["strike_steer_rate"].value) < 1e-3
    assert found["yaw_rate_bias"].value == pytest.approx(0.05, abs=1e-3)
    with pytest.raises(ParameterError, match="expected a finite mean and a positive standard deviation"):
        Settings(priors={"onset_lean": (0.0, -1.0)})


def test_fixed_values_stay() -> None:
    record, _, _ = recording(0.005, 2)
    fixed = {"speed": SPEED, "initial_steer": 0.0, "lean_rate_bias": 0.001}
    settings = Settings(estimators=("strike",), fixed=fixed)
    (strike,) = fit_recording(record, load_bicycle(BICYCLE), settings).strikes
    assert not {"initial_steer", "lean_rate_bias"} & set(strike)


def window(values: dict[str, float], noise: float = 1e-3, **options: Any) -> Window:
    """A free response alone."""
    time = np.arange(150) / 100.0
    start = np.array([values.get(name, 0.0) for name in ("lean", "steer", "lean_rate", "steer_rate")])
    rates = forced().free(time) @ start + noise * np.random.default_rng(4).standard_normal((150, 2))
    return Window.from_arrays(time, rates[:, 0], rates[:, 1], speed=SPEED, bicycle=BICYCLE, **options)


def test_without_noise_a_response_is_found_to_its_digits() -> None:
    found = estimate(window({"lean_rate": 0.4, "steer": 0.01}, noise=0.0), Settings())
    assert found["initial_lean_rate"].value == pytest.approx(0.4, abs=1e-4)
    assert found["initial_steer"].value == pytest.approx(0.01, abs=1e-4)


def test_a_response_alone_says_little_of_the_strike_before() -> None:
    found = estimate(window({"lean_rate": 0.4}), Settings())
    assert abs(found["initial_lean_rate"].value - 0.4) < 3.0 * found["initial_lean_rate"].std
    # The lean rate before is known by its prior, and a little by the steer rate that a blow gives.
    assert 0.8 < found["strike_lean_rate"].std / DEFAULT_PRIORS["onset_lean_rate"] < 1.0


def test_a_stated_strike_is_an_impulse_there() -> None:
    record, _, onset = recording(0.005, 1)
    settings = Settings(estimators=("strike",), fixed={"speed": SPEED})
    (strike,) = fit_recording(record, load_bicycle(BICYCLE), settings, (onset + 0.02,)).strikes
    assert strike["strike_lean_rate"].std > 0.15
    assert strike.status == "ok"


@pytest.mark.parametrize("channel", ["lean_rate", "yaw_rate"])
def test_one_channel_is_enough(channel: str) -> None:
    both = window({"lean_rate": 0.4})
    absent = {channel: np.full(150, np.nan)}
    found = estimate(replace(both, **absent), Settings())
    assert found.status == "ok"
    assert f"{channel}_bias" not in found
    assert abs(found["initial_lean_rate"].value - 0.4) < 3.5 * found["initial_lean_rate"].std


def test_friction_is_refused_in_one_line() -> None:
    found = estimate(window({"lean_rate": 0.4}), Settings(fixed={"steer_coulomb_friction": 0.1}))
    assert found.status == "not_observable"
    assert "use least_squares" in found.message


def test_a_short_window_is_too_short() -> None:
    whole = window({"lean_rate": 0.4})
    short = replace(whole, time=whole.time[:10], lean_rate=whole.lean_rate[:10], yaw_rate=whole.yaw_rate[:10])
    assert estimate(short, Settings()).status == "too_short"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_a_reading_that_is_not_finite_is_missing(value: float) -> None:
    record, change, _ = recording(0.005, 1)
    readings = record.imu.angular_velocity.copy()
    readings[[40, 148, 200]] = value
    spoilt = replace(record, imu=replace(record.imu, angular_velocity=readings))
    found = fitted(spoilt)["strike_lean_rate"]
    assert abs(found.value - change) < 4.0 * found.std
