"""Linear state space of the sampled bicycle.

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
    """Time-varying model of n samples, m channels, s states; all noise is Gaussian and white."""

    transitions: Array  # F (n, s, s); the first leads from the start to the first sample
    rows: Array  # H (n, m, s)
    noise: Array  # (n, m) variance of each measurement
    process: Array  # (n, s, s) covariance of w
    mean: Array  # (s,) of the state at the start, before any measurement
    covariance: Array  # (s, s)


def bicycle_space(
    system: LinearSystem, time: Array, noise: tuple[float, float], mean: Array, std: Array, delay: float = 0.0
) -> StateSpace:
    """State space of a bicycle at constant speed without process noise.

    time: (n,) [s] of the samples, ascending; the start lies `delay` [s] before the first. noise: standard
    deviation [rad/s] of lean rate and yaw rate. mean, std: (6,) of state and biases at the start.
    """
    steps = np.round(np.diff(time, prepend=time[0] - delay), 9)
    discretised = {step: discretise(system, step)[0] for step in set(steps.tolist())}
    transitions = np.tile(np.eye(STATES), (len(time), 1, 1))
    transitions[:, :4, :4] = [discretised[step] for step in steps.tolist()]
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
    """State space with a narrow-band oscillation in one channel: a lightly damped oscillator driven by noise.

    frequency [Hz]; decay_time [s]: correlation time of the phase; std [rad/s] of the oscillation, stationary
    from the start on. Shimmy is one: a limit cycle of constant amplitude and slowly drifting phase.
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
    """State space with two more states, which are zero."""
    square, flat = ((0, 0), (0, 2), (0, 2)), ((0, 0), (0, 0), (0, 2))
    return StateSpace(
        transitions=np.pad(space.transitions, square),
        rows=np.pad(space.rows, flat),
        noise=space.noise,
        process=np.pad(space.process, square),
        mean=np.pad(space.mean, (0, 2)),
        covariance=np.pad(space.covariance, (0, 2)),
    )
