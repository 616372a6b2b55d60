"""Motion of the linearised bicycle at constant speed: state space, exact discretisation, response.

The state order is written here, once: lean, steer, lean_rate, steer_rate.

Reference: Kooijman et al. 2011, supplement Eqs. (3.1) and (10.2), doi 10.1126/science.1201959; C. F. Van
Loan, "Computing integrals involving the matrix exponential", IEEE TAC 23 (1978), doi
10.1109/TAC.1978.1101743.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tms_model.bicycle import Array, Bicycle
from tms_model.errors import ParameterError
from tms_model.exponential import expm

FASTEST = 1000.0  # [m/s]; far beyond it powers of speed overflow
STATE = ("lean", "steer", "lean_rate", "steer_rate")  # [rad, rad, rad/s, rad/s]
LEAN, STEER, LEAN_RATE, STEER_RATE = range(4)


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """x' = a x + b T_steer and yaw rate = yaw x, x in the order of STATE."""

    a: Array  # (4, 4)
    b: Array  # (4,), per N m of known steer torque
    yaw: Array  # (4,), yaw rate per state, Eq. (10.2)
    speed: float  # v [m/s]


def state_matrix(bicycle: Bicycle, speed: float | Array, lean_rate_gain: float = 0.0) -> Array:
    """State matrix (4, 4) of Eq. (3.1) at constant speed [m/s]; (n, 4, 4) at each of n speeds.

    The bicycle's own steer elements are in; lean_rate_gain [N m s/rad] adds to theirs what a controller
    commands in this run, T_known = lean_rate_gain * lean rate; positive steers into the fall.
    """
    damping = bicycle.damping_at(speed)
    damping[..., 1, 0] -= bicycle.steer_elements.steer_torque_gain * lean_rate_gain
    return first_order(bicycle.mass, damping, bicycle.stiffness_at(speed))


def first_order(mass: Array, damping: Array, stiffness: Array) -> Array:
    """State matrices (..., 4, 4) of M q'' + C q' + K q = 0; each (2, 2) or (..., 2, 2)."""
    matrix = np.zeros((*damping.shape[:-2], 4, 4))
    matrix[..., :2, 2:] = np.eye(2)
    matrix[..., 2:, :2] = -np.linalg.solve(mass, stiffness)
    matrix[..., 2:, 2:] = -np.linalg.solve(mass, damping)
    return matrix


def torque_column(bicycle: Bicycle) -> Array:
    """Change of the state (4,) per second and N m of known steer torque."""
    arrives = bicycle.steer_elements.steer_torque_gain
    return np.concatenate([np.zeros(2), np.linalg.solve(bicycle.mass, [0.0, arrives])])


def yaw_row(bicycle: Bicycle, speed: float | Array) -> Array:
    """Yaw rate per state (4,), Eq. (10.2), at a speed [m/s]; (n, 4) at n speeds."""
    projection = math.cos(bicycle.steer_axis_tilt) / bicycle.wheelbase
    row = np.zeros((*np.shape(speed), 4))
    row[..., STEER] = speed * projection
    row[..., STEER_RATE] = bicycle.trail * projection
    return row


def linear_system(bicycle: Bicycle, speed: float, lean_rate_gain: float = 0.0) -> LinearSystem:
    """The bicycle at constant speed [m/s], with optional lean-rate feedback on the steer torque [N m s/rad].

    Raises ParameterError for a speed that is not finite and positive (a bicycle that stands has no response
    to compare), or a feedback that is not finite.
    """
    if not 0.0 < speed <= FASTEST:
        raise ParameterError(
            f"speed: expected a positive number of m/s, at most {FASTEST:g}, found {speed:g}"
        )
    if not math.isfinite(lean_rate_gain):
        raise ParameterError(f"gain: expected a finite number of N m s/rad, found {lean_rate_gain:g}")
    matrix = state_matrix(bicycle, speed, lean_rate_gain)
    return LinearSystem(matrix, torque_column(bicycle), yaw_row(bicycle, speed), speed)


def discretise(system: LinearSystem, step: float) -> tuple[Array, Array]:
    """Exact transition over `step` [s]: x(t + step) = phi x(t) + gamma T with T held constant.

    Shapes (4, 4) and (4,). Both blocks come from one matrix exponential (Van Loan).
    """
    size = len(system.b)
    augmented = np.zeros((size + 1, size + 1))
    augmented[:size, :size], augmented[:size, size] = system.a, system.b
    exponential = expm(augmented * step)
    return exponential[:size, :size], exponential[:size, size]


def response(system: LinearSystem, initial: Array, times: Array, steer_torque: Array | None = None) -> Array:
    """States at `times` [s] (n,), ascending and not negative, when `initial` holds at time zero.

    initial: (4,) for one response, (4, m) for m at once. steer_torque: (n,) [N m], each value held until the
    next time (the first from time zero on). Returns (n, 4) or (n, 4, m). Exact between the times, whatever
    their spacing.
    """
    states = np.empty((len(times), *initial.shape))
    state = np.asarray(initial, dtype=float)
    transitions: dict[float, tuple[Array, Array]] = {}
    # Whole nanoseconds, so that equal steps share one matrix whatever the float times are.
    for k, step in enumerate(np.round(np.diff(times, prepend=0.0), 9).tolist()):
        if step not in transitions:
            transitions[step] = discretise(system, step)
        phi, gamma = transitions[step]
        np.dot(phi, state, out=states[k])
        state = states[k]
        if steer_torque is not None:
            state += (gamma * steer_torque[max(k - 1, 0)]).reshape((-1,) + (1,) * (initial.ndim - 1))
    return states


def with_heading(system: LinearSystem) -> LinearSystem:
    """The same system with the heading (yaw angle, SAE) as fifth state, integrated as exactly."""
    a = np.zeros((5, 5))
    a[:4, :4], a[4, :4] = system.a, system.yaw
    return LinearSystem(a, np.append(system.b, 0.0), np.append(system.yaw, 0.0), system.speed)


def yaw_rate(system: LinearSystem, states: Array) -> Array:
    """Yaw rate [rad/s], Eq. (10.2), of states (n, 4) or (n, 4, m); SAE sign, positive to the right."""
    return np.tensordot(states, system.yaw, axes=([1], [0]))
