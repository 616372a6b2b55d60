"""Censored (Tobit) regression of saturated samples: the rate was at least as large as the sensor's limit.

Tobit's likelihood is concave. Newton's method makes it a sequence of weighted least squares: each saturated
sample stands at a working value beyond its limit, with the share of information that is left in it as its
weight, until nothing moves. The noise variance is that of expectation and maximisation.

References: J. Tobin, Econometrica 26 (1958), doi 10.2307/1907382; A. P. Dempster, N. M. Laird and D. B.
Rubin, J. Royal Statistical Society B 39 (1977), doi 10.1111/j.2517-6161.1977.tb01600.x.
"""

from __future__ import annotations

import numpy as np
from tms_model.bicycle import Array


def working(limit: Array, sign: Array, predicted: Array, std: float) -> Array:
    """Working rates (m,) [rad/s] beyond their limits, sign +1: above, -1: below; noise std [rad/s]."""
    z = sign * (limit - predicted) / std
    return predicted + sign * std / (_hazard(z) - z)


def expected(limit: Array, sign: Array, predicted: Array, std: float) -> Array:
    """Rates expected (m,) [rad/s] beyond their limits."""
    return predicted + sign * std * _hazard(sign * (limit - predicted) / std)


def excess(limit: Array, sign: Array, predicted: Array, std: float) -> Array:
    """Variance (m,) left of a rate of which only this is known, per noise variance."""
    z = sign * (limit - predicted) / std
    hazard = _hazard(z)
    return 1.0 - hazard * (hazard - z)


def information(limit: Array, sign: Array, predicted: Array, std: float) -> Array:
    """Share (m,) of a sample's information that is left when only its limit is known."""
    return 1.0 - excess(limit, sign, predicted, std)


def log_probability(limit: Array, sign: Array, predicted: Array, std: float) -> Array:
    """Logarithm of the probability (m,) of a rate beyond its limit."""
    from scipy.special import log_ndtr

    probability: Array = log_ndtr(-sign * (limit - predicted) / std)
    return probability


def _hazard(z: Array) -> Array:
    """Density of the standard normal distribution at z per probability above it."""
    from scipy.special import log_ndtr

    hazard: Array = np.exp(-0.5 * z**2 - 0.5 * np.log(2.0 * np.pi) - log_ndtr(-z))
    return hazard
