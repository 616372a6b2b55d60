"""Identifiability of bicycle parameters by the singular values of the scaled Jacobian.

The Jacobian is scaled by the prior standard deviations of the parameters and by the noise of a measurement,
and projected orthogonally to the unknowns of each run. The data determine a combination of parameters with
singular value 10 ten times better than the priors do; below 1 the priors determine it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tms_model.bicycle import Array
from tms_model.measured import Measured

from tms_calibrate.pooled_problem import PooledProblem
from tms_calibrate.pooled_solver import linearise

MAX_TERMS = 4  # of a combination in words
MIN_COMPONENT = 0.25  # of a unit direction, for a term in words


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Identifiable combinations of p parameters, by data against priors."""

    names: tuple[str, ...]
    scales: Array  # (p,) prior standard deviations
    singular: Array  # (p,) descending, data against priors
    directions: Array  # (p, p), column k belongs to singular value k, in units of the scales
    alone: Array  # (p,) standard error per scale, all other parameters fixed
    together: Array  # (p,) the same, all other parameters free within their priors

    @property
    def known(self) -> int:
        """Number of combinations that the data determine better than the priors."""
        return int(np.sum(self.singular > 1.0))

    def in_words(self, index: int) -> str:
        """Combination `index` in words, such as 'steer_damper 0.86 - steer_torque_gain 0.33'."""
        direction = self.directions[:, index]
        largest = [int(k) for k in np.argsort(-np.abs(direction), kind="stable")[:MAX_TERMS]]
        sign = float(np.sign(direction[largest[0]]))
        parts = [
            f"{'+' if sign * direction[k] > 0.0 else '-'} {abs(direction[k]):.2f} {self.names[k]}"
            for k in largest
            if abs(direction[k]) >= MIN_COMPONENT
        ]
        return " ".join(parts).removeprefix("+ ")


def identify(problem: PooledProblem, values: dict[str, float], scales: dict[str, float]) -> Identifiability:
    """Identifiability of the parameters in `scales` from the runs of a problem, linearised at `values`.

    scales: prior standard deviation by name, positive, SI units.
    """
    names = tuple(scales)
    around = {**problem.known, **{name: value for name, value in values.items() if name not in scales}}
    priors = {name: Measured(values[name], scales[name]) for name in names}
    asked = replace(problem, nonlinear=names, priors=priors, known=around)
    solution = linearise(asked, np.array([values[name] for name in names]))
    scale = np.array([scales[name] for name in names])
    nothing = np.full(len(names), np.nan)
    if solution.arrow is None:
        return Identifiability(names, scale, np.zeros(len(names)), np.eye(len(names)), nothing, nothing)
    rows = np.concatenate(solution.arrow.projected)[:, len(problem.linear) :] * scale
    _, singular, directions = np.linalg.svd(rows, full_matrices=False)
    informed = np.sum(rows**2, axis=0)
    return Identifiability(
        names=names,
        scales=scale,
        singular=singular,
        directions=directions.T,
        alone=1.0 / np.sqrt(informed + 1.0),
        together=np.sqrt(np.diag(solution.arrow.shared_inverse)) / scale,
    )
