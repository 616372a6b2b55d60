"""Separable least-squares problem of one window: unknowns, start values, bounds and residual rows.

The prediction is linear in the initial state and the biases, and nonlinear in speed, rolling resistance,
strike time, feedback gain and the other parameters of NONLINEAR (`tms_fit.parameters`).
`tms_fit.least_squares.varpro` solves it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from tms_model import ParameterError
from tms_model.acceleration import coasting_loss
from tms_model.bicycle import Array

from tms_fit.least_squares import varpro
from tms_fit.least_squares.block_arrowhead import SMALLEST_SINGULAR_VALUE, Block
from tms_fit.least_squares.varpro import MAX_EVALUATIONS, ResidualBlock, Status, Unknowns
from tms_fit.parameters import BIASES, FRICTION, INITIAL, LINEAR, shaping
from tms_fit.response.discretization import known_values
from tms_fit.response.prediction import Predictor, derivative, predictor
from tms_fit.window import Window

Whitener = Callable[[Array], Array]  # values of both channels (n, 2, ...) -> rows (m, ...) of unit variance
Priors = Mapping[str, tuple[float, float]]  # mean and standard deviation by name, SI

SPEED_MIN = 0.05  # [m/s]
FRICTION_TOLERANCE = 1e-2  # last step [standard errors] with friction, which is not differentiable
SMALLEST_SINGULAR_VALUE_OF_DIFFERENCES = 1e-6  # relative to the largest, for finite-difference columns
START = (*INITIAL, *BIASES)  # columns of StartInformation
GAIN = "lean_rate_gain"
GAIN_STARTS = (-4.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 4.0, 8.0)  # relative to the steering's damping


@dataclass(frozen=True, eq=False)
class Problem:
    """Free parameters of a window, with fixed values and priors."""

    window: Window
    linear: tuple[str, ...]  # of LINEAR, free
    nonlinear: tuple[str, ...] = ()  # of NONLINEAR, free
    known: Mapping[str, float] = field(default_factory=dict)  # fixed values; others are 0 or as measured
    priors: Priors = field(default_factory=dict)  # of free parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters in the order of a solution's values."""
        return (*self.linear, *self.nonlinear)

    @property
    def is_informed(self) -> bool:
        """Whether more than the samples of the window determine the parameters."""
        return bool(self.priors) or self.window.start is not None

    def values(self, solution: Array) -> dict[str, float]:
        """All parameters by name, fixed and estimated, SI units."""
        return {**self.known, **dict(zip(self.names, solution.tolist(), strict=True))}

    def predicted(self, solution: Array) -> Array:
        """Both channels (n, 2) [rad/s] for values (p,) of the free parameters."""
        values = self.values(solution)
        return predictor(self.window, shaping(values)).predict(values)

    def without(self, name: str) -> Problem:
        """Problem without one of the parameters, which is then 0 or as measured."""
        names = [one for one in self.names if one != name]
        return replace(
            self,
            linear=tuple(one for one in names if one in LINEAR),
            nonlinear=tuple(one for one in names if one not in LINEAR),
            known={one: value for one, value in self.known.items() if one != name},
            priors={one: prior for one, prior in self.priors.items() if one != name},
        )


@dataclass(frozen=True, eq=False)
class ProblemSolution:
    """Solution of a `Problem`; without values where the data do not determine the parameters."""

    status: Status
    message: str
    values: Array = field(default_factory=lambda: np.empty(0))  # (p,) in the order of Problem.names
    jacobian: Array = field(default_factory=lambda: np.empty((0, 0)))  # (m, p) of the rows, priors last
    channels: Array = field(default_factory=lambda: np.empty((0, 2, 0)))  # (n, 2, p), the same per sample
    rows: Array = field(default_factory=lambda: np.empty(0))  # (m,) residual rows
    covariance: Array | None = None  # (p, p), None: that of the rows

    @property
    def inverse(self) -> Array:
        """Covariance (p, p): `covariance`, or that of rows of unit variance."""
        return self.of_rows if self.covariance is None else self.covariance

    @property
    def of_rows(self) -> Array:
        """Inverse (p, p) of J'J."""
        scale = np.linalg.norm(self.jacobian, axis=0)
        scaled = self.jacobian / scale
        inverse: Array = np.linalg.inv(scaled.T @ scaled) / np.outer(scale, scale)
        return inverse


@dataclass(frozen=True, eq=False)
class WindowRows:
    """Residual rows of one window as functions of its unknowns, for `tms_fit.least_squares.varpro`."""

    window: Window
    own: tuple[tuple[str, ...], tuple[str, ...]]  # names of its linear and nonlinear unknowns
    shared: tuple[tuple[str, ...], tuple[str, ...]]  # names of those shared with other windows
    known: Mapping[str, float]  # fixed values
    whiten: Whitener
    predictor: Callable[[Mapping[str, float]], Predictor]  # of nonlinear values by name
    slope: Callable[[Mapping[str, float], str, Mapping[str, float]], Array]
    # of nonlinear values, a name, and all values by name: derivative (n, 2) of the prediction

    def block(self, own: Unknowns) -> ResidualBlock:
        """The rows, with start values, bounds and priors of the window's own unknowns."""
        return ResidualBlock(own, self.linear, self.slopes)

    def linear(self, nonlinear: Array) -> Block:
        """Columns of the linear unknowns and the target at nonlinear values, own, then shared."""
        model = self.predictor(self._by_name(1, nonlinear))
        columns = model.select((*self.own[0], *self.shared[0]))
        target = self.window.measured - model.predict(self.known)
        rows = self.whiten(np.concatenate([columns, target[:, :, None]], axis=2))
        count = len(self.own[0])
        names = (*self.own[0], *self.shared[0])
        by_start, known = self._start(names)
        values = {**self.known, **self._by_name(1, nonlinear)}
        offset = known @ np.array([values.get(name, 0.0) if name not in names else 0.0 for name in START])
        start = self.window.start
        rows = np.concatenate([rows, np.column_stack([by_start, (start.target if start else 0.0) - offset])])
        return Block(rows[:, :count], rows[:, count:-1], rows[:, -1])

    def slopes(self, nonlinear: Array, linear: Array) -> tuple[Array, Array]:
        """Derivatives (m, k) and (m, l) of the prediction by own and shared nonlinear unknowns."""
        names, shaped = (*self.own[1], *self.shared[1]), self._by_name(1, nonlinear)
        if not names:
            return np.empty((0, 0)), np.empty((0, 0))
        values = {**self.known, **shaped, **self._by_name(0, linear)}
        rows = self.whiten(np.stack([self.slope(shaped, name, values) for name in names], axis=2))
        rows = np.concatenate([rows, self._start(names)[0]])
        count = len(self.own[1])
        return rows[:, :count], rows[:, count:]

    def _start(self, names: tuple[str, ...]) -> tuple[Array, Array]:
        """Rows on the start of the response for some unknowns (k, p), and for all of START (k, 6)."""
        start = self.window.start
        known = np.empty((0, len(START))) if start is None else start.rows
        found = np.zeros((len(known), len(names)))
        for column, name in enumerate(names):
            if name in START:
                found[:, column] = known[:, START.index(name)]
        return found, known

    def _by_name(self, kind: int, values: Array) -> dict[str, float]:
        return dict(zip((*self.own[kind], *self.shared[kind]), values.tolist(), strict=True))


def make_unknowns(
    window: Window, linear: tuple[str, ...], nonlinear: tuple[str, ...], start: Array, priors: Priors
) -> Unknowns:
    """Unknowns by name, with start values (k,) of the nonlinear ones, bounds and priors."""
    pairs = np.array([_bounds(window, name) for name in nonlinear]).reshape(-1, 2)
    none = (0.0, np.inf)
    mean, std = np.array([priors.get(name, none) for name in (*linear, *nonlinear)]).reshape(-1, 2).T
    return Unknowns(len(linear), start, pairs[:, 0], pairs[:, 1], mean, std)


def start_value(window: Window, name: str) -> float:
    """Start value of a nonlinear parameter."""
    if name == "rolling_resistance" and not window.speed.constant:
        return -float(window.speed.coefficients[1]) / coasting_loss(window.bicycle)
    if name == "strike_time" and not window.delay:
        return -0.5 * window.longest_delay
    return known_values(window).get(name, 0.0)


def _bounds(window: Window, name: str) -> tuple[float, float]:
    """Least and largest value of a nonlinear parameter."""
    bounds = {
        "strike_time": (-window.longest_delay, 0.0),
        "speed": (SPEED_MIN, np.inf),
        FRICTION: (0.0, np.inf),
    }
    return bounds.get(name, (-np.inf, np.inf))


def solve(problem: Problem, whiten: Whitener, start: Array | None = None) -> ProblemSolution:
    """Solution of a problem; `whiten` maps its samples to rows of unit variance.

    start: initial nonlinear values (k,); None: means of the priors, or values of the window.
    """
    try:
        first = _first(problem, whiten) if start is None else start
        block, shared = _block(problem, whiten, first)
        found = varpro.solve(
            [block],
            shared,
            FRICTION_TOLERANCE if _rubs(problem) else varpro.TOLERANCE,
            SMALLEST_SINGULAR_VALUE_OF_DIFFERENCES if problem.nonlinear else SMALLEST_SINGULAR_VALUE,
        )
    except ParameterError as error:
        return ProblemSolution(Status.NOT_OBSERVABLE, str(error))
    if found.status is Status.NOT_OBSERVABLE:
        names = ", ".join(problem.names)
        text = f"the measured channels do not tell {names} apart; free fewer of them"
        return ProblemSolution(found.status, text)
    text = f"no minimum after {MAX_EVALUATIONS} steps; free fewer parameters or give a prior"
    values, rows = found.own[0], found.blocks[0]
    message = "" if found.status is Status.OK else text
    return ProblemSolution(found.status, message, values, rows.own, _channels(problem, values), rows.target)


def _block(problem: Problem, whiten: Whitener, start: Array) -> tuple[ResidualBlock, Unknowns]:
    """Residual block of the window with all unknowns its own, and no shared unknowns."""
    window, fixed = problem.window, shaping(problem.known, problem.names)
    rows = WindowRows(
        window,
        (problem.linear, problem.nonlinear),
        ((), ()),
        problem.known,
        whiten,
        lambda values: predictor(window, {**fixed, **values}),
        lambda values, name, every: derivative(window, {**fixed, **values}, name).predict(every),
    )
    own = make_unknowns(window, problem.linear, problem.nonlinear, start, problem.priors)
    return rows.block(own), make_unknowns(window, (), (), np.empty(0), {})


def _channels(problem: Problem, solution: Array) -> Array:
    """Derivatives (n, 2, p) of the prediction by all free parameters."""
    values = problem.values(solution)
    nonlinear = shaping(values)
    slopes = [
        derivative(problem.window, nonlinear, name).predict(values)[:, :, None] for name in problem.nonlinear
    ]
    columns = predictor(problem.window, nonlinear).select(problem.linear)
    return np.concatenate([columns, *slopes], axis=2)


def _rubs(problem: Problem) -> bool:
    return FRICTION in {*problem.names, *problem.known}


def _first(problem: Problem, whiten: Whitener) -> Array:
    """Initial nonlinear values (k,); with friction those of the fit without it."""
    window = problem.window
    first = np.array(
        [
            problem.priors[name][0] if name in problem.priors else start_value(window, name)
            for name in problem.nonlinear
        ],
        dtype=float,
    )
    if not _rubs(problem):
        return _best_gain(problem, whiten, first)
    smooth = problem.without(FRICTION)
    found = solve(smooth, whiten)
    if found.status is Status.NOT_OBSERVABLE:
        return first
    values = smooth.values(found.values)
    return np.array([values.get(name, one) for name, one in zip(problem.nonlinear, first, strict=True)])


def _best_gain(problem: Problem, whiten: Whitener, first: Array) -> Array:
    """Initial values (k,) with the feedback gain of least cost among GAIN_STARTS.

    A bicycle with too small a gain falls. Its best response is nearly zero for all such gains, so the
    gradient there does not lead to the right gain.
    """
    if GAIN not in problem.nonlinear or GAIN in problem.priors:
        return first
    bicycle = problem.window.bicycle
    size = problem.window.start_speed * float(np.abs(bicycle.damping[1]).max())  # of the steering's torques
    unit = size / (bicycle.steer_elements.steer_torque_gain or 1.0)
    is_gain = np.array([name == GAIN for name in problem.nonlinear])
    starts = [first, *(first + share * unit * is_gain for share in GAIN_STARTS if np.isfinite(size))]
    costs = [varpro.cost([block], shared) for block, shared in (_block(problem, whiten, s) for s in starts)]
    return starts[int(np.argmin(costs))]
