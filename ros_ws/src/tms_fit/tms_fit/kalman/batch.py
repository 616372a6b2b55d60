"""Kalman filter and smoother for many runs at once, measured at the same instants with the same model.

Covariances and gains depend on which samples are missing, not on what the others say: runs that miss the
same samples share them. What is left for each run is one product with a small matrix per sample, done for all
runs together:

    (x[k], e[k]) = step[k] (x[k - 1], y[k])

x: state, y: measurement, e: innovations of its channels, each given those before it, which are independent.

The smoother is Bryson and Frazier's (see `tms_fit.estimators.kalman_rts`): its adjoint pass gives gradient
and curvature of minus the log-likelihood by the state at the start, so the prior can be taken out exactly.

References: G. J. Bierman, "Factorization Methods for Discrete Sequential Estimation", Academic Press (1977),
chapter 2 (one scalar after the other); "Fixed interval smoothing with discrete measurements", Int. J. Control
18 (1973), doi 10.1080/00207177308932487.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.kalman.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class Steps:
    """What g patterns of missing samples make of a state space."""

    pattern: NDArray[np.intp]  # (r,) which of them a run has
    step: Array  # (n, g, s + m, s + m); rows and columns of absent measurements are zero
    variance: Array  # (n, g, m) of the innovations, infinite where absent
    covariance: Array  # (g, s, s) of the state at the last sample


@dataclass(frozen=True, eq=False)
class BatchFilter:
    """r runs of n samples, m channels, s states."""

    space: StateSpace
    steps: Steps
    innovation: Array  # (r, n, m), each given the channels before it; 0 where absent
    nis: Array  # (r, n) sum over the channels used
    channel_count: NDArray[np.intp]  # (r, n) channels used
    log_likelihood: Array  # (r,)
    state: Array  # (r, s) at the last sample

    @property
    def covariance(self) -> Array:
        """Of the state at the last sample (r, s, s)."""
        return np.asarray(self.steps.covariance[self.steps.pattern])


@dataclass(frozen=True, eq=False)
class Start:
    """State at the start, given all measurements; p of the s states."""

    values: Array  # (r, p)
    covariance: Array  # (r, p, p)


def filter_batch(space: StateSpace, measured: Array) -> BatchFilter:
    """Filter measured (r, n, m), NaN where a measurement is missing.

    Memory: three times the measurements, and (s + m)^2 numbers for each sample of each pattern.
    """
    present = np.isfinite(measured)
    steps = _steps(space, present)
    runs, count, channels = measured.shape
    size = space.mean.size
    values = np.where(present, measured, 0.0).transpose(1, 2, 0).copy()
    now = np.empty((size + channels, runs))
    now[:size] = space.mean[:, None]
    innovation = np.empty_like(values)
    for k in range(count):
        now[size:] = values[k]
        now = _apply(steps.step[k], now, steps.pattern)
        innovation[k] = now[size:]
    variance = steps.variance.transpose(0, 2, 1)[:, :, steps.pattern]
    weighted = np.sum(innovation**2 / variance, axis=1).T
    used = np.isfinite(steps.variance)
    spread = np.log(np.where(used, 2.0 * math.pi * np.where(used, steps.variance, 1.0), 1.0)).sum(axis=(0, 2))
    return BatchFilter(
        space=space,
        steps=steps,
        innovation=np.moveaxis(innovation, -1, 0),
        nis=weighted,
        channel_count=present.sum(axis=2),
        log_likelihood=-0.5 * (weighted.sum(axis=1) + spread[steps.pattern]),
        state=now[:size].T.copy(),
    )


def smooth_start(filtered: BatchFilter, free: list[int], prior: bool = False) -> Start:
    """The states numbered in `free` at the start of each run, from all its measurements.

    Without `prior` what was known of them before is taken out: the answer is the least-squares one, to 1e-9
    of a standard error if the prior was ten of them wide; each tenfold more costs two digits. The other
    states keep their prior. Raises numpy.linalg.LinAlgError where the data don't tell them apart.
    """
    space, steps = filtered.space, filtered.steps
    size, (runs, count, channels) = space.mean.size, filtered.innovation.shape
    adjoint = np.zeros((size + channels, runs))
    curvature = np.zeros_like(steps.covariance)
    weight = 1.0 / steps.variance
    for k in range(count - 1, -1, -1):
        step = steps.step[k]
        adjoint[size:] = (filtered.innovation[:, k] * weight[k, steps.pattern]).T
        adjoint = _apply(np.swapaxes(step, 1, 2), adjoint, steps.pattern)
        moved, seen = step[:, :size, :size], step[:, size:, :size]
        curvature = np.swapaxes(moved, 1, 2) @ curvature @ moved
        curvature += np.swapaxes(seen, 1, 2) @ (weight[k][:, :, None] * seen)
    return _start(space, adjoint[:size].T, curvature[steps.pattern], free, prior)


def _apply(matrices: Array, vectors: Array, pattern: NDArray[np.intp]) -> Array:
    """Product of each run's matrix, of matrices (g, a, a), with its vector, of vectors (a, r)."""
    if len(matrices) == 1:
        return np.asarray(matrices[0] @ vectors)
    return np.asarray((matrices[pattern] @ vectors.T[:, :, None])[:, :, 0].T)


def _start(space: StateSpace, gradient: Array, curvature: Array, free: list[int], prior: bool) -> Start:
    known, slope, bend = (
        space.covariance[np.ix_(free, free)],
        gradient[:, free],
        curvature[:, free][:, :, free],
    )
    if prior:
        return Start(space.mean[free] - slope @ known, known - known @ bend @ known)
    inverse = np.linalg.inv(bend)
    return Start(space.mean[free] - np.einsum("rpq,rq->rp", inverse, slope), inverse - known)


def _steps(space: StateSpace, present: NDArray[np.bool_]) -> Steps:
    runs, count, channels = present.shape
    flat = np.packbits(present.reshape(runs, -1), axis=1)
    _, first, pattern = np.unique(flat, axis=0, return_index=True, return_inverse=True)
    there, size = present[first], space.mean.size
    covariance = np.tile(space.covariance, (len(first), 1, 1))
    step = np.zeros((count, len(first), size + channels, size + channels))
    step[:, :, :size, :size] = space.transitions[:, None]
    variance = np.full((count, len(first), channels), np.inf)
    for k in range(count):
        covariance = space.transitions[k] @ covariance @ space.transitions[k].T + space.process[k]
        for c in range(channels):
            row, used = space.rows[k, c], there[:, k, c]
            along = covariance @ row
            spread = along @ row + space.noise[k, c]
            gain = np.where(used[:, None], along / spread[:, None], 0.0)
            covariance = covariance - gain[:, :, None] * along[:, None, :]
            error = step[k, :, size + c]
            error[:] = -(row @ step[k, :, :size])
            error[:, size + c] += 1.0
            error *= used[:, None]
            step[k, :, :size] += gain[:, :, None] * error[:, None, :]
            variance[k, :, c] = np.where(used, spread, np.inf)
    return Steps(pattern.reshape(-1), step, variance, 0.5 * (covariance + np.swapaxes(covariance, 1, 2)))
