"""Calibration of bicycle parameters from many free responses, with cluster-robust intervals.

Model errors are correlated from sample to sample, so the residual variance underestimates the uncertainty of
a parameter. The scatter between pushes measures it instead: the noise of one measurement is inflated until
the gradients of the likelihood scatter from push to push as expected (the magnitude adjustment of composite
likelihoods). The inflated noise weighs the data against the priors.

References: D. Pauli, W. Racugno and L. Ventura, Statistica Sinica 21 (2011) 149-164 (adjustment); K.-Y. Liang
and S. L. Zeger, Biometrika 73 (1986), doi 10.1093/biomet/73.1.13 (scatter of gradients by cluster).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit
from tms_fit.parameters import check_known
from tms_model import Bicycle, ParameterError
from tms_model.bicycle import Array
from tms_model.changes import numbers_of
from tms_model.measured import Measured

from tms_calibrate.pooled_problem import PooledProblem, PooledSolution, Run
from tms_calibrate.pooled_solver import solve_pooled
from tms_calibrate.random_effects import RandomEffects, random_effects

MIN_RUNS = 4  # pushes, the least number whose scatter estimates a variance
DEFAULT_PRIOR_RELATIVE_STD = 0.2  # of the value, where the bicycle states no standard deviation
STEER_ELEMENT_PRIOR_STD = {  # where none is stated, since the value is often 0 or 1
    "steer_spring": 5.0,  # [N m/rad]
    "steer_damper": 0.5,  # [N m s/rad]
    "lean_gain": 5.0,  # [N m/rad]
    "steer_torque_gain": 0.2,
}
MAX_ITERATIONS = 20  # of noise and parameters in turn
NOISE_TOLERANCE = 0.01  # last relative change of the noise


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibrated parameters of a bicycle with covariance, priors and effective noise."""

    bicycle: Bicycle  # before calibration
    solution: PooledSolution
    priors: Mapping[str, Measured]
    prior_sources: Mapping[str, str]  # by name: stated, given or assumed
    design_effect: float  # measurements that carry the information of one independent measurement

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibrated parameters."""
        return self.solution.problem.nonlinear

    @property
    def values(self) -> Array:
        """Calibrated values (p,), SI units."""
        return self.solution.shared

    @property
    def covariance(self) -> Array:
        """Posterior covariance (p, p), priors included."""
        assert self.solution.arrow is not None
        return self.solution.arrow.shared_inverse

    @property
    def std(self) -> Array:
        """Posterior standard deviations (p,)."""
        std: Array = np.sqrt(np.diag(self.covariance))
        return std

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of the noise estimated from the scatter between pushes."""
        return scatter_degrees(self.solution)

    @property
    def ci95(self) -> Array:
        """95 % intervals (p, 2) by Student's t, since few pushes determine their scatter poorly."""
        half = float(stdtrit(self.degrees_of_freedom, 0.975)) * self.std
        return np.stack([self.values - half, self.values + half], axis=1)

    @property
    def contraction(self) -> Array:
        """Reduction (p,) of each prior variance by the data: 0 prior alone, 1 data alone."""
        prior = np.array([self.priors[name].deviation for name in self.names])
        share: Array = 1.0 - (self.std / prior) ** 2
        return share

    @property
    def repeated(self) -> dict[str, RandomEffects]:
        """Heterogeneity between pushes of each parameter, all other parameters fixed."""
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
    """Prior of each name and its source: given, stated with the bicycle, or assumed.

    An assumed standard deviation is STEER_ELEMENT_PRIOR_STD, or DEFAULT_PRIOR_RELATIVE_STD of the value.
    Raises ParameterError for a name that the bicycle lacks, a prior on a fixed parameter, and a prior without
    standard deviation, given or assumed from a value of 0.
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
            assumed = STEER_ELEMENT_PRIOR_STD.get(name, DEFAULT_PRIOR_RELATIVE_STD * abs(numbers[name]))
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
    """Calibrate `names` of a bicycle. Raises ParameterError as `priors_for` does, and for too few runs."""
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
    """Solution whose noise equals the balanced noise of its own residuals (fixed-point iteration)."""
    bare = solve_pooled(replace(problem, nonlinear=(), priors={}))
    if bare.status == "not_observable":
        return bare
    solution = solve_pooled(replace(problem, noise=4.0 * np.sqrt(bare.variance)))
    for _ in range(MAX_ITERATIONS):
        if solution.status == "not_observable":
            break
        noise = balanced_noise(solution)
        settled = abs(noise / solution.problem.noise - 1.0) < NOISE_TOLERANCE
        solution = solve_pooled(replace(problem, noise=noise), solution.shared)
        if settled:
            break
    return solution


def balanced_noise(solution: PooledSolution) -> float:
    """Noise [rad/s] of one measurement at which the runs' gradients scatter as expected.

    The predictions are linearised at the solution. Another noise changes the weight of the priors, which
    moves the solution and the residuals. The observed and the expected scatter of the gradients are compared
    in the metric of the covariance C, which gives little weight to directions that only the priors determine.
    Each push pulls the solution towards itself: with information I_i, its gradient at the solution has the
    expected variance I_i - I_i C I_i (R. M. Bell and D. F. McCaffrey, Survey Methodology 28 (2002) 169-181).
    """
    problem, arrow = solution.problem, solution.arrow
    assert arrow is not None
    slopes = [problem.noise * projected for projected in arrow.projected]  # (m, s) [rad/s per unit]
    information = [slope.T @ slope for slope in slopes]
    prior = np.linalg.inv(arrow.shared_inverse) - sum(information) / problem.noise**2
    gradients = np.array([s.T @ residual for s, residual in zip(slopes, solution.residuals, strict=True)])
    noise = problem.noise
    pull = -gradients.sum(axis=0) / noise**2  # gradient of the priors at the solution
    for _ in range(MAX_ITERATIONS):
        covariance = np.linalg.inv(sum(information) / noise**2 + prior)
        step = covariance @ (gradients.sum(axis=0) / noise**2 + pull)
        moved = gradients - np.array([one @ step for one in information])
        found = float(np.sum((moved @ covariance) * moved))
        shares = [covariance @ one / noise**2 for one in information]  # leverage of each push
        expected = noise**2 * sum(float(np.trace(one - one @ one)) for one in shares)
        before, noise = noise, float(np.sqrt(found / expected))
        if abs(noise / before - 1.0) < 0.1 * NOISE_TOLERANCE:
            break
    return noise


def scatter_degrees(solution: PooledSolution) -> float:
    """Degrees of freedom of the noise estimated from the runs' gradients, by Satterthwaite's moments.

    F. E. Satterthwaite, Biometrics Bulletin 2 (1946), doi 10.2307/3002019.
    """
    arrow = solution.arrow
    assert arrow is not None
    shares = [arrow.shared_inverse @ (one.T @ one) for one in arrow.projected]
    shares = [one - one @ one for one in shares]
    total = sum(float(np.trace(one)) for one in shares)
    return total**2 / sum(float(np.trace(one @ one)) for one in shares)
