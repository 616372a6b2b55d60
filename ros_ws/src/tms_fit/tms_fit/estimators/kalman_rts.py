"""Kalman filter and Rauch-Tung-Striebel smoother of the free response.

The state is lean, steer, lean rate, steer rate and the biases of both channels. By default there is no
process noise; the smoothed initial state then equals the least-squares estimate under white noise
(`tms_fit.kalman.rts`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tms_model.bicycle import Array
from tms_model.response import LEAN_RATE

from tms_fit.estimate import Estimate, Status
from tms_fit.estimators.least_squares import fit_model, select_model
from tms_fit.kalman.rts import smooth, smoothed_start
from tms_fit.kalman.state_space import STATES, StateSpace
from tms_fit.kalman.transition_cache import TransitionCache
from tms_fit.least_squares.make_estimate import in_order, variance_accounted_for
from tms_fit.least_squares.model_selection import ModelSpec, specify_model
from tms_fit.least_squares.problem import Problem
from tms_fit.parameters import BIASES, FRICTION, INITIAL, SLIP, shaping
from tms_fit.response.discretization import Transitions, as_ridden, discretize, known_values
from tms_fit.response.prediction import predictor
from tms_fit.settings import Settings
from tms_fit.window import Window

NAMES = (*INITIAL, *BIASES)  # of the state
PRIOR_WIDTH = 10.0  # prior standard deviation of a free state, relative to its standard error
NO_NOISE = (0.0, 0.0)


def estimate(
    window: Window, settings: Settings, acceleration_noise: tuple[float, float] = NO_NOISE
) -> Estimate:
    """Smoothed initial state and biases; NONLINEAR parameters are those of least squares.

    The free parameters are selected as for `least_squares`. acceleration_noise [rad/s^2/sqrt(Hz)]: density of
    white disturbances of lean and steer acceleration.
    """
    decided, _ = select_model(window, settings)
    settings = replace(
        settings, free=decided.free, noise="white", oscillator=(), loss="squares", saturation="drop"
    )
    choice = replace(specify_model(window, settings), words=decided.words, reasons=decided.reasons)
    squares = fit_model("kalman_rts", choice, settings)
    if not _is_smoothable(choice, settings):
        return replace(
            squares,
            message="priors on what is linear, slip, friction, or nothing linear: least squares instead of a"
            " smoother",
        )
    if squares.status != "ok":
        return in_order(squares, choice.free)
    known = {name: value for name, value in squares.complete.items() if name not in choice.problem.linear}
    problem = replace(choice.problem, nonlinear=(), known=known)
    conditional = _inverse(squares.jacobian[:, :, : len(problem.linear)], problem.window)
    values, inverse = smooth_problem(problem, conditional, squares.noise["noise_std"], acceleration_noise)
    if not (np.isfinite(values).all() and (np.diag(inverse) > 0.0).all()):
        return Estimate(
            "kalman_rts", Status.NOT_CONVERGED, "the solution lost its precision; free fewer parameters"
        )
    return in_order(_smoothed(squares, problem, values, inverse - conditional), choice.free)


def smooth_problem(
    problem: Problem,
    rough: Array,
    noise_std: float = 1.0,
    acceleration_noise: tuple[float, float] = NO_NOISE,
) -> tuple[Array, Array]:
    """Smoothed values (p,) of a problem's linear parameters, and their covariance (p, p) per `noise_std`^2.

    rough: approximate covariance (p, p); the filter's prior is PRIOR_WIDTH times as wide and is removed
    exactly at the end. noise_std [rad/s]: of the measurements; without process noise the values do not depend
    on it and the covariance is proportional to its square.
    """
    std = dict(zip(problem.linear, PRIOR_WIDTH * np.sqrt(np.diag(rough)), strict=True))
    density = (0.0, 0.0)
    if any(acceleration_noise):
        density = (acceleration_noise[0] / noise_std, acceleration_noise[1] / noise_std)
    space, forced = window_space(problem, std, density)
    states = smooth(space, problem.window.measured - forced)
    index = [NAMES.index(name) for name in problem.linear]
    start = smoothed_start(space, states.gradient[None], states.curvature[None], index)
    return start.values[0], start.covariance[0]


def window_space(
    problem: Problem, std: dict[str, float], acceleration_noise: tuple[float, float]
) -> tuple[StateSpace, Array]:
    """State space of a window for unit measurement noise, and the rates (n, 2) [rad/s] beside it.

    The rates are those due to the known torque and a fixed slip. std: of the initial states and biases by
    name, others are known. acceleration_noise: densities of lean and steer [rad/s^2/sqrt(Hz)], per rad/s of
    measurement noise.
    """
    window, values = problem.window, shaping(problem.known)
    moved = discretize(window, values)
    transitions = np.tile(np.eye(STATES), (len(window.time), 1, 1))
    transitions[:, :4, :4] = moved.transitions
    rows = np.zeros((len(window.time), 2, STATES))
    rows[:, 0, LEAN_RATE] = 1.0
    rows[:, 1, :4] = moved.yaw
    rows = _sensor_turn(values.get("mounting_pitch", 0.0)) @ rows
    rows[:, :, 4:] = np.eye(2)
    process = np.zeros_like(transitions)
    if any(acceleration_noise):
        process[:, :4, :4] = _process_noise(window, values, moved, acceleration_noise)
    space = StateSpace(
        transitions=transitions,
        rows=rows,
        noise=np.ones((len(window.time), 2)),
        process=process,
        mean=np.array([problem.known.get(name, 0.0) for name in NAMES]),
        covariance=np.diag([std.get(name, 0.0) ** 2 for name in NAMES]),
    )
    return space, predictor(window, values).predict({SLIP: problem.known.get(SLIP, 0.0)})


def _process_noise(
    window: Window, values: dict[str, float], moved: Transitions, density: tuple[float, float]
) -> Array:
    """Process noise covariance (n, 4, 4) of the step to each sample, at the speed of its middle."""
    values = {**known_values(window), **values}
    bicycle = as_ridden(window.bicycle, values["lean_rate_gain"], values["steer_damper"])
    cache = TransitionCache(bicycle, np.diag(np.square([0.0, 0.0, *density])))
    durations = np.diff(window.time, prepend=values["strike_time"])
    speeds = moved.speeds - 0.5 * np.diff(moved.speeds, prepend=moved.speeds[0])
    return np.array(
        [cache.at(speed, step)[2] for speed, step in zip(speeds.tolist(), durations.tolist(), strict=True)]
    )


def _is_smoothable(choice: ModelSpec, settings: Settings) -> bool:
    """Whether the state holds all linear parameters, and the response is linear in it."""
    linear = {*choice.problem.linear}
    rubbing = FRICTION in {*choice.free, *settings.fixed}
    return bool(linear) and not linear & {*choice.problem.priors} and SLIP not in choice.free and not rubbing


def _smoothed(squares: Estimate, problem: Problem, values: Array, difference: Array) -> Estimate:
    """Estimate with the smoother's values; difference: smoother less least-squares covariance, unit noise."""
    count = len(problem.linear)
    covariance = squares.covariance.copy()
    covariance[:count, :count] += squares.noise["noise_std"] ** 2 * difference
    predicted = problem.predicted(values)
    residual = problem.window.measured - predicted
    text = squares.message.replace("linear least squares", "Kalman filter and smoother")
    return replace(
        squares,
        message=text.replace("least squares", "Kalman filter and smoother"),
        values=np.concatenate([values, squares.values[count:]]),
        covariance=covariance,
        predicted=predicted,
        residual=residual,
        whitened=residual / squares.noise["noise_std"],
        vaf=variance_accounted_for(problem.window, predicted),
    )


def _inverse(jacobian: Array, window: Window) -> Array:
    """Covariance (p, p) under unit noise from derivatives (n, 2, p) of the channels."""
    rows = jacobian[np.isfinite(window.measured)]
    scale = np.linalg.norm(rows, axis=0)
    scaled = rows / scale
    inverse: Array = np.linalg.inv(scaled.T @ scaled) / np.outer(scale, scale)
    return inverse


def _sensor_turn(pitch: float) -> Array:
    """Rotation (2, 2) from lean and yaw rate to the rates of a sensor pitched nose up by an angle [rad]."""
    return np.array([[np.cos(pitch), -np.sin(pitch)], [np.sin(pitch), np.cos(pitch)]])
