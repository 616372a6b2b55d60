"""Pooled fits under autocorrelated noise, one noise model for all runs.

Values and covariances follow the rules of a fit of one run (`tms_fit.least_squares.irls`). `auto` selects
white noise unless the residuals are clearly autocorrelated, then an autoregressive process or an oscillator
with white noise, by the lower BIC over all runs. Autoregressive residuals are more often due to model
misspecification, so `auto` keeps the least-squares values, with their sandwich covariance under this noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from tms_fit.least_squares.irls import only_rounding, strike_time_slope
from tms_fit.noise import ar, oscillator
from tms_fit.noise.colored import ColoredNoise, likeliest_noise
from tms_fit.noise.posterior import Family, Piece, Posterior, posterior
from tms_fit.parameters import check_known
from tms_model.bicycle import Array

from tms_calibrate.pooled_problem import PooledProblem, PooledSolution
from tms_calibrate.pooled_solver import Linearised, linearised_run, solve_pooled
from tms_calibrate.sandwich_covariance import sandwich_covariance

MODELS = ("auto", "white", "ar", "oscillator")
MAX_ITERATIONS = 10  # of noise and values in turn
TOLERANCE = 0.01  # last change of the values, in standard errors
MAX_LOG_LIKELIHOOD_LOSS = 8.0  # below the maximum, for a candidate to keep its weight
GRID_HALF_WIDTH = 4.0  # standard deviations of a noise parameter on either side of its mean
GRID_REFINEMENTS = 2

_Found = ar.ARCandidates | Array  # processes, or oscillators (g, 3)


@dataclass(frozen=True, eq=False)
class NoisySolution:
    """A solution with its noise model and the covariance of its values."""

    solution: PooledSolution
    model: str  # white, ar, oscillator
    shared_covariance: Array = field(default_factory=lambda: np.empty((0, 0)))  # (s, s)
    own_covariance: tuple[Array, ...] = ()  # (q, q) of each run
    parameters: Mapping[str, float] = field(default_factory=dict)  # of the noise, by name, SI
    least_squares: bool = True  # whether the values are those of least squares


@dataclass(frozen=True, eq=False)
class _NoiseModel:
    """Candidate noise models of all runs, their posterior, and the likeliest noise of each run."""

    found: dict[int, _Found]  # candidates by channel
    pieces: tuple[Piece, ...]
    posterior: Posterior
    noises: tuple[ColoredNoise, ...]

    @property
    def parameters(self) -> dict[str, float]:
        return {name: value for noise in self.noises for name, value in noise.parameters.items()}


def solve_with_noise(
    problem: PooledProblem, model: str = "auto", stated: Sequence[float] = ()
) -> NoisySolution:
    """Solve under a noise model of MODELS. Raises ParameterError for another one.

    stated: known oscillator parameters: frequency [Hz], decay time [s], standard deviation [rad/s].
    """
    check_known((model,), MODELS, "noise")
    plain = _under_white_noise(problem)
    if plain.arrow is None:
        return NoisySolution(plain, "white")
    runs = _linearised(plain)
    residuals = [run.residual for run in runs]
    measured = np.concatenate([run.window.measured for run in problem.runs])
    rounding = only_rounding(measured, np.concatenate(residuals))
    colored = not rounding and ar.is_autocorrelated(*residuals)
    if model == "white" or (model == "auto" and not colored):
        std = _std(plain)
        scale = 1.0 if problem.priors else std**2 / plain.problem.noise**2
        own = tuple(scale * inverse for inverse in plain.arrow.own_inverse)
        shared = scale * plain.arrow.shared_inverse
        return NoisySolution(plain, "white", shared, own, {"noise_std": std})
    times = [run.window.time for run in problem.runs]
    name = _likelier(times, runs, stated) if model == "auto" else model
    law = _law(name, plain, runs, stated)
    if model == "auto" and name == "ar" and not problem.priors:
        shared, own = sandwich_covariance(plain, runs, law.pieces, law.posterior)
        return NoisySolution(plain, name, shared, own, law.parameters)
    return _under(name, plain, law, stated)


def _under_white_noise(problem: PooledProblem) -> PooledSolution:
    """Least squares; with priors, the noise of the samples is estimated from the residuals."""
    if not problem.priors:
        return solve_pooled(problem)
    bare = solve_pooled(replace(problem, priors={}))
    size = _std(bare) if bare.arrow is not None else _spread(problem)
    solution = solve_pooled(replace(problem, noise=size))
    for _ in range(MAX_ITERATIONS):
        if solution.arrow is None:
            break
        noise = _std(solution)
        settled = abs(noise / solution.problem.noise - 1.0) < TOLERANCE**2
        solution = solve_pooled(replace(problem, noise=noise), solution.shared[len(problem.linear) :])
        if settled:
            break
    return solution


def _std(solution: PooledSolution) -> float:
    """Standard deviation [rad/s] of the residuals, by degrees of freedom without priors; 1 if zero."""
    problem = solution.problem
    unknowns = len(problem.shared) + sum(len(run.names) for run in problem.runs)
    squares = sum(float(residual @ residual) for residual in solution.residuals)
    return math.sqrt(squares / max(problem.count - unknowns, 1)) or 1.0


def _spread(problem: PooledProblem) -> float:
    """Root mean square [rad/s] of the measurements, an upper bound of the noise; 1 if zero."""
    return math.sqrt(float(np.nanmean([np.nanmean(run.window.measured**2) for run in problem.runs]))) or 1.0


def _under(name: str, plain: PooledSolution, law: _NoiseModel, stated: Sequence[float]) -> NoisySolution:
    """Values and noise model estimated in turn under autocorrelated noise."""
    solution, problem = plain, replace(plain.problem, noise=1.0)
    bent = bool(problem.nonlinear or problem.priors) or any(run.nonlinear for run in problem.runs)
    for _ in range(MAX_ITERATIONS if bent else 1):  # one iteration solves a linear problem
        before = solution
        runs = tuple(
            replace(run, rows=noise.rows) for run, noise in zip(problem.runs, law.noises, strict=True)
        )
        start = solution.shared[len(problem.linear) :]
        solution = solve_pooled(replace(problem, runs=runs), start)
        if solution.arrow is None:
            return NoisySolution(solution, name)
        law = _law(name, solution, _linearised(solution), stated, None if bent else law.found)
        std = np.sqrt(np.diag(law.posterior.covariance))
        off = [np.abs(solution.shared - before.shared) / std]
        for one, other, covariance in zip(
            solution.own, before.own, law.posterior.own_covariance, strict=True
        ):
            off.append(np.abs(one - other) / np.sqrt(np.diag(covariance)))
        if max((float(one.max(initial=0.0)) for one in off), default=0.0) <= TOLERANCE:
            break
    found = law.posterior
    moved = replace(
        solution,
        shared=solution.shared + found.shift,
        own=tuple(one + step for one, step in zip(solution.own, found.own_shift, strict=True)),
    )
    return NoisySolution(moved, name, found.covariance, found.own_covariance, law.parameters, False)


def _linearised(solution: PooledSolution) -> tuple[Linearised, ...]:
    return tuple(
        linearised_run(solution.problem, run, solution.shared, own)
        for run, own in zip(solution.problem.runs, solution.own, strict=True)
    )


def _law(
    name: str,
    solution: PooledSolution,
    runs: Sequence[Linearised],
    stated: Sequence[float],
    known: dict[int, _Found] | None = None,
) -> _NoiseModel:
    """Noise model by restricted likelihood of the residuals, with the fitted unknowns marginalised."""
    problem = solution.problem
    goods = [np.isfinite(run.residual) for run in runs]
    times = [run.window.time for run in problem.runs]
    refinements = GRID_REFINEMENTS if known is None and len(runs) > 1 else 0
    found = _candidates(name, times, runs, stated) if known is None else known
    prior = problem.prior_rows(problem.shared, solution.shared)
    owns = [problem.prior_rows(run.names, own) for run, own in zip(problem.runs, solution.own, strict=True)]

    def pieces(with_start: bool) -> tuple[Piece, ...]:
        made = []
        for k, run in enumerate(runs):
            own, rows = run.own, owns[k]
            given = {*problem.known, *problem.runs[k].names}
            start = strike_time_slope(problem.runs[k].window, given, solution.values(k))
            if with_start and start is not None:
                own = np.concatenate([own, start[:, :, None]], axis=2)
                rows = np.concatenate([rows[0], np.zeros((len(rows[1]), 1))], axis=1), rows[1]
            made.append(Piece(_families(times[k], goods[k], found), own, run.shared, run.residual, rows))
        return tuple(made)

    ratios: Array | None = None
    fitted = posterior(pieces(True), prior, ratios, with_own=False)
    for _ in range(refinements):  # all runs determine the noise better than one run
        ratios = _refined_ratios(fitted)
        found = {c: _refined(one, fitted.weights.sum(axis=(1 - c, 2))) for c, one in found.items()}
        fitted = posterior(pieces(True), prior, ratios, with_own=False)
    last = pieces(False)
    noises = tuple(likeliest_noise(one, fitted) for one in last)
    return _NoiseModel(found, last, posterior(last, prior, ratios), noises)


def _likelier(times: Sequence[Array], runs: Sequence[Linearised], stated: Sequence[float]) -> str:
    """Name of the noise model with the lower BIC: ar or oscillator."""
    return min(("ar", "oscillator"), key=lambda name: _bic(name, times, runs, stated))


def _bic(name: str, times: Sequence[Array], runs: Sequence[Linearised], stated: Sequence[float]) -> float:
    """BIC of a noise model for the residuals of all runs, at each channel's likeliest candidate."""
    goods, found = [np.isfinite(run.residual) for run in runs], _candidates(name, times, runs, stated)
    total, unknowns, count = 0.0, 0, sum(int(good.sum()) for good in goods)
    for c, one in found.items():
        squares, determinants, samples = np.zeros(1), np.zeros(1), 0
        for time, good, run in zip(times, goods, runs, strict=True):
            family = _families(time, good, {c: one}).get(c)
            if family is not None:
                squares = squares + family.products(run.residual[good[:, c], c, None])[:, 0, 0]
                determinants = determinants + family.log_determinants
                samples += int(good[:, c].sum())
        total += float(np.min(samples * np.log(squares / samples) + determinants))
        unknowns += 1 + _size(one)
    return total + unknowns * math.log(count)


def _size(found: _Found) -> int:
    """Number of noise parameters of a channel beside its standard deviation."""
    if isinstance(found, ar.ARCandidates):
        return len(found.further) + 1 if len(found.first) else 0
    return oscillator.PARAMETER_COUNT if found[:, 2].any() else 0


def _candidates(
    name: str, times: Sequence[Array], runs: Sequence[Linearised], stated: Sequence[float]
) -> dict[int, _Found]:
    """Candidate noise models by channel, from the residuals of all runs that measured it."""
    found: dict[int, _Found] = {}
    for c in range(2):
        pairs = [(time, run.residual[:, c]) for time, run in zip(times, runs, strict=True)]
        kept = [(t[np.isfinite(r)], r[np.isfinite(r)]) for t, r in pairs if np.isfinite(r).sum() > 2]
        if not kept:
            continue
        when, residuals = [t for t, _ in kept], [r for _, r in kept]
        if name == "ar":
            found[c] = ar.candidates(residuals)
        else:
            grid = oscillator.candidates(when, residuals, stated)
            found[c] = oscillator.with_weight(grid, when, residuals, MAX_LOG_LIKELIHOOD_LOSS)
    return found


def _families(time: Array, good: NDArray[np.bool_], found: Mapping[int, _Found]) -> dict[int, Family]:
    """Candidate noise models by channel at the samples of a run: times (n,) [s], measured (n, 2)."""
    processes = {c: one for c, one in found.items() if isinstance(one, ar.ARCandidates)}
    oscillators = {c: one for c, one in found.items() if isinstance(one, np.ndarray)}
    return {
        **ar.families(time, good, processes),
        **oscillator.families(time, good, oscillators),
    }


def _refined(found: _Found, weights: Array) -> _Found:
    """Autoregressive candidates refined around their weights (g,); an oscillator grid is fine already."""
    if not isinstance(found, ar.ARCandidates) or len(found.first) < 2:
        return found
    places = np.arctanh(found.first)
    mean = float(weights @ places)
    std = math.sqrt(float(weights @ (places - mean) ** 2))
    half = max(GRID_HALF_WIDTH * std, float(places[1] - places[0]))
    return found.within(mean - half, mean + half)


def _refined_ratios(found: Posterior) -> Array:
    """Refined grid of the ratios of the channels' noise around their posterior weights."""
    weights = found.weights.sum(axis=(0, 1))
    if len(weights) < 2:
        return found.ratios
    mean = float(weights @ found.ratios)
    std = math.sqrt(float(weights @ (found.ratios - mean) ** 2))
    half = max(GRID_HALF_WIDTH * std, 0.5 * float(found.ratios[1] - found.ratios[0]))
    return mean + half * np.linspace(-1.0, 1.0, len(weights))
