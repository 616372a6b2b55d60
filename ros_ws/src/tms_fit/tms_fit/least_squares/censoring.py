"""Censored (Tobit) regression of saturated samples, whose rate is at least the sensor's limit.

The Tobit likelihood is concave. Newton's method maximises it by iteratively weighted least squares: each
saturated sample has a working value beyond its limit, weighted by its remaining information. The noise
variance follows by expectation maximisation.

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
    """Expected rates (m,) [rad/s] given that they lie beyond their limits."""
    return predicted + sign * std * _hazard(sign * (limit - predicted) / std)


def excess(limit: Array, sign: Array, predicted: Array, std: float) -> Array:
    """Variance (m,) of a rate given that it lies beyond its limit, relative to the noise variance."""
    z = sign * (limit - predicted) / std
    hazard = _hazard(z)
    return 1.0 - hazard * (hazard - z)


def information(limit: Array, sign: Array, predicted: Array, std: float) -> Array:
    """Fisher information (m,) of a censored sample relative to an uncensored one."""
    return 1.0 - excess(limit, sign, predicted, std)


def log_probability(limit: Array, sign: Array, predicted: Array, std: float) -> Array:
    """Logarithm of the probability (m,) of a rate beyond its limit."""
    from scipy.special import log_ndtr

    probability: Array = log_ndtr(-sign * (limit - predicted) / std)
    return probability


def _hazard(z: Array) -> Array:
    """Hazard function of the standard normal distribution: density at z over the probability above z."""
    from scipy.special import log_ndtr

    hazard: Array = np.exp(-0.5 * z**2 - 0.5 * np.log(2.0 * np.pi) - log_ndtr(-z))
    return hazard
