"""Many runs filtered at once: the same as filterpy, statsmodels and least squares one by one."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.stats import chi2, multivariate_normal
from tms_fit.kalman.batch import filter_batch, smooth_start
from tms_fit.kalman.rts import smooth, smoothed_start
from tms_fit.kalman.state_space import STATES, StateSpace, bicycle_space, with_oscillator
from tms_model import linear_system, load_bicycle, response, yaw_rate
from tms_model.response import LEAN_RATE

Array = NDArray[np.float64]
NOISE = 0.02  # [rad/s]
TRUTH = np.array([0.01, -0.02, 0.5, 0.1, 0.003, -0.004])
STD = np.array([0.1, 0.1, 1.0, 2.0, 0.05, 0.05])
SYSTEM = linear_system(load_bicycle("tms_eq_10_1"), 3.6)
TIME = np.cumsum(np.concatenate([[0.0], np.tile([0.01, 0.01, 0.013], 40)]))


def space() -> StateSpace:
    return bicycle_space(SYSTEM, TIME, (NOISE, 1.5 * NOISE), np.zeros(STATES), STD, delay=0.004)


def clean(truth: Array) -> Array:
    states = response(SYSTEM, truth[:4], TIME + 0.004)
    return np.stack([states[:, LEAN_RATE] + truth[4], yaw_rate(SYSTEM, states) + truth[5]], axis=1)


def measured(runs: int, missing: float = 0.0, seed: int = 1) -> Array:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((runs, len(TIME), 2)) * [NOISE, 1.5 * NOISE]
    values = clean(TRUTH) + noise
    values[rng.random(values.shape) < missing] = np.nan
    return values


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_filter_is_filterpys(missing: float) -> None:
    model, runs = space(), measured(4, missing)
    batch = filter_batch(model, runs)
    for number, run in enumerate(runs):
        kalman = KalmanFilter(dim_x=STATES, dim_z=2)
        kalman.x, kalman.P = model.mean.reshape(-1, 1), model.covariance.copy()
        likelihood = 0.0
        for k, sample in enumerate(run):
            kalman.predict(F=model.transitions[k], Q=model.process[k])
            good = np.isfinite(sample)
            nis = 0.0
            if good.any():
                noise = np.diag(model.noise[k])[np.ix_(good, good)]
                kalman.update(sample[good].reshape(-1, 1), R=noise, H=model.rows[k][good])
                nis = float((kalman.y.T @ kalman.SI @ kalman.y).item())
                likelihood -= 0.5 * (nis + np.log(np.linalg.det(2.0 * np.pi * kalman.S)))
            assert batch.nis[number, k] == pytest.approx(nis, abs=1e-9)
            assert batch.channel_count[number, k] == good.sum()
        assert batch.state[number] == pytest.approx(kalman.x[:, 0], abs=1e-10)
        assert batch.covariance[number] == pytest.approx(kalman.P, abs=1e-10)
        assert batch.log_likelihood[number] == pytest.approx(likelihood, abs=1e-8)


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("free", [[2], [2, 4, 5], list(range(STATES))])
def test_start_is_that_of_least_squares(missing: float, free: list[int]) -> None:
    columns = np.stack([clean(unit) for unit in np.eye(STATES)], axis=-1)[..., free]
    weights = np.tile(1.0 / np.array([NOISE, 1.5 * NOISE]), (len(TIME), 1))
    std = np.zeros(STATES)
    std[free] = 10.0 * np.sqrt(np.diag(inverse_normal(columns, weights)))  # wider ones cost digits
    model = bicycle_space(SYSTEM, TIME, (NOISE, 1.5 * NOISE), np.zeros(STATES), std, delay=0.004)
    runs = measured(5, missing)
    start = smooth_start(filter_batch(model, runs), free)
    for number, run in enumerate(runs):
        good = np.isfinite(run)
        inverse = inverse_normal(columns[good], weights[good])
        values = inverse @ (columns[good].T @ (run * weights**2)[good])
        std_error = np.sqrt(np.diag(inverse))
        assert (start.values[number] - values) / std_error == pytest.approx(0.0, abs=1e-9)
        assert np.sqrt(np.diag(start.covariance[number])) == pytest.approx(std_error, rel=1e-9)


def inverse_normal(columns: Array, weights: Array) -> Array:
    matrix = (columns * weights[..., None]).reshape(-1, columns.shape[-1])
    return np.linalg.inv(matrix.T @ matrix)


def test_start_with_its_prior_is_that_of_stacked_least_squares() -> None:
    model, runs = space(), measured(3)
    start = smooth_start(filter_batch(model, runs), list(range(STATES)), prior=True)
    columns = np.stack([clean(unit) for unit in np.eye(STATES)], axis=-1)
    weight = np.tile([1.0 / NOISE, 1.0 / (1.5 * NOISE)], len(TIME))
    matrix = np.vstack([columns.reshape(-1, STATES) * weight[:, None], np.diag(1.0 / STD)])
    for number, run in enumerate(runs):
        target = np.concatenate([run.ravel() * weight, np.zeros(STATES)])
        expected = np.linalg.lstsq(matrix, target, rcond=None)[0]
        assert start.values[number] == pytest.approx(expected, abs=1e-9)
        # the difference of two covariances, of which the prior's is up to 4: 1e-12 of that can't be told
        assert start.covariance[number] == pytest.approx(np.linalg.inv(matrix.T @ matrix), abs=1e-11)


def test_likelihood_by_innovations_is_that_of_the_joint_density() -> None:
    # All measurements of a run are one normal vector: y = A x0 + n, mean A m, covariance A P0 A' + R.
    model, run = space(), measured(1, 0.2)[0]
    columns = np.stack([clean(unit) for unit in np.eye(STATES)], axis=-1).reshape(-1, STATES)
    spread = columns @ model.covariance @ columns.T + np.diag(model.noise.ravel())
    good = np.isfinite(run.ravel())
    joint = multivariate_normal(columns[good] @ model.mean, spread[np.ix_(good, good)])
    assert filter_batch(model, run[None]).log_likelihood[0] == pytest.approx(
        joint.logpdf(run.ravel()[good]), rel=1e-9
    )


@pytest.mark.parametrize("oscillator", [False, True])
def test_statsmodels_agrees(oscillator: bool) -> None:
    tools = pytest.importorskip("statsmodels.tsa.statespace.kalman_smoother")
    model, run = space(), measured(1, 0.2)[0]
    if oscillator:
        model = with_oscillator(model, TIME, channel=1, frequency=20.0, decay_time=0.5, std=0.1)
    size = model.mean.size
    oracle = tools.KalmanSmoother(k_endog=2, k_states=size, k_posdef=size, nobs=len(TIME) + 1)
    # its first state is that at the start, where nothing is measured
    oracle.bind(np.vstack([[np.nan, np.nan], run]).T.copy(order="F"))
    oracle["design"] = np.moveaxis(np.concatenate([model.rows[:1], model.rows]), 0, -1)
    noise = [np.diag(row) for row in model.noise[[0, *range(len(TIME))]]]
    oracle["obs_cov"] = np.moveaxis(np.array(noise), 0, -1)
    oracle["transition"] = np.moveaxis(np.concatenate([model.transitions, np.eye(size)[None]]), 0, -1)
    oracle["selection"] = np.eye(size)[:, :, None]
    oracle["state_cov"] = np.moveaxis(np.concatenate([model.process, np.zeros((1, size, size))]), 0, -1)
    oracle.tolerance = 0
    oracle.initialize_known(model.mean, model.covariance)
    told = oracle.smooth()
    batch = filter_batch(model, run[None])
    start = smooth_start(batch, list(range(size)), prior=True)
    assert batch.log_likelihood[0] == pytest.approx(told.llf_obs[1:].sum(), rel=1e-10)
    assert start.values[0] == pytest.approx(told.smoothed_state[:, 0], abs=1e-9)
    assert start.covariance[0] == pytest.approx(told.smoothed_state_cov[:, :, 0], abs=1e-10)
    # the fixed-interval smoother of one run: all states, and the start once more
    smoothed = smooth(model, run)
    assert smoothed.state == pytest.approx(told.smoothed_state.T, abs=1e-9)
    assert smoothed.covariance == pytest.approx(np.moveaxis(told.smoothed_state_cov, -1, 0), abs=1e-10)
    alone = smoothed_start(model, smoothed.gradient[None], smoothed.curvature[None], [2, 4, 5])
    together = smooth_start(batch, [2, 4, 5])
    assert alone.values == pytest.approx(together.values, abs=1e-9)
    assert alone.covariance == pytest.approx(together.covariance, abs=1e-10)


@pytest.mark.parametrize("share", [1, 2, 5], ids=["own gaps", "shared gaps", "one pattern"])
def test_runs_filtered_together_are_those_filtered_alone(share: int, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = measured(5)
    missing = np.repeat(np.isnan(measured(5, 0.2)), share, axis=0)[:5]
    runs[missing] = np.nan
    monkeypatch.setattr("tms_fit.kalman.batch.CHUNK", 2)
    monkeypatch.setattr("tms_fit.kalman.gains.CHUNK", 2)
    together = filter_batch(space(), runs)
    start = smooth_start(together, [2, 4, 5])
    assert together.gains.gain.shape[-1] == -(-5 // share)
    for number in range(5):
        alone = filter_batch(space(), runs[number : number + 1])
        alone_start = smooth_start(alone, [2, 4, 5])
        for name in ("innovation", "nis", "channel_count", "log_likelihood", "state", "covariance"):
            expected = getattr(alone, name)[0]
            np.testing.assert_allclose(getattr(together, name)[number], expected, rtol=1e-9, atol=1e-12)
        assert (together.innovation[number][missing[number]] == 0.0).all()
        assert start.values[number] == pytest.approx(alone_start.values[0], abs=1e-10)
        # differences of two covariances, of which the prior's is 1
        assert start.covariance[number] == pytest.approx(alone_start.covariance[0], abs=1e-11)


def test_nis_lies_in_its_band() -> None:
    runs = 200
    rng = np.random.default_rng(3)
    model = space()
    truths = model.mean + rng.standard_normal((runs, STATES)) * STD
    values = np.array([clean(truth) for truth in truths])
    values += rng.standard_normal(values.shape) * [NOISE, 1.5 * NOISE]
    batch = filter_batch(model, values)
    degrees = int(batch.channel_count.sum())
    low, high = chi2.ppf([0.0005, 0.9995], degrees)
    assert low < batch.nis.sum() < high
    # the state's error at the end, weighed by its covariance
    end = np.array([np.concatenate([response(SYSTEM, t[:4], TIME + 0.004)[-1], t[4:]]) for t in truths])
    error = batch.state - end
    # The castering mode has died out: its variance, e^-46 of what it was, is lost in the others' rounding.
    variance, directions = np.linalg.eigh(batch.covariance[0])
    told = variance > 1e-12 * variance[-1]
    assert told.sum() == STATES - 1
    nees = (error @ directions[:, told]) ** 2 / variance[told]
    low, high = chi2.ppf([0.0005, 0.9995], nees.size)
    assert low < nees.sum() < high


def test_an_oscillation_in_the_yaw_rate_neither_bends_nor_widens_the_answer() -> None:
    # 20 Hz of 0.1 rad/s, five times the noise. Called an oscillator it does not matter.
    rng = np.random.default_rng(4)
    runs, std = 100, np.where(np.isin(np.arange(STATES), [2, 4, 5]), STD, 0.0)
    plain = bicycle_space(SYSTEM, TIME, (NOISE, NOISE), np.zeros(STATES), std, delay=0.004)
    values = clean(np.array([0, 0, 0.5, 0, 0, 0])) + NOISE * rng.standard_normal((runs, len(TIME), 2))
    phases = rng.uniform(0, 2 * np.pi, (runs, 1))
    values[:, :, 1] += 0.1 * np.sqrt(2.0) * np.cos(2.0 * np.pi * 20.0 * TIME + phases)
    shaken = with_oscillator(plain, TIME, channel=1, frequency=20.0, decay_time=5.0, std=0.1)
    start = smooth_start(filter_batch(shaken, values), [2, 4, 5])
    quiet = smooth_start(filter_batch(plain, values), [2, 4, 5])
    stated = np.sqrt(start.covariance[0, 0, 0])
    assert stated < 1.05 * np.sqrt(quiet.covariance[0, 0, 0])  # as without an oscillation
    assert np.std(start.values[:, 0]) == pytest.approx(stated, rel=0.25)
    assert abs(np.mean(start.values[:, 0]) - 0.5) < 4.0 * stated / np.sqrt(runs)
