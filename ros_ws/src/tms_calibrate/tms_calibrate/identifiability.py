"""Identifiability of bicycle parameters by the singular values of the scaled Jacobian.

The change of the predictions by each number, times its prior standard deviation, per standard deviation of
what one measurement stands for, with all that a run's own unknowns could imitate taken out. A singular value
of 10 says: this combination of numbers is known ten times better by the data than by the priors; one below 1:
the priors hold it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tms_model.bicycle import Array
from tms_model.measured import Measured

from tms_calibrate.pooled_problem import PooledProblem
from tms_calibrate.pooled_solver import linearise

SHOWN = 4  # numbers in a combination that is told in words
SMALL = 0.25  # part of a combination that is not worth a word


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Of p numbers with their scales."""

    names: tuple[str, ...]
    scales: Array  # (p,) prior standard deviations
    singular: Array  # (p,) descending, data against priors
    directions: Array  # (p, p), column k belongs to singular value k, in units of the scales
    alone: Array  # (p,) standard error per scale, all other numbers known
    together: Array  # (p,) the same with all others unknown within their priors

    @property
    def known(self) -> int:
        """Number of combinations that the data know better than the priors."""
        return int(np.sum(self.singular > 1.0))

    def in_words(self, index: int) -> str:
        """A combination, such as 'steer_damper 0.86 - steer_torque_gain 0.33'."""
        direction = self.directions[:, index]
        largest = [int(k) for k in np.argsort(-np.abs(direction), kind="stable")[:SHOWN]]
        sign = float(np.sign(direction[largest[0]]))
        parts = [
            f"{'+' if sign * direction[k] > 0.0 else '-'} {abs(direction[k]):.2f} {self.names[k]}"
            for k in largest
            if abs(direction[k]) >= SMALL
        ]
        return " ".join(parts).removeprefix("+ ")


def identify(problem: PooledProblem, values: dict[str, float], scales: dict[str, float]) -> Identifiability:
    """What the runs of a problem, with its noise, tell of the numbers in `scales`, around `values`.

    scales: standard deviation by name, positive, within which a number is known without the runs.
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
