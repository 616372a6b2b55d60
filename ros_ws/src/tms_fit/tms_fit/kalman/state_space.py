"""The sampled bicycle as a linear state space: what Kalman filters of every kind run on.

    x[k] = F[k] x[k - 1] + w[k],   y[k, c] = H[k, c] x[k] + v[k, c]

x[-1] is the state at the start of the free response. The state is lean, steer, lean rate, steer rate, the
biases of both channels, and, where the frame shakes, an oscillator of two states for each shaken channel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from tms_model import LinearSystem, discretise
from tms_model.bicycle import Array
from tms_model.response import LEAN_RATE

STATES = 6  # four of the bicycle, two biases


@dataclass(frozen=True, eq=False)
class StateSpace:
    """n samples, m channels, s states. What is random is Gaussian and white."""

    transitions: Array  # F (n, s, s); the first leads from the start to the first sample
    rows: Array  # H (n, m, s)
    noise: Array  # (n, m) variance of each measurement
    process: Array  # (n, s, s) covariance of w
    mean: Array  # (s,) of the state at the start, before any measurement
    covariance: Array  # (s, s)


def bicycle_space(
    system: LinearSystem, time: Array, noise: tuple[float, float], mean: Array, std: Array, delay: float = 0.0
) -> StateSpace:
    """State space of a bicycle at constant speed, nothing disturbing it.

    time: (n,) [s] of the samples, ascending; the start lies `delay` [s] before the first. noise: standard
    deviation [rad/s] of lean rate and yaw rate. mean, std: (6,) of state and biases at the start.
    """
    steps = np.round(np.diff(time, prepend=time[0] - delay), 9)
    known = {step: discretise(system, step)[0] for step in set(steps.tolist())}
    transitions = np.tile(np.eye(STATES), (len(time), 1, 1))
    transitions[:, :4, :4] = [known[step] for step in steps.tolist()]
    rows = np.zeros((2, STATES))
    rows[0, LEAN_RATE] = rows[0, 4] = rows[1, 5] = 1.0
    rows[1, :4] = system.yaw
    return StateSpace(
        transitions=transitions,
        rows=np.tile(rows, (len(time), 1, 1)),
        noise=np.tile(np.square(noise), (len(time), 1)),
        process=np.zeros_like(transitions),
        mean=np.asarray(mean, dtype=float),
        covariance=np.diag(np.square(std)),
    )


def with_oscillator(
    space: StateSpace, time: Array, channel: int, frequency: float, decay_time: float, std: float
) -> StateSpace:
    """The space with a narrow-band oscillation in one channel: a randomly driven, lightly damped oscillator.

    frequency [Hz]; decay_time [s] in which its phase is forgotten; std [rad/s] of the oscillation, which it
    keeps from the start on. Shimmy is one: a limit cycle of constant amplitude and slowly wandering phase.
    """
    size = space.mean.size
    steps = np.diff(time, prepend=time[0])
    kept, angle = np.exp(-steps / decay_time), 2.0 * math.pi * frequency * steps
    wider = _widened(space)
    transitions = wider.transitions.copy()
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    transitions[:, size:, size:] = np.moveaxis(turn * kept, -1, 0)
    process, rows = wider.process.copy(), wider.rows.copy()
    process[:, size:, size:] = std**2 * (1.0 - kept**2)[:, None, None] * np.eye(2)
    rows[:, channel, size] = 1.0
    covariance = wider.covariance.copy()
    covariance[size:, size:] = std**2 * np.eye(2)
    return replace(wider, transitions=transitions, process=process, rows=rows, covariance=covariance)


def _widened(space: StateSpace) -> StateSpace:
    """The space with two more states that do nothing."""
    square, flat = ((0, 0), (0, 2), (0, 2)), ((0, 0), (0, 0), (0, 2))
    return StateSpace(
        transitions=np.pad(space.transitions, square),
        rows=np.pad(space.rows, flat),
        noise=space.noise,
        process=np.pad(space.process, square),
        mean=np.pad(space.mean, (0, 2)),
        covariance=np.pad(space.covariance, (0, 2)),
    )
