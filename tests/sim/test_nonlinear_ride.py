"""A run of the nonlinear bicycle: its equations, the linear ones for small angles, and how both differ."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tms_model import ParameterError, load_bicycle
from tms_model.acceleration import resistance_load
from tms_model.nonlinear_response import nonlinear_response
from tms_sim.motion import Motion, Trajectory

NONLINEAR: dict[str, Any] = {"effects__nonlinear": True}
ROLLING: dict[str, Any] = {f"effects__{name}": False for name in ("slip", "scrub", "shimmy")}


def columns(motion: Motion) -> np.ndarray:
    rates = (motion.lean, motion.steer, motion.lean_rate, motion.steer_rate, motion.speed, motion.yaw)
    return np.stack(rates, axis=1)


def departures(run: Trajectory) -> dict[str, float]:
    (told,) = (event for event in run.events if event.kind == "nonlinear")
    return dict(told.figures)


@pytest.mark.parametrize("coasts", [False, True])
@pytest.mark.quick_for(coasts=[True])
def test_it_is_the_motion_of_the_nonlinear_equations(go: Any, coasts: bool) -> None:
    # Over large angles: 0.3 rad/s leans the benchmark bicycle by 8 degrees.
    changes = {"floor": "hard_wood", "effects__rolling_resistance": True, "speed_at_strike": 5.0}
    run = go("benchmark_strike", **NONLINEAR, **(changes if coasts else {}), duration=6.0)
    bicycle = load_bicycle("benchmark")
    assert bicycle.parameters is not None
    motion = run.at(np.array([2.0, 2.0005, 3.7773, 6.0]))
    load = resistance_load(bicycle.parameters, float(motion.acceleration[0])) if coasts else None
    initial = np.array([0.0, 0.0, 0.3, 0.0, motion.speed[0]])
    expected = nonlinear_response(bicycle, initial, motion.time - 2.0, load)
    np.testing.assert_allclose(columns(motion), expected.states[:, :6], atol=2e-9)
    np.testing.assert_allclose(motion.yaw_rate, expected.yaw_rate, atol=2e-8)
    way = motion.rear_contact - motion.rear_contact[0]
    np.testing.assert_allclose(way, expected.states[:, 6:], atol=2e-9)
    assert not motion.front_slip.any()


def test_small_angles_are_the_linear_ones(go: Any) -> None:
    # What linear theory leaves out is of third order: a tenth of the strike, a thousandth of the departure.
    strong, weak = (
        departures(go("benchmark_strike", **NONLINEAR, strike__lean_rate=rate, duration=3.0))
        for rate in (0.2, 0.02)
    )
    for name in ("lean_rad", "lean_rate_rad_s", "yaw_rate_rad_s"):
        assert weak[name] == pytest.approx(1e-3 * strong[name], rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("coasts", [False, True])
@pytest.mark.parametrize(("frame", "size"), [("rear_frame", 1e-2), ("front_frame", 1e-3)])
def test_an_offset_mass_does_what_it_does_to_the_linear_one_at_small_angles(
    go: Any, frame: str, size: float, coasts: bool
) -> None:
    # A tenth of the mass: a thousandth of the departure, which is of third order in the angles.
    changes = {"floor": "hard_wood", "effects__rolling_resistance": coasts, "strike__lean_rate": 0.0}
    strong, weak = (
        departures(
            go("tms_strike", **NONLINEAR, bicycle="tms_table_8_1", **changes, **{f"asymmetry__{frame}": mass})
        )
        for mass in (size, size / 10.0)
    )
    assert strong["lean_rad"] > 1e-4
    for name in ("lean_rad", "yaw_rate_rad_s"):
        assert weak[name] < 3e-3 * strong[name]


@pytest.mark.long
def test_the_departure_told_is_that_of_both_runs(go: Any) -> None:
    run, linear = (go("benchmark_strike", **changes, duration=5.0) for changes in (NONLINEAR, {}))
    times = np.arange(0.0, 5.0, 0.005)
    lean = np.abs(run.at(times).lean - linear.at(times).lean).max()
    assert departures(run)["lean_rad"] == pytest.approx(lean, rel=1e-3)
    heading = run.at(np.array([5.0])).yaw - linear.at(np.array([5.0])).yaw
    assert departures(run)["heading_rad"] == pytest.approx(float(heading[0]), rel=1e-9)


@pytest.mark.long
def test_the_whole_experiment_on_wheels_that_roll(go: Any) -> None:
    run = go("gym_run", **NONLINEAR, **ROLLING, bicycle="tms_table_8_1", strike__lean_rate=0.05)
    assert run.ended_by == "caught"
    times = np.arange(0.0, run.end, 0.001)
    motion = run.at(times)
    assert np.abs(np.diff(motion.lean)).max() < 0.002
    assert np.abs(np.diff(motion.speed)).max() < 0.02
    assert motion.speed[-1] == pytest.approx(0.0, abs=0.01)


def test_it_falls_beyond_the_lean_limit(go: Any) -> None:
    run = go("tms_strike", **NONLINEAR, bicycle="tms_table_8_1", speed=1.0)
    assert run.ended_by == "fallen"
    last = run.at(np.array([run.end]))
    limits = max(abs(last.lean[0]) - 1.0, abs(last.steer[0]) - math.pi / 2.0)
    assert limits == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "changes", "says"),
    [
        (
            "gym_run",
            {},
            "effects.slip, effects.scrub, effects.shimmy, which act in the linear equations alone",
        ),
        ("tms_strike", {}, "only the matrices"),
        ("delft_push", {}, "inertia_yy"),
    ],
)
def test_what_only_the_linear_bicycle_has_is_refused(go: Any, name: str, changes: Any, says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        go(name, **NONLINEAR, **changes)
