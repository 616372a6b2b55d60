"""Calibration of bicycle parameters from many free responses, with intervals by the scatter of pushes.

What a model leaves out makes residuals that are alike from sample to sample, so that a residual's variance
says little about how well a parameter is known. What says it is how much the pushes disagree with each other:
the noise that one measurement stands for is made as large as the scatter, from push to push, of the gradients
of the likelihood (the magnitude adjustment of composite likelihoods). It weighs the data against the priors.

References: D. Pauli, W. Racugno and L. Ventura, Statistica Sinica 21 (2011) 149-164 (adjustment); K.-Y. Liang
and S. L. Zeger, Biometrika 73 (1986), doi 10.1093/biomet/73.1.13 (scatter of gradients by cluster).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student_t
from tms_fit.parameters import check_known
from tms_model import Bicycle, ParameterError
from tms_model.bicycle import Array
from tms_model.changes import numbers_of
from tms_model.measured import Measured

from tms_calibrate.pooled_problem import PooledProblem, PooledSolution, Run
from tms_calibrate.pooled_solver import solve_pooled
from tms_calibrate.random_effects import RandomEffects, random_effects

MIN_RUNS = 4  # pushes, so that their scatter says something
PRIOR_SHARE = 0.2  # of its value: a parameter's prior standard deviation where none is stated
ELEMENT_PRIORS = {  # where none is stated; zero or one where the bicycle says nothing
    "steer_spring": 5.0,  # [N m/rad]
    "steer_damper": 0.5,  # [N m s/rad]
    "lean_gain": 5.0,  # [N m/rad]
    "steer_torque_gain": 0.2,
}
ROUNDS = 20  # at most, of the noise and the parameters in turn
SETTLED = 0.01  # change of the noise that ends them


@dataclass(frozen=True, eq=False)
class Calibration:
    """Numbers of a bicycle with their covariance, and what bears it out."""

    bicycle: Bicycle  # before
    solution: PooledSolution
    priors: Mapping[str, Measured]
    prior_sources: Mapping[str, str]  # stated, given or assumed
    design_effect: float  # how many measurements tell as much as one independent one

    @property
    def names(self) -> tuple[str, ...]:
        """What was calibrated."""
        return self.solution.problem.nonlinear

    @property
    def values(self) -> Array:
        """(p,)"""
        return self.solution.shared

    @property
    def covariance(self) -> Array:
        """(p, p), priors included."""
        assert self.solution.arrow is not None
        return self.solution.arrow.shared_inverse

    @property
    def std(self) -> Array:
        """(p,)"""
        std: Array = np.sqrt(np.diag(self.covariance))
        return std

    @property
    def degrees_of_freedom(self) -> float:
        """That the noise is known with, as the scatter of the pushes tells it."""
        return scatter_degrees(self.solution)

    @property
    def ci95(self) -> Array:
        """95 % intervals (p, 2) by Student's t: few pushes tell their scatter badly."""
        half = float(student_t.ppf(0.975, self.degrees_of_freedom)) * self.std
        return np.stack([self.values - half, self.values + half], axis=1)

    @property
    def contraction(self) -> Array:
        """Share (p,) of each prior variance that the data took away: 0 nothing learnt, 1 all is data."""
        prior = np.array([self.priors[name].deviation for name in self.names])
        share: Array = 1.0 - (self.std / prior) ** 2
        return share

    @property
    def repeated(self) -> dict[str, RandomEffects]:
        """Each number as each push alone tells it, all others held: is their scatter that of the noise?"""
        return {name: self._repeated(k) for k, name in enumerate(self.names)}

    def _repeated(self, index: int) -> RandomEffects:
        assert self.solution.arrow is not None
        noise = self.solution.problem.noise
        pairs = [
            (float(p[:, index] @ r) / noise / float(p[:, index] @ p[:, index]), np.linalg.norm(p[:, index]))
            for p, r in zip(self.solution.arrow.projected, self.solution.residuals, strict=True)
        ]
        steps, precisions = (np.array(column) for column in zip(*pairs, strict=True))
        return random_effects(self.values[index] + steps, 1.0 / precisions)


def priors_for(
    bicycle: Bicycle, names: tuple[str, ...], given: Mapping[str, Measured]
) -> tuple[dict[str, Measured], dict[str, str]]:
    """A prior for each name and where it comes from: given, stated with the bicycle, or assumed.

    Assumed is PRIOR_SHARE of the value, or ELEMENT_PRIORS. Raises ParameterError for a name that the bicycle
    does not have, a prior on what is not free or without deviation, and for a value of 0 of which PRIOR_SHARE
    says nothing.
    """
    numbers = numbers_of(bicycle)
    check_known(names, numbers, "free")
    check_known(given, names, "prior")
    priors, sources = {}, {}
    for name in names:
        if name in given:
            priors[name], sources[name] = given[name], "given"
        elif bicycle.standard_deviations.get(name, 0.0) > 0.0:
            priors[name], sources[name] = Measured(numbers[name], bicycle.standard_deviations[name]), "stated"
        else:
            assumed = ELEMENT_PRIORS.get(name, PRIOR_SHARE * abs(numbers[name]))
            priors[name], sources[name] = Measured(numbers[name], assumed), "assumed"
        if not priors[name].deviation > 0.0:
            raise ParameterError(
                f"prior: {name}: expected a standard deviation, found none; say --prior"
                f" {name}={priors[name].value:g},STD"
            )
    return priors, sources


def calibrate(
    bicycle: Bicycle, runs: tuple[Run, ...], names: tuple[str, ...], given: Mapping[str, Measured]
) -> Calibration:
    """Calibrate `names` of a bicycle; raises ParameterError as `priors_for`, and for too few runs."""
    if not names or len(set(names)) < len(names):
        raise ParameterError(f"free: expected each name once, found {', '.join(names) or 'none'}")
    if len(runs) < MIN_RUNS:
        raise ParameterError(
            f"expected at least {MIN_RUNS} strikes, whose scatter says how sure they are, found {len(runs)}"
        )
    priors, sources = priors_for(bicycle, names, given)
    compared = tuple(replace(run, window=replace(run.window, bicycle=bicycle)) for run in runs)
    solution = solve_balanced(PooledProblem(compared, nonlinear=names, priors=priors))
    if solution.status == "not_observable":
        raise ParameterError(f"calibration: {solution.message}")
    white = sum(float(r @ r) for r in solution.residuals) / max(solution.problem.degrees_of_freedom, 1)
    return Calibration(bicycle, solution, priors, sources, solution.problem.noise**2 / white)


def solve_balanced(problem: PooledProblem) -> PooledSolution:
    """The solution at which the noise that a measurement stands for is what the scatter of the runs says."""
    bare = solve_pooled(replace(problem, nonlinear=(), priors={}))
    if bare.status == "not_observable":
        return bare
    solution = solve_pooled(replace(problem, noise=4.0 * np.sqrt(bare.variance)))
    for _ in range(ROUNDS):
        if solution.status == "not_observable":
            break
        noise = balanced_noise(solution)
        settled = abs(noise / solution.problem.noise - 1.0) < SETTLED
        solution = solve_pooled(replace(problem, noise=noise), solution.shared)
        if settled:
            break
    return solution


def balanced_noise(solution: PooledSolution) -> float:
    """Noise [rad/s] of one measurement at which the runs' gradients scatter as expected.

    The predictions are taken as linear around the solution; with another noise the priors pull more or less,
    which moves the solution and the residuals. The scatter of the gradients and what is expected of it are
    compared in the metric of the covariance C, in which directions that only the priors hold weigh little. A
    push pulls the solution towards itself: with information I_i, its gradient at the solution is expected to
    scatter by I_i - I_i C I_i (R. M. Bell and D. F. McCaffrey, Survey Methodology 28 (2002) 169-181), whether
    it is the noise or the prior that makes the solution differ from the truth.
    """
    problem, arrow = solution.problem, solution.arrow
    assert arrow is not None
    slopes = [problem.noise * projected for projected in arrow.projected]  # (m, s) [rad/s per unit]
    information = [slope.T @ slope for slope in slopes]
    prior = np.linalg.inv(arrow.shared_inverse) - sum(information) / problem.noise**2
    gradients = np.array([s.T @ residual for s, residual in zip(slopes, solution.residuals, strict=True)])
    noise = problem.noise
    pull = -gradients.sum(axis=0) / noise**2  # of the priors, at the solution
    for _ in range(ROUNDS):
        covariance = np.linalg.inv(sum(information) / noise**2 + prior)
        step = covariance @ (gradients.sum(axis=0) / noise**2 + pull)
        moved = gradients - np.array([one @ step for one in information])
        found = float(np.sum((moved @ covariance) * moved))
        shares = [covariance @ one / noise**2 for one in information]  # of all that is known, each push's
        expected = noise**2 * sum(float(np.trace(one - one @ one)) for one in shares)
        before, noise = noise, float(np.sqrt(found / expected))
        if abs(noise / before - 1.0) < 0.1 * SETTLED:
            break
    return noise


def scatter_degrees(solution: PooledSolution) -> float:
    """Degrees of freedom of the noise that the runs' gradients show, by Satterthwaite's moments.

    F. E. Satterthwaite, Biometrics Bulletin 2 (1946), doi 10.2307/3002019.
    """
    arrow = solution.arrow
    assert arrow is not None
    shares = [arrow.shared_inverse @ (one.T @ one) for one in arrow.projected]
    shares = [one - one @ one for one in shares]
    total = sum(float(np.trace(one)) for one in shares)
    return total**2 / sum(float(np.trace(one @ one)) for one in shares)
