"""Where a free response ends before its window does: the bicycle is caught, is held still, or falls.

Told from the speed and the rates that were measured, without the bicycle's equations:

- caught: the speed collapses, faster than rolling ever slows a bicycle down, or it comes to a stand;
- held: lean and yaw rate jump, and within 0.3 s nothing moves any more (where no speed tells);
- fallen: the lean rate of the last second adds up to more than a radian.

Hands grip within hundredths of a second, the speed follows later. So the end is where the rates first bend as
they did not before, close to where the speed begins to fall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tms_model.bicycle import Array

STEP = 0.01  # [s] of the grids; samples closer than this are averaged
SLOPE = 0.1  # [s] over which a deceleration is taken
BRAKING = 2.0  # [m/s^2]; more than what rolling costs on the softest floor (1.3)
LOSS = 0.25  # [m/s], least loss of speed
STAND = 0.1  # [m/s]; a bicycle slower than this stands
BEGUN = 0.2  # of the largest deceleration; from there on a speed falls
EARLIER = 0.15  # [s]; a grip is felt in the rates before the speed falls, and
LATER = 0.05  # [s] after that at the latest
BENT = 6.0  # a bend of the rates, per what is usual
LEAST_BEND = 0.1  # [rad/s]; held still: three times that
OF_LARGEST = 0.3  # held still: least bend per largest; a fall bends the rates, too
LEADS = np.array([-0.5, -0.15, 0.2, 0.55, 0.9])  # a line through five steps, 1.5 steps after the last of them
STILL = 0.04  # [rad/s] about the mean, in the rates of a bicycle that is held, at least
BIAS = 0.1  # [rad/s], more than a gyroscope tells of a bicycle that is held
HELD = 0.25  # [s] that it takes to see that
GRIP = 0.3  # [s] from the grip until nothing moves
FALLEN = 1.0  # [rad] of lean within
FALL = 1.0  # [s]


@dataclass(frozen=True)
class WindowEnd:
    """How a free response ended."""

    kind: str  # next_strike, recording, caught, held, fallen
    time: float  # [s], the last instant that belongs to it, on the caller's axis
    why: str  # one plain phrase


def find_window_end(time: Array, rates: Array, speed_time: Array, speed: Array) -> WindowEnd | None:
    """The first thing that ends a free response; None: nothing does.

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
    """By the speed, whose collapse the rates date."""
    if len(time) < 6 or time[-1] - time[0] < 2.0 * SLOPE:
        return None
    smooth = _median_of_three(speed)
    noise = 1.4826 * float(np.median(np.abs(np.diff(speed)))) / np.sqrt(2.0)
    at = np.arange(time[0], time[-1] + 1e-9, STEP)
    v = np.interp(at, time, smooth)
    half = round(SLOPE / 2.0 / STEP)
    slope = (v[2 * half :] - v[: -2 * half]) / SLOPE  # at at[half:-half]
    worst = int(np.argmin(slope))
    usual = float(np.median(slope[: max(worst - round(0.2 / STEP), 1)]))
    steep = slope - usual <= BEGUN * (slope[worst] - usual)
    before = np.flatnonzero(~steep[: worst + 1])
    begin = float(at[half + (int(before[-1]) + 1 if len(before) else 0)])
    left = float(v[-5:].max())  # to stay; a sensor that says nothing for a moment loses no speed
    loss = float(np.interp(begin, at, v)) - left
    braked = slope[worst] < min(-BRAKING, 3.0 * usual) - 6.0 * noise / SLOPE and loss > LOSS + 6.0 * noise
    stands = float(v[0]) > 3.0 * STAND and left < STAND and slope[worst] < 2.0 * usual - 0.2
    if not (braked or stands):
        return None
    end = _first_bend(grid, rates, begin - EARLIER, begin + LATER, LEAST_BEND)
    text = f"the bicycle was caught, its speed falls from {left + loss:.2f} to {max(left, 0.0):.2f} m/s"
    return WindowEnd("caught", begin - LATER if end is None else end, text)


def _held(grid: Array, rates: Array) -> WindowEnd | None:
    """By rates that stop at once and stay where they are until the last sample."""
    moving = np.zeros(len(grid), dtype=bool)
    seen = np.isfinite(rates).any(axis=0)
    if not seen.any() or grid[-1] - grid[0] < HELD + 2.0 * STEP:
        return None
    for rate in rates[:, seen].T:
        tail = rate[grid > grid[-1] - HELD]
        tail = tail[np.isfinite(tail)]
        if len(tail) < 4 or abs(mean := float(np.median(tail))) > BIAS:
            return None
        limit = max(STILL, 4.0 * 1.4826 * float(np.median(np.abs(np.diff(tail)))) / np.sqrt(2.0))
        moving |= np.abs(rate - mean) > limit
    last = np.flatnonzero(moving)
    if not len(last) or grid[-1] - grid[last[-1]] < HELD:
        return None
    still = float(grid[last[-1]])
    end = _first_bend(grid, rates, still - GRIP, still, 3.0 * LEAST_BEND, OF_LARGEST)
    return None if end is None else WindowEnd("held", end, "the bicycle was held: nothing moves any more")


def _fallen(grid: Array, lean_rate: Array) -> WindowEnd | None:
    """By a lean that a bicycle doesn't come back from."""
    lean = np.cumsum(np.nan_to_num(lean_rate)) * STEP
    earlier = np.interp(grid - FALL, grid, lean, left=0.0)
    over = np.flatnonzero(np.abs(lean - earlier) > FALLEN)
    if not len(over):
        return None
    text = f"the bicycle fell, it leans by more than {FALLEN:g} rad within {FALL:g} s"
    return WindowEnd("fallen", float(grid[over[0]]), text)


def _first_bend(
    grid: Array, rates: Array, since: float, until: float, least: float, share: float = 0.0
) -> float | None:
    """The last instant before rates bend, within a stretch, as they did not before; None: they don't.

    A bend is what the mean of two steps differs by from the line through the five before.
    """
    bends = np.zeros(len(grid))
    before = grid < since
    for rate in rates.T:
        bend = np.full(len(grid), np.nan)
        if len(grid) > len(LEADS):
            led = np.convolve(rate, LEADS[::-1], "valid")[:-2]
            bend[len(LEADS) : -1] = np.abs(0.5 * (rate[len(LEADS) : -1] + rate[len(LEADS) + 1 :]) - led)
        known = bend[before & np.isfinite(bend)]
        usual = 1.4826 * float(np.median(known)) if len(known) > 4 else 0.0
        bends = np.fmax(bends, bend / max(BENT * usual, least))
    within = (grid >= since) & (grid <= until)
    largest = float(np.max(bends[within], initial=0.0))
    found = np.flatnonzero(within & (bends > max(1.0, share * largest)))
    return float(grid[found[0] - 1]) if len(found) and found[0] > 0 else None


def _binned(time: Array, rates: Array) -> tuple[Array, Array]:
    """Means over the steps of a grid (k,), (k, 2); steps without a sample are interpolated."""
    place = np.floor((time - time[0]) / STEP + 0.5).astype(np.int64)
    grid = time[0] + STEP * np.arange(place[-1] + 1)
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
