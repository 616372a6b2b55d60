"""The free ride of the nonlinear bicycle, and how far it departs from the linear one.

Between strikes the nonlinear Whipple equations (`tms_model.nonlinear`, knife-edge wheels that roll) are
integrated; strikes and joints act as on the upright bicycle, and the hands before and after as ever.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from tms_model import Bicycle, ParameterError
from tms_model.acceleration import resistance_load
from tms_model.bicycle import Array
from tms_model.nonlinear import Load, whipple_parameters
from tms_model.nonlinear_response import SPEED, YAW, moving, nonlinear_response, rates
from tms_model.response import LEAN, STEER
from tms_model.rolling import YAW_RATE

from tms_sim.motion import CHANNELS, Event, Trajectory
from tms_sim.plant import Plant
from tms_sim.scenario import Scenario
from tms_sim.steps import ORDER, bridge

STEP = 0.005  # [s]; polynomials of the fifth order between such states are right to 1e-9 rad (a test)
_LINEAR_ONLY = ("effects.slip", "effects.scrub", "effects.shimmy")


@dataclass(frozen=True, eq=False)
class FreeRide:
    """What `free_ride` finds."""

    begins: Array  # (k,) [s] since its start
    coefficients: Array  # (5, k, ORDER + 1) of tms_sim.motion.CHANNELS
    end: float  # [s] since its start
    state: Array  # (8,) at the end, in the order of tms_model.nonlinear_response.NONLINEAR_STATE
    yaw_rate: float  # [rad/s] at the end
    over: bool  # beyond a limit, or there is no motion any more
    stopped: bool  # it has rolled to a stop


def nonlinear_load(scenario: Scenario, plant: Plant) -> Load:
    """What slows a scenario's nonlinear bicycle, and what its offset mass does, as on the upright bicycle.

    Raises ParameterError for what only the linear bicycle has.
    """
    wrong = [key for key in _LINEAR_ONLY if scenario.switch(key)]
    if wrong:
        raise ParameterError(
            f"effects.nonlinear: expected only what its equations hold, found {', '.join(wrong)}, which act"
            " in the linear equations alone; switch them off"
            f" ({' '.join(f'--set {key}=false' for key in wrong)}), or effects.nonlinear"
        )
    slows = resistance_load(whipple_parameters(plant.bicycle), plant.acceleration)
    lean, steer = (plant.projection @ plant.moments).tolist()
    return replace(slows, lean_torque=lean, steer_torque=steer)


def free_ride(
    bicycle: Bicycle, load: Load, initial: Array, duration: float, limits: tuple[float, float]
) -> FreeRide:
    """The free motion from `initial` (8,), for a time or until |lean| or |steer| passes its limit [rad].

    Raises ParameterError as `tms_model.nonlinear_response.nonlinear_response` does.
    """
    count = max(1, math.ceil(duration / STEP - 1e-9))
    times: Array = duration / count * np.arange(count + 1, dtype=float)
    found = nonlinear_response(bicycle, initial, times, load)
    states = found.states[: int(np.isfinite(found.states[:, LEAN]).sum())]
    passed = np.flatnonzero((np.abs(states[:, LEAN]) >= limits[0]) | (np.abs(states[:, STEER]) >= limits[1]))
    states = states[: passed[0] + 1] if len(passed) else states
    if len(states) < 2:
        return FreeRide(
            np.empty(0), np.empty((5, 0, ORDER + 1)), 0.0, initial, 0.0, True, found.status == "stopped"
        )
    kept, length = _polynomials(bicycle, load, states, float(times[1])), float(times[1])
    state, end = states[-1], float(times[len(states) - 1])
    if len(passed):
        inside = _passing(kept[:2, -1], length, limits)
        state, end = _at(kept[:, -1], inside), float(times[len(states) - 2]) + inside
    turn = float(moving(bicycle, state, load).rates[YAW_RATE])
    over = len(passed) > 0 or len(states) <= count
    stopped = found.status == "stopped" and not len(passed)
    return FreeRide(times[: len(states) - 1], kept, end, state, turn, over, stopped)


def _at(polynomials: Array, time: float) -> Array:
    """State (8,), its x and y 0, of one step's polynomials (5, m) at a time [s] in it."""
    powers = time ** np.arange(ORDER + 1)
    values = polynomials @ powers
    slopes = polynomials[:2, 1:] @ (np.arange(1, ORDER + 1) * powers[:-1])
    lean, steer, yaw, _, speed = values
    return np.array([lean, steer, *slopes, speed, yaw, 0.0, 0.0])


def _polynomials(bicycle: Bicycle, load: Load, states: Array, length: float) -> Array:
    """Polynomials (5, k, ORDER + 1) through states (k + 1, 8), their rates and accelerations."""
    change = np.array([rates(bicycle, state, load) for state in states])
    turns = [moving(bicycle, state, load) for state in states]
    ends = np.zeros((len(CHANNELS), len(states), 3))
    ends[:2, :, 0], ends[:2, :, 1] = states[:, :2].T, states[:, 2:4].T
    ends[:2, :, 2] = change[:, 2:4].T
    ends[2] = [
        [x[YAW], now.rates[YAW_RATE], now.accelerations[YAW_RATE]]
        for x, now in zip(states, turns, strict=True)
    ]
    ends[4] = np.stack([states[:, SPEED], change[:, SPEED], np.gradient(change[:, SPEED], length)], axis=1)
    kept = np.zeros((len(CHANNELS), len(states) - 1, ORDER + 1))
    for channel, at in enumerate(ends):
        kept[channel, :, :6] = bridge(at[:-1], at[1:], length)
    return kept


def _passing(polynomials: Array, length: float, limits: tuple[float, float]) -> float:
    """Time [s] in a step when lean or steer (2, m) passes its limit."""
    low, high = 0.0, length
    for _ in range(50):
        middle = 0.5 * (low + high)
        values = np.abs(polynomials @ middle ** np.arange(ORDER + 1))
        low, high = (low, middle) if (values >= np.array(limits)).any() else (middle, high)
    return high


def departure(nonlinear: Trajectory, linear: Trajectory) -> Event:
    """By how much the nonlinear run departs from the linear one, until hands catch either."""
    ends = [one.time for run in (nonlinear, linear) for one in run.events if one.text == "caught"]
    end = min(nonlinear.end, linear.end, *ends)
    times = np.linspace(0.0, end, max(2, math.ceil(end / STEP)))
    one, other = nonlinear.at(times), linear.at(times)
    lean = float(np.abs(one.lean - other.lean).max())
    return Event(
        0.0,
        "nonlinear",
        f"the nonlinear bicycle: its lean departs from the linear one's by {math.degrees(lean):.3g} deg",
        end,
        {
            "lean_rad": lean,
            "lean_rate_rad_s": float(np.abs(one.lean_rate - other.lean_rate).max()),
            "yaw_rate_rad_s": float(np.abs(one.yaw_rate - other.yaw_rate).max()),
            "heading_rad": float(one.yaw[-1] - other.yaw[-1]),
        },
    )
