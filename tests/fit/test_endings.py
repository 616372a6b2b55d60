"""A window ends when the free response does: hands, a fall, the next strike; and hands are no strike."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tms_fit.strikes.window_end import find_window_end

TIME = np.arange(200) / 100.0
SPEED_TIME = np.arange(100) / 50.0


def rates(lean_rate: np.ndarray, noise: float = 0.02) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.stack([lean_rate, 0.5 * lean_rate], axis=1) + noise * rng.standard_normal((len(lean_rate), 2))


def swinging(time: np.ndarray) -> np.ndarray:
    return np.asarray(0.4 * np.cos(6.0 * time) * np.exp(-time))


@pytest.mark.parametrize("slowing", [0.0, 0.6, 1.3])
def test_rolling_ends_nothing(slowing: float) -> None:
    # 1.3 m/s^2: hall 1, from 3.6 to 1 m/s.
    speed = 3.6 - slowing * SPEED_TIME + 0.01 * np.random.default_rng(1).standard_normal(len(SPEED_TIME))
    assert find_window_end(TIME, rates(swinging(TIME)), SPEED_TIME, speed) is None


def test_a_sensor_that_says_zero_for_a_moment_ends_nothing() -> None:
    speed = np.where((SPEED_TIME > 1.0) & (SPEED_TIME < 1.2), 0.0, 3.6)
    assert find_window_end(TIME, rates(swinging(TIME)), SPEED_TIME, speed) is None


@pytest.mark.parametrize("lasts", [0.3, 0.5, 1.0])
def test_a_speed_that_collapses_is_a_catch_dated_by_the_rates(lasts: float) -> None:
    # Caught at 1.0 s: the rates jump at once, the speed begins to fall along a smooth step.
    s = np.clip((SPEED_TIME - 1.0) / lasts, 0.0, 1.0)
    speed = 3.0 * (1.0 - (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5))
    grip = np.where((TIME > 1.0) & (TIME < 1.15), 2.0 * np.sin(np.pi * (TIME - 1.0) / 0.15), 0.0)
    ending = find_window_end(TIME, rates(np.where(TIME > 1.0, grip, swinging(TIME))), SPEED_TIME, speed)
    assert ending is not None
    assert ending.kind == "caught"
    assert 0.97 <= ending.time <= 1.01
    assert "its speed falls from 2.9" in ending.why


def test_without_a_speed_rates_that_stop_tell_of_hands() -> None:
    grip = np.where((TIME > 1.0) & (TIME < 1.15), 2.0 * np.sin(np.pi * (TIME - 1.0) / 0.15), 0.0)
    held = rates(np.where(TIME > 1.0, grip, swinging(TIME)))
    ending = find_window_end(TIME, held, np.empty(0), np.empty(0))
    assert ending is not None
    assert ending.kind == "held"
    assert 0.97 <= ending.time <= 1.01
    # A response that has died down by itself isn't held.
    assert find_window_end(TIME, rates(swinging(4.0 * TIME)), np.empty(0), np.empty(0)) is None


@pytest.mark.parametrize("seed", [0, 2, 4, 7, 10])
@pytest.mark.quick_for(seed=[0, 10])
def test_a_bicycle_that_leans_on_evenly_after_a_strike_is_not_held(seed: int) -> None:
    # A gyroscope tells no such rate of what stands still.
    time, noise = TIME[:134], 0.02 * np.random.default_rng(seed).standard_normal((134, 2))
    struck = np.where(time > 1.0, 0.33 - 0.25 * (time - 1.0), 0.0)
    turning = 0.3 * np.maximum(time - 1.0, 0.0)
    moved = np.stack([struck, turning], axis=1) + noise
    assert find_window_end(time, moved, np.empty(0), np.empty(0)) is None


def test_a_lean_rate_that_adds_up_is_a_fall() -> None:
    ending = find_window_end(TIME, rates(0.1 * np.exp(2.5 * TIME)), np.empty(0), np.empty(0))
    assert ending is not None
    assert ending.kind == "fallen"
    # The lean of the last second reaches a radian: 0.04 (exp(2.5 t) - exp(2.5 (t - 1))) = 1 at t = 1.32 s.
    assert ending.time == pytest.approx(1.32, abs=0.02)


@pytest.mark.parametrize("name", ["gym_linoleum", "gym_thick_rubber", "gym_polyurethane", "gym_strikes"])
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.quick_for(name=["gym_linoleum"], seed=[1])
def test_hands_end_a_simulated_response_and_strike_nothing(
    make_run: Any, fit_run: Any, name: str, seed: int
) -> None:
    run = make_run(name, seed=seed)
    (caught,) = (one.time for one in run.trajectory.events if one.text == "caught")
    struck = [one.time + one.duration for one in run.trajectory.events if one.kind == "strike"]
    fits = fit_run(run, estimators=("least_squares",))
    found = [(one.strike.end_ns - run.info.start_ns) / 1e9 for one in fits]
    assert found == pytest.approx(struck, abs=0.012)
    last = fits[-1]
    end = (last.end_ns - run.info.start_ns) / 1e9
    if caught < found[-1] + 1.5:
        assert last.window_end.kind in ("caught", "next_strike")  # a touch before the speed shows it
        assert caught - 0.05 < end < caught + 0.03
        assert f"window {last.window_end.time:.2f} s: " in last.estimates[0].message
    assert [one.estimates[0].status for one in fits] == ["ok"] * len(fits)


def test_without_its_speed_topic_a_caught_run_tells_the_same(make_run: Any, fit_run: Any) -> None:
    run = replace(make_run("gym_linoleum"), speed=None)
    (fit,) = fit_run(run, estimators=("least_squares",), fixed={"speed": 3.6})
    assert fit.window_end.kind in ("held", "next_strike")  # a touch before nothing moves
    assert (fit.end_ns - run.info.start_ns) / 1e9 == pytest.approx(4.347, abs=0.03)


def test_the_end_of_a_record_is_told(make_run: Any, fit_run: Any) -> None:
    (fit,) = fit_run(make_run("tms_strike", duration=3.0), estimators=("least_squares",))
    assert fit.window_end.kind == "recording"
    assert fit.estimates[0].message.endswith("window 1.00 s: nothing more was recorded")
