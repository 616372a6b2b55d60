"""Random effects: a published meta-analysis, statsmodels, and what must hold for any numbers."""

from __future__ import annotations

import numpy as np
import pytest
from statsmodels.stats.meta_analysis import combine_effects
from tms_calibrate.random_effects import METHODS, random_effects
from tms_model import ParameterError

# Thirteen trials of the BCG vaccine, G. A. Colditz et al., JAMA 271 (1994), doi
# 10.1001/jama.1994.03510330076038: cases and others among the vaccinated, cases and others among the rest.
BCG = np.array(
    [
        *([4, 119, 11, 128], [6, 300, 29, 274], [3, 228, 11, 209], [62, 13536, 248, 12619]),
        *([33, 5036, 47, 5761], [180, 1361, 372, 1079], [8, 2537, 10, 619], [505, 87886, 499, 87892]),
        *([29, 7470, 45, 7232], [17, 1699, 65, 1600], [186, 50448, 141, 27197], [5, 2493, 3, 2338]),
        [27, 16886, 29, 17825],
    ],
    dtype=float,
)
# Logarithm of the relative risk, as the package metafor prints it: W. Viechtbauer, J. Stat. Softw. 36
# (2010), doi 10.18637/jss.v036.i03.
PUBLISHED = {
    "reml": {"mean": -0.7145, "tau2": 0.3132, "naive_std": 0.1798},
    "dersimonian_laird": {"mean": -0.7141, "tau2": 0.3088, "naive_std": 0.1787},
}


def log_risk_ratios() -> tuple[np.ndarray, np.ndarray]:
    a, b, c, d = BCG.T
    return np.log(a / (a + b) / (c / (c + d))), np.sqrt(1 / a - 1 / (a + b) + 1 / c - 1 / (c + d))


@pytest.mark.parametrize("method", METHODS)
def test_the_bcg_trials_come_out_as_printed(method: str) -> None:
    values, std = log_risk_ratios()
    found, printed = random_effects(values, std, method), PUBLISHED[method]
    assert round(found.mean, 4) == printed["mean"]
    assert round(found.between_std**2, 4) == printed["tau2"]
    assert round(1.0 / np.sqrt(np.sum(1.0 / (std**2 + found.between_std**2))), 4) == printed["naive_std"]
    assert round(found.q, 4) == 152.2330
    assert found.p < 1e-4
    assert found.prediction95[0] < found.ci95[0] < found.mean < found.ci95[1] < found.prediction95[1]


@pytest.mark.parametrize("seed", range(5))
def test_statsmodels_agrees(seed: int) -> None:
    generator = np.random.default_rng(seed)
    std = generator.uniform(0.05, 0.5, 12)
    values = 1.0 + 0.4 * generator.standard_normal(12) + std * generator.standard_normal(12)
    found, other = (
        random_effects(values, std, "dersimonian_laird"),
        combine_effects(values, std**2, method_re="chi2"),
    )
    assert found.between_std**2 == pytest.approx(other.tau2, rel=1e-10)
    assert found.mean == pytest.approx(other.mean_effect_re, rel=1e-10)
    assert found.q == pytest.approx(other.q, rel=1e-10)
    assert found.i2 == pytest.approx(max(other.i2, 0.0), rel=1e-9)
    # Hartung and Knapp's standard error, which here may not fall below the model's own.
    assert found.std == pytest.approx(max(other.sd_eff_w_re_hksj, other.sd_eff_w_re), rel=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_reml_is_where_the_restricted_likelihood_is_largest(seed: int) -> None:
    generator = np.random.default_rng(seed)
    std = generator.uniform(0.05, 0.5, 8)
    values = 0.3 * generator.standard_normal(8) + std * generator.standard_normal(8)

    def likelihood(between: float) -> float:
        weights = 1.0 / (std**2 + between)
        off = values - weights @ values / weights.sum()
        return float(np.sum(np.log(weights)) - np.log(weights.sum()) - weights @ off**2) / 2.0

    found = random_effects(values, std).between_std ** 2
    grid = np.linspace(0.0, 2.0, 20001)
    assert found == pytest.approx(grid[np.argmax([likelihood(one) for one in grid])], abs=1.01e-4)


def test_by_hand() -> None:
    # Two runs, 0 and 2, each +/- 1: Q = 1 + 1 = 2, one degree of freedom, I2 = 1 - 1 / 2; the moments give
    # tau2 = (2 - 1) / (2 - 2 / 2) = 1, and so does REML, whose variance of two values is 2 = 1 + tau2.
    for method in METHODS:
        found = random_effects(np.array([0.0, 2.0]), np.ones(2), method)
        assert (found.mean, found.q, found.i2) == pytest.approx((1.0, 2.0, 0.5))
        assert found.between_std == pytest.approx(1.0)
        assert found.std == pytest.approx(1.0)  # sqrt((1 + 1) / 2)


def test_runs_that_agree_and_a_single_one() -> None:
    alike = random_effects(np.full(6, 0.7), np.full(6, 0.1))
    assert (alike.between_std, alike.q, alike.i2) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert alike.std == pytest.approx(0.1 / np.sqrt(6.0))
    single = random_effects(np.array([0.7]), np.array([0.1]))
    assert (single.mean, single.std) == (0.7, 0.1)
    assert np.isnan([single.q, single.between_std, *single.ci95]).all()


@pytest.mark.parametrize(
    ("values", "std", "method", "why"),
    [
        ([1.0], [0.1], "mean", "method: expected one of reml"),
        ([1.0, 2.0], [0.1], "reml", "as many values as standard errors"),
        ([], [], "reml", "as many values"),
        ([1.0, np.nan], [0.1, 0.1], "reml", "finite values with positive"),
        ([1.0, 2.0], [0.1, 0.0], "reml", "finite values with positive"),
    ],
)
def test_what_no_fit_gives_is_refused(values: list[float], std: list[float], method: str, why: str) -> None:
    with pytest.raises(ParameterError, match=why):
        random_effects(np.array(values), np.array(std), method)
