"""Random-effects model of meta-analysis: mean, heterogeneity and prediction interval over runs.

Each of k runs has an estimate y_i with standard error s_i; its true value varies from run to run with
standard deviation tau about the mean. Cochran's Q tests tau = 0; I2 = (Q - (k - 1)) / Q is the share of the
scatter that the standard errors do not explain.

References: R. DerSimonian and N. Laird, Controlled Clinical Trials 7 (1986), doi
10.1016/0197-2456(86)90046-2; W. Viechtbauer, J. Educ. Behav. Stat. 30 (2005), doi 10.3102/10769986030003261
(REML); J. P. T. Higgins and S. G. Thompson, Stat. Med. 21 (2002), doi 10.1002/sim.1186 (I2); J. Hartung and
G. Knapp, Stat. Med. 20 (2001), doi 10.1002/sim.791 (standard error and interval by Student's t).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc, stdtrit
from tms_model import ParameterError
from tms_model.bicycle import Array

METHODS = ("reml", "dersimonian_laird")


@dataclass(frozen=True)
class RandomEffects:
    """Mean over k runs and their heterogeneity; NaN where k is too small."""

    count: int  # k
    mean: float
    std: float  # standard error of the mean; not below the one of Hartung and Knapp
    ci95: tuple[float, float]
    between_std: float  # tau, of the true values from run to run
    prediction95: tuple[float, float]  # of the true value of a further run
    q: float  # Cochran's Q
    p: float  # of a Q at least as large if tau = 0
    i2: float  # share of the scatter that the standard errors don't explain
    method: str


def random_effects(values: Array, std: Array, method: str = "reml") -> RandomEffects:
    """Mean of `values` (k,) with standard errors `std` (k,), all positive.

    Raises ParameterError for an unknown method, different shapes, or numbers that no fit gives.
    """
    values, std = np.asarray(values, dtype=float), np.asarray(std, dtype=float)
    if method not in METHODS:
        raise ParameterError(f"method: expected one of {', '.join(METHODS)}, found {method!r}")
    if values.ndim != 1 or values.shape != std.shape or not len(values):
        raise ParameterError(
            f"expected as many values as standard errors, found shapes {values.shape} and {std.shape}"
        )
    if not (np.isfinite(values).all() and np.isfinite(std).all() and (std > 0.0).all()):
        raise ParameterError("expected finite values with positive standard errors")
    variances, nan = std**2, float("nan")
    count = len(values)
    if count == 1:
        edges = (nan, nan)
        return RandomEffects(1, float(values[0]), float(std[0]), edges, nan, edges, nan, nan, nan, method)
    q = cochran_q(values, variances)
    between = (_reml if method == "reml" else _moments)(values, variances)
    weights = 1.0 / (variances + between)
    mean = float(weights @ values / weights.sum())
    scatter = float(weights @ (values - mean) ** 2) / (count - 1)
    # Not below the standard error of the model: few runs may agree by chance.
    error = math.sqrt(max(scatter, 1.0) / weights.sum())
    half = float(stdtrit(count - 1, 0.975)) * error
    reach = float(stdtrit(max(count - 2, 1), 0.975)) * math.sqrt(between + error**2)
    return RandomEffects(
        count=count,
        mean=mean,
        std=error,
        ci95=(mean - half, mean + half),
        between_std=math.sqrt(between),
        prediction95=(mean - reach, mean + reach),
        q=q,
        p=float(chdtrc(count - 1, q)),
        i2=max(0.0, 1.0 - (count - 1) / q) if q > 0.0 else 0.0,
        method=method,
    )


def cochran_q(values: Array, variances: Array) -> float:
    """Weighted sum of squares about the weighted mean of values (k,) with variances (k,)."""
    weights = 1.0 / variances
    off = values - weights @ values / weights.sum()
    return float(np.sum(weights * off**2))


def _moments(values: Array, variances: Array) -> float:
    """Variance between runs by the method of moments on Q (DerSimonian and Laird, Eq. 8)."""
    weights = 1.0 / variances
    spread = float(weights.sum()) - float(weights @ weights) / float(weights.sum())
    return max(0.0, (cochran_q(values, variances) - (len(values) - 1)) / spread)


def _reml(values: Array, variances: Array) -> float:
    """Variance between runs by restricted maximum likelihood, 0 where the likelihood falls from 0 on."""

    def slope(between: float) -> float:
        """Derivative of twice the restricted log-likelihood."""
        weights = 1.0 / (variances + between)
        off = values - weights @ values / weights.sum()
        return float(weights**2 @ off**2 - weights.sum() + weights @ weights / weights.sum())

    if slope(0.0) <= 0.0:
        return 0.0
    high = float(np.ptp(values)) ** 2 + float(variances.max())
    while slope(high) > 0.0:
        high *= 2.0
    return float(brentq(slope, 0.0, high, xtol=1e-14 * high, rtol=1e-12))
