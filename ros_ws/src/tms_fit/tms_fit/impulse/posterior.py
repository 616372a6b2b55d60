"""Posterior of a strike: a force of unknown onset, duration and shape on a moving bicycle.

    x(t) = Phi(t, t0) x(t0) + sum_k G_k(t; onset, duration) [s_k, r_k]

Before, during and after the force the bicycle moves as Eq. (3.1) says, at the speed of that moment. The force
changes the lean rate by s and the steer rate by r (the kick), through the inverse mass matrix. For a given
onset and duration all unknowns are linear: the state before, gyroscope biases, s, r, and the shape of a force
that lasts longer than an impulse. They have Gaussian priors (`tms_fit.impulse.prior`), s a flat one.
Each pair of onset and duration on a grid is weighted by its marginal likelihood and prior, and the grid is
refined where the weight is.

Samples after the strike enter as samples, or, where they have been fitted already, as Gaussian information on
the state at the start of the free response.

References: Kooijman et al. 2011, supplement Eq. (3.1), doi 10.1126/science.1201959; C. E. Rasmussen and C. K.
I. Williams, Gaussian Processes for Machine Learning (2006), ISBN 026218253X, section 2.7 (explicit basis
functions marginalised).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array

from tms_fit.impulse.force import SHAPES, ForcedBicycle
from tms_fit.impulse.prior import ImpulsePrior

COARSE_DURATIONS_S = np.array([0.0, 0.01, 0.025, 0.05, 0.1, 0.17, 0.28, 0.4, 0.55])
DURATION_SCALE_S = 0.02  # of the prior 1 / (DURATION_SCALE_S + duration)
COARSE_STEP_S = 0.003  # of the first grid of middles
LONGEST_IMPULSE_S = 0.1  # a longer force has an unknown shape
GRID_POINTS = 11  # of middles and of durations in a refined grid
REFINEMENTS = 3
SMALLEST_STEP_S = 1e-4  # between middles where one alone is left
LOG_WEIGHT_RANGE = 10.0  # below the largest log-weight of the middles that a refined grid covers
STATES, BIASES = 4, 2
UNKNOWNS = STATES + BIASES  # of the motion without the force

Whitener = Callable[[Array], Array]  # values (n, 2, ...) -> rows (m, ...) of unit variance


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Onsets and durations of a force on a grid."""

    onset: Array  # (h,) [s]
    duration: Array  # (h,) [s]
    area: Array  # (h,) of a grid cell [s^2]

    @property
    def end(self) -> Array:
        """End of each force (h,) [s]."""
        return self.onset + self.duration

    @property
    def shapes(self) -> int:
        """Number of shapes of the force."""
        return SHAPES if (self.duration > LONGEST_IMPULSE_S).any() else 1

    def ending_by(self, time: float) -> Hypotheses:
        """Those that end at a time [s] at the latest; the earliest end where there are none."""
        return self.rows(self.until(time))

    def until(self, time: float) -> NDArray[np.intp]:
        """Rows of those."""
        return np.flatnonzero(self.end <= max(time, float(self.end.min())))

    def rows(self, index: NDArray[np.intp]) -> Hypotheses:
        """Some of them."""
        return Hypotheses(self.onset[index], self.duration[index], self.area[index])


@dataclass(frozen=True, eq=False)
class StrikeSamples:
    """Samples around a strike with the model of the bicycle."""

    bicycle: ForcedBicycle
    time: Array  # (n,) [s]
    rates: Array  # (n, 2) [rad/s] lean and yaw rate, NaN: not measured
    prior: ImpulsePrior


@dataclass(frozen=True, eq=False)
class FreeInformation:
    """Gaussian information on the start of the free response: exp(-x'Mx/2 + v'x).

    x: state at `time`, biases, and further unknowns of the free response.
    """

    time: float  # [s]
    matrix: Array  # (6 + e, 6 + e)
    vector: Array  # (6 + e,)

    @property
    def more(self) -> int:
        """Number of further unknowns."""
        return len(self.vector) - UNKNOWNS


@dataclass(frozen=True, eq=False)
class ImpulsePosterior:
    """Weights of onset and duration, and the unknowns at each.

    Unknowns: state at the first sample, biases, then for each shape of the force the changes of lean rate and
    steer rate, then further unknowns of the free response.
    """

    hypotheses: Hypotheses
    log_weight: Array  # (h,) unnormalised
    mean: Array  # (h, q)
    covariance: Array  # (h, q, q)
    samples: StrikeSamples

    @property
    def weight(self) -> Array:
        """Weights (h,), which sum to 1."""
        density = np.exp(self.log_weight - self.log_weight.max())
        weight: Array = density / density.sum()
        return weight

    @property
    def best(self) -> int:
        """Index of the hypothesis of largest weight per area."""
        return int(np.argmax(self.log_weight - np.log(self.hypotheses.area)))

    def seen_from(self, time: float, samples: StrikeSamples) -> ImpulsePosterior:
        """The hypotheses that end by a time [s], which becomes 0, with samples that count from there.

        Unknowns stay those of the samples before.
        """
        kept = self.hypotheses.until(time)
        grid = self.hypotheses.rows(kept)
        return ImpulsePosterior(
            Hypotheses(grid.onset - time, grid.duration, grid.area),
            self.log_weight[kept],
            self.mean[kept],
            self.covariance[kept],
            samples,
        )

    def quantile(self, values: Array, share: float) -> float:
        """Quantile of a property (h,) of the hypotheses."""
        order = np.argsort(values, kind="stable")
        total = np.cumsum(self.weight[order])
        return float(values[order][min(int(np.searchsorted(total, share)), len(order) - 1)])

    def moments(self, values: Array) -> tuple[float, float]:
        """Mean and standard deviation of a property (h,) of the hypotheses."""
        mean = float(self.weight @ values)
        return mean, math.sqrt(float(self.weight @ (values - mean) ** 2))

    def at(self, time: float) -> tuple[Array, Array]:
        """Mean (p,) and covariance (p, p) of state at a time [s], biases, changes of both rates, and more."""
        turn = self._reported(time)
        means = np.einsum("hij,hj->hi", turn, self.mean)
        spreads = turn @ self.covariance @ np.swapaxes(turn, 1, 2)
        mean = self.weight @ means
        off = means - mean
        covariance = np.einsum("h,hij->ij", self.weight, spreads) + (self.weight[:, None] * off).T @ off
        return mean, covariance

    def conditional(self, index: int, time: float) -> tuple[Array, Array]:
        """The same for one hypothesis."""
        turn = self._reported(time)[index]
        return turn @ self.mean[index], turn @ self.covariance[index] @ turn.T

    def predicted(self, index: int) -> Array:
        """Lean and yaw rate (n, 2) [rad/s] of one hypothesis."""
        one = self.hypotheses.rows(np.array([index]))
        shapes = (self.mean.shape[1] - UNKNOWNS) // 2
        fixed, forces = _columns(self.samples, one, shapes)
        values = self.mean[index]
        rates: Array = fixed @ values[:UNKNOWNS] + forces[0] @ values[UNKNOWNS : UNKNOWNS + 2 * shapes]
        return rates

    def _reported(self, time: float) -> Array:
        """Transformations (h, p, q) of the unknowns to those of `at`."""
        count = self.mean.shape[1]
        shapes = self.hypotheses.shapes
        forces = 2 * shapes
        more = count - UNKNOWNS - forces
        turn = np.zeros((len(self.mean), UNKNOWNS + 2 + more, count))
        turn[:, :UNKNOWNS] = _start(self.samples, self.hypotheses, time, count, shapes)
        turn[:, UNKNOWNS, UNKNOWNS] = turn[:, UNKNOWNS + 1, UNKNOWNS + 1] = 1.0
        for k in range(more):
            turn[:, UNKNOWNS + 2 + k, UNKNOWNS + forces + k] = 1.0
        return turn


def coarse_grid(earliest: float, latest: float, spacing: float) -> Hypotheses:
    """First grid: middles between two times [s] and durations up to half a second; spacing [s] of samples."""
    step = min(max(COARSE_STEP_S, spacing / 8.0), 0.25 * (latest - earliest))
    middles = np.arange(earliest, latest + 0.5 * step, step)
    return _grid([middles] * len(COARSE_DURATIONS_S), COARSE_DURATIONS_S)


def instant(time: float) -> Hypotheses:
    """An impulse at a stated time [s]."""
    return Hypotheses(np.array([time]), np.zeros(1), np.ones(1))


def refined_grid(found: ImpulsePosterior) -> Hypotheses:
    """Finer grid where the weight of a posterior is."""
    log_density = found.log_weight - np.log(found.hypotheses.area)
    middles = 0.5 * (found.hypotheses.onset + found.hypotheses.end)
    durations = np.unique(found.hypotheses.duration)
    rows = [np.flatnonzero(found.hypotheses.duration == one) for one in durations]
    peaks = np.array([log_density[some].max() for some in rows])
    likely = np.flatnonzero(peaks > peaks.max() - LOG_WEIGHT_RANGE)
    first, last = max(int(likely[0]) - 1, 0), min(int(likely[-1]) + 2, len(durations))
    ranges = np.array([_range(middles[some], log_density[some]) for some in rows[first:last]])
    known = durations[first:last]
    finer = known
    if len(known) > 1:
        count = max(GRID_POINTS, 2)
        finer = np.unique(np.interp(np.linspace(0.0, len(known) - 1.0, count), np.arange(len(known)), known))
    ends = [np.interp(finer, known, side) for side in ranges.T]
    return _grid([np.linspace(a, b, GRID_POINTS) for a, b in zip(*ends, strict=True)], finer)


def _range(middles: Array, log_density: Array) -> tuple[float, float]:
    """Interval of middles that hold the weight of one duration, one step wider."""
    order = np.argsort(middles)
    middles, log_density = middles[order], log_density[order]
    likely = np.flatnonzero(log_density > log_density.max() - LOG_WEIGHT_RANGE)
    step = float(np.diff(middles).max()) if len(middles) > 1 else SMALLEST_STEP_S
    return float(middles[likely[0]]) - step, float(middles[likely[-1]]) + step


def _grid(middles: list[Array], durations: Array) -> Hypotheses:
    widths = np.gradient(durations) if len(durations) > 1 else np.ones(1)
    steps = [float(one[1] - one[0]) if len(one) > 1 else SMALLEST_STEP_S for one in middles]
    counts = [len(one) for one in middles]
    duration = np.repeat(durations, counts)
    return Hypotheses(
        np.concatenate(middles) - 0.5 * duration, duration, np.repeat(widths * np.array(steps), counts)
    )


def evaluate(
    samples: StrikeSamples, hypotheses: Hypotheses, whiten: Whitener, after: FreeInformation | None = None
) -> ImpulsePosterior:
    """Posterior of a strike on a grid of hypotheses.

    whiten: noise model of the samples. after: information from samples that follow.
    """
    shapes = hypotheses.shapes
    fixed, forces = _columns(samples, hypotheses, shapes)
    count, width = len(hypotheses.onset), 2 * shapes
    base = whiten(fixed)
    target = whiten(np.where(np.isfinite(samples.rates), samples.rates, 0.0))
    flat = whiten(np.moveaxis(forces, 0, 2).reshape(*samples.rates.shape, count * width))
    own = np.ascontiguousarray(np.moveaxis(flat.reshape(-1, count, width), 1, 0))  # (h, m, 2 k)
    size = UNKNOWNS + width + (after.more if after else 0)
    forced = slice(UNKNOWNS, UNKNOWNS + width)
    normal, right = np.zeros((count, size, size)), np.zeros((count, size))
    normal[:, :UNKNOWNS, :UNKNOWNS] = base.T @ base
    normal[:, forced, forced] = np.swapaxes(own, 1, 2) @ own
    cross = base.T @ own
    normal[:, :UNKNOWNS, forced], normal[:, forced, :UNKNOWNS] = cross, np.swapaxes(cross, 1, 2)
    right[:, :UNKNOWNS], right[:, forced] = base.T @ target, target @ own
    squares = np.full(count, float(target @ target))
    log_prior = _add_priors(samples, hypotheses, normal, right, squares)
    if after is not None:
        start = np.zeros((count, UNKNOWNS + after.more, size))
        start[:, :UNKNOWNS] = _start(samples, hypotheses, after.time, size, shapes)
        for k in range(after.more):
            start[:, UNKNOWNS + k, UNKNOWNS + width + k] = 1.0
        turned = np.swapaxes(start, 1, 2)
        normal += turned @ after.matrix @ start
        right += turned @ after.vector
    scale = np.sqrt(np.diagonal(normal, axis1=1, axis2=2))
    scaled = normal / scale[:, :, None] / scale[:, None, :]
    covariance = np.linalg.inv(scaled) / scale[:, :, None] / scale[:, None, :]
    mean = np.einsum("hij,hj->hi", covariance, right)
    squares -= np.einsum("hi,hi->h", mean, right)
    determinant = np.linalg.slogdet(scaled)[1] + 2.0 * np.log(scale).sum(axis=1)
    log_weight = log_prior - 0.5 * (squares + determinant)
    return ImpulsePosterior(hypotheses, log_weight, mean, covariance, samples)


def _add_priors(
    samples: StrikeSamples, hypotheses: Hypotheses, normal: Array, right: Array, squares: Array
) -> Array:
    """Add the priors to normal equations (h, q, q), (h, q) and sums (h,); returns their log density (h,)."""
    prior = samples.prior
    before = samples.bicycle.transition(hypotheses.onset - samples.time[0])  # (h, 4, 4)
    rows = before / prior.onset_std[:, None]
    wanted = prior.onset_mean / prior.onset_std
    turned = np.swapaxes(rows, 1, 2)
    normal[:, :STATES, :STATES] += turned @ rows
    right[:, :STATES] += turned @ wanted
    squares += float(wanted @ wanted)
    log_density = np.linalg.slogdet(rows)[1]
    others, values = prior.rows(hypotheses.shapes)  # (k, 2 + 2 shapes) of biases and forces
    last = STATES + others.shape[1]
    normal[:, STATES:last, STATES:last] += others.T @ others
    right[:, STATES:last] += others.T @ values
    squares += float(values @ values)
    density: Array = log_density + np.log(hypotheses.area) - np.log(DURATION_SCALE_S + hypotheses.duration)
    return density


def _columns(samples: StrikeSamples, hypotheses: Hypotheses, shapes: int) -> tuple[Array, Array]:
    """Derivatives of the rates by state and biases (n, 2, 6), and by the forces (h, n, 2, 2 k)."""
    fixed = np.zeros((len(samples.time), 2, UNKNOWNS))
    fixed[:, :, :STATES] = samples.bicycle.free(samples.time - samples.time[0])
    fixed[:, 0, STATES] = fixed[:, 1, STATES + 1] = 1.0
    since = samples.time - hypotheses.onset[:, None]
    return fixed, _shaped(
        lambda t, d, k: samples.bicycle.forced(t, d, k), since, hypotheses.duration[:, None], shapes
    )


def _start(samples: StrikeSamples, hypotheses: Hypotheses, time: float, count: int, shapes: int) -> Array:
    """State at a time [s] and biases (h, 6, q) per unknown."""
    start = np.zeros((len(hypotheses.onset), UNKNOWNS, count))
    start[:, :STATES, :STATES] = samples.bicycle.transition(np.array(time - samples.time[0]))
    start[:, :STATES, UNKNOWNS : UNKNOWNS + 2 * shapes] = _shaped(
        samples.bicycle.forced_state, time - hypotheses.onset, hypotheses.duration, shapes
    )
    start[:, STATES, STATES] = start[:, STATES + 1, STATES + 1] = 1.0
    return start


def _shaped(
    respond: Callable[[Array, Array, int], Array], since: Array, duration: Array, shapes: int
) -> Array:
    """Responses (h, ..., r, 2 k) to the forces; an impulse has one shape, further columns are zero."""
    if shapes == 1:
        return respond(since, duration, 1)
    long = duration.reshape(len(since), -1)[:, 0] > LONGEST_IMPULSE_S
    every = respond(since[long], duration[long], shapes)
    found = np.zeros((len(since), *every.shape[1:]))
    found[long] = every
    found[~long, ..., :2] = respond(since[~long], duration[~long], 1)
    return found
