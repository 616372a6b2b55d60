"""Error budget of the initial lean rate: statistical error, and errors of the values taken as known.

Each contribution is the change of the estimate, refitted with the same unknowns, for a small change of
what the fit takes as known: speed, rolling resistance, the strike's instant, an entry of M, C1, K0 or K2
(SOM Eq. 3.1), a parameter of the bicycle with a stated standard deviation. To first order (JCGM 100:2008,
section 5.1): derivative times uncertainty, derivatives by central differences.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from tms_model import Bicycle, with_parameters
from tms_model.bicycle import Array

from tms_fit.estimate import Estimate
from tms_fit.estimators.least_squares import fit_window
from tms_fit.parameters import STRIKE
from tms_fit.settings import Settings
from tms_fit.window import Window

PARAMETER = "initial_lean_rate"
DIFFERENCE_STEP = 1e-4  # of the central differences, share of the value changed
DELAY_STEP_S = 1e-4  # [s]
RESISTANCE_STEP = 1e-3  # of C_r


@dataclass(frozen=True)
class Contribution:
    """One value that the fit takes as known."""

    name: str
    value: float  # as the fit took it, SI
    sensitivity: float  # d estimate / d value; NaN where a refit failed
    uncertainty: float  # standard deviation of the value, NaN: none is stated
    included: bool  # whether the estimate's standard error includes it

    @property
    def part(self) -> float:
        """Standard deviation [rad/s] that it gives to the estimate, NaN where no uncertainty is stated."""
        return abs(self.sensitivity) * self.uncertainty

    @property
    def per_percent(self) -> float:
        """Change of the estimate [rad/s] if the value were 1 % larger."""
        return 0.01 * self.value * self.sensitivity


@dataclass(frozen=True)
class Budget:
    """Statistical and model error of one estimate, side by side."""

    value: float  # [rad/s] initial lean rate
    statistical: float  # [rad/s] its standard error
    contributions: tuple[Contribution, ...]

    @property
    def model(self) -> float:
        """Standard deviation [rad/s] by stated uncertainties outside the standard error; NaN: none."""
        parts = [one.part for one in self.contributions if not one.included and math.isfinite(one.part)]
        return math.sqrt(sum(part**2 for part in parts)) if parts else float("nan")


def error_budget(window: Window, settings: Settings, estimate: Estimate) -> Budget | None:
    """Budget of a least-squares estimate; None where it has no initial lean rate, or holds the strike."""
    if PARAMETER not in estimate.names or STRIKE[0] in estimate.names:
        return None
    index = estimate.names.index(PARAMETER)
    asked = replace(settings, free=estimate.names)
    found = [
        *_run_contributions(window, asked, estimate),
        *_matrix_contributions(window, asked),
        *_parameter_contributions(window, asked),
    ]
    return Budget(float(estimate.values[index]), float(estimate.std[index]), tuple(found))


def _estimated(window: Window, settings: Settings) -> float:
    """The initial lean rate [rad/s], NaN where there is none."""
    return fit_window(window, settings).parameters.get(PARAMETER, math.nan)


def _run_contributions(window: Window, settings: Settings, estimate: Estimate) -> Iterator[Contribution]:
    if "speed" not in {*estimate.names, *settings.fixed}:
        step = DIFFERENCE_STEP * window.start_speed
        ends = [_estimated(_with_speed_change(window, part), settings) for part in (-step, step)]
        yield Contribution(
            "speed", window.start_speed, (ends[1] - ends[0]) / (2 * step), window.speed.std or math.nan, True
        )
    if "rolling_resistance" not in {*estimate.names, *settings.fixed} and window.speed.constant:
        tried = [
            replace(settings, fixed={**settings.fixed, "rolling_resistance": part})
            for part in (-RESISTANCE_STEP, RESISTANCE_STEP)
        ]
        ends = [_estimated(window, one) for one in tried]
        slope = (ends[1] - ends[0]) / (2 * RESISTANCE_STEP)
        yield Contribution("rolling_resistance", 0.0, slope, math.nan, False)
    if "strike_time" not in {*estimate.names, *settings.fixed}:
        low, high = max(window.delay - DELAY_STEP_S, 0.0), window.delay + DELAY_STEP_S
        ends = [_estimated(replace(window, delay=delay), settings) for delay in (low, high)]
        slope = -(ends[1] - ends[0]) / (high - low)  # a longer delay is an earlier strike
        yield Contribution("strike_time", -window.delay, slope, window.delay_std or math.nan, True)


def _matrix_contributions(window: Window, settings: Settings) -> Iterator[Contribution]:
    """Each entry separately; the off-diagonal entries of M and K0 are one value each."""
    for letter, matrix in window.bicycle.canonical.items():
        for row, column in np.ndindex(2, 2):
            symmetric = letter in ("M", "K0")
            if (symmetric and column < row) or (letter == "K2" and column == 0):
                continue
            step = DIFFERENCE_STEP * (float(matrix[row, column]) or float(np.abs(matrix).max()))
            ends = []
            for part in (-step, step):
                changed = matrix.copy()
                changed[row, column] += part
                if symmetric and row != column:
                    changed[column, row] += part
                bicycle = _with_matrix(window.bicycle, letter, changed)
                ends.append(_estimated(replace(window, bicycle=bicycle), settings))
            name = f"{letter}_{('lean', 'steer')[row]}_{('lean', 'steer')[column]}"
            slope = (ends[1] - ends[0]) / (2 * step)
            yield Contribution(name, float(matrix[row, column]), slope, math.nan, False)


def _parameter_contributions(window: Window, settings: Settings) -> Iterator[Contribution]:
    """The bicycle's parameters whose uncertainty is stated."""
    bicycle = window.bicycle
    for name, deviation in bicycle.standard_deviations.items():
        if deviation > 0.0:
            value = bicycle.numbers[name]
            step = 0.1 * deviation
            ends = [
                _estimated(replace(window, bicycle=with_parameters(bicycle, {name: value + part})), settings)
                for part in (-step, step)
            ]
            yield Contribution(name, value, (ends[1] - ends[0]) / (2 * step), deviation, False)


def _with_speed_change(window: Window, change: float) -> Window:
    coefficients = window.speed.coefficients.copy()
    coefficients[0] += change
    return replace(window, speed=replace(window.speed, coefficients=coefficients))


def _with_matrix(bicycle: Bicycle, letter: str, matrix: Array) -> Bicycle:
    """The bicycle with one matrix of Eq. (3.1) changed."""
    if letter == "M":
        return replace(bicycle, mass=matrix)
    if letter == "C1":
        return replace(bicycle, damping=matrix)
    if letter == "K0":
        return replace(bicycle, stiffness0=matrix)
    return replace(bicycle, stiffness2=matrix)
