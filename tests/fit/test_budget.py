"""The error budget: derivatives by hand, and what theory says must cancel."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tms_fit.diagnostics.error_budget import error_budget
from tms_fit.estimators.least_squares import fit_window
from tms_fit.parameters import DEFAULT_FREE
from tms_fit.settings import Settings
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window
from tms_model import linear_system, load_bicycle, response, yaw_rate

SETTINGS = Settings(free=DEFAULT_FREE, steer_torque="ignore")


def window_of(name: str, speed: float, **changes: float) -> Window:
    """A noisy free response of 1.5 s; changes: standard deviations the bicycle states."""
    bicycle = replace(load_bicycle(name), standard_deviations=changes)
    system = linear_system(bicycle, speed)
    time = np.arange(151) / 100.0
    states = response(system, np.array([0.0, 0.0, 0.5, 0.0]), time + 0.004)
    rates = np.stack([states[:, 2], yaw_rate(system, states)], axis=1)
    rates += 0.02 * np.random.default_rng(3).standard_normal(rates.shape)
    curve = constant_speed(speed, 0.005)
    return Window(0, time, rates[:, 0], rates[:, 1], bicycle, curve, delay=0.004, delay_std=0.002)


@pytest.mark.parametrize(("name", "speed"), [("tms_eq_10_1", 3.6), ("benchmark", 5.0), ("delft_sbw", 5.0)])
def test_a_bicycle_twice_as_heavy_moves_the_same(name: str, speed: float) -> None:
    # M, C1, K0 and K2 all 1 % larger is the same equation: the entries' shares cancel (Euler's theorem).
    window = window_of(name, speed)
    budget = error_budget(window, SETTINGS, fit_window(window, SETTINGS))
    assert budget is not None
    shares = [
        one.per_percent for one in budget.contributions if one.name.split("_")[0] in ("M", "C1", "K0", "K2")
    ]
    assert len(shares) == 12
    assert max(abs(share) for share in shares) > 1e-3
    assert sum(shares) == pytest.approx(0.0, abs=1e-5 * max(abs(share) for share in shares) + 1e-8)


def test_speed_and_start_by_refitting_by_hand() -> None:
    window = window_of("tms_eq_10_1", 3.6)
    estimate = fit_window(window, SETTINGS)
    budget = error_budget(window, SETTINGS, estimate)
    assert budget is not None
    told = {one.name: one for one in budget.contributions}
    low, high = (
        fit_window(replace(window, speed=constant_speed(v)), SETTINGS).parameters["initial_lean_rate"]
        for v in (3.55, 3.65)
    )
    assert told["speed"].sensitivity == pytest.approx((high - low) / 0.1, rel=1e-2)
    assert told["speed"].part == pytest.approx(abs(told["speed"].sensitivity) * 0.005)
    early, late = (
        fit_window(replace(window, delay=delay), SETTINGS).parameters["initial_lean_rate"]
        for delay in (0.005, 0.003)
    )
    assert told["strike_time"].sensitivity == pytest.approx((late - early) / 0.002, rel=1e-2)
    # What the standard error holds already: noise, speed and start in squares.
    alone = fit_window(replace(window, speed=constant_speed(3.6), delay_std=0.0), SETTINGS)
    index = estimate.names.index("initial_lean_rate")
    whole = math.sqrt(alone.std[index] ** 2 + told["speed"].part ** 2 + told["strike_time"].part ** 2)
    assert budget.statistical == pytest.approx(whole, rel=5e-3)
    assert math.isnan(budget.model)


def test_stated_uncertainty_of_a_parameter_is_model_error() -> None:
    window = window_of("benchmark", 5.0, trail=0.004, rear_frame_z=0.02)
    budget = error_budget(window, SETTINGS, fit_window(window, SETTINGS))
    assert budget is not None
    told = {one.name: one for one in budget.contributions if math.isfinite(one.part) and not one.included}
    assert set(told) == {"trail", "rear_frame_z"}
    assert budget.model == pytest.approx(math.hypot(told["trail"].part, told["rear_frame_z"].part))
    assert budget.model > 0.0


def test_no_budget_without_an_initial_lean_rate() -> None:
    window = window_of("tms_eq_10_1", 3.6)
    other = replace(SETTINGS, free=("initial_lean",))
    assert error_budget(window, other, fit_window(window, other)) is None
