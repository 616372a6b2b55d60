"""End of a free response within its window: the bicycle is caught, is held still, or falls.

Detected from the measured speed and rates, without the bicycle's equations:

- caught: the speed collapses, faster than by any rolling resistance, or it falls to zero;
- held: lean and yaw rate jump, and within 0.3 s nothing moves any more (without a speed);
- fallen: the integral of the lean rate over the last second exceeds a radian.

Hands grip within hundredths of a second, the speed follows later. So the end is where the rates first bend as
they did not before, close to where the speed begins to fall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tms_model.bicycle import Array

GRID_STEP_S = 0.01  # of the grids; samples closer than this are averaged
SLOPE_LENGTH_S = 0.1  # over which a deceleration is taken
LEAST_BRAKING = 2.0  # [m/s^2]; larger than by rolling on the softest floor (1.3)
LEAST_SPEED_LOSS = 0.25  # [m/s]
STANDSTILL_SPEED = 0.1  # [m/s] below which a bicycle is at rest
ONSET_SHARE = 0.2  # of the largest deceleration; from there on the speed falls
GRIP_BEFORE_S = 0.15  # a grip shows in the rates before the speed falls, and
GRIP_AFTER_S = 0.05  # after that at the latest
BEND_FACTOR = 6.0  # least bend of the rates per usual bend
LEAST_BEND = 0.1  # [rad/s]; held still: three times that
HELD_BEND_SHARE = 0.3  # held still: least bend per largest; a fall bends the rates, too
LINE_WEIGHTS = np.array(
    [-0.5, -0.15, 0.2, 0.55, 0.9]
)  # a line through five steps, 1.5 steps after the last of them
STILL_RATE = 0.04  # [rad/s] about the mean, in the rates of a bicycle that is held, at least
LARGEST_BIAS = 0.1  # [rad/s] of a gyroscope on a bicycle that is held
HELD_FOR_S = 0.25  # until it counts as held
GRIP_LENGTH_S = 0.3  # from the grip until nothing moves
FALLEN_LEAN = 1.0  # [rad] of lean within
FALL_LENGTH_S = 1.0  # [s]


@dataclass(frozen=True)
class WindowEnd:
    """How a free response ended."""

    kind: str  # next_strike, recording, caught, held, fallen
    time: float  # [s], the last instant that belongs to it, on the caller's axis
    why: str  # one plain phrase


def find_window_end(time: Array, rates: Array, speed_time: Array, speed: Array) -> WindowEnd | None:
    """The earliest end of a free response; None where there is none.

    time (n,) [s], rates (n, 2) lean rate and yaw rate [rad/s], NaN: absent; speed_time (m,) [s], speed (m,)
    [m/s].
    """
    if len(time) < 2:
        return None
    grid, binned = _binned(time, rates)
    good = np.isfinite(speed)
    found = [
        _caught(grid, binned, speed_time[good], speed[good]),
        _held(grid, binned),
        _fallen(grid, binned[:, 0]),
    ]
    return min((one for one in found if one), key=lambda one: one.time, default=None)


def _caught(grid: Array, rates: Array, time: Array, speed: Array) -> WindowEnd | None:
    """By a collapse of the speed; the time is that of the bend of the rates."""
    if len(time) < 6 or time[-1] - time[0] < 2.0 * SLOPE_LENGTH_S:
        return None
    smooth = _median_of_three(speed)
    noise = 1.4826 * float(np.median(np.abs(np.diff(speed)))) / np.sqrt(2.0)
    at = np.arange(time[0], time[-1] + 1e-9, GRID_STEP_S)
    v = np.interp(at, time, smooth)
    half = round(SLOPE_LENGTH_S / 2.0 / GRID_STEP_S)
    slope = (v[2 * half :] - v[: -2 * half]) / SLOPE_LENGTH_S  # at at[half:-half]
    worst = int(np.argmin(slope))
    usual = float(np.median(slope[: max(worst - round(0.2 / GRID_STEP_S), 1)]))
    steep = slope - usual <= ONSET_SHARE * (slope[worst] - usual)
    before = np.flatnonzero(~steep[: worst + 1])
    begin = float(at[half + (int(before[-1]) + 1 if len(before) else 0)])
    left = float(v[-5:].max())  # the loss must persist; a short dropout of the sensor is none
    loss = float(np.interp(begin, at, v)) - left
    spread = 6.0 * noise
    steep_enough = slope[worst] < min(-LEAST_BRAKING, 3.0 * usual) - spread / SLOPE_LENGTH_S
    braked = steep_enough and loss > LEAST_SPEED_LOSS + spread
    slows = slope[worst] < 2.0 * usual - 0.2
    stands = slows and float(v[0]) > 3.0 * STANDSTILL_SPEED and left < STANDSTILL_SPEED
    if not (braked or stands):
        return None
    end = _first_bend(grid, rates, begin - GRIP_BEFORE_S, begin + GRIP_AFTER_S, LEAST_BEND)
    text = f"the bicycle was caught, its speed falls from {left + loss:.2f} to {max(left, 0.0):.2f} m/s"
    return WindowEnd("caught", begin - GRIP_AFTER_S if end is None else end, text)


def _held(grid: Array, rates: Array) -> WindowEnd | None:
    """By rates that stop suddenly and stay constant until the last sample."""
    moving = np.zeros(len(grid), dtype=bool)
    seen = np.isfinite(rates).any(axis=0)
    if not seen.any() or grid[-1] - grid[0] < HELD_FOR_S + 2.0 * GRID_STEP_S:
        return None
    for rate in rates[:, seen].T:
        tail = rate[grid > grid[-1] - HELD_FOR_S]
        tail = tail[np.isfinite(tail)]
        if len(tail) < 4 or abs(mean := float(np.median(tail))) > LARGEST_BIAS:
            return None
        limit = max(STILL_RATE, 4.0 * 1.4826 * float(np.median(np.abs(np.diff(tail)))) / np.sqrt(2.0))
        moving |= np.abs(rate - mean) > limit
    last = np.flatnonzero(moving)
    if not len(last) or grid[-1] - grid[last[-1]] < HELD_FOR_S:
        return None
    still = float(grid[last[-1]])
    end = _first_bend(grid, rates, still - GRIP_LENGTH_S, still, 3.0 * LEAST_BEND, HELD_BEND_SHARE)
    return None if end is None else WindowEnd("held", end, "the bicycle was held: nothing moves any more")


def _fallen(grid: Array, lean_rate: Array) -> WindowEnd | None:
    """By a lean angle beyond recovery."""
    lean = np.cumsum(np.nan_to_num(lean_rate)) * GRID_STEP_S
    earlier = np.interp(grid - FALL_LENGTH_S, grid, lean, left=0.0)
    over = np.flatnonzero(np.abs(lean - earlier) > FALLEN_LEAN)
    if not len(over):
        return None
    text = f"the bicycle fell, it leans by more than {FALLEN_LEAN:g} rad within {FALL_LENGTH_S:g} s"
    return WindowEnd("fallen", float(grid[over[0]]), text)


def _first_bend(
    grid: Array, rates: Array, since: float, until: float, least: float, share: float = 0.0
) -> float | None:
    """The last instant before the first unusual bend of the rates in an interval; None where there is none.

    A bend is the difference of the mean of two steps from the line through the five before.
    """
    bends, span = np.zeros(len(grid)), len(LINE_WEIGHTS)
    before = grid < since
    for rate in rates.T:
        bend = np.full(len(grid), np.nan)
        if len(grid) > span:
            line = np.convolve(rate, LINE_WEIGHTS[::-1], "valid")[:-2]
            bend[span:-1] = np.abs(0.5 * (rate[span:-1] + rate[span + 1 :]) - line)
        known = bend[before & np.isfinite(bend)]
        usual = 1.4826 * float(np.median(known)) if len(known) > 4 else 0.0
        bends = np.fmax(bends, bend / max(BEND_FACTOR * usual, least))
    within = (grid >= since) & (grid <= until)
    largest = float(np.max(bends[within], initial=0.0))
    found = np.flatnonzero(within & (bends > max(1.0, share * largest)))
    return float(grid[found[0] - 1]) if len(found) and found[0] > 0 else None


def _binned(time: Array, rates: Array) -> tuple[Array, Array]:
    """Means over the steps of a grid (k,), (k, 2); steps without a sample are interpolated."""
    place = np.floor((time - time[0]) / GRID_STEP_S + 0.5).astype(np.int64)
    grid = time[0] + GRID_STEP_S * np.arange(place[-1] + 1)
    binned = np.full((len(grid), rates.shape[1]), np.nan)
    for channel, rate in enumerate(rates.T):
        good = np.isfinite(rate)
        if not good.any():
            continue
        counts = np.bincount(place[good], minlength=len(grid))
        sums = np.bincount(place[good], rate[good], len(grid))
        filled = np.flatnonzero(counts)
        binned[:, channel] = np.interp(np.arange(len(grid)), filled, sums[filled] / counts[filled])
    return grid, binned


def _median_of_three(values: Array) -> Array:
    """Each value, or the middle one of it and its neighbours: one outlier vanishes."""
    inside: Array = np.median(np.stack([values[:-2], values[1:-1], values[2:]]), axis=0)
    return np.concatenate([values[:1], inside, values[-1:]])
