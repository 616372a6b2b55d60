"""The Cramer-Rao bound: the published figures, and what theory says about its dependence on each choice."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import BagWriter, read_recording
from tms_fit.parameters import PARAMETERS
from tms_fit.recording_fit import bicycle_of, fit_recording
from tms_fit.settings import Settings
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario
from tms_study.bound import Experiment, bound, planned, table

# Eq. (10.1), 3.6 m/s constant, initial lean rate 0.5 rad/s, 400 samples at 100 Hz, white noise of 0.02 rad/s:
# computed with independent code, two implementations agreed.
EXPERIMENT = Experiment(rate=100.0, noise_density=0.002, duration=3.99, lean_rate=0.5)
LEAN_RATE, BIASES = ("initial_lean_rate",), ("lean_rate_bias", "yaw_rate_bias")
ON_RUBBER = {"floor": "thin_rubber", "effects.rolling_resistance": True}
STATES = ("initial_lean", "initial_steer", "initial_lean_rate", "initial_steer_rate")
KNOWN = [
    (LEAN_RATE, 1.2066e-3, 5e-8),
    ((*LEAN_RATE, "speed"), 1.2119e-3, 5e-8),
    ((*LEAN_RATE, *BIASES), 1.568e-3, 5e-7),
    ((*LEAN_RATE, *BIASES, "speed", "initial_steer_rate"), 5.738e-3, 5e-7),
    (STATES, 9.27469e-3, 2e-8),
]


@pytest.mark.parametrize(("free", "expected", "digits"), KNOWN, ids=lambda value: str(value)[:40])
def test_bound_is_the_known_one(free: tuple[str, ...], expected: float, digits: float) -> None:
    found = bound(load_scenario("tms_strike"), EXPERIMENT, free)
    assert found.std["initial_lean_rate"] == pytest.approx(expected, abs=digits)


def test_speed_and_lean_rate_alone() -> None:
    scenario = load_scenario("tms_strike")
    both = bound(scenario, EXPERIMENT, (*LEAN_RATE, "speed"))
    assert both.std["speed"] == pytest.approx(5.1e-3, abs=5e-5)
    alone = bound(scenario, replace(EXPERIMENT, channels=("lean_rate",)), LEAN_RATE)
    assert alone.std["initial_lean_rate"] == pytest.approx(2.777e-3, abs=5e-7)


def test_noise_strength_and_rate_scale_as_they_must() -> None:
    # Twice the noise: twice the bound. A strike twice as hard halves the speed's. More samples of the same
    # noise density change nothing but the sum's step.
    scenario, free = load_scenario("tms_strike"), (*LEAN_RATE, "speed")
    one = bound(scenario, EXPERIMENT, free).std
    loud = bound(scenario, replace(EXPERIMENT, noise_density=0.004), free).std
    hard = bound(scenario, replace(EXPERIMENT, lean_rate=1.0), free).std
    fast = bound(scenario, replace(EXPERIMENT, rate=1000.0), free).std
    for name in free:
        assert loud[name] == pytest.approx(2.0 * one[name], rel=1e-9)
        assert fast[name] == pytest.approx(one[name], rel=0.02)
    assert hard["speed"] == pytest.approx(one["speed"] / 2.0, rel=1e-6)
    assert hard["initial_lean_rate"] == pytest.approx(one["initial_lean_rate"], rel=1e-6)


def test_what_can_not_be_told_apart_has_no_bound() -> None:
    lean_only = replace(EXPERIMENT, channels=("lean_rate",))
    assert bound(load_scenario("tms_strike"), lean_only, BIASES).std.keys() == {"lean_rate_bias"}
    unstruck = replace(EXPERIMENT, lean_rate=0.0)
    assert bound(load_scenario("tms_strike"), unstruck, (*LEAN_RATE, "speed")).std == {}


def test_command(command: Any, refused: Any) -> None:
    document = json.loads(command("tms_study", "bound", "tms_strike", "--json").out)
    rows = document["bounds"]
    assert len(rows) == len(table(load_scenario("tms_strike"), tuple(document["free"])))
    assert rows[0]["rate"] == 100.0
    assert rows[0]["noise"] == pytest.approx(0.02)
    assert np.isfinite(rows[0]["std"]["initial_lean_rate"])
    text = command("tms_study", "bound", "tms_strike", "--free", "initial_lean_rate", "--set", "speed=4").out
    assert "Cramer-Rao" in text
    assert "free: unknown 'lean'" in refused("tms_study", "bound", "tms_strike", "--free", "lean")
    assert "expected a sensor with noise" in refused("tms_study", "bound", "tms_strike_ideal")


@pytest.mark.parametrize("rate", [25.0, 40.0, 100.0])
@pytest.mark.parametrize("duration", [4.2, 6.0])
@pytest.mark.quick_for(rate=[25.0, 100.0])
def test_samples_are_those_that_a_fit_uses(rate: float, duration: float, tmp_path: Path) -> None:
    # Both ends count, where the window ends the response and where the recording does: at 25 Hz one of 38.
    scenario = load_scenario("tms_strike", {"imu.rate": rate, "duration": duration, "strike.time": [3.0]})
    with BagWriter(tmp_path / "bag") as bag:
        for record in simulate(scenario, np.random.default_rng(1)).records():
            bag.write(record)
    recording = read_recording(tmp_path / "bag")
    (fit,) = fit_recording(
        recording, bicycle_of(recording, None), Settings(estimators=("least_squares",)), (3.0,)
    ).strikes
    assert fit.window is not None
    assert len(fit.window.time) == planned(scenario).count


def test_every_tenth_sample_of_a_fast_sensor_has_the_noise_of_a_fast_one() -> None:
    # sqrt(10) times the noise that a sensor has which averages down to its output rate.
    slow = planned(load_scenario("tms_strike"))
    picked = planned(load_scenario("tms_strike", {"imu.raw_rate": 1000.0}))
    assert (picked.rate, slow.rate) == (100.0, 100.0)
    assert picked.noise == pytest.approx(math.sqrt(10.0) * slow.noise, rel=1e-12)


def test_the_floor_slows_the_bicycle_down() -> None:
    # On C_r = 0.06, as in tests/fit/test_projection.py: 0.97 mrad/s alone, 1.40 with speed and C_r, C_r to
    # 0.7 %.
    scenario = load_scenario("tms_strike", {**ON_RUBBER, "speed_at_strike": 3.6})
    assert bound(scenario, EXPERIMENT, LEAN_RATE).std["initial_lean_rate"] == pytest.approx(0.97e-3, abs=5e-6)
    both = bound(scenario, EXPERIMENT, (*LEAN_RATE, "speed", "rolling_resistance")).std
    assert both["initial_lean_rate"] == pytest.approx(1.40e-3, abs=1e-5)
    assert both["rolling_resistance"] / 0.06 == pytest.approx(0.0070, abs=1e-4)


def test_a_ride_that_ends_sooner_has_no_later_samples() -> None:
    slow = load_scenario("tms_strike", {**ON_RUBBER, "speed_at_strike": 1.5})
    durations = [one.experiment.duration for one in table(slow, LEAN_RATE)]
    assert max(durations) < 1.5 / (0.06 * 9.81) < 3.0


def test_a_kick_of_the_steering_is_in_it_and_grows_with_the_strike() -> None:
    free = (*LEAN_RATE, "speed")
    kicked = load_scenario("gym_run", {"effects.rolling_resistance": False})
    by_hand = load_scenario("tms_strike", {"strike.lean_rate": 0.2, "strike.steer_rate": -7.0 * 0.2})
    plain = load_scenario("tms_strike", {"strike.lean_rate": 0.2})
    found, same, other = (
        bound(one, replace(EXPERIMENT, lean_rate=0.2), free).std for one in (kicked, by_hand, plain)
    )
    assert found["speed"] == pytest.approx(same["speed"], rel=0.02)  # the kick is -7.0 to two digits
    assert found["speed"] < 0.9 * other["speed"]
    harder = bound(kicked, replace(EXPERIMENT, lean_rate=0.4), free).std
    assert harder["speed"] == pytest.approx(found["speed"] / 2.0, rel=1e-6)


@pytest.mark.parametrize("name", PARAMETERS)
def test_every_parameter_has_a_bound(name: str) -> None:
    # Beside the lean rate, in a run that tells it: friction and slip were said not to be told apart from it.
    free = tuple(dict.fromkeys((*LEAN_RATE, name)))
    assert bound(load_scenario("tms_strike"), EXPERIMENT, free).std.keys() == set(free)
