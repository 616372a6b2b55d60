"""Nonlinear least squares by variable projection: linear parameters are solved for inside.

For each set of nonlinear parameters the best linear ones are known at once. What remains is a small problem,
solved by Gauss-Newton steps damped after Levenberg and Marquardt; the step comes from the joint Jacobian of
all parameters, which is Kaufman's form of variable projection.

References: G. H. Golub and V. Pereyra, SIAM J. Numer. Anal. 10 (1973), doi 10.1137/0710036; L. Kaufman, BIT
15 (1975), doi 10.1007/BF01932995.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from tms_model import ParameterError
from tms_model.acceleration import coasting_loss
from tms_model.bicycle import Array

from tms_fit.parameters import FRICTION, LINEAR, shaping
from tms_fit.response.discretization import known_values
from tms_fit.response.prediction import Predictor, derivative, predictor
from tms_fit.window import Window

Rows = Callable[[Array], Array]  # values of both channels (n, 2, ...) -> rows (m, ...) of unit variance

STEPS = 50  # at most, of Gauss and Newton
SETTLED = 1e-6  # last step, in standard errors
RUBBED = 1e-2  # the same with friction, whose kinks no derivative follows
GAIN = "lean_rate_gain"
GAINS = (
    -4.0,
    -2.0,
    -1.0,
    -0.5,
    0.5,
    1.0,
    2.0,
    4.0,
    8.0,
)  # per torque that a rate of 1 rad/s makes without one
LINEAR_RANK = 1e-9  # smallest singular value of the scaled columns, per largest, that can still be told apart
RANK = 1e-6  # the same with columns that are differences


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be found in a window, and what is known."""

    window: Window
    linear: tuple[str, ...]  # of LINEAR, free
    nonlinear: tuple[str, ...] = ()  # of NONLINEAR, free
    known: Mapping[str, float] = field(default_factory=dict)  # those that are not free; else 0 or as measured
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # of free ones: mean, deviation

    @property
    def names(self) -> tuple[str, ...]:
        """All that is free, in the order of a Solution."""
        return (*self.linear, *self.nonlinear)

    @property
    def known_nonlinear(self) -> dict[str, float]:
        """What `predictor` must be told besides the free ones."""
        return shaping(self.known, self.names)

    def values(self, solution: Array) -> dict[str, float]:
        """All parameters by name, known and found."""
        return {**self.known, **dict(zip(self.names, solution.tolist(), strict=True))}

    def predicted(self, solution: Array) -> Array:
        """Both channels (n, 2) [rad/s] of a solution (p,)."""
        values = self.values(solution)
        return predictor(self.window, shaping(values)).predict(values)


@dataclass(frozen=True, eq=False)
class Solution:
    """What a solver found; empty arrays when the measurement does not tell the parameters apart."""

    status: str  # ok, not_converged, not_observable
    message: str
    values: Array = field(default_factory=lambda: np.empty(0))  # (p,) in the order of Problem.names
    jacobian: Array = field(default_factory=lambda: np.empty((0, 0)))  # (m, p) of the rows, priors last
    channels: Array = field(default_factory=lambda: np.empty((0, 2, 0)))  # (n, 2, p), the same per sample
    rows: Array = field(default_factory=lambda: np.empty(0))  # (m,) residual rows
    steps: int = 0
    covariance: Array | None = None  # (p, p), where it is not that of the rows

    @property
    def inverse(self) -> Array:
        """Covariance (p, p): what was found otherwise, else that of rows of unit variance."""
        return self.of_rows if self.covariance is None else self.covariance

    @property
    def of_rows(self) -> Array:
        """Inverse (p, p) of J'J."""
        scale = np.linalg.norm(self.jacobian, axis=0)
        scaled = self.jacobian / scale
        inverse: Array = np.linalg.inv(scaled.T @ scaled) / np.outer(scale, scale)
        return inverse


@dataclass(frozen=True, eq=False)
class _Point:
    """The problem at one set of nonlinear values, linear ones solved for."""

    nonlinear: Array  # (q,)
    linear: Array  # (p,)
    model: Predictor
    rows: Array  # (m,) residual rows, those of the priors on linear ones included
    cost: float


def solve(problem: Problem, rows: Rows, start: Array | None = None) -> Solution:
    """Solve a problem whose samples `rows` turns into rows of unit variance.

    start: nonlinear values (q,) to begin with; None: the priors' means, or what the window knows.
    """
    try:
        point = _at(problem, rows, _first(problem, rows) if start is None else start)
        if point is None:
            return _unobservable(problem)
        return _descend(problem, rows, point)
    except ParameterError as error:
        return Solution("not_observable", str(error))


def _descend(problem: Problem, rows: Rows, point: _Point) -> Solution:
    damping, step_count, settled = 0.0, 0, not problem.nonlinear
    channels, jacobian, residual = _jacobian(problem, rows, point)
    while not settled and step_count < STEPS:
        step = _step(problem, point, jacobian, residual, damping)
        if step is None:
            return _unobservable(problem)
        change, small = step
        trial = _try(problem, rows, _bounded(problem, point.nonlinear + change))
        step_count += 1
        if trial is not None and trial.cost <= point.cost * (1.0 + 1e-12) + 1e-300:
            point, damping = trial, damping / 10.0 if damping > 1e-6 else 0.0
            channels, jacobian, residual = _jacobian(problem, rows, point)
            settled = small
        elif small:
            settled = True  # rounding: nothing better is within reach
        else:
            damping = max(10.0 * damping, 1e-3)
    if not full_rank(jacobian, RANK if problem.nonlinear else LINEAR_RANK):
        return _unobservable(problem)
    values = np.concatenate([point.linear, point.nonlinear])
    status = "ok" if settled else "not_converged"
    message = "" if settled else f"no minimum after {STEPS} steps; free fewer parameters or give a prior"
    return Solution(status, message, values, jacobian, channels, residual, step_count)


def _step(
    problem: Problem, point: _Point, jacobian: Array, residual: Array, damping: float
) -> tuple[Array, bool] | None:
    """Change of the nonlinear values (q,), and whether it is small; None if nothing tells them apart."""
    count = len(problem.linear)
    scale = np.linalg.norm(jacobian, axis=0)
    if not scale.all():
        return None
    low, high = _bounds(problem)
    free = np.ones(len(scale), dtype=bool)
    for _ in range(len(problem.nonlinear) + 1):
        scaled = jacobian[:, free] / scale[free]
        damped = np.concatenate([scaled, math.sqrt(damping) * np.eye(scaled.shape[1])]) if damping else scaled
        target = np.concatenate([residual, np.zeros(scaled.shape[1])]) if damping else residual
        found, _, rank, singular = np.linalg.lstsq(damped, target, rcond=None)
        if rank < scaled.shape[1] or singular[-1] < RANK * singular[0]:
            return None
        change = np.zeros(len(scale))
        change[free] = found / scale[free]
        # At a bound and pulled beyond it: what is left is solved without that one.
        wanted = point.nonlinear + change[count:]
        stuck = ((point.nonlinear <= low) & (wanted < low)) | ((point.nonlinear >= high) & (wanted > high))
        stuck &= free[count:]
        if not stuck.any():
            break
        free[count:] &= ~stuck
    spread = math.sqrt(float(residual @ residual) / max(len(residual) - len(scale), 1))
    settled = RUBBED if FRICTION in {*problem.names, *problem.known} else SETTLED
    small = np.abs(change[count:]) <= settled * spread / scale[count:] + 1e-11 * (
        1.0 + np.abs(point.nonlinear)
    )
    return change[count:], bool(small.all())


def _first(problem: Problem, rows: Rows) -> Array:
    """Where to begin: with friction, from what is found without it, which is linear in the initial state."""
    first = starting_values(problem)
    if FRICTION not in {*problem.names, *problem.known}:
        return _among_gains(problem, rows, first)
    names = [name for name in problem.names if name != FRICTION]
    smooth = replace(
        problem,
        linear=tuple(name for name in names if name in LINEAR),
        nonlinear=tuple(name for name in names if name not in LINEAR),
        known={name: value for name, value in problem.known.items() if name != FRICTION},
        priors={name: prior for name, prior in problem.priors.items() if name != FRICTION},
    )
    found = solve(smooth, rows)
    if found.status == "not_observable":
        return first
    values = dict(zip(smooth.names, found.values.tolist(), strict=True))
    return np.array([values.get(name, one) for name, one in zip(problem.nonlinear, first, strict=True)])


def _among_gains(problem: Problem, rows: Rows, first: Array) -> Array:
    """The start (q,), with the feedback gain that explains the most, of some that a controller may have.

    Too small a gain leaves a bicycle that falls. Its best response is nearly none, whatever the gain, so that
    no slope leads from there to the right one.
    """
    if GAIN not in problem.nonlinear or GAIN in problem.priors:
        return first
    bicycle, index = problem.window.bicycle, problem.nonlinear.index(GAIN)
    size = problem.window.start_speed * float(
        np.abs(bicycle.damping[1]).max()
    )  # of the steering's own torques
    rivals = [first]
    for share in GAINS if np.isfinite(size) else ():
        rival = first.copy()
        rival[index] += share * size / (bicycle.steer_elements.steer_torque_gain or 1.0)
        rivals.append(rival)
    costs = [math.inf if (point := _try(problem, rows, one)) is None else point.cost for one in rivals]
    return rivals[int(np.argmin(costs))]


def starting_values(problem: Problem) -> Array:
    """Where to begin with the nonlinear parameters."""
    window = problem.window
    known = known_values(window)
    if not window.speed.constant and "rolling_resistance" in problem.nonlinear:
        known["rolling_resistance"] = -float(window.speed.coefficients[1]) / coasting_loss(window.bicycle)
    if "strike_time" in problem.nonlinear and not window.delay:
        known["strike_time"] = -0.5 * window.longest_delay
    first = [
        problem.priors[name][0] if name in problem.priors else known.get(name, 0.0)
        for name in problem.nonlinear
    ]
    return _bounded(problem, np.array(first, dtype=float))


def _bounds(problem: Problem) -> tuple[Array, Array]:
    bounds = {
        "strike_time": (-problem.window.longest_delay, 0.0),
        "speed": (0.05, np.inf),
        FRICTION: (0.0, np.inf),
    }
    pairs = np.array([bounds.get(name, (-np.inf, np.inf)) for name in problem.nonlinear]).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _bounded(problem: Problem, nonlinear: Array) -> Array:
    clipped: Array = np.clip(nonlinear, *_bounds(problem))
    return clipped


def _try(problem: Problem, rows: Rows, nonlinear: Array) -> _Point | None:
    try:
        return _at(problem, rows, nonlinear)
    except ParameterError:  # as a speed that ends before the window does
        return None


def _at(problem: Problem, rows: Rows, nonlinear: Array) -> _Point | None:
    values = dict(zip(problem.nonlinear, nonlinear.tolist(), strict=True))
    model = predictor(problem.window, {**problem.known_nonlinear, **values})
    matrix = rows(model.select(problem.linear))
    target = rows(problem.window.measured - model.predict(problem.known))
    extra, wanted = _prior_rows(problem.linear, problem.priors)
    if len(wanted):
        matrix, target = np.concatenate([matrix, extra]), np.concatenate([target, wanted])
    linear = _best(matrix, target)
    if linear is None:
        return None
    residual = target - matrix @ linear
    offs = [
        (value - problem.priors[name][0]) / problem.priors[name][1]
        for name, value in values.items()
        if name in problem.priors
    ]
    cost = float(residual @ residual) + sum(off**2 for off in offs)
    return _Point(nonlinear, linear, model, residual, cost)


def _best(matrix: Array, target: Array) -> Array | None:
    """Least squares; None when the columns are not independent."""
    if not matrix.shape[1]:
        return np.empty(0)
    scale = np.linalg.norm(matrix, axis=0)
    if not (scale.all() and np.isfinite(scale).all()):
        return None
    values, _, rank, _ = np.linalg.lstsq(matrix / scale, target, rcond=LINEAR_RANK)
    return values / scale if rank == matrix.shape[1] else None


def _jacobian(problem: Problem, rows: Rows, point: _Point) -> tuple[Array, Array, Array]:
    """Derivatives of the prediction (n, 2, p), as rows (m, p) with those of the priors, and residual rows."""
    values = dict(zip(problem.nonlinear, point.nonlinear.tolist(), strict=True))
    nonlinear = {**problem.known_nonlinear, **values}
    linear = {**problem.known, **dict(zip(problem.linear, point.linear.tolist(), strict=True))}
    slopes = [
        derivative(problem.window, nonlinear, name).predict(linear)[:, :, None] for name in problem.nonlinear
    ]
    channels = np.concatenate([point.model.select(problem.linear), *slopes], axis=2)
    extra, wanted = _prior_rows(problem.nonlinear, problem.priors)
    jacobian = np.zeros((len(point.rows) + len(wanted), len(problem.names)))
    measured = rows(channels)
    jacobian[: len(measured)] = measured
    on_linear, _ = _prior_rows(problem.linear, problem.priors)
    jacobian[len(measured) : len(point.rows), : len(problem.linear)] = on_linear
    jacobian[len(point.rows) :, len(problem.linear) :] = extra
    residual = np.concatenate([point.rows, wanted - extra @ point.nonlinear])
    return channels, jacobian, residual


def _prior_rows(names: tuple[str, ...], priors: Mapping[str, tuple[float, float]]) -> tuple[Array, Array]:
    """One further row per prior (m, p), and what it should give (m,): a measurement like any other."""
    held = [(names.index(name), *priors[name]) for name in names if name in priors]
    matrix, target = np.zeros((len(held), len(names))), np.zeros(len(held))
    for row, (column, mean, std) in enumerate(held):
        matrix[row, column], target[row] = 1.0 / std, mean / std
    return matrix, target


def full_rank(jacobian: Array, least: float) -> bool:
    """Whether the columns (m, p) are independent: no singular value up to `least` of the largest."""
    scale = np.linalg.norm(jacobian, axis=0)
    if not (scale.all() and np.isfinite(scale).all()):
        return False
    singular = np.linalg.svd(jacobian / scale, compute_uv=False)
    return bool(singular[-1] > least * singular[0])


def _unobservable(problem: Problem) -> Solution:
    return Solution(
        "not_observable",
        f"the measured channels do not tell {', '.join(problem.names)} apart; free fewer of them",
    )
