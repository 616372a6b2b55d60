"""Fixed-interval (Rauch-Tung-Striebel) smoother in the form of Bryson and Frazier.

Forward, a Kalman filter with filterpy's arithmetic; backward, the adjoint of minus the log-likelihood, with
lambda = 0 and Lambda = 0 after the last sample:

    C = I - K H
    lambda <- C' lambda - H' S^-1 e             x[k|n] = x - P lambda
    Lambda <- C' Lambda C + H' S^-1 H           P[k|n] = P - P Lambda P
    lambda <- F' lambda,   Lambda <- F' Lambda F

x, P: state and covariance predicted for sample k; e, S: innovation and its covariance, K: gain. The usual
form inverts P, which is singular here (known initial states, no process noise) or becomes so (the castering
mode dies out); filterpy's `rts_smoother` then fails or loses all digits. This form inverts S only.

Without process noise the smoothed initial state is the least-squares estimate.

References: H. E. Rauch, F. Tung and C. T. Striebel, AIAA J. 3 (1965), doi 10.2514/3.3166; A. E. Bryson and
M. Frazier (1963); G. J. Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18
(1973), doi 10.1080/00207177308932487.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from tms_model.bicycle import Array

from tms_fit.kalman.recursion import kalman_filter, update
from tms_fit.kalman.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class SmoothedStates:
    """States given all n samples: at the start, then at each sample."""

    state: Array  # (n + 1, s)
    covariance: Array  # (n + 1, s, s)
    gradient: Array  # lambda (s,) of minus the log-likelihood by the state at the start, at its prior mean
    curvature: Array  # Lambda (s, s)


class SmoothedStart(NamedTuple):
    """State at the start of r runs given all samples; p of the s states."""

    values: Array  # (r, p)
    covariance: Array  # (r, p, p)


class _Update(NamedTuple):
    """One sample of the forward pass."""

    state: Array  # x (s, 1), predicted
    covariance: Array  # P (s, s), predicted
    reduction: Array  # C (s, s)
    gradient: Array  # H' S^-1 e (s, 1)
    information: Array  # H' S^-1 H (s, s)


def smooth(space: StateSpace, measured: Array) -> SmoothedStates:
    """Smoothed states of one run of two channels, measured (n, 2); NaN: missing.

    Process noise is that of the state space, which can be zero.
    """
    size, steps = space.mean.size, _filter(space, measured)
    gradient, curvature = np.zeros((size, 1)), np.zeros((size, size))
    gradients, curvatures = np.empty((len(steps) + 1, size, 1)), np.empty((len(steps) + 1, size, size))
    for k in reversed(range(len(steps))):
        step, transition = steps[k], space.transitions[k]
        gradient = step.reduction.T @ gradient - step.gradient
        curvature = step.reduction.T @ curvature @ step.reduction + step.information
        gradients[k + 1], curvatures[k + 1] = gradient, curvature
        gradient, curvature = transition.T @ gradient, transition.T @ curvature @ transition
    gradients[0], curvatures[0] = gradient, curvature
    predicted = np.array([space.mean[:, None], *(step.state for step in steps)])
    covariance = np.array([space.covariance, *(step.covariance for step in steps)])
    return SmoothedStates(
        state=(predicted - covariance @ gradients)[:, :, 0],
        covariance=covariance - covariance @ curvatures @ covariance,
        gradient=gradient[:, 0],
        curvature=curvature,
    )


def _filter(space: StateSpace, measured: Array) -> list[_Update]:
    """Forward pass."""
    kalman = kalman_filter(space.mean.size)
    kalman.x, kalman.P = space.mean.reshape(-1, 1).copy(), space.covariance.copy()
    steps = []
    for k, sample in enumerate(measured):
        kalman.predict(F=space.transitions[k], Q=space.process[k])
        present = np.isfinite(sample)
        update(kalman, sample.reshape(2, 1), space.rows[k], np.diag(space.noise[k]), present.tolist())
        steps.append(_adjoint_terms(kalman, space.rows[k][present]))
    return steps


def _adjoint_terms(kalman: Any, rows: Array) -> _Update:
    """Terms of the backward pass after an update with H = rows (m, s), m channels being present."""
    reduction = np.eye(len(kalman.x))
    gradient, information = np.zeros_like(kalman.x), np.zeros_like(kalman.P)
    if len(rows):
        weighted = rows.T @ kalman.SI
        reduction -= kalman.K @ rows
        gradient, information = weighted @ kalman.y, weighted @ rows
    return _Update(kalman.x_prior, kalman.P_prior, reduction, gradient, information)


def smoothed_start(
    space: StateSpace, gradient: Array, curvature: Array, free: list[int], prior: bool = False
) -> SmoothedStart:
    """State at the start by lambda (r, s) and Lambda (r, s, s); only the states numbered in `free`.

    Without `prior`, their prior is taken out exactly: x0 - Lambda^-1 lambda and Lambda^-1 - P0, by the matrix
    inversion lemma from x0 - P0 lambda and P0 - P0 Lambda P0. That is the least-squares estimate, to 1e-9 of
    a standard error if the prior was ten of them wide; each tenfold more costs two digits. The other states
    keep their prior. Raises numpy.linalg.LinAlgError where the data do not determine the free states.
    """
    known = space.covariance[np.ix_(free, free)]
    slope, bend = gradient[:, free], curvature[:, free][:, :, free]
    if prior:
        return SmoothedStart(space.mean[free] - slope @ known, known - known @ bend @ known)
    inverse = np.linalg.inv(bend)
    return SmoothedStart(space.mean[free] - np.einsum("rpq,rq->rp", inverse, slope), inverse - known)
