"""`study strikes`: the bound it compares with, and the command."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from tms_model import linear_system, load_bicycle, response
from tms_study.strikes import after_a_change, cases, end_bound, judge, pulse

SYSTEM = linear_system(load_bicycle("tms_eq_10_1"), 3.6)


def test_a_short_pulse_is_an_impulse_in_its_middle() -> None:
    time = np.arange(-0.5, 1.0, 0.01)
    after = time > 0.05
    impulse = response(SYSTEM, np.array([0.0, 0.0, 0.3, 0.0]), time[after] + 0.002)[:, 2]
    moved = pulse(after_a_change(SYSTEM), time, 0.0, 0.004, 0.3)
    assert moved[after, 0] == pytest.approx(impulse, abs=1e-4)
    assert (moved[time < -0.005] == 0.0).all()


def test_bound_is_larger_where_less_is_known() -> None:
    known, hardly, unknown = (end_bound(SYSTEM, 0.3, 0.05, 100.0, length) for length in (1e-6, 0.02, np.inf))
    assert known < 0.5 * hardly < hardly < unknown < 1.2 * hardly


def test_bound_of_the_end_falls_with_strength_and_hardly_with_the_rate() -> None:
    # Noise of one density at every rate: once the impulse is sampled, more samples tell nothing more.
    weak, strong = (end_bound(SYSTEM, change, 0.05, 200.0) for change in (0.2, 0.8))
    assert 3.0 < weak / strong <= 4.0
    assert end_bound(SYSTEM, 0.2, 0.05, 800.0) == pytest.approx(weak, rel=0.1)


def score(topic: str, seed: int, runs: int) -> Any:
    (case,) = (one for one in cases() if one.topic == topic)
    return judge(case, np.random.default_rng(seed), runs)


@pytest.mark.parametrize("runs", [1, pytest.param(6, marks=pytest.mark.long)])
def test_joints_of_hard_wood_are_no_strikes(runs: int) -> None:
    wood = score("gym_wood", 5, runs)
    assert (wood.strikes, wood.found, wood.false) == (runs, runs, 0)


@pytest.mark.parametrize("rate", [100, 400])
@pytest.mark.quick_for(rate=[100])
def test_impulses_of_50_ms_are_dated_to_10_ms(rate: int) -> None:
    # One standard deviation of the bound is 4 ms: 98 in 100 could be.
    found = score(f"0.3 rad/s in 50 ms at {rate} Hz", 6, 10)
    assert found.found == 10
    assert found.close >= 0.8
    assert np.abs(found.errors).max() < 0.020


def test_command_says_what_was_found(command: Any) -> None:
    done = command("tms_study", "strikes", "--only", "tms_strike_ideal", "--runs", "2", "--json")
    assert done.code == 0, done.err
    (case,) = json.loads(done.out)["cases"]
    assert (case["strikes"], case["found"], case["missed"], case["false"]) == (2, 2, 0, 0)
    assert case["largest_error"] <= 0.010
    table = command("tms_study", "strikes", "--only", "tms_strike_ideal", "--runs", "1").out
    assert table.splitlines()[2].startswith("| tms_strike_ideal ")


@pytest.mark.parametrize("words", [("--only", "nonsense"), ("--runs", "0")])
def test_command_refuses_nonsense_in_one_line(command: Any, words: tuple[str, str]) -> None:
    done = command("tms_study", "strikes", *words)
    assert done.code == 2
    assert len(done.err.strip().splitlines()) == 1
    assert words[0] in done.err
