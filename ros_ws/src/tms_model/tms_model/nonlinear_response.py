"""Motion of the nonlinear Whipple bicycle in time: free, under a steer torque, or slowed by resistance."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tms_model.bicycle import Array, Bicycle
from tms_model.errors import ParameterError
from tms_model.nonlinear import Load, Motion, motion, whipple_parameters
from tms_model.response import LEAN, LEAN_RATE, STATE, STEER_RATE
from tms_model.rolling import YAW_RATE

if TYPE_CHECKING:
    from scipy.integrate import DOP853

NONLINEAR_STATE = (*STATE, "speed", "yaw", "x", "y")  # speed [m/s], yaw [rad], rear contact in the plane [m]
SPEED, YAW, X, Y = range(4, 8)
FALLEN = math.radians(80.0)  # of lean: beyond this its handlebars are on the ground
OK = "ok"


@dataclass(frozen=True, eq=False)
class NonlinearResponse:
    """States at the times asked for; NaN from where the motion ended, if `status` is not `ok`.

    status: ok; fallen (leans more than FALLEN); stopped (rolled to a stop); stuck (no posture with both
    wheels on the ground, or steps that vanish).
    """

    times: Array  # (n,) [s]
    states: Array  # (n, 8), in the order of NONLINEAR_STATE
    yaw_rate: Array  # (n,) [rad/s]
    status: str
    message: str


def nonlinear_response(
    bicycle: Bicycle,
    initial: Array,
    times: Array,
    load: Load | None = None,
    steer_torque: Array | None = None,
    tolerance: float = 1e-10,
) -> NonlinearResponse:
    """Response at `times` [s] (n,), ascending and not negative, when `initial` holds at time zero.

    initial: (8,) in the order of NONLINEAR_STATE; of (5,), yaw, x and y start at 0. load: constant.
    steer_torque: (n,) [N m] besides the load's, each value held until the next time (the first from time zero
    on). tolerance: of each step, relative, and absolute per rad, m and s. Raises ParameterError for a bicycle
    without parameters, and for a start from which no motion is possible.
    """
    start = np.zeros(len(NONLINEAR_STATE))
    start[: len(initial)] = initial
    if not (np.isfinite(start).all() and start[SPEED] > 0.0):
        raise ParameterError(f"initial state: expected finite numbers and a positive speed, found {start}")
    states = np.full((len(times), len(start)), np.nan)
    load, status, message = load or Load(), OK, f"{times[-1]:g} s as asked for"
    rates(bicycle, start, load)
    last_state, last_time = start, 0.0
    for rows in _held(len(times), steer_torque):
        known = 0.0 if steer_torque is None else float(steer_torque[max(rows.start - 1, 0)])
        torque = bicycle.steer_elements.steer_torque_gain * known
        held = replace(load, steer_torque=load.steer_torque + torque)
        run = _Run(bicycle, held, tolerance, last_time, last_state)
        run.fill(times[rows], states[rows])
        if run.status != OK:
            status, message = run.status, run.message
            break
        last_state, last_time = states[rows][-1], float(times[rows][-1])
    yaw_rates = [math.nan if np.isnan(x[0]) else moving(bicycle, x).rates[YAW_RATE] for x in states]
    return NonlinearResponse(times, states, np.array(yaw_rates), status, message)


def moving(bicycle: Bicycle, state: Array, load: Load | None = None) -> Motion:
    """The instant's motion of `state`, (5,) or more of NONLINEAR_STATE; the bicycle's steer elements act."""
    elements, load = bicycle.steer_elements, load or Load()
    torque = elements.stiffness[1] @ state[:2] + elements.damping[1] @ state[2:4]
    acting = replace(load, steer_torque=load.steer_torque - float(torque))
    return motion(whipple_parameters(bicycle), state[:5], acting)


def rates(bicycle: Bicycle, state: Array, load: Load) -> Array:
    """Time derivative (8,) of a state (8,)."""
    now = moving(bicycle, state, load)
    speed, yaw = state[SPEED], state[YAW]
    return np.array(
        [
            state[LEAN_RATE],
            state[STEER_RATE],
            *now.accelerations[:3],
            now.rates[YAW_RATE],
            speed * math.cos(yaw),
            speed * math.sin(yaw),
        ]
    )


def _held(count: int, steer_torque: Array | None) -> list[slice]:
    """Rows that one steer torque leads to: all of them, or each by itself."""
    return [slice(0, count)] if steer_torque is None else [slice(k, k + 1) for k in range(count)]


class _Run:
    """Integration from one state on under a constant load; says how it ended."""

    def __init__(self, bicycle: Bicycle, load: Load, tolerance: float, time: float, state: Array) -> None:
        self.status, self.message = OK, ""
        self._derivative = lambda _, x: rates(bicycle, x, load)
        self._tolerance, self._time, self._state = tolerance, time, state

    def fill(self, times: Array, states: Array) -> None:
        """Write the states at `times` into the rows of `states`, as far as the motion goes."""
        row = int(np.searchsorted(times, self._time, side="right"))
        states[:row] = self._state
        if row == len(times):
            return
        solver = self._solver(float(times[-1]))
        while row < len(times) and self._step(solver):
            until = int(np.searchsorted(times, solver.t, side="right"))
            if until > row:
                states[row:until] = solver.dense_output()(times[row:until]).T
                row = until

    def _solver(self, end: float) -> DOP853:
        # scipy.integrate takes half a second to import: only who integrates pays for it
        from scipy.integrate import DOP853

        return DOP853(
            self._derivative, self._time, self._state, end, rtol=self._tolerance, atol=self._tolerance
        )

    def _step(self, solver: DOP853) -> bool:
        try:
            solver.step()
        except ParameterError as error:
            self.status, self.message = "stuck", f"after {solver.t:.4g} s: {error}"
            return False
        lean, speed = abs(float(solver.y[LEAN])), float(solver.y[SPEED])
        if solver.status == "failed" or not np.isfinite(solver.y).all():
            self.status, self.message = "stuck", f"no step small enough after {solver.t:.4g} s"
        elif lean > FALLEN:
            self.status, self.message = "fallen", f"leans {math.degrees(lean):.0f} deg at {solver.t:.4g} s"
        elif speed <= 0.0:
            self.status, self.message = "stopped", f"speed {speed:.3g} m/s at {solver.t:.4g} s"
        return self.status == OK
