"""Kalman gains of many runs at once, one set for each pattern of missing samples.

Gains depend on which samples are missing, not on their values. Runs that miss the same samples, a pattern,
share covariances and gains. Patterns are the last axis of every array, so that each step is done for all of
them by a few products and sums of long rows.

Reference: G. J. Bierman, "Factorization Methods for Discrete Sequential Estimation", Academic Press (1977),
chapter 2 (one scalar measurement after the other).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.kalman.state_space import StateSpace

CHUNK = 1000  # patterns whose covariances fit the processor's cache


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains of g patterns of missing samples."""

    pattern: NDArray[np.intp]  # (r,) index of each run's pattern
    present: NDArray[np.bool_]  # (n, m, g)
    gain: Array  # (n, m, s, g), 0 where absent
    variance: Array  # (n, m, g) of the innovations, each given the channels before it; infinite where absent
    covariance: Array  # (s, s, g) of the state at the last sample

    def of(self, runs: slice) -> NDArray[np.intp] | slice:
        """Indices of some runs' patterns; a slice, which copies nothing, if all share one or none do."""
        count = self.present.shape[2]
        if count == 1:
            return slice(None)
        return runs if count == len(self.pattern) else self.pattern[runs]


def gains(space: StateSpace, present: NDArray[np.bool_]) -> Gains:
    """Gains for runs whose measurements are present (r, n, m)."""
    pattern, there = _patterns(present)
    (count, channels, patterns), size = there.shape, space.mean.size
    gain, variance = np.empty((count, channels, size, patterns)), np.empty(there.shape)
    covariance = np.empty((size, size, patterns))
    for k in range(0, patterns, CHUNK):
        part = slice(k, k + CHUNK)
        covariance[:, :, part] = _recursion(space, there[:, :, part], gain[..., part], variance[..., part])
    return Gains(pattern, there, gain, variance, covariance)


def sensitivities(space: StateSpace, known: Gains) -> tuple[Array, Array]:
    """Minus the derivative of the innovations by the initial state (n, m, s, g), and the curvature (s, s, g).

    The curvature is that of minus the log-likelihood by the initial state.
    """
    count, channels, size, patterns = known.gain.shape
    seen, curvature = np.empty(known.gain.shape), np.zeros((size, size, patterns))
    state = np.repeat(np.eye(size)[:, :, None], patterns, axis=2)  # its derivative by that at the start
    for k in range(count):
        state = (space.transitions[k] @ state.reshape(size, -1)).reshape(state.shape)
        for c in range(channels):
            found = seen[k, c]
            found[:] = (space.rows[k, c] @ state.reshape(size, -1)).reshape(size, patterns)
            curvature += (found / known.variance[k, c])[:, None] * found
            state -= known.gain[k, c][:, None] * found
    return seen, curvature


def _patterns(present: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Index of each run's pattern (r,), and the patterns (n, m, g)."""
    if (present == present[:1]).all():
        return np.zeros(len(present), dtype=np.intp), np.moveaxis(present[:1], 0, -1)
    flat = np.packbits(present.reshape(len(present), -1), axis=1)
    _, first, pattern = np.unique(flat, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(present):
        first = pattern = np.arange(len(present))
    return pattern.reshape(-1), np.ascontiguousarray(np.moveaxis(present[first], 0, -1))


def _recursion(space: StateSpace, there: NDArray[np.bool_], gain: Array, variance: Array) -> Array:
    """Covariance (s, s, g) at the last sample of some patterns (n, m, g); fills in gain and variance."""
    (count, channels, patterns), size = there.shape, space.mean.size
    covariance = np.repeat(space.covariance[:, :, None], patterns, axis=2)
    known = np.empty_like(covariance)
    for k in range(count):
        transition = space.transitions[k]
        covariance = (transition @ covariance.reshape(size, -1)).reshape(covariance.shape)
        covariance = np.matmul(transition, covariance)  # F P F': this one along the second axis
        covariance += space.process[k][:, :, None]
        for c in range(channels):
            row = space.rows[k, c]
            along = (row @ covariance.reshape(size, -1)).reshape(size, patterns)
            spread = row @ along + space.noise[k, c]
            np.multiply(along, there[k, c] / spread, out=gain[k, c])
            covariance -= np.multiply(gain[k, c][:, None], along, out=known)
            variance[k, c] = spread
    variance[~there] = np.inf
    symmetric: Array = 0.5 * (covariance + np.swapaxes(covariance, 0, 1))
    return symmetric
