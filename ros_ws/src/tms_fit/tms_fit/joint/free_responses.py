"""Several free responses in one fit: unknowns of each run, and unknowns that all runs share.

Shared may be what a prediction is linear in (a bias), and what shapes it: numbers of the bicycle and
parameters of a run such as `speed`. Each Gauss-Newton step solves for all unknowns at once; the linear ones
are then solved for anew at the values that it reaches (variable projection, as in a fit of one run).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from tms_model import Bicycle, ParameterError, with_parameters
from tms_model.acceleration import coasting_loss
from tms_model.bicycle import Array
from tms_model.changes import MATRIX_ENTRIES, numbers_of
from tms_model.measured import Measured
from tms_model.parameters import PARAMETER_NAMES
from tms_model.steer_elements import STEER_ELEMENT_NAMES

from tms_fit.joint.arrow import ArrowSolution, Block, solve_arrow
from tms_fit.least_squares.motion import known_values
from tms_fit.least_squares.prediction import Predictor, predictor
from tms_fit.settings import LINEAR, NONLINEAR
from tms_fit.window import Window

CONTROLLED = "lean_rate_gain"  # the run's controller, as in a fit of one run; not the bicycle's own element
BICYCLE_NUMBERS = tuple(
    name for name in (*PARAMETER_NAMES, *STEER_ELEMENT_NAMES, *MATRIX_ENTRIES) if name != CONTROLLED
)
STEP = 1e-4  # of the differences, in sizes of a parameter
STEPS = 40  # at most, of Gauss and Newton
HALVINGS = 12  # at most, of one step
SETTLED = 1e-4  # last step, in standard errors


@dataclass(frozen=True, eq=False)
class Run:
    """One free response and the unknowns that are its own."""

    window: Window
    linear: tuple[str, ...]  # of LINEAR
    nonlinear: tuple[str, ...] = ()  # such as speed


@dataclass(frozen=True, eq=False)
class JointProblem:
    """What is to be found from several runs, and what is known."""

    runs: tuple[Run, ...]
    linear: tuple[str, ...] = ()  # shared, of LINEAR
    nonlinear: tuple[str, ...] = ()  # shared, of BICYCLE_NUMBERS or a run's
    known: Mapping[str, float] = field(default_factory=dict)
    priors: Mapping[str, Measured] = field(default_factory=dict)  # of shared nonlinear ones
    noise: float = 1.0  # [rad/s], standard deviation that one measurement stands for, against the priors

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
        own = sum(len(run.linear) + len(run.nonlinear) for run in self.runs)
        return self.count + len(self.priors) - own - len(self.shared)


@dataclass(frozen=True, eq=False)
class JointSolution:
    """What was found. Values are empty when the status is not_observable."""

    problem: JointProblem
    status: str  # ok, not_converged, not_observable
    message: str
    shared: Array = field(default_factory=lambda: np.empty(0))  # (s,)
    own: tuple[Array, ...] = ()  # (q,) of each run: linear, then nonlinear
    residuals: tuple[Array, ...] = ()  # (m,) [rad/s] of each run, measured channels only
    arrow: ArrowSolution | None = None  # rows in units of the noise: covariances if it is of that size

    @property
    def shared_values(self) -> dict[str, float]:
        """Shared values by name."""
        return dict(zip(self.problem.shared, self.shared.tolist(), strict=True))

    def values(self, run: int) -> dict[str, float]:
        """All values of one run by name: known, shared and own."""
        one = self.problem.runs[run]
        own = dict(zip((*one.linear, *one.nonlinear), self.own[run].tolist(), strict=True))
        return {**self.problem.known, **self.shared_values, **own}

    @property
    def variance(self) -> float:
        """Of the residuals [rad^2/s^2], for as many unknowns as there are."""
        squares = sum(float(residual @ residual) for residual in self.residuals)
        for name, prior in self.problem.priors.items():
            off = (self.shared_values[name] - prior.value) / prior.deviation
            squares += (self.problem.noise * off) ** 2
        return squares / max(self.problem.degrees_of_freedom, 1)


@dataclass(frozen=True, eq=False)
class _Point:
    """The problem at one set of nonlinear values, linear ones solved for."""

    shared: Array  # (k,) nonlinear
    own: tuple[Array, ...]  # nonlinear of each run
    found: ArrowSolution
    cost: float


def model_of(window: Window, values: Mapping[str, float]) -> Predictor:
    """Predictor of a window for numbers of the bicycle and the run by name; others as the window says."""
    numbers = tuple((name, value) for name, value in values.items() if name in BICYCLE_NUMBERS)
    bicycle = _changed(window.bicycle, numbers) if numbers else window.bicycle
    of_the_run = {name: value for name, value in values.items() if name in NONLINEAR}
    return predictor(replace(window, bicycle=bicycle), of_the_run)


@lru_cache(maxsize=32)  # the same for all windows of a step
def _changed(bicycle: Bicycle, numbers: tuple[tuple[str, float], ...]) -> Bicycle:
    return with_parameters(bicycle, dict(numbers))


def size_of(problem: JointProblem, name: str) -> float:
    """What counts as a large change of a parameter: its prior's standard deviation, its value, or 1."""
    if name in problem.priors:
        return problem.priors[name].deviation
    return abs(_start(problem.runs[0].window, name)) or 1.0


def solve_jointly(problem: JointProblem, start: Array | None = None) -> JointSolution:
    """Solve; start: shared nonlinear values (k,) to begin with, else the priors' means or what is known."""
    first = [_first(problem, name) for name in problem.nonlinear]
    own = tuple(
        np.array([_start(run.window, name) for name in run.nonlinear], dtype=float) for run in problem.runs
    )
    try:
        point = _at(problem, np.array(first, dtype=float) if start is None else start, own)
        return _descend(problem, point) if point else _unobservable(problem)
    except ParameterError as error:
        return JointSolution(problem, "not_observable", str(error))


def linearise(problem: JointProblem, shared: Array) -> JointSolution:
    """The problem around shared nonlinear values (k,), linear ones solved for: what its data could tell."""
    own = tuple(
        np.array([_start(run.window, name) for name in run.nonlinear], dtype=float) for run in problem.runs
    )
    point = _at(problem, shared, own)
    full = _linearised(problem, point) if point else None
    return _solution(problem, point, full, "ok") if point and full else _unobservable(problem)


def _first(problem: JointProblem, name: str) -> float:
    prior = problem.priors.get(name)
    return prior.value if prior else _start(problem.runs[0].window, name)


def _start(window: Window, name: str) -> float:
    """Value of a parameter before anything is fitted."""
    if name == "rolling_resistance" and not window.speed.constant:
        return -float(window.speed.coefficients[1]) / coasting_loss(window.bicycle)
    if name in NONLINEAR:
        return known_values(window).get(name, 0.0)
    return numbers_of(window.bicycle).get(name, 0.0)


def _descend(problem: JointProblem, point: _Point) -> JointSolution:
    nonlinear = bool(problem.nonlinear) or any(run.nonlinear for run in problem.runs)
    for _ in range(STEPS):
        full = _linearised(problem, point)
        if full is None:
            return _unobservable(problem)
        if not nonlinear or _small(problem, full):
            return _solution(problem, point, full, "ok")
        following = _better(problem, point, full)
        if following is None:  # rounding: nothing better is within reach
            return _solution(problem, point, full, "ok")
        point = following
    full = _linearised(problem, point)
    return _solution(problem, point, full, "not_converged") if full else _unobservable(problem)


def _better(problem: JointProblem, point: _Point, full: ArrowSolution) -> _Point | None:
    """The point that the step leads to, or a part of the step where the whole leads uphill or nowhere."""
    count, part = len(problem.linear), 1.0
    for _ in range(HALVINGS):
        shared = point.shared + part * full.shared[count:]
        own = tuple(
            values + part * step[len(run.linear) :]
            for values, step, run in zip(point.own, full.own, problem.runs, strict=True)
        )
        try:
            trial = _at(problem, shared, own)
        except ParameterError:  # numbers that no bicycle has
            trial = None
        if trial is not None and trial.cost < point.cost:
            return trial
        part /= 2.0
    return None


def _small(problem: JointProblem, full: ArrowSolution) -> bool:
    count = len(problem.linear)
    steps = [(full.shared[count:], np.diag(full.shared_inverse)[count:])]
    for run, step, inverse in zip(problem.runs, full.own, full.own_inverse, strict=True):
        steps.append((step[len(run.linear) :], np.diag(inverse)[len(run.linear) :]))
    return all(bool((np.abs(step) <= SETTLED * np.sqrt(variance)).all()) for step, variance in steps)


def _at(problem: JointProblem, shared: Array, own: tuple[Array, ...]) -> _Point | None:
    """Best linear values at given nonlinear ones; None if nothing tells them apart."""
    blocks = []
    for run, values in zip(problem.runs, own, strict=True):
        model = model_of(run.window, _nonlinear(problem, run, shared, values))
        good = np.isfinite(run.window.measured)
        blocks.append(
            Block(
                model.select(run.linear)[good] / problem.noise,
                model.select(problem.linear)[good] / problem.noise,
                (run.window.measured - model.predict(problem.known))[good] / problem.noise,
            )
        )
    found = solve_arrow(blocks, np.empty((0, len(problem.linear))), np.empty(0))
    if found is None:
        return None
    cost = sum(float(residual @ residual) for residual in found.residuals)
    cost += float(np.sum(_prior_rows(problem, shared)[1] ** 2))
    return _Point(shared, own, found, cost)


def _nonlinear(problem: JointProblem, run: Run, shared: Array, own: Array) -> dict[str, float]:
    return {
        **{name: value for name, value in problem.known.items() if name not in LINEAR},
        **dict(zip(problem.nonlinear, shared.tolist(), strict=True)),
        **dict(zip(run.nonlinear, own.tolist(), strict=True)),
    }


def _prior_rows(problem: JointProblem, shared: Array) -> tuple[Array, Array]:
    """Rows (k, s) of the priors and how far (k,) the nonlinear values are from them."""
    held = [name for name in problem.nonlinear if name in problem.priors]
    rows, off = np.zeros((len(held), len(problem.shared))), np.zeros(len(held))
    for row, name in enumerate(held):
        prior, index = problem.priors[name], problem.nonlinear.index(name)
        rows[row, len(problem.linear) + index] = 1.0 / prior.deviation
        off[row] = (prior.value - shared[index]) / prior.deviation
    return rows, off


def _linearised(problem: JointProblem, point: _Point) -> ArrowSolution | None:
    """The linear problem around a point: its solution is the step, its inverses are the covariances."""
    shared = np.concatenate([point.found.shared, point.shared])
    blocks = [
        block_of(problem, run, shared, np.concatenate([linear, nonlinear]))
        for run, linear, nonlinear in zip(problem.runs, point.found.own, point.own, strict=True)
    ]
    return solve_arrow(blocks, *_prior_rows(problem, point.shared))


def block_of(problem: JointProblem, run: Run, shared: Array, own: Array) -> Block:
    """A run's derivatives and residuals at given values, in units of the problem's noise."""
    count = len(problem.linear)
    nonlinear = _nonlinear(problem, run, shared[count:], own[len(run.linear) :])
    values = {
        **problem.known,
        **dict(zip(problem.linear, shared[:count].tolist(), strict=True)),
        **dict(zip(run.linear, own[: len(run.linear)].tolist(), strict=True)),
    }
    good = np.isfinite(run.window.measured)
    model = model_of(run.window, nonlinear)

    def columns(linear: tuple[str, ...], names: tuple[str, ...]) -> Array:
        slopes = [_slope(problem, run.window, nonlinear, name, values)[:, :, None] for name in names]
        return np.concatenate([model.select(linear), *slopes], axis=2)[good] / problem.noise

    return Block(
        columns(run.linear, run.nonlinear),
        columns(problem.linear, problem.nonlinear),
        (run.window.measured - model.predict(values))[good] / problem.noise,
    )


def _slope(
    problem: JointProblem,
    window: Window,
    nonlinear: Mapping[str, float],
    name: str,
    values: Mapping[str, float],
) -> Array:
    """Change (n, 2) of the prediction per unit of a nonlinear parameter."""
    step = STEP * size_of(problem, name)
    ends = [
        model_of(window, {**nonlinear, name: nonlinear[name] + part * step}).predict(values)
        for part in (-1.0, 1.0)
    ]
    return (ends[1] - ends[0]) / (2.0 * step)


def _solution(problem: JointProblem, point: _Point, full: ArrowSolution, status: str) -> JointSolution:
    message = (
        "" if status == "ok" else f"no minimum after {STEPS} steps; free fewer parameters or give priors"
    )
    return JointSolution(
        problem=problem,
        status=status,
        message=message,
        shared=np.concatenate([point.found.shared, point.shared]),
        own=tuple(np.concatenate(pair) for pair in zip(point.found.own, point.own, strict=True)),
        residuals=tuple(problem.noise * residual for residual in point.found.residuals),
        arrow=full,
    )


def _unobservable(problem: JointProblem) -> JointSolution:
    names = dict.fromkeys(
        (*problem.shared, *(n for run in problem.runs for n in (*run.linear, *run.nonlinear)))
    )
    return JointSolution(
        problem,
        "not_observable",
        f"the measured channels do not tell {', '.join(names)} apart; free fewer of them, or give priors",
    )
