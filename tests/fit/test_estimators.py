"""The estimators: right without noise, equal where theory says so, honest where nothing can be known."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.integrate import solve_ivp, trapezoid
from scipy.linalg import block_diag, expm
from tms_fit.estimate import Estimate
from tms_fit.estimators import ESTIMATORS, kalman_rts, least_squares
from tms_fit.least_squares.make_estimate import variance_accounted_for
from tms_fit.least_squares.problem import Problem
from tms_fit.parameters import BIASES, DEFAULT_FREE, INITIAL
from tms_fit.settings import Settings
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window
from tms_model import bicycle_names, discretise, linear_system, load_bicycle, response, yaw_rate

TRUTH = {
    "initial_lean": 0.03,
    "initial_steer": -0.02,
    "initial_lean_rate": 0.5,
    "initial_steer_rate": -0.8,
    "lean_rate_bias": 0.01,
    "yaw_rate_bias": -0.02,
}
SUBSETS = [subset for count in range(1, 7) for subset in combinations((*INITIAL, *BIASES), count)]


def made_window(
    truth: dict[str, float],
    *,
    bicycle: str = "tms_eq_10_1",
    speed: float = 3.6,
    noise: float = 0.0,
    delay: float = 0.0,
    seed: int = 1,
    count: int = 150,
    step: float = 0.01,
    torque: bool = False,
    missing: bool = False,
    jitter: bool = False,
) -> Window:
    """A window with what it measures made from `truth` at its start, `delay` before the first sample."""
    rng = np.random.default_rng(seed)
    time = np.arange(count) * step
    if jitter:
        time[1:] = np.round(time[1:] + rng.uniform(-0.3, 0.3, count - 1) * step, 9)
    system = linear_system(load_bicycle(bicycle), speed)
    known = 0.05 * np.cos(7.0 * time) if torque else None
    states = response(system, np.array([truth.get(name, 0.0) for name in INITIAL]), time + delay, known)
    measured = np.stack([states[:, 2], yaw_rate(system, states)], axis=1)
    measured += [truth.get(name, 0.0) for name in BIASES] + noise * rng.standard_normal((count, 2))
    if missing:
        measured[rng.random((count, 2)) < 0.1] = np.nan
        measured[20:24] = np.nan
    return Window(
        0,
        time,
        measured[:, 0],
        measured[:, 1],
        load_bicycle(bicycle),
        constant_speed(speed),
        known,
        delay=delay,
    )


def settings(free: tuple[str, ...], fixed: dict[str, float] | None = None) -> Settings:
    return Settings(free=free, fixed=fixed or {}, noise="white")


def assert_same(one: Estimate, other: Estimate, precision: float) -> None:
    """The same answer, to a share of its standard errors."""
    assert (one.status, other.status) == ("ok", "ok")
    assert one.names == other.names
    np.testing.assert_allclose((one.values - other.values) / other.std, 0.0, atol=precision)
    np.testing.assert_allclose(one.std, other.std, rtol=100.0 * precision)
    assert (one.sample_count, one.degrees_of_freedom) == (other.sample_count, other.degrees_of_freedom)


# The estimator strike is about the first sample, whatever the delay.
@pytest.mark.parametrize("estimator", [name for name in ESTIMATORS if name != "strike"])
@pytest.mark.parametrize("bicycle", bicycle_names())
def test_every_estimator_is_exact_without_noise(estimator: str, bicycle: str) -> None:
    window = made_window({"initial_lean_rate": -0.37}, bicycle=bicycle, delay=0.0042)
    answer = ESTIMATORS[estimator](window, settings(("initial_lean_rate",)))
    assert answer.status == "ok"
    assert answer.parameters["initial_lean_rate"] == pytest.approx(-0.37, rel=1e-8)
    assert answer.std[0] < 1e-8
    assert all(vaf == pytest.approx(1.0, abs=1e-12) for vaf in answer.vaf.values())


@pytest.mark.parametrize("estimator", ["least_squares", "kalman_rts"])
def test_all_unknowns_at_once(estimator: str) -> None:
    answer = ESTIMATORS[estimator](
        made_window(TRUTH, torque=True, delay=0.003), settings((*INITIAL, *BIASES))
    )
    assert answer.parameters == pytest.approx(TRUTH, abs=1e-7)


@pytest.mark.parametrize("estimator", ["least_squares", "kalman_rts"])
def test_what_is_known_is_held(estimator: str) -> None:
    known = {name: value for name, value in TRUTH.items() if name != "initial_lean_rate"}
    answer = ESTIMATORS[estimator](made_window(TRUTH, noise=0.01), settings(("initial_lean_rate",), known))
    assert answer.names == ("initial_lean_rate",)
    low, high = answer.ci95[0]
    assert low < 0.5 < high
    wrong = ESTIMATORS[estimator](made_window(TRUTH, noise=0.01), settings(("initial_lean_rate",)))
    assert wrong.residual_std > 2.0 * answer.residual_std


@pytest.mark.parametrize("free", SUBSETS, ids=lambda free: "+".join(free))
def test_least_squares_is_kalman_smoothing(free: tuple[str, ...]) -> None:
    # Without process noise the two are one: any unknowns, samples missing, stamps jittering, a torque acting,
    # the start between two samples.
    window = made_window(TRUTH, noise=0.02, torque=True, missing=True, jitter=True, delay=0.0037)
    fixed = {name: value for name, value in TRUTH.items() if name not in free}
    by_squares, by_filter = (
        ESTIMATORS[name](window, settings(free, fixed)) for name in ("least_squares", "kalman_rts")
    )
    assert_same(by_filter, by_squares, 1e-9)


@pytest.mark.parametrize("free", [("initial_lean_rate",), DEFAULT_FREE, INITIAL])
def test_uncertain_start_widens_both_alike(free: tuple[str, ...]) -> None:
    window = made_window(TRUTH, noise=0.02, delay=0.004)
    uncertain = replace(window, delay_std=0.002)
    plain, wide = (least_squares.fit_window(one, settings(free)) for one in (window, uncertain))
    assert_same(kalman_rts.estimate(uncertain, settings(free)), wide, 1e-6)
    index = free.index("initial_lean_rate")
    # By hand: the estimate at a start 1 ms later, less that 1 ms earlier, is its derivative.
    ends = [
        least_squares.fit_window(replace(window, delay=0.004 + h), settings(free)).values[index]
        for h in (-1e-3, 1e-3)
    ]
    by_hand = (ends[1] - ends[0]) / 2e-3 * 0.002
    scale = wide.residual_std**2 / plain.residual_std**2
    assert wide.std[index] ** 2 == pytest.approx(scale * plain.std[index] ** 2 + by_hand**2, rel=1e-3)
    assert wide.std[index] > plain.std[index]


@pytest.mark.parametrize("free", [("initial_lean_rate",), INITIAL, (*INITIAL, *BIASES)])
def test_least_squares_by_other_means(free: tuple[str, ...]) -> None:
    # The textbook: columns from an integrator, normal equations, s^2 (A'A)^-1.
    window = made_window(TRUTH, noise=0.02)
    columns = []
    for name in free:
        if name in BIASES:
            column = np.zeros((150, 2))
            column[:, BIASES.index(name)] = 1.0
        else:
            start = np.eye(4)[INITIAL.index(name)]
            system = linear_system(window.bicycle, window.start_speed)
            found = solve_ivp(
                lambda _, x, a=system.a: a @ x, (0, 1.5), start, "DOP853", window.time, rtol=1e-12, atol=1e-13
            )
            column = np.stack([found.y[2], system.yaw @ found.y], axis=1)
        columns.append(column.ravel())
    matrix, target = np.array(columns).T, window.measured.ravel()
    normal = np.linalg.inv(matrix.T @ matrix)
    values = normal @ matrix.T @ target
    variance = np.sum((target - matrix @ values) ** 2) / (300 - len(free))
    answer = least_squares.fit_window(window, settings(free))
    np.testing.assert_allclose(answer.values, values, rtol=1e-6)
    np.testing.assert_allclose(answer.covariance, variance * normal, rtol=1e-5, atol=1e-12)
    assert answer.residual_std == pytest.approx(math.sqrt(variance), rel=1e-9)


def test_smoothing_is_that_of_filterpy() -> None:
    # filterpy's own smoother inverts predicted covariances, which needs some process noise (1e-14 here) and a
    # short record. Its prior, which ours takes out again, is put into ours: information adds.
    prior, sigma = np.diag([0.1, 0.1, 1.0, 2.0]) ** 2, 0.02
    window = made_window({"initial_lean_rate": 0.5, "initial_steer_rate": -0.8}, noise=sigma, count=40)
    kalman = KalmanFilter(dim_x=4, dim_z=2)
    kalman.x, kalman.P = np.zeros((4, 1)), prior.copy()
    system = linear_system(window.bicycle, window.start_speed)
    kalman.F, _ = discretise(system, 0.01)
    kalman.H = np.stack([[0.0, 0.0, 1.0, 0.0], system.yaw])
    kalman.R, kalman.Q = sigma**2 * np.eye(2), 1e-14 * np.eye(4)
    states, covariances = [], []
    for k, sample in enumerate(window.measured):
        if k:
            kalman.predict()
        kalman.update(sample.reshape(2, 1))
        states.append(kalman.x.copy())
        covariances.append(kalman.P.copy())
    theirs, their_covariances, _, _ = kalman.rts_smoother(np.array(states), np.array(covariances))

    rough = least_squares.fit_window(window, settings(INITIAL)).covariance / sigma**2
    values, inverse = kalman_rts.smooth_problem(Problem(window, INITIAL), rough)
    information = np.linalg.inv(inverse) / sigma**2
    covariance = np.linalg.inv(information + np.linalg.inv(prior))
    np.testing.assert_allclose(covariance @ information @ values, theirs[0][:, 0], rtol=0.0, atol=2e-6)
    np.testing.assert_allclose(covariance, their_covariances[0], rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("free", [DEFAULT_FREE, (*INITIAL, *BIASES)])
def test_smoothing_with_process_noise_is_generalised_least_squares(free: tuple[str, ...]) -> None:
    # Disturbances make the measurements correlated: y = A p + M w + n, so that their covariance is
    # C = M Q M' + sigma^2 I and p = (A' C^-1 A)^-1 A' C^-1 y. Transitions and Q (Van Loan) are scipy's.
    window = made_window(TRUTH, noise=0.02, torque=True, missing=True, jitter=True, delay=0.0037, count=60)
    fixed = {name: value for name, value in TRUTH.items() if name not in free}
    density = (0.03, 0.3)  # [rad/s^2/sqrt(Hz)]
    answer = kalman_rts.estimate(window, settings(free, fixed), density)
    system = linear_system(window.bicycle, window.start_speed)
    rows = np.stack([np.eye(4)[2], system.yaw])
    maps, covariances, columns, states = [], [], [], np.eye(4)
    for duration in np.diff(window.time, prepend=-window.delay):
        block = np.block(
            [[-system.a, np.diag([0.0, 0.0, *np.square(density)])], [np.zeros((4, 4)), system.a.T]]
        )
        whole = expm(block * duration)
        transition = whole[4:, 4:].T
        maps = [transition @ one for one in maps] + [np.eye(4)]
        covariances.append(transition @ whole[:4, 4:])
        states = transition @ states
        # to sample k from disturbances 0..k, then zeros
        columns.append((np.hstack([rows @ states, np.eye(2)]), [rows @ one for one in maps]))
    count = len(columns)
    disturbed = np.zeros((2 * count, 4 * count))
    for k, (_, parts) in enumerate(columns):
        disturbed[2 * k : 2 * k + 2, : 4 * k + 4] = np.hstack(parts)
    sigma = answer.noise["noise_std"]
    spread = disturbed @ block_diag(*covariances) @ disturbed.T + sigma**2 * np.eye(2 * count)
    forced = response(system, np.zeros(4), window.time + window.delay, window.steer_torque)
    target = (window.measured - np.stack([forced[:, 2], yaw_rate(system, forced)], axis=1)).ravel()
    design = np.vstack([one for one, _ in columns])
    names = (*INITIAL, *BIASES)
    target -= design @ [fixed.get(name, 0.0) for name in names]
    good = np.isfinite(target)
    design = design[good][:, [names.index(name) for name in free]]
    weighted = np.linalg.solve(spread[np.ix_(good, good)], design)
    covariance = np.linalg.inv(design.T @ weighted)
    std = np.sqrt(np.diag(covariance))
    assert answer.names == free
    np.testing.assert_allclose((answer.values - covariance @ weighted.T @ target[good]) / std, 0.0, atol=1e-6)
    np.testing.assert_allclose(answer.covariance, covariance, rtol=1e-6, atol=1e-6 * std.min() ** 2)
    without = kalman_rts.estimate(window, settings(free, fixed))
    assert (answer.std > 1.05 * without.std)[free.index("initial_lean_rate")]


def test_a_fixed_slip_is_taken_off_before_smoothing() -> None:
    window = replace(made_window(TRUTH, noise=0.02), slip_window=0.3)
    held = settings(INITIAL, {"slip_yaw_rate": -0.4})
    assert_same(kalman_rts.estimate(window, held), least_squares.fit_window(window, held), 1e-9)


def test_som2011_looks_at_the_lean_rate_only() -> None:
    window = made_window(TRUTH, noise=0.02)
    answer = ESTIMATORS["som2011"](window, settings((*INITIAL, *BIASES)))
    elsewhere = replace(window, yaw_rate=window.yaw_rate + 5.0)
    again = ESTIMATORS["som2011"](elsewhere, settings(("yaw_rate_bias",)))
    alone = least_squares.fit_window(
        replace(window, yaw_rate=np.full(150, np.nan)), settings(("initial_lean_rate",))
    )
    assert answer.names == ("initial_lean_rate",)
    np.testing.assert_array_equal(answer.values, again.values)
    np.testing.assert_array_equal(answer.covariance, again.covariance)
    np.testing.assert_array_equal(answer.values, alone.values)
    assert set(answer.vaf) == {"lean_rate"}
    assert answer.sample_count == 150


def absent(window: Window, *channels: str) -> Window:
    return replace(window, **{channel: np.full(len(window.time), math.nan) for channel in channels})  # type: ignore[arg-type]


UNKNOWABLE = {
    "bias of an absent channel": (
        absent(made_window(TRUTH), "yaw_rate"),
        ("initial_lean_rate", "yaw_rate_bias"),
    ),
    "only the bias of an absent channel": (absent(made_window(TRUTH), "lean_rate"), ("lean_rate_bias",)),
    "known torque, no motion to tell": (
        absent(made_window({}, torque=True), "yaw_rate"),
        ("initial_lean_rate", "yaw_rate_bias"),
    ),
}


@pytest.mark.parametrize("estimator", ["least_squares", "kalman_rts"])
@pytest.mark.parametrize("case", UNKNOWABLE)
def test_what_can_not_be_told_apart_is_not_observable(estimator: str, case: str) -> None:
    window, free = UNKNOWABLE[case]
    answer = ESTIMATORS[estimator](window, settings(free))
    assert answer.status == "not_observable"
    assert "free fewer" in answer.message
    assert answer.names == ()
    assert len(answer.values) == 0
    assert answer.parameters == {}


SHORT = {
    "a fifth of a second": made_window(TRUTH, count=21),
    "ten samples": made_window(TRUTH, count=6, step=0.1),
    "nothing measured": absent(made_window(TRUTH), "lean_rate", "yaw_rate"),
    "one sample": made_window(TRUTH, count=1),
}


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("case", SHORT)
def test_what_is_too_short_is_said(estimator: str, case: str) -> None:
    answer = ESTIMATORS[estimator](SHORT[case], settings(DEFAULT_FREE))
    assert answer.status == "too_short"
    assert "expected at least" in answer.message
    assert "found" in answer.message
    assert answer.names == ()


def test_interval_by_hand() -> None:
    # Student's t leaves 2.5 % above 2.2281 with 10 degrees of freedom: 1 +- 2.2281 * 0.5.
    one = Estimate("x", "ok", "", ("a",), np.array([1.0]), np.array([[0.25]]), degrees_of_freedom=10)
    np.testing.assert_allclose(one.ci95, [[1.0 - 1.11405, 1.0 + 1.11405]], atol=5e-5)
    assert one.std[0] == 0.5


def test_variance_accounted_for_by_hand() -> None:
    # Measured +-1: variance 1. Predicted half of it: +-0.5 remain, variance 0.25: 0.75. A constant off counts
    # for nothing.
    window = replace(
        made_window(TRUTH, count=4), lean_rate=np.array([1.0, -1.0, 1.0, -1.0]), yaw_rate=np.full(4, math.nan)
    )
    predicted = np.stack([0.5 * window.lean_rate + 7.0, np.zeros(4)], axis=1)
    assert variance_accounted_for(window, predicted) == {"lean_rate": pytest.approx(0.75)}


@pytest.mark.parametrize("delay", [0.0, 0.0013, 0.005, 0.0099])
@pytest.mark.parametrize("free", [("initial_lean_rate",), DEFAULT_FREE])
def test_start_between_two_samples_is_found(delay: float, free: tuple[str, ...]) -> None:
    window = made_window({"initial_lean_rate": 0.5}, delay=delay)
    found = least_squares.refine_start(replace(window, delay=0.0), settings(free), 0.01)
    assert found.delay == pytest.approx(delay, abs=2e-6)
    assert found.delay_std < 1e-5
    assert found.start_ns == -round(found.delay * 1e9)


def test_start_is_never_less_certain_than_a_uniform_guess() -> None:
    # Nothing but noise: the start may be anywhere between the samples, 0.01 / sqrt(12) = 0.0029 s.
    window = made_window({}, noise=0.02)
    found = least_squares.refine_start(window, settings(("initial_lean_rate",)), 0.01)
    assert found.delay_std == pytest.approx(0.01 / math.sqrt(12.0), rel=0.1)
    assert found.delay_std <= 0.01 / math.sqrt(12.0) * (1.0 + 1e-4)
    assert 0.0 <= found.delay <= 0.01


@pytest.mark.parametrize("peak", [-0.5, -0.02, -0.001, 0.0, 0.004, 0.0099, 0.011, 0.3])
@pytest.mark.parametrize("spread", [2e-4, 0.003, 1.0])
def test_a_start_between_two_samples_is_a_normal_distribution_cut_off(peak: float, spread: float) -> None:
    # Against the density, scaled by its largest value, in steps ten times finer.
    mean, std = least_squares.truncated_normal(peak, spread, 0.01)
    nearest = min(max(peak, 0.0), 0.01)
    width = min(0.01, 12.0 * spread, 60.0 * spread**2 / max(abs(peak - nearest), 1e-9))
    x = np.linspace(max(nearest - width, 0.0), min(nearest + width, 0.01), 4001)
    density = np.exp(-0.5 * (x - nearest) * (x + nearest - 2.0 * peak) / spread**2)
    whole, first, second = (trapezoid((x - nearest) ** k * density, x) for k in range(3))
    assert mean == pytest.approx(nearest + first / whole, abs=3e-3 * std)
    assert std == pytest.approx(math.sqrt(second / whole - (first / whole) ** 2), rel=3e-3)


@pytest.mark.long
def test_a_kick_does_not_misdate_the_strike() -> None:
    # A start upright and straight puts the instant of a strike that kicks the steering at one of the samples.
    # With all four initial states free the response says nothing of it: only that it lies between them.
    truth = {"initial_lean_rate": 0.25, "initial_steer_rate": -1.2, "initial_lean": 0.01}
    for seed in range(4):
        window = made_window(truth, noise=0.02, delay=0.005, seed=seed)
        upright = least_squares.refine_start(window, settings(DEFAULT_FREE), 0.01)
        assert upright.delay - 0.005 > 5.0 * upright.delay_std
        free = least_squares.refine_start(window, Settings(), 0.01)
        assert free.delay == pytest.approx(0.005, abs=0.001)
        assert free.delay_std == pytest.approx(0.01 / math.sqrt(12.0), rel=0.05)


def test_coloured_residuals_are_told() -> None:
    window = made_window({"initial_lean_rate": 0.5}, noise=0.02)
    wave = replace(window, yaw_rate=window.yaw_rate + 0.1 * np.sin(2.0 * np.pi * 3.0 * window.time))
    white, coloured = (
        least_squares.fit_window(one, settings(("initial_lean_rate",))) for one in (window, wave)
    )
    assert abs(white.residual_autocorrelation) < 4.0 / math.sqrt(150)
    assert "too narrow" not in white.message
    assert coloured.residual_autocorrelation > 0.7  # cos(2 pi 3 / 100) = 0.98 of the wave, less the noise
    assert "too narrow" in coloured.message


def test_a_feedback_gain_free_of_the_gyroscopes_noise(make_run: Any, fit_run: Any) -> None:
    # The torque is 7 times the true lean rate. Regressed on the measured one, it would come out short by the
    # noise's share.
    gains = []
    for seed in range(12):
        ((strike),) = fit_run(make_run("delft_push", seed=seed, duration=5.0), estimators=("least_squares",))
        assert strike.window is not None
        assert strike.window.steer_torque is None
        gains.append(strike.window.lean_rate_gain)
    spread = np.std(gains) / math.sqrt(len(gains))
    assert abs(np.mean(gains) - 7.0) < 4.0 * spread
    assert spread < 0.03
