"""Pooled fit of the strikes of several recordings, with a test of heterogeneity."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit
from tms_fit.estimate import Estimate
from tms_fit.estimators.least_squares import fit_window
from tms_fit.least_squares.block_arrowhead import solve_block_arrowhead
from tms_fit.parameters import BIASES, FRICTION, LINEAR, NONLINEAR, check_known
from tms_fit.recording_fit import RecordingFit, first_stamp
from tms_fit.settings import Settings
from tms_fit.window import Window, without_saturated
from tms_model import ParameterError
from tms_model.bicycle import Array
from tms_model.measured import Measured

from tms_calibrate.pooled_noise import NoisySolution, solve_with_noise
from tms_calibrate.pooled_problem import BICYCLE_NUMBERS, PooledProblem, PooledSolution, Run
from tms_calibrate.pooled_solver import block_of, model_of
from tms_calibrate.random_effects import RandomEffects, random_effects

NOT_SHAREABLE = ("strike_time", FRICTION)  # friction only in a fit of one run
SHAREABLE = tuple(
    dict.fromkeys((*BIASES, *(name for name in NONLINEAR if name not in NOT_SHAREABLE), *BICYCLE_NUMBERS))
)
DIFFERENCE_STEP = 1e-3  # of derivatives by nuisance parameters, in their standard deviations


@dataclass(frozen=True, eq=False)
class Strike:
    """One strike of one recording with its own fit, as of `fit run`."""

    recording: str  # name of the bag
    index: int  # counted from 1 in the recording
    seconds: float  # [s] since the recording's first stamp
    start_ns: int  # [ns] of the free response
    found: Window | None  # None: no free response to compare
    alone: Estimate  # its own fit

    @property
    def window(self) -> Window:
        """Window of the free response; every strike of a pooled fit has one."""
        assert self.found is not None
        return self.found


@dataclass(frozen=True, eq=False)
class PooledFit:
    """Pooled fit of several strikes with covariances and heterogeneity."""

    strikes: tuple[Strike, ...]
    left_out: tuple[Strike, ...]  # without an estimate of their own
    noisy: NoisySolution
    shared_covariance: Array  # (s, s)
    own_covariance: tuple[Array, ...]  # (q, q) of each strike
    between: dict[str, RandomEffects]  # of the strikes' own estimates, by parameter

    @property
    def solution(self) -> PooledSolution:
        """Solution of the pooled problem under its noise model."""
        return self.noisy.solution

    @property
    def residual_std(self) -> float:
        """Standard deviation [rad/s] of measured minus predicted rates, by the degrees of freedom."""
        problem = self.solution.problem
        squares = 0.0
        for k, run in enumerate(problem.runs):
            values = self.solution.values(k)
            squares += float(
                np.nansum((run.window.measured - model_of(run.window, values).predict(values)) ** 2)
            )
        return math.sqrt(squares / max(problem.degrees_of_freedom, 1))

    @property
    def quantile(self) -> float:
        """Half of a 95 % interval per standard error: Student's t."""
        return float(stdtrit(max(self.solution.problem.degrees_of_freedom, 1), 0.975))


def strikes_of(fit: RecordingFit) -> tuple[Strike, ...]:
    """Strikes of a fitted recording."""
    start = first_stamp(fit.recording)
    return tuple(
        Strike(
            recording=fit.recording.path.name,
            index=k,
            seconds=(one.start_ns - start) / 1e9,
            start_ns=one.start_ns,
            found=None if one.window is None else without_saturated(one.window),
            alone=one.estimates[0],
        )
        for k, one in enumerate(fit.strikes, start=1)
    )


def usable(strikes: Sequence[Strike]) -> tuple[tuple[Strike, ...], tuple[Strike, ...]]:
    """Strikes with and without an estimate of their own. Raises ParameterError if none has one."""
    good = tuple(one for one in strikes if one.found is not None and one.alone.status == "ok")
    if not good:
        why = f"; the first says: {strikes[0].alone.message}" if strikes else ""
        raise ParameterError(f"expected at least one strike that can be fitted, found {len(strikes)}{why}")
    return good, tuple(one for one in strikes if one not in good)


def fit_pooled(
    strikes: Sequence[Strike],
    share: tuple[str, ...],
    known: Mapping[str, float] | None = None,
    method: str = "reml",
    priors: Mapping[str, Measured] | None = None,
    noise: str = "auto",
    oscillator: tuple[float, ...] = (),
) -> PooledFit:
    """Pooled fit of strikes with shared unknowns `share`: biases or numbers of the bicycle.

    The other unknowns are those of the strikes' own fits; `known` are the values fixed in them. priors: of
    shared unknowns and of each strike's own. noise, oscillator: as for one strike, one model for all, under
    which the strikes' own fits are repeated. Raises ParameterError for names that can't be shared or aren't
    free, or if no strike can be fitted.
    """
    check_known(share, SHAREABLE, "share")
    if len(set(share)) < len(share):
        raise ParameterError(f"share: expected each name once, found {', '.join(share)}")
    good, left_out = usable(strikes)
    if any(FRICTION in one.alone.names for one in good) or FRICTION in (known or {}):
        raise ParameterError(f"{FRICTION}: expected in fit run only, neither free nor fixed here")
    runs = tuple(
        Run(
            one.window,
            tuple(name for name in one.alone.names if name in LINEAR and name not in share),
            tuple(name for name in one.alone.names if name not in LINEAR and name not in share),
        )
        for one in good
    )
    problem = PooledProblem(
        runs,
        tuple(name for name in share if name in LINEAR),
        tuple(name for name in share if name not in LINEAR),
        known or {},
        priors or {},
    )
    unknowns = {*problem.shared, *(name for run in runs for name in run.names)}
    for name in problem.priors:
        if name not in unknowns:
            raise ParameterError(f"prior: {name}: expected a free parameter; add it to --free or --share")
    noisy = solve_with_noise(problem, noise, oscillator)
    if noisy.solution.arrow is None:
        return PooledFit(good, left_out, noisy, np.empty((0, 0)), (), {})
    shared, own = _covariances(noisy)
    if noise != "white":
        good = tuple(_under_noise(one, noise, oscillator) for one in good)
    return PooledFit(good, left_out, noisy, shared, own, _between(good, method, problem.priors))


def _under_noise(one: Strike, noise: str, oscillator: tuple[float, ...]) -> Strike:
    """Strike with its own fit repeated for the same unknowns under another noise model."""
    settings = one.alone.settings or Settings()
    settings = replace(settings, free=one.alone.names, noise=noise, oscillator=oscillator)
    alone = fit_window(one.window, settings)
    return replace(one, alone=alone) if alone.status == "ok" else one


def _between(
    strikes: Sequence[Strike], method: str, priors: Mapping[str, Measured]
) -> dict[str, RandomEffects]:
    """Random-effects mean of each parameter over the strikes' own fits.

    Parameters with a prior are left out: the common prior makes the fits agree.
    """
    means = {}
    for name in dict.fromkeys(name for one in strikes for name in one.alone.names if name not in priors):
        pairs = [(one.alone[name].value, one.alone[name].std) for one in strikes if name in one.alone]
        values, std = (np.array(column, dtype=float) for column in zip(*pairs, strict=True))
        if (std > 0.0).all():
            means[name] = random_effects(values, std, method)
    return means


def _covariances(noisy: NoisySolution) -> tuple[Array, tuple[Array, ...]]:
    """Covariances (s, s) of shared and (q, q) of own values, by noise and uncertain nuisance parameters."""
    solution, shared, own = noisy.solution, noisy.shared_covariance, list(noisy.own_covariance)
    problem = solution.problem
    blocks = [
        block_of(problem, run, solution.shared, values)
        for run, values in zip(problem.runs, solution.own, strict=True)
    ]
    priors = problem.prior_rows(problem.shared, solution.shared)
    for k, run in enumerate(problem.runs):
        names = {*problem.shared, *run.nonlinear, *problem.known}
        for low, high, width in _nuisance_steps(run.window, names):
            steps = []
            for window in (low, high):
                moved = block_of(problem, replace(run, window=window), solution.shared, solution.own[k])
                found = solve_block_arrowhead([*blocks[:k], moved, *blocks[k + 1 :]], *priors)
                steps.append(found)
            if steps[0] is None or steps[1] is None:
                continue
            shift = (steps[1].shared - steps[0].shared) / width
            shared = shared + np.outer(shift, shift)
            for j, (before, after) in enumerate(zip(steps[0].own, steps[1].own, strict=True)):
                one = (after - before) / width
                own[j] = own[j] + np.outer(one, one)
    return shared, tuple(own)


def _nuisance_steps(window: Window, names: set[str]) -> Iterator[tuple[Window, Window, float]]:
    """Pairs of windows that differ in one nuisance parameter, and their distance in standard deviations.

    The nuisance parameters are the measured speed and the strike time. names: parameters that are free or
    fixed and so replace those of the window.
    """
    curve = window.speed
    spread = curve.covariance.copy()
    if "speed" in names:
        spread[0, :] = spread[:, 0] = 0.0
    if "rolling_resistance" in names:
        spread[1:, :] = spread[:, 1:] = 0.0
    variances, axes = np.linalg.eigh(spread)
    for variance, axis in zip(variances, axes.T, strict=True):
        if variance > 0.0:
            step = DIFFERENCE_STEP * math.sqrt(variance) * axis
            ends = (replace(curve, coefficients=curve.coefficients + part * step) for part in (-1.0, 1.0))
            low, high = (replace(window, speed=end) for end in ends)
            yield low, high, 2.0 * DIFFERENCE_STEP
    if window.delay_std and "strike_time" not in names:
        step = DIFFERENCE_STEP * window.delay_std
        least, most = max(window.delay - step, 0.0), window.delay + step
        yield replace(window, delay=least), replace(window, delay=most), (most - least) / window.delay_std
