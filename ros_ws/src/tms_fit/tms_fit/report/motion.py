"""How the bicycle moved: lean, steer, heading and path of the rear contact, for the animated drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tms_bag.samples import StateSamples
from tms_model.bicycle import Array
from tms_model.response import LEAN, STEER

from tms_fit.comparison import Comparison
from tms_fit.parameters import INITIAL
from tms_fit.response.discretization import discretize


@dataclass(frozen=True, eq=False)
class Motion:
    """SAE signs; times [s] since the start of the free response; the path begins at 0, 0 heading along x."""

    time: Array  # (n,) [s]
    lean: Array  # (n,) [rad]
    steer: Array  # (n,) [rad]
    yaw: Array  # (n,) [rad]
    x: Array  # (n,) [m] of the rear contact
    y: Array  # (n,) [m], to the right


def predicted_motion(both: Comparison) -> Motion:
    """The motion that an estimate predicts, from its initial state and the known steer torque on."""
    steps = discretize(both.shown, both.estimate.nonlinear)
    torque = both.shown.steer_torque
    known = np.zeros(len(both.time)) if torque is None else np.nan_to_num(torque)
    state = np.array([both.estimate.complete.get(name, 0.0) for name in INITIAL])
    states, turning = [state], [float(steps.yaw[0] @ state)]
    for k, (transition, step) in enumerate(zip(steps.transitions, steps.torque_steps, strict=True)):
        state = transition @ state + step * known[max(k - 1, 0)]
        states.append(state)
        turning.append(float(steps.yaw[k] @ state))
    time = np.concatenate([[0.0], both.time])
    speeds = np.concatenate([steps.speeds[:1], steps.speeds])
    rows = slice(1, None) if both.time[0] <= 0.0 else slice(None)  # the strike fell on the first sample
    lean, steer = np.array(states)[:, LEAN], np.array(states)[:, STEER]
    yaw = _integral(time, np.array(turning))
    return _along(time[rows], lean[rows], steer[rows], yaw[rows], speeds[rows])


def true_motion(state: StateSamples, start_ns: int, first: float, last: float) -> Motion | None:
    """What a simulated bicycle really did between two times [s]; None where that was not recorded."""
    seconds = (state.time_ns - start_ns) / 1e9
    rows = np.flatnonzero((seconds >= first) & (seconds <= last))
    if len(rows) < 2:
        return None
    lean, steer = state.state[rows, LEAN], state.state[rows, STEER]
    return _along(seconds[rows], lean, steer, state.yaw[rows], state.speed[rows])


def _along(time: Array, lean: Array, steer: Array, yaw: Array, speed: Array) -> Motion:
    """The path from heading and speed; it begins where and as the free response does."""
    heading = yaw - np.interp(0.0, time, yaw)
    x, y = _integral(time, speed * np.cos(heading)), _integral(time, speed * np.sin(heading))
    return Motion(time, lean, steer, heading, x - np.interp(0.0, time, x), y - np.interp(0.0, time, y))


def _integral(time: Array, values: Array) -> Array:
    """Running trapezoidal integral, zero at the first sample."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])
