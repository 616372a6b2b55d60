"""Pooled problems: several free responses with own and shared unknowns, and their solutions.

Unknowns are of each run or shared by all runs; a prediction is linear in some, and shaped by others: numbers
of the bicycle and parameters of a run such as `speed`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from tms_fit.least_squares.block_arrowhead import BlockArrowheadSolution
from tms_fit.least_squares.problem import Whitener
from tms_fit.least_squares.varpro import Status
from tms_fit.window import Window
from tms_model.bicycle import Array
from tms_model.changes import MATRIX_ENTRIES
from tms_model.measured import Measured
from tms_model.parameters import PARAMETER_NAMES
from tms_model.steer_elements import STEER_ELEMENT_NAMES

CONTROLLED = "lean_rate_gain"  # the run's controller, as in a fit of one run; not the bicycle's own element
BICYCLE_NUMBERS = tuple(
    name for name in (*PARAMETER_NAMES, *STEER_ELEMENT_NAMES, *MATRIX_ENTRIES) if name != CONTROLLED
)


@dataclass(frozen=True, eq=False)
class Run:
    """One free response and the unknowns that are its own."""

    window: Window
    linear: tuple[str, ...]  # of LINEAR
    nonlinear: tuple[str, ...] = ()  # such as speed
    rows: Whitener | None = None  # samples (n, 2, ...) as rows (m, ...) of white noise; None: each by itself

    @property
    def names(self) -> tuple[str, ...]:
        """In the order of a solution's own values."""
        return (*self.linear, *self.nonlinear)

    def select(self, values: Array) -> Array:
        """Whitener (m, ...) of values (n, 2, ...), those that were measured."""
        good = np.isfinite(self.window.measured)
        return values[good] if self.rows is None else self.rows(values)


@dataclass(frozen=True, eq=False)
class PooledProblem:
    """Unknowns of several runs, with fixed values and priors."""

    runs: tuple[Run, ...]
    linear: tuple[str, ...] = ()  # shared, of LINEAR
    nonlinear: tuple[str, ...] = ()  # shared, of BICYCLE_NUMBERS or a run's
    known: Mapping[str, float] = field(default_factory=dict)
    priors: Mapping[str, Measured] = field(default_factory=dict)  # shared unknowns; others: of each run's own
    noise: float = 1.0  # standard deviation that one row stands for, against the priors; [rad/s] of a sample

    @property
    def shared(self) -> tuple[str, ...]:
        """Names in the order of a solution's shared values."""
        return (*self.linear, *self.nonlinear)

    @property
    def count(self) -> int:
        """Scalar measurements."""
        return sum(int(np.isfinite(run.window.measured).sum()) for run in self.runs)

    @property
    def degrees_of_freedom(self) -> int:
        """Measurements, those that a prior stands for included, less unknowns."""
        unknowns = [name for run in self.runs for name in run.names] + list(self.shared)
        return self.count + sum(name in self.priors for name in unknowns) - len(unknowns)

    def prior_rows(self, names: tuple[str, ...], values: Array) -> tuple[Array, Array]:
        """Whitener (k, p) that priors add for unknowns (p,), and how far (k,) the values are from them."""
        held = [name for name in names if name in self.priors]
        rows, off = np.zeros((len(held), len(names))), np.zeros(len(held))
        for row, name in enumerate(held):
            prior, index = self.priors[name], names.index(name)
            rows[row, index] = 1.0 / prior.deviation
            off[row] = (prior.value - values[index]) / prior.deviation
        return rows, off


@dataclass(frozen=True, eq=False)
class PooledSolution:
    """Solution of a pooled problem; without values where the status is not_observable."""

    problem: PooledProblem
    status: Status
    message: str
    shared: Array = field(default_factory=lambda: np.empty(0))  # (s,)
    own: tuple[Array, ...] = ()  # (q,) of each run: linear, then nonlinear
    residuals: tuple[Array, ...] = ()  # (m,) of the rows of each run; [rad/s] where they are samples
    arrow: BlockArrowheadSolution | None = (
        None  # rows in units of the noise: covariances if it is of that size
    )

    @property
    def shared_values(self) -> dict[str, float]:
        """Shared values by name."""
        return dict(zip(self.problem.shared, self.shared.tolist(), strict=True))

    def values(self, run: int) -> dict[str, float]:
        """All values of one run by name: known, shared and own."""
        own = dict(zip(self.problem.runs[run].names, self.own[run].tolist(), strict=True))
        return {**self.problem.known, **self.shared_values, **own}

    @property
    def variance(self) -> float:
        """Of the rows, for as many unknowns as there are: [rad^2/s^2] where they are samples."""
        squares = sum(float(residual @ residual) for residual in self.residuals)
        for names, values in (
            (self.problem.shared, self.shared),
            *((run.names, own) for run, own in zip(self.problem.runs, self.own, strict=True)),
        ):
            off = self.problem.prior_rows(names, values)[1]
            squares += self.problem.noise**2 * float(off @ off)
        return squares / max(self.problem.degrees_of_freedom, 1)
