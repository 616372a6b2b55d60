"""Several free responses in one fit: unknowns of each run, and unknowns that all runs share.

Each Gauss-Newton step solves for all unknowns at once; the linear ones are then solved for anew at the values
that it reaches (variable projection, as in a fit of one run).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from tms_fit.least_squares.block_arrowhead import Block, BlockArrowheadSolution, solve_block_arrowhead
from tms_fit.parameters import LINEAR, NONLINEAR
from tms_fit.response.discretization import known_values
from tms_fit.response.prediction import Predictor, derivative, predictor
from tms_fit.window import Window
from tms_model import Bicycle, ParameterError, with_parameters
from tms_model.acceleration import coasting_loss
from tms_model.bicycle import Array
from tms_model.changes import numbers_of

from tms_calibrate.pooled_problem import BICYCLE_NUMBERS, PooledProblem, PooledSolution, Run

STEP = 1e-4  # of the differences, in sizes of a parameter
STEPS = 40  # at most, of Gauss and Newton
HALVINGS = 12  # at most, of one step
SETTLED = 1e-4  # last step, in standard errors


@dataclass(frozen=True, eq=False)
class _Point:
    """The problem at one set of nonlinear values, linear ones solved for."""

    shared: Array  # (k,) nonlinear
    own: tuple[Array, ...]  # nonlinear of each run
    found: BlockArrowheadSolution
    cost: float


@dataclass(frozen=True, eq=False)
class Linearised:
    """A run around some values: what each sample says of each unknown, and what is left of it."""

    own: Array  # (n, 2, q) derivatives of the prediction
    shared: Array  # (n, 2, s)
    residual: Array  # (n, 2) [rad/s], NaN: not measured


def model_of(window: Window, values: Mapping[str, float]) -> Predictor:
    """Predictor of a window for numbers of the bicycle and the run by name; others as the window says."""
    return predictor(_with_numbers(window, values), _of_the_run(values))


def _with_numbers(window: Window, values: Mapping[str, float]) -> Window:
    numbers = tuple((name, value) for name, value in values.items() if name in BICYCLE_NUMBERS)
    return replace(window, bicycle=_changed(window.bicycle, numbers)) if numbers else window


def _of_the_run(values: Mapping[str, float]) -> dict[str, float]:
    """Those that aren't the bicycle's: a steer damper would count twice."""
    return {
        name: value for name, value in values.items() if name in NONLINEAR and name not in BICYCLE_NUMBERS
    }


@lru_cache(maxsize=32)  # the same for all windows of a step
def _changed(bicycle: Bicycle, numbers: tuple[tuple[str, float], ...]) -> Bicycle:
    return with_parameters(bicycle, dict(numbers))


def size_of(problem: PooledProblem, name: str) -> float:
    """What counts as a large change of a parameter: its prior's standard deviation, its value, or 1."""
    if name in problem.priors:
        return problem.priors[name].deviation
    return abs(_start(problem.runs[0].window, name)) or 1.0


def solve_pooled(problem: PooledProblem, start: Array | None = None) -> PooledSolution:
    """Solve; start: shared nonlinear values (k,) to begin with, else the priors' means or what is known."""
    first = np.array(_firsts(problem, problem.runs[0], problem.nonlinear))
    own = tuple(np.array(_firsts(problem, run, run.nonlinear)) for run in problem.runs)
    try:
        point = _at(problem, first if start is None else start, own)
        return _descend(problem, point) if point else _unobservable(problem)
    except ParameterError as error:
        return PooledSolution(problem, "not_observable", str(error))


def linearise(problem: PooledProblem, shared: Array) -> PooledSolution:
    """The problem around shared nonlinear values (k,), linear ones solved for: what its data could tell."""
    own = tuple(np.array(_firsts(problem, run, run.nonlinear)) for run in problem.runs)
    point = _at(problem, shared, own)
    full = _linearised(problem, point) if point else None
    return _solution(problem, point, full, "ok") if point and full else _unobservable(problem)


def _firsts(problem: PooledProblem, run: Run, names: tuple[str, ...]) -> list[float]:
    """Where to begin: the priors' means, or what is known of a run."""
    priors = problem.priors
    low, high = _bounds(run, names)
    first = [priors[name].value if name in priors else _start(run.window, name) for name in names]
    clipped: list[float] = np.clip(np.array(first, dtype=float), low, high).tolist()
    return clipped


def _start(window: Window, name: str) -> float:
    """Value of a parameter before anything is fitted."""
    if name == "rolling_resistance" and not window.speed.constant:
        return -float(window.speed.coefficients[1]) / coasting_loss(window.bicycle)
    if name == "strike_time" and not window.delay:
        return -0.5 * window.longest_delay
    if name in NONLINEAR and name not in BICYCLE_NUMBERS:
        return known_values(window).get(name, 0.0)
    return numbers_of(window.bicycle).get(name, 0.0)


def _bounds(run: Run, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Least and largest values (p,) of nonlinear unknowns."""
    pairs = np.array(
        [(-run.window.longest_delay, 0.0) if name == "strike_time" else (-np.inf, np.inf) for name in names]
    ).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _descend(problem: PooledProblem, point: _Point) -> PooledSolution:
    nonlinear = bool(problem.nonlinear) or any(run.nonlinear for run in problem.runs)
    for _ in range(STEPS):
        full = _linearised(problem, point)
        if full is None:
            return _unobservable(problem)
        step = _within_bounds(problem, point, full)
        if not nonlinear or _small(problem, step, full):
            return _solution(problem, point, full, "ok")
        following = _better(problem, point, step)
        if following is None:  # rounding: nothing better is within reach
            return _solution(problem, point, full, "ok")
        point = following
    full = _linearised(problem, point)
    return _solution(problem, point, full, "not_converged") if full else _unobservable(problem)


def _within_bounds(
    problem: PooledProblem, point: _Point, full: BlockArrowheadSolution
) -> BlockArrowheadSolution:
    """The step with those of the runs' unknowns held that stand at a bound and are pulled beyond it."""
    held = []
    for run, values, step in zip(problem.runs, point.own, full.own, strict=True):
        low, high = _bounds(run, run.nonlinear)
        wanted = values + step[len(run.linear) :]
        stuck = ((values <= low) & (wanted < low)) | ((values >= high) & (wanted > high))
        held.append(np.concatenate([np.zeros(len(run.linear), dtype=bool), stuck]))
    if not any(one.any() for one in held):
        return full
    found = _linearised(problem, point, held)
    if found is None:
        return full
    own = []
    for one, step in zip(held, found.own, strict=True):
        whole = np.zeros(len(one))
        whole[~one] = step
        own.append(whole)
    return replace(full, own=tuple(own), shared=found.shared)


def _better(problem: PooledProblem, point: _Point, step: BlockArrowheadSolution) -> _Point | None:
    """The point that the step leads to, or a part of the step where the whole leads uphill or nowhere."""
    count, part = len(problem.linear), 1.0
    for _ in range(HALVINGS):
        shared = point.shared + part * step.shared[count:]
        own = tuple(
            np.clip(values + part * change[len(run.linear) :], *_bounds(run, run.nonlinear))
            for values, change, run in zip(point.own, step.own, problem.runs, strict=True)
        )
        try:
            trial = _at(problem, shared, own)
        except ParameterError:  # numbers that no bicycle has
            trial = None
        if trial is not None and trial.cost < point.cost:
            return trial
        part /= 2.0
    return None


def _small(problem: PooledProblem, step: BlockArrowheadSolution, full: BlockArrowheadSolution) -> bool:
    count = len(problem.linear)
    steps = [(step.shared[count:], np.diag(full.shared_inverse)[count:])]
    for run, change, inverse in zip(problem.runs, step.own, full.own_inverse, strict=True):
        steps.append((change[len(run.linear) :], np.diag(inverse)[len(run.linear) :]))
    return all(bool((np.abs(one) <= SETTLED * np.sqrt(variance)).all()) for one, variance in steps)


def _at(problem: PooledProblem, shared: Array, own: tuple[Array, ...]) -> _Point | None:
    """Best linear values at given nonlinear ones; None if nothing tells them apart."""
    blocks = []
    for run, values in zip(problem.runs, own, strict=True):
        model = model_of(run.window, _nonlinear(problem, run, shared, values))
        block = Block(
            run.select(model.select(run.linear)) / problem.noise,
            run.select(model.select(problem.linear)) / problem.noise,
            run.select(run.window.measured - model.predict(problem.known)) / problem.noise,
        )
        blocks.append(_with_priors(problem, run.linear, block, np.zeros(len(run.linear))))
    rows, wanted = problem.prior_rows(problem.linear, np.zeros(len(problem.linear)))
    found = solve_block_arrowhead(blocks, rows, wanted)
    if found is None:
        return None
    cost = sum(float(residual @ residual) for residual in found.residuals)
    off = [wanted - rows @ found.shared, problem.prior_rows(problem.nonlinear, shared)[1]]
    off += [problem.prior_rows(run.nonlinear, one)[1] for run, one in zip(problem.runs, own, strict=True)]
    return _Point(shared, own, found, cost + sum(float(one @ one) for one in off))


def _with_priors(problem: PooledProblem, names: tuple[str, ...], block: Block, values: Array) -> Block:
    """A run's rows, and one more for each prior of its own unknowns."""
    rows, off = problem.prior_rows(names, values)
    if not len(off):
        return block
    return Block(
        np.concatenate([block.own, rows]),
        np.concatenate([block.shared, np.zeros((len(off), block.shared.shape[1]))]),
        np.concatenate([block.target, off]),
    )


def _nonlinear(problem: PooledProblem, run: Run, shared: Array, own: Array) -> dict[str, float]:
    return {
        **{name: value for name, value in problem.known.items() if name not in LINEAR},
        **dict(zip(problem.nonlinear, shared.tolist(), strict=True)),
        **dict(zip(run.nonlinear, own.tolist(), strict=True)),
    }


def _linearised(
    problem: PooledProblem, point: _Point, held: list[NDArray[np.bool_]] | None = None
) -> BlockArrowheadSolution | None:
    """The linear problem around a point: its solution is the step, its inverses are the covariances.

    held: (q,) of each run, which of its unknowns stay; they are left out of the step.
    """
    shared = np.concatenate([point.found.shared, point.shared])
    blocks = [
        block_of(problem, run, shared, np.concatenate([linear, nonlinear]))
        for run, linear, nonlinear in zip(problem.runs, point.found.own, point.own, strict=True)
    ]
    if held is not None:
        blocks = [replace(block, own=block.own[:, ~one]) for block, one in zip(blocks, held, strict=True)]
    return solve_block_arrowhead(blocks, *problem.prior_rows(problem.shared, shared))


def block_of(problem: PooledProblem, run: Run, shared: Array, own: Array) -> Block:
    """A run's derivatives and residuals at given values, in units of the problem's noise, and its priors."""
    found = linearised_run(problem, run, shared, own)
    block = Block(
        run.select(found.own) / problem.noise,
        run.select(found.shared) / problem.noise,
        run.select(found.residual) / problem.noise,
    )
    return _with_priors(problem, run.names, block, own)


def linearised_run(problem: PooledProblem, run: Run, shared: Array, own: Array) -> Linearised:
    """Derivatives by a run's own unknowns and by shared ones at given values (q,) and (s,), and residuals."""
    nonlinear = _nonlinear(problem, run, shared[len(problem.linear) :], own[len(run.linear) :])
    values = {
        **problem.known,
        **dict(zip(problem.shared, shared.tolist(), strict=True)),
        **dict(zip(run.names, own.tolist(), strict=True)),
    }
    model = model_of(run.window, nonlinear)

    def columns(linear: tuple[str, ...], names: tuple[str, ...]) -> Array:
        slopes = [_slope(problem, run.window, nonlinear, name, values)[:, :, None] for name in names]
        return np.concatenate([model.select(linear), *slopes], axis=2)

    return Linearised(
        columns(run.linear, run.nonlinear),
        columns(problem.linear, problem.nonlinear),
        run.window.measured - model.predict(values),
    )


def _slope(
    problem: PooledProblem,
    window: Window,
    nonlinear: Mapping[str, float],
    name: str,
    values: Mapping[str, float],
) -> Array:
    """Change (n, 2) of the prediction per unit of a nonlinear parameter."""
    if name in NONLINEAR:
        by = derivative(_with_numbers(window, nonlinear), _of_the_run(nonlinear), name)
        return by.predict(values)
    step = STEP * size_of(problem, name)
    ends = [
        model_of(window, {**nonlinear, name: nonlinear[name] + part * step}).predict(values)
        for part in (-1.0, 1.0)
    ]
    return (ends[1] - ends[0]) / (2.0 * step)


def _solution(
    problem: PooledProblem, point: _Point, full: BlockArrowheadSolution, status: str
) -> PooledSolution:
    message = (
        "" if status == "ok" else f"no minimum after {STEPS} steps; free fewer parameters or give priors"
    )
    residuals = []
    for run, rows in zip(problem.runs, point.found.residuals, strict=True):
        held = sum(name in problem.priors for name in run.linear)  # rows of priors, which come last
        residuals.append(problem.noise * rows[: len(rows) - held])
    return PooledSolution(
        problem=problem,
        status=status,
        message=message,
        shared=np.concatenate([point.found.shared, point.shared]),
        own=tuple(np.concatenate(pair) for pair in zip(point.found.own, point.own, strict=True)),
        residuals=tuple(residuals),
        arrow=full,
    )


def _unobservable(problem: PooledProblem) -> PooledSolution:
    names = dict.fromkeys(
        (*problem.shared, *(n for run in problem.runs for n in (*run.linear, *run.nonlinear)))
    )
    return PooledSolution(
        problem,
        "not_observable",
        f"the measured channels do not tell {', '.join(names)} apart; free fewer of them, or give priors",
    )
