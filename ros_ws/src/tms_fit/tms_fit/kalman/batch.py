"""Kalman filter and smoother of many runs at once, measured at the same instants with the same model.

The gains are those of `tms_fit.kalman.gains`. What remains for each run is one product with the transition
for every sample, and one sum with the gain for every channel of it, done for all runs together:

    x <- F x;   e = y - h x,   x <- x + K e   for each channel

x: state, y: measurement, e: innovation, each given the channels before it. Runs are the last axis of the
arrays, in chunks that fit the processor's cache.

The smoother of the initial state needs no second pass over the runs. Innovations are linear in that state,
with sensitivities that are the same for all runs that share gains: gradient and curvature of minus the
log-likelihood are sums over the innovations, and the prior can be taken out exactly
(`tms_fit.kalman.rts.smoothed_start`).

References: G. J. Bierman, "Factorization Methods for Discrete Sequential Estimation", Academic Press (1977),
chapter 2; F. C. Schweppe, IEEE Trans. Information Theory 11 (1965), doi 10.1109/TIT.1965.1053737, for the
likelihood by innovations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.kalman.gains import Gains, gains, sensitivities
from tms_fit.kalman.rts import SmoothedStart, smoothed_start
from tms_fit.kalman.state_space import StateSpace

CHUNK = 2000  # runs


@dataclass(frozen=True, eq=False)
class BatchFilter:
    """Filtered runs: r of n samples, m channels, s states."""

    space: StateSpace
    gains: Gains
    innovation: Array  # (r, n, m), each given the channels before it; 0 where absent
    nis: Array  # (r, n) sum over the channels used
    log_likelihood: Array  # (r,)
    state: Array  # (r, s) at the last sample

    @property
    def channel_count(self) -> NDArray[np.intp]:
        """Number of channels that are present (r, n)."""
        return np.asarray(self.gains.present.sum(axis=1).T[self.gains.pattern])

    @property
    def covariance(self) -> Array:
        """Covariance of the state at the last sample (r, s, s)."""
        return np.asarray(np.moveaxis(self.gains.covariance, -1, 0)[self.gains.pattern])


def filter_batch(space: StateSpace, measured: Array) -> BatchFilter:
    """Filtered runs, measured (r, n, m); NaN: missing.

    Memory: twice the measurements, and s + 1 numbers for each measurement of each pattern of missing samples.
    """
    known = gains(space, np.isfinite(measured))
    runs, count, channels = measured.shape
    innovation, nis = np.zeros((count, channels, runs)), np.zeros((count, runs))
    state = np.empty((space.mean.size, runs))
    for k in range(0, runs, CHUNK):
        part = slice(k, k + CHUNK)
        state[:, part] = _filter(space, known, part, measured[part], innovation[:, :, part], nis[:, part])
    used = np.where(known.present, known.variance, 0.5 / math.pi)
    spread = np.log(2.0 * math.pi * used).sum(axis=(0, 1))
    return BatchFilter(
        space=space,
        gains=known,
        innovation=np.moveaxis(innovation, -1, 0),
        nis=nis.T,
        log_likelihood=-0.5 * (nis.sum(axis=0) + spread[known.pattern]),
        state=state.T,
    )


def _filter(
    space: StateSpace, known: Gains, part: slice, measured: Array, innovation: Array, nis: Array
) -> Array:
    """State (s, r) at the last sample; fills in innovation (n, m, r) and nis (n, r), which are zero."""
    runs, count, channels = measured.shape
    values = measured.transpose(1, 2, 0).copy()
    state = np.repeat(space.mean[:, None], runs, axis=1)
    change, weighted = np.empty_like(state), np.empty(runs)
    own, everything = known.of(part), bool(known.present.all())
    for k in range(count):
        state = space.transitions[k] @ state
        for c in range(channels):
            error = innovation[k, c]
            there = True if everything else known.present[k, c][own]
            np.subtract(values[k, c], space.rows[k, c] @ state, out=error, where=there)
            state += np.multiply(_of(known.gain[k, c], own), error, out=change)
            np.multiply(error, error, out=weighted)
            weighted /= known.variance[k, c][own]
            nis[k] += weighted
    return state


def smooth_start(filtered: BatchFilter, free: list[int], prior: bool = False) -> SmoothedStart:
    """Smoothed initial states numbered in `free`, with their prior or without: see `smoothed_start`."""
    space, known = filtered.space, filtered.gains
    innovation = np.moveaxis(filtered.innovation, 0, -1)
    seen, curvature = sensitivities(space, known)
    seen /= known.variance[:, :, None]
    gradient = np.zeros((space.mean.size, innovation.shape[2]))
    for first in range(0, innovation.shape[2], CHUNK):
        part = slice(first, first + CHUNK)
        own = known.of(part)
        for k in range(len(innovation)):
            gradient[:, part] -= np.einsum("csr,cr->sr", _of(seen[k], own), innovation[k, :, part])
    return smoothed_start(space, gradient.T, np.moveaxis(curvature, -1, 0)[known.pattern], free, prior)


def _of(numbers: Array, own: NDArray[np.intp] | slice) -> Array:
    """Numbers of some runs, the last axis; `take` is three times as fast as an index."""
    return numbers[..., own] if isinstance(own, slice) else numbers.take(own, axis=-1)
