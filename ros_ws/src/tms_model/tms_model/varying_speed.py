"""Linear motion of the bicycle while its speed changes: state matrices, transitions, response.

    x' = A(v, v') x + B T_steer,  yaw rate = (cos lambda_s / w)(v steer + c steer')

with the terms in v' of `tms_model.acceleration`, for any v(t) given at instants and straight between
them. Each step is one exponential, by the sixth-order Magnus expansion at three Gauss points, in parts of at
most MAX_STEP; at constant speed that is exact. For the catalogue's bicycles and decelerations up to 2 m/s^2
the states are right to 1e-9 of their size (a test compares them with an integrator).

Reference: S. Blanes, F. Casas, J. A. Oteo and J. Ros, "The Magnus expansion and some of its applications",
Physics Reports 470 (2009), doi 10.1016/j.physrep.2008.11.001, section 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tms_model.acceleration import acceleration_stiffness, parameters_under_acceleration
from tms_model.bicycle import Array, Bicycle
from tms_model.errors import ParameterError
from tms_model.exponential import expm
from tms_model.resistance import Resistance
from tms_model.response import first_order, torque_column, yaw_row

MAX_STEP = 0.005  # [s]
_GAUSS = (0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15))  # points in a step of length one


@dataclass(frozen=True, eq=False)
class VaryingSystem:
    """State x in the order of tms_model.response.STATE at `times`; the steer torque is held between them.

    x[k + 1] = transitions[k] x[k] + torque_steps[k] T[k] and yaw rate = yaw[k] x[k].
    """

    times: Array  # (n,) [s]
    speeds: Array  # (n,) [m/s]
    transitions: Array  # (n - 1, 4, 4)
    torque_steps: Array  # (n - 1, 4), per N m
    yaw: Array  # (n, 4)


def state_matrices(
    bicycle: Bicycle, speeds: Array, accelerations: Array, resistance: Resistance = "rolling"
) -> Array:
    """State matrices (n, 4, 4) at speeds (n,) [m/s] that change at accelerations (n,) [m/s^2].

    The bicycle's steer elements are in. A bicycle given by matrices only takes the terms in v' from its
    stand-in (`tms_model.acceleration.STAND_INS`). Raises ParameterError as `acceleration_stiffness` does.
    """
    stiffness = bicycle.stiffness_at(speeds)
    if accelerations.any():
        parameters, _ = parameters_under_acceleration(bicycle)
        stiffness += acceleration_stiffness(parameters, accelerations, resistance)
    return first_order(bicycle.mass, bicycle.damping_at(speeds), stiffness)


def varying_system(
    bicycle: Bicycle, times: Array, speeds: Array, resistance: Resistance = "rolling"
) -> VaryingSystem:
    """Transitions between the times (n,) [s], ascending, with the speeds (n,) [m/s] at them.

    Raises ParameterError for times that don't ascend, for a speed that is not finite and at least zero, and
    as `state_matrices` does.
    """
    times, speeds = np.asarray(times, dtype=float), np.asarray(speeds, dtype=float)
    _check(times, speeds)
    steps = np.diff(times)
    accelerations = np.diff(speeds) / steps
    whole = transitions_from(bicycle, speeds[:-1], accelerations, steps, resistance)
    return VaryingSystem(times, speeds, whole[:, :4, :4], whole[:, :4, 4], yaw_row(bicycle, speeds))


def transitions_from(
    bicycle: Bicycle, speeds: Array, accelerations: Array, steps: Array, resistance: Resistance = "rolling"
) -> Array:
    """Transitions (n, 5, 5) of state and held torque over steps (n,) [s] that need not follow each other.

    speeds (n,) [m/s] at their beginning, accelerations (n,) [m/s^2] during them. Raises ParameterError as
    `state_matrices` does.
    """
    parts = 1 if not accelerations.any() else max(1, math.ceil(round(float(steps.max()) / MAX_STEP, 6)))
    exponentials = expm(_magnus(bicycle, steps / parts, speeds, accelerations, parts, resistance))
    whole = exponentials[:, 0]
    for part in range(1, parts):
        whole = exponentials[:, part] @ whole
    return whole


def varying_response(system: VaryingSystem, initial: Array, steer_torque: Array | None = None) -> Array:
    """States at the system's times when `initial` holds at the first of them.

    initial: (4,) for one response, (4, m) for m at once. steer_torque: (n,) [N m], each value held until the
    next time. Returns (n, 4) or (n, 4, m).
    """
    states = np.empty((len(system.times), *initial.shape))
    states[0] = initial
    for k, transition in enumerate(system.transitions):
        states[k + 1] = transition @ states[k]
        if steer_torque is not None:
            step = system.torque_steps[k] * steer_torque[k]
            states[k + 1] += step.reshape((-1,) + (1,) * (initial.ndim - 1))
    return states


def varying_yaw_rate(system: VaryingSystem, states: Array) -> Array:
    """Yaw rate [rad/s], SAE sign, of states (n, 4) or (n, 4, m) at the system's times."""
    rate: Array = np.einsum("ki,ki...->k...", system.yaw, states)
    return rate


def _check(times: Array, speeds: Array) -> None:
    if times.ndim != 1 or times.shape != speeds.shape or len(times) < 2:
        raise ParameterError(
            f"times and speeds: expected two or more of each, as many of one as of the other, found shapes"
            f" {times.shape} and {speeds.shape}"
        )
    if not (np.diff(times) > 0.0).all():
        raise ParameterError("times: expected ascending numbers of seconds")
    wrong = np.flatnonzero(~(np.isfinite(speeds) & (speeds >= 0.0)))
    if len(wrong):
        raise ParameterError(
            f"speed: expected zero or a positive number of m/s, found {speeds[wrong[0]]:g} at"
            f" {times[wrong[0]]:g} s; shorten the run, or let it lose speed less quickly"
        )


def _magnus(
    bicycle: Bicycle, steps: Array, speeds: Array, accelerations: Array, parts: int, resistance: Resistance
) -> Array:
    """Exponents (n, parts, 5, 5) of the equal parts of each step; the fifth state is the held torque."""
    generators = []
    for place in _GAUSS:
        elapsed = steps[:, None] * (np.arange(parts) + place)
        at = speeds[:, None] + accelerations[:, None] * elapsed
        changing = np.broadcast_to(accelerations[:, None], at.shape)
        generator = np.zeros((*at.shape, 5, 5))
        matrices = state_matrices(bicycle, at.ravel(), changing.ravel(), resistance)
        generator[..., :4, :4] = matrices.reshape(*at.shape, 4, 4)
        generator[..., :4, 4] = torque_column(bicycle)
        generators.append(generator * steps[:, None, None, None])
    first, middle, last = generators
    slope, bend = math.sqrt(15.0) / 3.0 * (last - first), 10.0 / 3.0 * (last - 2.0 * middle + first)
    one = _commutator(middle, slope)
    two = -_commutator(middle, 2.0 * bend + one) / 60.0
    return middle + bend / 12.0 + _commutator(-20.0 * middle - bend + one, slope + two) / 240.0


def _commutator(first: Array, second: Array) -> Array:
    return first @ second - second @ first
