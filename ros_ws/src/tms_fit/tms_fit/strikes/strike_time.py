"""A strike once more, with what the bicycle's equations and the yaw rate know about it.

The detector sees the lean rate alone and takes short stretches of it for parabolas. Where the bicycle's
equations explain the motion before and after the impulse, they date its end better than any parabola, tell a
weak impulse from a push, and tell a bicycle that was struck from one whose steering was kicked.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from tms_model import linear_system
from tms_model.bicycle import Array
from tms_model.response import FASTEST

from tms_fit.least_squares.varpro import Problem
from tms_fit.strikes.impulse import Impulse, fit_impulse
from tms_fit.strikes.strike import NANOSECONDS, Strike
from tms_fit.window import Window, without_saturated

BEFORE = NANOSECONDS // 2  # [ns] of motion before a strike that is looked at
AFTER = 7 * NANOSECONDS // 20  # [ns] after it; what comes later has known other things
REACH = 0.06  # [s] on either side of where the detector has the middle of an impulse
KNOWN = 0.05  # [s] of motion after the middle of what was pushed, at least
MISFIT = 0.1  # of a change, in the lean rate: where the equations leave more they are not asked
HARDLY = 0.05  # weight of a push's lengths that an impulse may have, where the detector saw a push
LITTLE = 0.05  # the same: where they leave more, something else may have turned the steering meanwhile
SURE = 0.01  # [s], standard deviation of an end that takes the place of a push's peak
SURELY = 3.0  # standard deviations
AGREES = 2.0  # the same, between an end between two samples and that by the equations
SHAKEN = 0.3  # [rad/s], standard deviation of the kicks that it then may have got


def refine_strike_time(strike: Strike, window: Window, least: float) -> Strike | str:
    """The strike with its end by the equations, or as it is where they don't tell; or why it is none.

    window: the motion around the strike, from `BEFORE` until `AFTER` it. least [rad/s]: by how much what
    acted on the lean must have changed its rate, if it was a strike.
    """
    allowed = 0.5 if strike.kind == "strike" else HARDLY
    impulse = _impulse(strike, window)
    shaken = impulse is not None and (
        impulse.misfit > LITTLE * abs(strike.change) or impulse.push_share > allowed
    )
    if shaken:
        impulse = _impulse(strike, window, SHAKEN)
    if impulse is None or impulse.misfit > MISFIT * abs(strike.change):
        return strike
    acted = math.copysign(1.0, strike.change) * impulse.lean_rate + 2.0 * impulse.lean_rate_std
    if math.isfinite(impulse.steer_rate) and acted < least:
        return (
            f"the steering was kicked, not the bicycle struck: what acted on the lean changed its rate by"
            f" {impulse.lean_rate:+.3f} +- {impulse.lean_rate_std:.3f} rad/s, the rest followed from the"
            f" steering, as over a joint of the floor; {least:.2f} rad/s or more was needed"
        )
    if impulse.push_share > allowed or (shaken and impulse.end_std > (strike.end_std or SURE)):
        return strike
    return strike if _agrees(strike, impulse, window) else _with_end(strike, impulse, window)


def _agrees(strike: Strike, impulse: Impulse, window: Window) -> bool:
    """Whether the detector has the end between two samples, and the equations don't exclude it there."""
    first, last = ((when - window.first_ns) / NANOSECONDS for when in (strike.before_ns, strike.time_ns))
    reach = AGREES * impulse.end_std
    return strike.sharp and not impulse.sharp and first - reach < impulse.end < last + reach


def is_impulsive(strike: Strike, window: Window, least: float) -> bool:
    """Whether the lean was struck by more than `least` [rad/s], whatever else turned the steering meanwhile.

    Without a yaw rate what turned the steering isn't known: then nothing is sure.
    """
    impulse = _impulse(strike, window, SHAKEN)
    if impulse is None or math.isnan(impulse.steer_rate) or impulse.misfit > MISFIT * abs(strike.change):
        return False
    acted = math.copysign(1.0, strike.change) * impulse.lean_rate
    return acted - SURELY * impulse.lean_rate_std >= least


def _impulse(strike: Strike, window: Window, shaken: float = 0.0) -> Impulse | None:
    window = without_saturated(window)
    end = (strike.end_ns - window.first_ns) / NANOSECONDS
    speed = float(window.speed.at(end))
    if not 0.0 < speed <= FASTEST:
        return None
    system = linear_system(window.bicycle, speed, window.lean_rate_gain)
    rates = window.measured - _forced(window)
    return fit_impulse(window.time, rates, system, _middles(strike, window, end), shaken)


def _middles(strike: Strike, window: Window, end: float) -> tuple[float, float]:
    """Between which times [s] the middle of the impulse is looked for."""
    if strike.kind == "push":
        latest = min(end, float(window.time[-1]) - KNOWN)
        return (strike.onset_ns - window.first_ns) / NANOSECONDS - REACH, latest
    reach = max(REACH, 1.5 * (strike.time_ns - strike.before_ns) / NANOSECONDS)
    return end - strike.rise / 2.0 - reach, end - strike.rise / 2.0 + reach


def _forced(window: Window) -> Array:
    """Both rates (n, 2) by the known torque of the steering alone."""
    if window.steer_torque is None:
        return np.zeros((len(window.time), 2))
    return Problem(window, ("initial_lean",)).predicted(np.zeros(1))


def _with_end(strike: Strike, impulse: Impulse, window: Window) -> Strike:
    stamps = window.first_ns + np.round(window.time * NANOSECONDS).astype(np.int64)
    end_ns = window.first_ns + round(impulse.end * NANOSECONDS)
    begin_ns = end_ns - round(impulse.length * NANOSECONDS)
    if impulse.sharp:
        first = int(np.searchsorted(window.time, impulse.step + 1e-9, side="right"))
        onset = first - 1
    else:
        first = int(np.searchsorted(stamps, end_ns))
        onset = max(0, int(np.searchsorted(stamps, begin_ns)) - 1)
    if not 0 < first < len(stamps):
        return strike
    return replace(
        strike,
        time_ns=int(stamps[first]),
        before_ns=int(stamps[first - 1]),
        onset_ns=int(stamps[onset]),
        change=impulse.lean_rate,
        sharp=impulse.sharp,
        end_ns=end_ns,
        end_std=impulse.end_std,
        kind="strike",
        rise=impulse.length,
        why=f"{strike.why}; by the bicycle's equations an impulse of {impulse.lean_rate:+.3f} +-"
        f" {impulse.lean_rate_std:.3f} rad/s that took {1e3 * impulse.length:.0f} ms",
    )
