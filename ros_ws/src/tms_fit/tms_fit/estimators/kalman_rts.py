"""Kalman filter (filterpy) over the free response, and fixed-interval smoothing back to the strike.

The state is lean, steer, lean rate, steer rate and the free biases. Nothing disturbs the bicycle after the
strike, so the process noise is zero and the smoothed initial state is the least-squares one: two ways to the
same answer.

The smoother is Rauch, Tung and Striebel's in the form of Bryson and Frazier. The usual form inverts the
predicted covariance, which is singular here (initial states that are known, no process noise) and soon
becomes so (the castering mode dies out); filterpy's rts_smoother then fails or loses all digits. This form
inverts innovation covariances only.

References: H. E. Rauch, F. Tung and C. T. Striebel, AIAA J. 3 (1965), doi 10.2514/3.3166; A. E. Bryson and M.
Frazier (1963); G. J. Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18
(1973), doi 10.1080/00207177308932487.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from filterpy.kalman import KalmanFilter
from tms_model.bicycle import Array
from tms_model.response import LEAN_RATE

from tms_fit.estimate import Estimate
from tms_fit.estimators.least_squares import decide, fit_model
from tms_fit.least_squares.make_estimate import in_order, variance_accounted_for
from tms_fit.least_squares.model_selection import choose
from tms_fit.least_squares.varpro import Problem
from tms_fit.parameters import BIASES, FRICTION, INITIAL, NONLINEAR, SLIP
from tms_fit.response.discretization import Transitions, discretize
from tms_fit.settings import Settings
from tms_fit.window import Window

PRIOR = 10.0  # prior standard deviation of a free parameter, per standard error that the data give


def estimate(window: Window, settings: Settings) -> Estimate:
    """Smoothed initial state and biases; for NONLINEAR parameters the values of least squares.

    What the settings leave open is decided as for `least_squares`.
    """
    decided, _ = decide(window, settings)
    settings = replace(
        settings, free=decided.free, noise="white", oscillator=(), loss="squares", saturation="drop"
    )
    choice = replace(choose(window, settings), words=decided.words, reasons=decided.reasons)
    rubbing = FRICTION in {*choice.free, *settings.fixed}
    linear = choice.problem.linear
    if not linear or {*choice.problem.priors} & {*linear} or SLIP in choice.free or rubbing:
        return replace(
            fit_model("kalman_rts", choice, settings),
            message="priors on what is linear, slip, friction, or nothing linear: least squares instead of a"
            " smoother",
        )
    squares = fit_model("kalman_rts", choice, settings)
    if squares.status != "ok":
        return in_order(squares, choice.free)
    known = {name: value for name, value in squares.complete.items() if name not in choice.problem.linear}
    problem = replace(choice.problem, nonlinear=(), known=known)
    conditional = _inverse(squares.jacobian[:, :, : len(problem.linear)], problem.window)
    values, inverse = smooth(problem, conditional)
    if not (np.isfinite(values).all() and (np.diag(inverse) > 0.0).all()):
        return Estimate(
            "kalman_rts", "not_converged", "the solution lost its precision; free fewer parameters"
        )
    return in_order(_smoothed(squares, problem, values, inverse - conditional), choice.free)


def _smoothed(squares: Estimate, problem: Problem, values: Array, difference: Array) -> Estimate:
    """The estimate with the smoother's values, and its covariance of them when all else is known."""
    count = len(problem.linear)
    covariance = squares.covariance.copy()
    covariance[:count, :count] += squares.noise["noise_std"] ** 2 * difference
    together = np.concatenate([values, squares.values[count:]])
    predicted = replace(problem, nonlinear=()).predicted(values)
    residual = problem.window.measured - predicted
    text = squares.message.replace("linear least squares", "Kalman filter and smoother")
    return replace(
        squares,
        message=text.replace("least squares", "Kalman filter and smoother"),
        values=together,
        covariance=covariance,
        predicted=predicted,
        residual=residual,
        whitened=residual / squares.noise["noise_std"],
        vaf=variance_accounted_for(problem.window, predicted),
    )


def _inverse(jacobian: Array, window: Window) -> Array:
    """Covariance (p, p) for unit noise variance by derivatives (n, 2, p)."""
    rows = jacobian[np.isfinite(window.measured)]
    scale = np.linalg.norm(rows, axis=0)
    scaled = rows / scale
    inverse: Array = np.linalg.inv(scaled.T @ scaled) / np.outer(scale, scale)
    return inverse


def smooth(problem: Problem, rough: Array) -> tuple[Array, Array]:
    """Smoothed values (p,) of a problem's linear parameters and their covariance (p, p) for unit noise.

    rough: (p, p), about that covariance. Without process noise the values do not depend on the measurement
    noise and their covariance is proportional to it, so the filter runs with unit noise. Its prior serves the
    recursion and is taken out exactly at the end, so that the answer is what the data alone say: with
    curvature L and gradient l of the adjoint pass at the start, prior x0, P0, the values are x0 - L^-1 l and
    their covariance L^-1 - P0 (from x0 - P0 l and P0 - P0 L P0 by the matrix inversion lemma). A prior as
    wide as ten standard errors costs two digits in this; a diffuse one would cost all.
    """
    window, fixed = problem.window, problem.known
    prior = dict(zip(problem.linear, PRIOR * np.sqrt(np.diag(rough)), strict=True))
    names = _names(prior)
    kalman = KalmanFilter(dim_x=len(names), dim_z=2, dim_u=1)
    kalman.x = np.array([[fixed.get(name, 0.0)] for name in names])
    kalman.P = np.diag([prior.get(name, 0.0) ** 2 for name in names])
    index = [names.index(name) for name in prior]
    start, uncertainty = kalman.x[index, 0], kalman.P[np.ix_(index, index)]
    moved = discretize(window, {name: value for name, value in fixed.items() if name in NONLINEAR})
    measured = window.measured - [0.0 if name in names else fixed.get(name, 0.0) for name in BIASES]
    torque = np.zeros(len(window.time)) if window.steer_torque is None else np.nan_to_num(window.steer_torque)
    turn = _sensor_turn(fixed.get("mounting_pitch", 0.0))
    passed = []
    for k, sample in enumerate(measured):
        transition, control = _transition(moved, k, len(names))
        rows = _measurement_rows(moved.yaw[k], names, turn)
        kalman.predict(u=np.array([[torque[max(k - 1, 0)]]]), B=control, F=transition, Q=0.0)
        passed.append((transition, *_update(kalman, rows, sample)))
    gradient, curvature = _backward(passed, len(names))
    inverse = np.linalg.inv(curvature[np.ix_(index, index)])
    return start - inverse @ gradient[index, 0], inverse - uncertainty


def _backward(passed: list[tuple[Array, Array, Array, Array, Array]], size: int) -> tuple[Array, Array]:
    """Adjoint pass of Bryson and Frazier: what all measurements together say about the state at the start.

    passed: per sample F (size, size), H (m, size), gain K (size, m), innovation y (m, 1), inverse of its
    covariance (m, m).
    """
    gradient, curvature = np.zeros((size, 1)), np.zeros((size, size))
    for transition, rows, gain, innovation, information in reversed(passed):
        kept = np.eye(size) - gain @ rows
        gradient = transition.T @ (kept.T @ gradient - rows.T @ information @ innovation)
        curvature = transition.T @ (kept.T @ curvature @ kept + rows.T @ information @ rows) @ transition
    return gradient, curvature


def _names(prior: dict[str, float]) -> tuple[str, ...]:
    """The state: the four of the bicycle, then the free biases."""
    return (*INITIAL, *(name for name in BIASES if name in prior))


def _transition(moved: Transitions, k: int, size: int) -> tuple[Array, Array]:
    """F (size, size) and the torque's column (size, 1) from the sample before to sample k."""
    transition, control = np.eye(size), np.zeros((size, 1))
    transition[:4, :4], control[:4, 0] = moved.transitions[k], moved.torque_steps[k]
    return transition, control


def _sensor_turn(pitch: float) -> Array:
    """Rates as a sensor pitched nose up by an angle [rad] feels them: (2, 2)."""
    return np.array([[np.cos(pitch), -np.sin(pitch)], [np.sin(pitch), np.cos(pitch)]])


def _measurement_rows(yaw: Array, names: tuple[str, ...], turn: Array) -> Array:
    """H (2, size): lean rate and yaw rate from the state."""
    rows = np.zeros((2, len(names)))
    rows[0, LEAN_RATE] = 1.0
    rows[1, :4] = yaw
    rows = turn @ rows
    for channel, name in enumerate(BIASES):
        if name in names:
            rows[channel, names.index(name)] = 1.0
    return rows


def _update(kalman: KalmanFilter, rows: Array, sample: Array) -> tuple[Array, Array, Array, Array]:
    """Use the measured channels; return their H, K, innovation and inverse of its covariance."""
    size = len(kalman.x)
    good = np.isfinite(sample)
    if not good.any():
        return np.zeros((0, size)), np.zeros((size, 0)), np.zeros((0, 1)), np.zeros((0, 0))
    # filterpy wants columns: a one-dimensional z would silently turn x into a matrix.
    kalman.update(sample[good].reshape(-1, 1), R=np.eye(int(good.sum())), H=rows[good])
    if kalman.x.shape != (size, 1):
        raise AssertionError(f"state of shape {kalman.x.shape} after an update")
    return rows[good], kalman.K.copy(), kalman.y.copy(), kalman.SI.copy()
