"""Whatever a scenario says within its ranges: the run is finite, its stamps ascend, its phases are legal."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tms_model import ParameterError
from tms_sim.protocol import ride
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario, scenario_names

FREE, RUN_UP, SETTLING, STRIKE, RESPONSE, CAUGHT, FALLEN = range(7)
FOLLOWS = {
    FREE: {STRIKE, RESPONSE, CAUGHT, FALLEN},
    RUN_UP: {SETTLING},
    SETTLING: {STRIKE, RESPONSE, CAUGHT, FALLEN},
    STRIKE: {RESPONSE, CAUGHT, FALLEN},
    RESPONSE: {STRIKE, RESPONSE, CAUGHT, FALLEN},
    CAUGHT: set(),
    FALLEN: set(),
}
SWITCHES = ("rolling_resistance", "slip", "steer_kick", "scrub", "joints", "shimmy")


@st.composite
def changes(draw: Any) -> dict[str, Any]:
    """Changes of gym_run: every switch, floor, strike, way to hold and to catch."""
    release = draw(st.sampled_from([0.0, 0.8]))
    count = draw(st.integers(1, 3))
    gaps = draw(st.lists(st.floats(0.11, 1.0), min_size=count, max_size=count))
    times = (release + np.cumsum(gaps)).tolist()
    return {
        **{f"effects.{name}": draw(st.booleans()) for name in SWITCHES},
        "bicycle": draw(st.sampled_from(["tms_eq_10_1", "tms_table_8_1"])),
        "floor": draw(st.sampled_from(["ideal", "hard_wood", "linoleum", "thick_rubber", "thin_rubber"])),
        "wheels": draw(st.sampled_from(["aluminium", "polyurethane"])),
        "speed": draw(st.floats(0.5, 8.0)),
        "speed_at_strike": draw(st.sampled_from([0.0, 3.6])),
        "duration": times[-1] + draw(st.floats(0.15, 2.0)),
        "run_up.duration": release,
        "strike.time": times,
        "strike.lean_rate": draw(st.lists(st.floats(-1.0, 1.0), min_size=count, max_size=count)),
        "strike.duration": draw(st.sampled_from([0.0, 0.001, 0.1])),
        "catch.lean_deg": draw(st.sampled_from([0.0, 5.0, 30.0])),
        "catch.speed": draw(st.sampled_from([0.0, 1.0, 3.4])),
        "asymmetry.rear_frame": draw(st.sampled_from([0.0, -0.002])),
        "asymmetry.front_frame": draw(st.sampled_from([0.0, 0.001])),
        "seed": draw(st.integers(0, 1000)),
    }


@settings(deadline=None, max_examples=25)
@given(changes())
def test_any_run_is_finite_and_in_order(change: dict[str, Any]) -> None:
    scenario = load_scenario("gym_run", change)
    run = ride(scenario, np.random.default_rng(scenario.integer("seed")))
    assert 0.0 < run.end <= scenario.number("duration") + 1e-9
    assert (np.diff(run.starts) > 0.0).all()
    motion = run.at(np.linspace(0.0, run.end, 500))
    for name, values in vars(motion).items():
        assert np.isfinite(values).all(), name
    phases = run.phases.tolist()
    assert all(after in FOLLOWS[before] for before, after in pairwise(phases))
    assert (np.diff(run.phase_starts) >= 0.0).all()
    times = [event.time for event in run.events]
    assert times == sorted(times)
    assert all(0.0 <= event.time <= run.end + 1e-9 and event.duration >= 0.0 for event in run.events)
    assert run.ended_by in ("duration", "caught", "fallen", "stopped")
    if not change["effects.slip"]:
        held = motion.phase == CAUGHT
        assert np.abs(motion.rear_slip).max() == 0.0
        assert np.abs(motion.front_slip[~held]).max(initial=0.0) < 1e-9 * max(
            1.0, np.abs(motion.steer_rate).max()
        )


@settings(deadline=None, max_examples=8)
@given(changes())
def test_samples_of_any_run_are_finite_and_truth_agrees_with_itself(change: dict[str, Any]) -> None:
    scenario = load_scenario("gym_run", change)
    run = simulate(scenario, np.random.default_rng(scenario.integer("seed")))
    assert np.isfinite(run.imu.angular_velocity).all()
    assert (np.diff(run.state.time_ns) > 0).all()
    times = (run.state.time_ns - run.info.start_ns) / 1e9
    again = run.trajectory.at(times)
    np.testing.assert_array_equal(run.state.phase, again.phase)
    np.testing.assert_array_equal(run.state.rear_contact, again.rear_contact)
    # Rates are the rates of change of what they say, where nothing jumps.
    fine = np.linspace(0.0, run.trajectory.end, 2000)
    motion = run.trajectory.at(fine)
    jumps = np.array([event.time for event in run.trajectory.events])
    middle = 0.5 * (fine[1:] + fine[:-1])
    quiet = np.abs(middle[:, None] - jumps[None]).min(axis=1) > 0.11
    step = fine[1] - fine[0]
    for value, rate in (("lean", "lean_rate"), ("yaw", "yaw_rate"), ("speed", "acceleration")):
        change_of = np.diff(getattr(motion, value))[quiet]
        rates = 0.5 * step * (getattr(motion, rate)[1:] + getattr(motion, rate)[:-1])[quiet]
        scale = max(1.0, float(np.abs(getattr(motion, rate)).max()))
        assert np.abs(change_of - rates).max(initial=0.0) < 1e-3 * scale * step * 10.0


@pytest.mark.parametrize("name", scenario_names())
@pytest.mark.quick_for(name=["tms_strike", "gym_run", "delft_push"])
def test_same_seed_same_ride(name: str) -> None:
    scenario = load_scenario(name)
    one, other = (ride(scenario, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(one.coefficients, other.coefficients)
    assert one.events == other.events


def test_instants_outside_the_run_are_refused() -> None:
    run = ride(load_scenario("tms_strike"), np.random.default_rng(1))
    for times in ([-0.1], [8.1], [float("nan")]):
        with pytest.raises(ParameterError, match="time: expected instants from 0 to 8 s"):
            run.at(np.array(times))
    assert run.at(np.empty(0)).lean.shape == (0,)
