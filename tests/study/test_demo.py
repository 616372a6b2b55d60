"""The truth that the demo compares with."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tms_fit import fit_recording
from tms_fit.strike_fit import StrikeFit
from tms_sim.run import SimulatedRun, simulate
from tms_sim.scenario import load_scenario
from tms_study.demo import true_lean_rate


def struck(scenario: str, **changes: Any) -> tuple[SimulatedRun, StrikeFit]:
    """A run, and the fit of its first strike."""
    changes = {key.replace("__", "."): value for key, value in changes.items()}
    run = simulate(load_scenario(scenario, changes), np.random.default_rng(1))
    return run, fit_recording(run.recording(), run.info.bicycle).strikes[0]


def test_the_truth_of_a_strike_between_two_samples_is_that_at_the_end_of_its_impulse() -> None:
    # Half a degree of lean and a steer kick: 5 ms after the impulse the lean rate is 0.05 rad/s larger.
    run, strike = struck("gym_run", duration=7.0)
    instant, found = true_lean_rate(run, strike)
    (event,) = [one for one in run.trajectory.events if one.kind == "strike"]
    assert instant == pytest.approx(event.time + event.duration)
    around = run.trajectory.at(np.array([instant, instant + 0.005])).lean_rate
    assert found == around[0] < around[1] - 0.03
    before = float(run.trajectory.at(np.array([event.time])).lean_rate[0])
    assert found - before == pytest.approx(0.2, abs=0.06)


def test_a_start_taken_for_exact_is_compared_at_its_instant() -> None:
    run, strike = struck("gym_run", duration=7.0)
    assert strike.window is not None
    for late in (-0.02, 0.02):  # before the impulse's end no free response can begin
        exact = replace(strike.window, delay=strike.window.delay - late, delay_std=0.0)
        instant, found = true_lean_rate(run, replace(strike, window=exact))
        end, _ = true_lean_rate(run, strike)
        assert instant == pytest.approx(max(end, (exact.start_ns - run.info.start_ns) / 1e9))
        assert found == float(run.trajectory.at(np.array([instant])).lean_rate[0])
