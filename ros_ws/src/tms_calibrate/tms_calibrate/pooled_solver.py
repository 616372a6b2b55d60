"""Pooled fits by variable projection, one residual block per run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from tms_fit.least_squares import varpro
from tms_fit.least_squares.block_arrowhead import Block
from tms_fit.least_squares.problem import WindowRows, make_unknowns, start_value
from tms_fit.least_squares.varpro import MAX_EVALUATIONS, ResidualBlock, Solution, Status, Unknowns
from tms_fit.parameters import LINEAR, NONLINEAR
from tms_fit.response.prediction import Predictor, derivative, predictor
from tms_fit.window import Window
from tms_model import Bicycle, ParameterError, with_parameters
from tms_model.bicycle import Array
from tms_model.changes import numbers_of

from tms_calibrate.pooled_problem import BICYCLE_NUMBERS, PooledProblem, PooledSolution, Run

DIFFERENCE_STEP = 1e-4  # of finite differences, relative to `size_of` a parameter


@dataclass(frozen=True, eq=False)
class Linearised:
    """Linearised prediction and residuals of a run, sample by sample."""

    own: Array  # (n, 2, q) derivatives of the prediction
    shared: Array  # (n, 2, s)
    residual: Array  # (n, 2) [rad/s], NaN: not measured


def model_of(window: Window, values: Mapping[str, float]) -> Predictor:
    """Predictor of a window for parameters of bicycle and run by name; others are those of the window."""
    return predictor(_with_numbers(window, values), _of_the_run(values))


def _with_numbers(window: Window, values: Mapping[str, float]) -> Window:
    numbers = tuple((name, value) for name, value in values.items() if name in BICYCLE_NUMBERS)
    return replace(window, bicycle=_changed(window.bicycle, numbers)) if numbers else window


def _of_the_run(values: Mapping[str, float]) -> dict[str, float]:
    """Parameters of the run; those of the bicycle are left out, else a steer damper would count twice."""
    return {
        name: value for name, value in values.items() if name in NONLINEAR and name not in BICYCLE_NUMBERS
    }


@lru_cache(maxsize=32)  # the same for all windows of a step
def _changed(bicycle: Bicycle, numbers: tuple[tuple[str, float], ...]) -> Bicycle:
    return with_parameters(bicycle, dict(numbers))


def size_of(problem: PooledProblem, name: str) -> float:
    """Scale of a parameter: its prior standard deviation, its magnitude, or 1."""
    if name in problem.priors:
        return problem.priors[name].deviation
    return abs(_start(problem.runs[0].window, name)) or 1.0


def solve_pooled(problem: PooledProblem, start: Array | None = None) -> PooledSolution:
    """Solution of a pooled problem; a prediction that fails counts as not observable.

    start: initial shared nonlinear values (k,); None: prior means, or values of the first run.
    """
    try:
        return _solution(problem, varpro.solve(*_rows(problem, start)))
    except ParameterError as error:
        return PooledSolution(problem, Status.NOT_OBSERVABLE, str(error))


def linearise(problem: PooledProblem, shared: Array) -> PooledSolution:
    """Solution for the linear unknowns at shared nonlinear values (k,)."""
    return _solution(problem, varpro.linearise(*_rows(problem, shared)))


def _rows(problem: PooledProblem, start: Array | None) -> tuple[list[ResidualBlock], Unknowns]:
    """Residual block of each run, and the shared unknowns."""
    first = problem.runs[0].window
    priors = {name: (one.value, one.deviation) for name, one in problem.priors.items()}

    def unknowns(window: Window, linear: tuple[str, ...], names: tuple[str, ...]) -> Unknowns:
        values = [priors[name][0] if name in priors else _start(window, name) for name in names]
        return make_unknowns(window, linear, names, np.array(values, dtype=float), priors)

    blocks = [
        _window_rows(problem, run).block(unknowns(run.window, run.linear, run.nonlinear))
        for run in problem.runs
    ]
    shared = unknowns(first, problem.linear, problem.nonlinear)
    return blocks, shared if start is None else replace(shared, start=start)


def _window_rows(problem: PooledProblem, run: Run) -> WindowRows:
    """Residual rows of a run, in units of the problem's noise."""
    window = run.window
    fixed = {name: value for name, value in problem.known.items() if name not in LINEAR}
    return WindowRows(
        window,
        (run.linear, run.nonlinear),
        (problem.linear, problem.nonlinear),
        problem.known,
        lambda values: run.select(values) / problem.noise,
        lambda values: model_of(window, {**fixed, **values}),
        lambda values, name, every: _slope(problem, window, {**fixed, **values}, name, every),
    )


def _start(window: Window, name: str) -> float:
    """Initial value of a nonlinear parameter."""
    if name in BICYCLE_NUMBERS:
        return numbers_of(window.bicycle).get(name, 0.0)
    return start_value(window, name)


def block_of(problem: PooledProblem, run: Run, shared: Array, own: Array) -> Block:
    """Jacobian and residuals of a run at given values, in units of the problem's noise, with its priors."""
    found = linearised_run(problem, run, shared, own)
    block = Block(
        run.select(found.own) / problem.noise,
        run.select(found.shared) / problem.noise,
        run.select(found.residual) / problem.noise,
    )
    return block.with_rows(*problem.prior_rows(run.names, own))


def linearised_run(problem: PooledProblem, run: Run, shared: Array, own: Array) -> Linearised:
    """Jacobian by own and shared unknowns at given values (q,) and (s,), and residuals of a run."""
    values = {
        **problem.known,
        **dict(zip(problem.shared, shared.tolist(), strict=True)),
        **dict(zip(run.names, own.tolist(), strict=True)),
    }
    nonlinear = {name: value for name, value in values.items() if name not in LINEAR}
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
    """Derivative (n, 2) of the predicted rates by a nonlinear parameter, [rad/s] per unit."""
    if name in NONLINEAR:
        by = derivative(_with_numbers(window, nonlinear), _of_the_run(nonlinear), name)
        return by.predict(values)
    step = DIFFERENCE_STEP * size_of(problem, name)
    ends = [
        model_of(window, {**nonlinear, name: nonlinear[name] + part * step}).predict(values)
        for part in (-1.0, 1.0)
    ]
    return (ends[1] - ends[0]) / (2.0 * step)


def _solution(problem: PooledProblem, found: Solution) -> PooledSolution:
    """Pooled solution with residuals, or with a message where the data do not determine it."""
    if found.arrow is None:
        names = dict.fromkeys((*problem.shared, *(name for run in problem.runs for name in run.names)))
        text = (
            f"the measured channels do not tell {', '.join(names)} apart; free fewer of them, or give priors"
        )
        return PooledSolution(problem, found.status, text)
    text = f"no minimum after {MAX_EVALUATIONS} steps; free fewer parameters or give priors"
    residuals = []
    for run, rows in zip(problem.runs, found.blocks, strict=True):
        priors = sum(name in problem.priors for name in run.names)  # their rows come last
        residuals.append(problem.noise * rows.target[: len(rows.target) - priors])
    return PooledSolution(
        problem=problem,
        status=found.status,
        message="" if found.status is Status.OK else text,
        shared=found.shared,
        own=found.own,
        residuals=tuple(residuals),
        arrow=found.arrow,
    )
