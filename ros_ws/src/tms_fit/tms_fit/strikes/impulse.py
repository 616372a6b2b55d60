"""Impulse of a strike from both rates and the bicycle's equations: its end, and what it acted on.

Before and after the impulse the bicycle moves as Eq. (3.1) says, at the speed of that moment; the impulse has
the course of half a sine and changes lean rate and steer rate. For every end and length on a grid the state
before, the biases, a shimmy and the two changes are linear; the residual sums give each pair its weight,
exp(-sum / (2 variance)) times its prior, and the result is the weighted mean, as in
`tms_fit.strikes.edge`, which needs no bicycle and approximates short segments by parabolas.

A floor can't strike: its forces act at the line through both contacts, about which the bicycle leans, and
have no lever there. They can only turn the steering, M q' = (0, impulse), and the lean follows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model import LinearSystem, response
from tms_model.bicycle import Array
from tms_model.response import LEAN_RATE, STEER_RATE

from tms_fit.strikes.classification import noise_of
from tms_fit.strikes.edge import (
    LEAST_SPACING_S,
    LONGEST_IMPULSE_S,
    between_samples,
    shimmy_frequency,
    thinned,
)

SHORT_LENGTHS_S = (0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.035, 0.04, 0.05, 0.06, 0.07, 0.08)
LENGTHS_S = np.array([*SHORT_LENGTHS_S, 0.1, 0.12, 0.14, 0.17, 0.2, 0.25, 0.3, 0.4])  # [s]
LENGTH_SCALE_S = 0.02  # of the prior: beyond it a length twice as long is half as likely
GRID_STEP_S = 0.002  # of the grid of middles
RESPONSE_STEP_S = 0.001  # of tabulated responses
MEAN_LENGTH_S = 0.05  # of running means of the residuals, in which noise averages out
UNKNOWN_COUNT = 10  # the state before, two biases, two changes, end, length
KICK_SPACING_S = 0.02  # between possible kicks of the steering
LEAST_NOISE = 1e-4  # [rad/s]
LARGEST_RESPONSE = 1e6  # [rad/s] per unit of a state, within a second
RANK_TOLERANCE = 1e-8  # least singular value per largest

_WIDTHS = np.diff(np.concatenate([LENGTHS_S[:1], 0.5 * (LENGTHS_S[1:] + LENGTHS_S[:-1]), LENGTHS_S[-1:]]))
_PRIOR = _WIDTHS / (LENGTH_SCALE_S + LENGTHS_S)


@dataclass(frozen=True)
class Impulse:
    """Posterior mean of the impulse. Times in seconds, on the caller's axis."""

    end: float
    end_std: float
    length: float
    lean_rate: float  # [rad/s], change of the lean rate by the impulse on the lean
    lean_rate_std: float  # [rad/s]
    steer_rate: float  # [rad/s], change of the steer rate; NaN without a yaw rate
    sharp: bool  # more likely than not no sample lies within the impulse
    step: float  # the sample before a sharp one
    push_share: float  # weight of the lengths that only a push has
    misfit: float  # [rad/s], root mean square of the lean rate's residuals beyond noise


@dataclass(frozen=True, eq=False)
class _Rows:
    """Samples of the channels that were measured, one below the other, in units of their noise."""

    time: Array  # (n,) [s]
    seen: tuple[int, ...]  # channels: 0 lean rate, 1 yaw rate
    good: NDArray[np.bool_]  # (n c,) measured
    scale: Array  # (n c,) [rad/s] noise
    known: Array  # (m, p), orthonormal: the motion without the impulse
    left: Array  # (m,) residuals of the measured rates without the impulse


def fit_impulse(
    time: Array, rates: Array, system: LinearSystem, middles: tuple[float, float], kick_std: float = 0.0
) -> Impulse | None:
    """The impulse whose middle lies between two times; None where there are too few samples.

    time (n,) ascending [s]; rates (n, 2) lean rate and yaw rate [rad/s], NaN: absent. kick_std: standard
    deviation [rad/s] of kicks that the steering may have got every `KICK_SPACING_S` seconds besides.
    """
    spacing = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    time, rates = thinned(time, rates)
    rows = _rows(time, rates, system, middles[0], kick_std)
    if rows is None or (time < middles[0]).sum() < 3 or (time > middles[1]).sum() < 3:
        return None
    ends = np.arange(*middles, max(GRID_STEP_S, spacing / 8.0)) + LENGTHS_S[:, None] / 2.0
    after = _after(system, float(time[-1] - time[0]) + LENGTHS_S[-1])
    fits = [_solved(rows, _columns(rows, after, e, s)) for e, s in zip(ends, LENGTHS_S, strict=True)]
    sums, variances = (np.array([one[k] for one in fits]) for k in (0, 2))  # (lengths, ends)
    changes = np.array([one[1] for one in fits])  # (lengths, ends, k)
    best = np.unravel_index(int(np.argmin(sums)), sums.shape)
    variance = max(float(sums.min()) / max(len(rows.left) - UNKNOWN_COUNT, 1), 1e-12)
    weight = np.exp(-0.5 * (sums - sums.min()) / variance) * _PRIOR[:, None]
    weight /= weight.sum()
    end, change = float((weight * ends).sum()), float((weight * changes[..., 0]).sum())
    spread = variance * variances + (changes[..., 0] - change) ** 2
    columns = _columns(rows, after, ends[best[0], best[1] : best[1] + 1], LENGTHS_S[best[0]])[0]
    residual = rows.left - (columns - rows.known @ (rows.known.T @ columns)) @ changes[best]
    share, step = between_samples(time, ends, LENGTHS_S, weight)
    return Impulse(
        end=end,
        end_std=float(np.sqrt((weight * (ends - end) ** 2).sum() + GRID_STEP_S**2 / 12.0)),
        length=float(weight.sum(axis=1) @ LENGTHS_S),
        lean_rate=change,
        lean_rate_std=float(np.sqrt((weight * spread).sum())),
        steer_rate=float((weight * changes[..., 1]).sum()) if changes.shape[-1] > 1 else math.nan,
        sharp=share > 0.5 and spacing > LEAST_SPACING_S,
        step=step,
        push_share=float(weight[LENGTHS_S > LONGEST_IMPULSE_S].sum()),
        misfit=_misfit(rows, residual),
    )


def _rows(time: Array, rates: Array, system: LinearSystem, begin: float, kick_std: float) -> _Rows | None:
    """Rows of the fit; None where the lean rate has too few samples, or a state grows without bound."""
    seen = tuple(k for k in (0, 1) if np.isfinite(rates[:, k]).sum() > UNKNOWN_COUNT)
    if 0 not in seen:
        return None
    rates = rates[:, seen]
    good = np.isfinite(rates).T.ravel()
    noise = [max(noise_of(rate[np.isfinite(rate)]), LEAST_NOISE) for rate in rates.T]
    scale = np.repeat(noise, len(time))
    moving = response(system, np.eye(4), time - time[0])
    channels = [moving[:, LEAN_RATE], np.einsum("s,nsk->nk", system.yaw, moving)]
    before = np.zeros((len(seen), len(time), 4 + 3 * len(seen)))
    for row, channel in enumerate(seen):
        before[row, :, :4] = channels[channel]
        before[row, :, 4 + row] = 1.0
        quiet = (time < begin) & np.isfinite(rates[:, row])
        if frequency := shimmy_frequency(time[quiet], rates[quiet, row]):
            phase = 2.0 * np.pi * frequency * time
            first = 4 + len(seen) + 2 * row
            before[row, :, first], before[row, :, first + 1] = np.sin(phase), np.cos(phase)
    if not np.isfinite(before).all() or np.abs(before).max() > LARGEST_RESPONSE:
        return None  # not the motion of a bicycle
    columns = (before.reshape(len(scale), -1) / scale[:, None])[good]
    y = (rates.T.ravel() / scale)[good]
    if kick_std and len(seen) > 1:
        kicks = _kicks(time, system).reshape(len(scale), -1)
        count = kicks.shape[1]
        columns = np.block(
            [
                [columns, kick_std * (kicks / scale[:, None])[good]],
                [np.zeros((count, columns.shape[1])), np.eye(count)],
            ]
        )
        y = np.concatenate([y, np.zeros(count)])
    size = np.linalg.norm(columns, axis=0)
    left, singular, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    known = left[:, singular > RANK_TOLERANCE * singular[0]]
    return _Rows(time, seen, good, scale, known, y - known @ (known.T @ y))


def _kicks(time: Array, system: LinearSystem) -> Array:
    """Both rates (2, n, k) after kicks of the steering, one every `KICK_SPACING_S` seconds."""
    begins = np.arange(time[0], time[-1], KICK_SPACING_S)
    after = _after(system, float(time[-1] - time[0]))[:, :, 1]
    place = (time[:, None] - begins) / RESPONSE_STEP_S
    low = np.clip(np.floor(place).astype(np.int64), 0, len(after) - 1)
    return np.where(place[..., None] < 0.0, 0.0, after[low]).transpose(2, 0, 1)


def _after(system: LinearSystem, span: float) -> Array:
    """Rates after a unit change of lean rate and steer rate, (m, channel, which), per `RESPONSE_STEP_S`."""
    times = np.arange(round(span / RESPONSE_STEP_S) + 2, dtype=np.float64) * RESPONSE_STEP_S
    states = response(system, np.eye(4)[:, [LEAN_RATE, STEER_RATE]], times)
    return np.stack([states[:, LEAN_RATE], np.einsum("s,nsk->nk", system.yaw, states)], axis=1)


def _columns(rows: _Rows, after: Array, ends: Array, length: float) -> Array:
    """Columns of the changes by an impulse of one length for each of its ends: (e, m, k)."""
    pulsed = after
    if length > 0.0:
        edges = np.clip(
            (np.arange(round(length / RESPONSE_STEP_S) + 2) - 0.5) * RESPONSE_STEP_S / length, 0.0, 1.0
        )
        course = np.diff(0.5 * (1.0 - np.cos(np.pi * edges)))
        flat = after.reshape(len(after), -1)
        pulsed = np.stack([np.convolve(course, one)[: len(one)] for one in flat.T], axis=1).reshape(
            after.shape
        )
    place = (rows.time - ends[:, None] + length) / RESPONSE_STEP_S
    low = np.clip(np.floor(place).astype(np.int64), 0, len(pulsed) - 2)
    share = (place - low)[..., None, None]
    values = (1.0 - share) * pulsed[low] + share * pulsed[low + 1]  # (e, n, channel, which)
    values = np.where((place < 0.0)[..., None, None], 0.0, values)
    values = values[:, :, rows.seen, : len(rows.seen)].transpose(0, 2, 1, 3)
    values = np.asarray(values.reshape(len(ends), len(rows.scale), -1) / rows.scale[:, None])[:, rows.good]
    beyond = len(rows.left) - values.shape[1]
    return np.pad(values, ((0, 0), (0, beyond), (0, 0)))


def _solved(rows: _Rows, columns: Array) -> tuple[Array, Array, Array]:
    """Residual sums (e,), changes (e, k) and the first one's variance for unit noise (e,)."""
    turned = columns.transpose(0, 2, 1)
    free = turned @ rows.known
    normal = turned @ columns - free @ free.transpose(0, 2, 1)
    normal = normal + 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[1])
    inverse = np.linalg.inv(normal)
    along = turned @ rows.left
    changes = np.einsum("ekl,el->ek", inverse, along)
    sums = rows.left @ rows.left - np.einsum("ek,ek->e", changes, along)
    return sums, changes, inverse[:, 0, 0]


def _misfit(rows: _Rows, residual: Array) -> float:
    """Root mean square [rad/s] of running means of the lean rate's residuals, less their share of noise."""
    good = rows.good[: len(rows.time)]
    time, left = rows.time[good], residual[: good.sum()] * rows.scale[0]
    low = np.searchsorted(time, time - MEAN_LENGTH_S / 2)
    high = np.searchsorted(time, time + MEAN_LENGTH_S / 2, side="right")
    sums = np.concatenate([[0.0], np.cumsum(left)])
    means = (sums[high] - sums[low]) / (high - low)
    noise = noise_of(left) ** 2 * float(np.mean(1.0 / (high - low)))
    return math.sqrt(max(float(np.mean(means**2)) - noise, 0.0))
