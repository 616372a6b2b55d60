"""Refined strike times, by the bicycle's equations and the yaw rate.

The detector sees the lean rate alone and approximates short segments of it by parabolas. Where the bicycle's
equations explain the motion before and after the impulse, they give its end more accurately, separate a weak
impulse from a push, and a bicycle that was struck from one whose steering was kicked.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from tms_model import linear_system
from tms_model.bicycle import Array
from tms_model.response import FASTEST

from tms_fit.least_squares.problem import Problem
from tms_fit.strikes.impulse import Impulse, fit_impulse
from tms_fit.strikes.strike import NANOSECONDS, Strike
from tms_fit.window import Window, without_saturated

BEFORE_STRIKE_NS = NANOSECONDS // 2  # [ns] of motion before a strike that is fitted
AFTER_STRIKE_NS = 7 * NANOSECONDS // 20  # [ns] of motion after it; the later is left out
MIDDLE_SEARCH_S = 0.06  # on either side of the detected middle of an impulse
LEAST_MOTION_AFTER_S = 0.05  # of motion after the middle of a push
LARGEST_MISFIT_SHARE = 0.1  # of a change: with a larger misfit of the lean rate the equations are not used
LARGEST_PUSH_WEIGHT = 0.05  # of an impulse where a push was detected
SMALL_MISFIT_SHARE = 0.05  # of a change: with a larger misfit the steering may have been kicked meanwhile
PEAK_STD_S = 0.01  # largest standard deviation of an end that replaces the peak of a push
IMPULSE_STANDARD_ERRORS = 3.0  # by which an impulse exceeds the least change
AGREEMENT_STANDARD_ERRORS = 2.0  # between a detected end between two samples and that by the equations
STEER_KICK_STD = 0.3  # [rad/s] of the steer rate by a kick


def refine_strike_time(strike: Strike, window: Window, least: float) -> Strike | str:
    """The strike with its end by the equations, unchanged where they don't determine it; or why it is none.

    window: the motion from `BEFORE_STRIKE_NS` before the strike to `AFTER_STRIKE_NS` after it. least [rad/s]:
    least change of the lean rate by the impulse on the lean, for a strike.
    """
    allowed = 0.5 if strike.kind == "strike" else LARGEST_PUSH_WEIGHT
    impulse = _impulse(strike, window)
    kicked = impulse is not None and (
        impulse.misfit > SMALL_MISFIT_SHARE * abs(strike.change) or impulse.push_share > allowed
    )
    if kicked:
        impulse = _impulse(strike, window, STEER_KICK_STD)
    if impulse is None or impulse.misfit > LARGEST_MISFIT_SHARE * abs(strike.change):
        return strike
    acted = math.copysign(1.0, strike.change) * impulse.lean_rate + 2.0 * impulse.lean_rate_std
    if math.isfinite(impulse.steer_rate) and acted < least:
        return (
            f"the steering was kicked, not the bicycle struck: what acted on the lean changed its rate by"
            f" {impulse.lean_rate:+.3f} +- {impulse.lean_rate_std:.3f} rad/s, the rest followed from the"
            f" steering, as over a joint of the floor; {least:.2f} rad/s or more was needed"
        )
    if impulse.push_share > allowed or (kicked and impulse.end_std > (strike.end_std or PEAK_STD_S)):
        return strike
    return strike if _agrees(strike, impulse, window) else _with_end(strike, impulse, window)


def _agrees(strike: Strike, impulse: Impulse, window: Window) -> bool:
    """Whether the end was detected between two samples, and the equations don't exclude it there."""
    first, last = ((when - window.first_ns) / NANOSECONDS for when in (strike.before_ns, strike.time_ns))
    reach = AGREEMENT_STANDARD_ERRORS * impulse.end_std
    return strike.sharp and not impulse.sharp and first - reach < impulse.end < last + reach


def is_impulsive(strike: Strike, window: Window, least: float) -> bool:
    """Whether the impulse on the lean exceeds `least` [rad/s], whatever turned the steering meanwhile.

    False without a yaw rate: what turned the steering is then unknown.
    """
    impulse = _impulse(strike, window, STEER_KICK_STD)
    if (
        impulse is None
        or math.isnan(impulse.steer_rate)
        or impulse.misfit > LARGEST_MISFIT_SHARE * abs(strike.change)
    ):
        return False
    acted = math.copysign(1.0, strike.change) * impulse.lean_rate
    return acted - IMPULSE_STANDARD_ERRORS * impulse.lean_rate_std >= least


def _impulse(strike: Strike, window: Window, kicked: float = 0.0) -> Impulse | None:
    window = without_saturated(window)
    end = (strike.end_ns - window.first_ns) / NANOSECONDS
    speed = float(window.speed.at(end))
    if not 0.0 < speed <= FASTEST:
        return None
    system = linear_system(window.bicycle, speed, window.lean_rate_gain)
    rates = window.measured - _forced(window)
    return fit_impulse(window.time, rates, system, _middles(strike, window, end), kicked)


def _middles(strike: Strike, window: Window, end: float) -> tuple[float, float]:
    """Interval [s] in which the middle of the impulse is searched."""
    if strike.kind == "push":
        latest = min(end, float(window.time[-1]) - LEAST_MOTION_AFTER_S)
        return (strike.onset_ns - window.first_ns) / NANOSECONDS - MIDDLE_SEARCH_S, latest
    reach = max(MIDDLE_SEARCH_S, 1.5 * (strike.time_ns - strike.before_ns) / NANOSECONDS)
    return end - strike.rise / 2.0 - reach, end - strike.rise / 2.0 + reach


def _forced(window: Window) -> Array:
    """Both rates (n, 2) due to the known steer torque alone."""
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
