"""Pooled problems of several free responses with own and shared unknowns, and their solutions.

Predictions are linear in some unknowns and nonlinear in others: numbers of the bicycle, and parameters of a
run such as `speed`.
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

CONTROLLER_GAIN = "lean_rate_gain"  # of the run's controller, not the bicycle's own element
BICYCLE_NUMBERS = tuple(
    name for name in (*PARAMETER_NAMES, *STEER_ELEMENT_NAMES, *MATRIX_ENTRIES) if name != CONTROLLER_GAIN
)


@dataclass(frozen=True, eq=False)
class Run:
    """One free response and its own unknowns."""

    window: Window
    linear: tuple[str, ...]  # of LINEAR
    nonlinear: tuple[str, ...] = ()  # such as speed
    rows: Whitener | None = None  # samples (n, 2, ...) to rows (m, ...) of white noise; None: identity

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of a solution's own values."""
        return (*self.linear, *self.nonlinear)

    def select(self, values: Array) -> Array:
        """Whitened rows (m, ...) of values (n, 2, ...) at the measured samples."""
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
    noise: float = 1.0  # standard deviation of one row, against the priors; [rad/s] for samples

    @property
    def shared(self) -> tuple[str, ...]:
        """Names in the order of a solution's shared values."""
        return (*self.linear, *self.nonlinear)

    @property
    def count(self) -> int:
        """Number of scalar measurements."""
        return sum(int(np.isfinite(run.window.measured).sum()) for run in self.runs)

    @property
    def degrees_of_freedom(self) -> int:
        """Number of measurements and priors less unknowns."""
        unknowns = [name for run in self.runs for name in run.names] + list(self.shared)
        return self.count + sum(name in self.priors for name in unknowns) - len(unknowns)

    def prior_rows(self, names: tuple[str, ...], values: Array) -> tuple[Array, Array]:
        """Rows (k, p) of the priors on unknowns (p,), and their residuals (k,) at the values."""
        held = [name for name in names if name in self.priors]
        rows, off = np.zeros((len(held), len(names))), np.zeros(len(held))
        for row, name in enumerate(held):
            prior, index = self.priors[name], names.index(name)
            rows[row, index] = 1.0 / prior.deviation
            off[row] = (prior.value - values[index]) / prior.deviation
        return rows, off


@dataclass(frozen=True, eq=False)
class PooledSolution:
    """Solution of a pooled problem, without values where the status is not_observable."""

    problem: PooledProblem
    status: Status
    message: str
    shared: Array = field(default_factory=lambda: np.empty(0))  # (s,)
    own: tuple[Array, ...] = ()  # (q,) of each run: linear, then nonlinear
    residuals: tuple[Array, ...] = ()  # (m,) of the rows of each run; [rad/s] where they are samples
    arrow: BlockArrowheadSolution | None = None  # of rows in units of the noise: covariances

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
        """Residual variance of the rows by the degrees of freedom; [rad^2/s^2] where they are samples."""
        squares = sum(float(residual @ residual) for residual in self.residuals)
        for names, values in (
            (self.problem.shared, self.shared),
            *((run.names, own) for run, own in zip(self.problem.runs, self.own, strict=True)),
        ):
            off = self.problem.prior_rows(names, values)[1]
            squares += self.problem.noise**2 * float(off @ off)
        return squares / max(self.problem.degrees_of_freedom, 1)
