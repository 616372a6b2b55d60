"""Many runs at once: the answers of one fit after the other, an error that is stated, intervals that hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tms_fit.estimators.least_squares import fit_window
from tms_fit.least_squares.batch import fit_batch
from tms_fit.least_squares.table import TOLERANCE, tabulate
from tms_fit.least_squares.varpro import Problem
from tms_fit.response.prediction import predictor
from tms_fit.settings import NONLINEAR, Settings
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window
from tms_model import ParameterError, load_bicycle

TRUTH = {"initial_lean_rate": 0.5, "speed": 3.6}


def made_window(count: int = 150, missing: bool = False, **more: float) -> Window:
    """A strike without noise; `missing`: with gaps."""
    absent, truth = np.full(count, np.nan), {**TRUTH, **more}
    time = np.arange(count) * 0.01
    window = Window(0, time, absent, absent, load_bicycle("tms_eq_10_1"), constant_speed(3.6))
    nonlinear = {name: value for name, value in truth.items() if name in NONLINEAR}
    rates = predictor(window, nonlinear).predict(truth)
    if missing:
        rates[np.random.default_rng(3).random(rates.shape) < 0.1] = np.nan
    return replace(window, lean_rate=rates[:, 0], yaw_rate=rates[:, 1])


def noisy(window: Window, count: int, std: float = 0.02) -> np.ndarray:
    return window.measured + std * np.random.default_rng(1).standard_normal((count, len(window.time), 2))


CASES = {
    "nothing nonlinear": (("initial_lean_rate", "yaw_rate_bias"), (), {}),
    "speed": (("initial_lean_rate",), ("speed",), {"speed": (3.0, 4.2)}),
    "speed and biases": (
        ("initial_lean_rate", "lean_rate_bias", "yaw_rate_bias"),
        ("speed",),
        {"speed": (3.0, 4.2)},
    ),
    "start": (
        ("initial_lean_rate", "initial_steer_rate"),
        ("strike_time",),
        {"strike_time": (-0.02, -0.0001)},
    ),
    "speed, with biases that are known": (
        ("initial_lean_rate", "initial_steer_rate"),
        ("speed",),
        {"speed": (3.0, 4.2)},
    ),
    "speed and pitch": (
        ("initial_lean_rate",),
        ("speed", "mounting_pitch"),
        {"speed": (3.3, 3.9), "mounting_pitch": (-0.2, 0.2)},
    ),
}


@pytest.mark.parametrize("missing", [False, True], ids=["", "missing"])
@pytest.mark.parametrize("case", CASES)
def test_a_batch_is_one_fit_after_the_other(case: str, missing: bool) -> None:
    linear, nonlinear, ranges = CASES[case]
    window = made_window(missing=missing, strike_time=-0.006)
    fixed = {} if "strike_time" in nonlinear else {"strike_time": -0.006}
    if "known" in case:  # a forced response
        fixed |= {"lean_rate_bias": 0.02, "yaw_rate_bias": -0.03}
    table = tabulate(Problem(window, linear, nonlinear, fixed), ranges)
    runs = noisy(window, 5)
    for several in (fit_batch(table, runs), fit_batch(table, runs[:1])):  # one alone goes its own way
        assert several.converged.all()
        for row, run in enumerate(runs[: len(several.values)]):
            alone = fit_window(
                replace(window, lean_rate=run[:, 0], yaw_rate=run[:, 1]),
                Settings(free=(*linear, *nonlinear), fixed=fixed, noise="white"),
            )
            np.testing.assert_allclose((several.values[row] - alone.values) / alone.std, 0.0, atol=1e-5)
            np.testing.assert_allclose(several.std[row], alone.std, rtol=1e-5)
            assert several.residual_std[row] == pytest.approx(alone.noise["noise_std"], rel=1e-8)
            np.testing.assert_allclose(several.ci95[row], alone.ci95, atol=1e-4 * float(alone.std.max()))


def test_the_tables_error_is_what_it_says() -> None:
    window = made_window()
    table = tabulate(Problem(window, ("initial_lean_rate",), ("speed",)), {"speed": (3.0, 4.2)})
    assert table.error < 20.0 * TOLERANCE
    speeds = np.random.default_rng(5).uniform(3.0, 4.2, 40)
    inside = table.coordinates(speeds[:, None])[:, :, 0]
    exact = np.array([predictor(window, {"speed": speed}).columns[:, :, 2].ravel() for speed in speeds])
    assert np.abs(inside @ table.basis.T - exact).max() < 3.0 * table.error * np.abs(exact).max()
    np.testing.assert_allclose(table.basis.T @ table.basis, np.eye(table.rank), atol=1e-12)


def test_slopes_of_the_table() -> None:
    ranges = {"speed": (3.3, 3.9), "mounting_pitch": (-0.2, 0.2)}
    table = tabulate(Problem(made_window(), ("initial_lean_rate",), ("speed", "mounting_pitch")), ranges)
    centre, step = np.array([[3.62, 0.03]]), 1e-4
    slopes = table.columns(centre).reshape(3, 2, table.rank)[1:].transpose(0, 2, 1)
    for axis in range(2):
        ends = [table.coordinates(centre + sign * step * np.eye(2)[axis]) for sign in (-1.0, 1.0)]
        np.testing.assert_allclose(slopes[axis], (ends[1] - ends[0])[0] / (2.0 * step), atol=1e-5)


@pytest.mark.parametrize("known", [{}, {"lean_rate_bias": 0.02}], ids=["", "forced"])
def test_gram_matrix_of_a_run(known: dict[str, float]) -> None:
    problem = Problem(made_window(), ("initial_lean_rate", "initial_lean"), ("speed",), known)
    table = tabulate(problem, {"speed": (3.0, 4.2)})
    rows = noisy(problem.window, 1).ravel()
    for speed in (3.02, 3.57, 4.2):
        parts = table.columns(np.array([[speed]]))[0] @ table.basis.T  # (2 (p + 1), m)
        target = rows - parts[2]
        factors = np.array([*parts[:2], *parts[3 : 6 if known else 5], target])
        gram = table.gram.at(table.gram.of_run(rows @ table.basis, rows @ rows), speed)
        # What of the forced response no basis holds, 1e-9 of the largest rate, is left out of the first only.
        expected = (factors @ factors.T).ravel()
        np.testing.assert_allclose(gram, expected, rtol=1e-8, atol=1e-8)


def test_standard_errors_reach_the_bound_and_intervals_hold() -> None:
    # 10,000 runs: sd/CRLB 1.00 +- 0.02 (its own deviation is 0.007), coverage 0.945 to 0.955.
    window = made_window(400)
    table = tabulate(Problem(window, ("initial_lean_rate",), ("speed",)), {"speed": (3.3, 3.9)})
    runs = fit_batch(table, noisy(window, 10_000))
    truth = np.array([0.5, 3.6])
    bound = np.array([1.2119e-3, 5.134e-3])
    assert runs.converged.all()
    np.testing.assert_allclose(runs.values.std(axis=0) / bound, 1.0, atol=0.02)
    np.testing.assert_allclose(runs.values.mean(axis=0), truth, atol=0.04 * float(bound.max()))
    inside = ((runs.ci95[:, :, 0] <= truth) & (truth <= runs.ci95[:, :, 1])).mean(axis=0)
    assert (inside >= 0.945).all()
    assert (inside <= 0.955).all()


def test_chunks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    window = made_window()
    table = tabulate(Problem(window, ("initial_lean_rate",), ("speed",)), {"speed": (3.0, 4.2)})
    runs = noisy(window, 50)
    whole = fit_batch(table, runs)
    monkeypatch.setattr("tms_fit.least_squares.batch.CHUNK", 7 * 300 * 2)
    parts = fit_batch(table, runs)
    np.testing.assert_allclose(parts.values, whole.values, rtol=1e-9)


def test_an_answer_beyond_the_table_is_marked() -> None:
    window = made_window()
    table = tabulate(Problem(window, ("initial_lean_rate",), ("speed",)), {"speed": (2.6, 3.2)})
    runs = noisy(window, 4)
    assert not fit_batch(table, runs).converged.any()
    assert not fit_batch(table, runs[:1]).converged.any()


@pytest.mark.parametrize("value", [np.nan, 0.0], ids=["not finite", "zero"])
def test_a_run_that_tells_nothing_is_marked(value: float) -> None:
    window = made_window()
    table = tabulate(Problem(window, ("initial_lean_rate",), ("speed",)), {"speed": (3.0, 4.2)})
    runs = noisy(window, 3)
    runs[1] = value
    np.testing.assert_array_equal(fit_batch(table, runs).converged, [True, False, True])
    assert not fit_batch(table, runs[1:2]).converged.any()


def test_a_run_without_noise_is_found_exactly() -> None:
    window = made_window()
    table = tabulate(Problem(window, ("initial_lean_rate",), ("speed",)), {"speed": (3.0, 4.2)})
    for count in (1, 2):
        found = fit_batch(table, np.repeat(window.measured[None], count, axis=0), np.array([3.3]))
        assert found.converged.all()
        np.testing.assert_allclose(found.values, [[0.5, 3.6]] * count, rtol=1e-8)


REFUSED = {
    "no range": ({}, {}, "expected a range low < high of speed"),
    "empty range": ({"speed": (3.6, 3.6)}, {}, "expected a range low < high of speed"),
    "prior": ({"speed": (3.0, 4.0)}, {"speed": (3.6, 0.1)}, "expected no priors"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_tables_refused(case: str) -> None:
    ranges, priors, said = REFUSED[case]
    problem = Problem(made_window(), ("initial_lean_rate",), ("speed",), {}, priors)
    with pytest.raises(ParameterError, match=said):
        tabulate(problem, ranges)


def test_no_table_of_what_no_channel_tells_apart() -> None:
    window = made_window()
    window = replace(window, lean_rate=np.full_like(window.lean_rate, np.nan))
    problem = Problem(window, ("initial_lean_rate", "lean_rate_bias"), ("speed",))
    with pytest.raises(ParameterError, match="do not tell initial_lean_rate, lean_rate_bias apart"):
        tabulate(problem, {"speed": (3.0, 4.2)})
