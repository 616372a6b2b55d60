"""What a simulated run costs, against real time and a general integrator. See benchmarks/README.md."""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from measure import in_turn, print_machine, print_timings
from scipy.integrate import solve_ivp
from tms_bag import BagWriter, topics
from tms_model import load_bicycle
from tms_model.varying_speed import state_matrices
from tms_sim.protocol import ride
from tms_sim.run import simulate
from tms_sim.scenario import Scenario, load_scenario

DURATION = 10.0  # [s]
SWITCHES = ("rolling_resistance", "slip", "steer_kick", "scrub", "joints", "shimmy")
# Everything that moves the bicycle and everything that spoils its sensors, for the whole time.
EVERYTHING = {
    **{f"effects.{name}": True for name in SWITCHES},
    "duration": DURATION,
    "catch.speed": 0.0,
    "catch.lean_deg": 0.0,
    "strike.lean_rate": 0.1,
    "imu.errors": "all",
    "imu.misalignment_deg": [1.0, -0.5, 0.8],
    "fusion.enabled": True,
    "floor_vibration.rms": 3.5,
    "padding.natural_frequency": 15.0,
    "wireless.loss": 0.02,
    "wireless.latency": 0.01,
    "wireless.jitter": 0.005,
    "wireless.clock_drift": 3e-5,
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few repeats: does it run?")
    repeats = 3 if parser.parse_args().quick else 21
    print_machine(("numpy", "scipy"))
    print(f"medians of {repeats} repeats, quartiles in brackets; {DURATION:g} s")
    everything = load_scenario("gym_run", EVERYTHING)
    wood = load_scenario("gym_wood", EVERYTHING)
    coasting = load_scenario("tms_strike", {**COASTING, "duration": DURATION})
    timings = in_turn(
        {
            "solve_ivp, DOP853, coasting only": lambda: integrated(coasting),
            "ride, coasting only": riding(coasting),
            "ride, gym_run": riding(everything),
            "ride, gym_wood: 50 slides": riding(wood),
            "sim run gym_run, sensors and bag": lambda: whole_run("gym_run"),
            "sim run gym_wood, sensors and bag": lambda: whole_run("gym_wood"),
        },
        repeats,
    )
    print_timings("simulation", timings, "solve_ivp, DOP853, coasting only")
    for name, timing in timings.items():
        print(f"  {name}: {DURATION / timing.median:.0f} times faster than real time")
    for name in ("gym_run", "gym_wood"):
        spent = processor_time(lambda name=name: whole_run(name), repeats)  # type: ignore[misc]
        print(
            f"  sim run {name}: {1e3 * spent:.0f} ms of the processor,"
            f" {DURATION / spent:.0f} times faster than real time"
        )


COASTING = {"effects.rolling_resistance": True, "floor": "hard_wood", "strike.time": 0.1}


def processor_time(way: Callable[[], object], repeats: int) -> float:
    """Median time [s] that the processor spends on it: what other work on the machine touches less."""
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        way()
        spent.append(time.process_time() - start)
    return statistics.median(spent)


def riding(scenario: Scenario) -> Callable[[], object]:
    """The motion of a scenario, and its state at 100 Hz."""
    times = np.arange(1000) / 100.0

    def go() -> object:
        trajectory = ride(scenario, np.random.default_rng(1))
        return trajectory.at(times[times <= trajectory.end])

    return go


def integrated(scenario: Scenario) -> object:
    """The free response of the coasting bicycle as a general integrator finds it, as exactly."""
    bicycle = load_bicycle(scenario.text("bicycle"))
    slope = -0.015 * bicycle.gravity

    def change(time: float, state: np.ndarray) -> np.ndarray:
        return state_matrices(bicycle, np.array([3.6 + slope * time]), np.array([slope]))[0] @ state

    times = np.arange(990) / 100.0
    return solve_ivp(change, (0.0, 9.9), [0.0, 0.0, 0.5, 0.0], "DOP853", times, rtol=1e-10, atol=1e-12)


def whole_run(name: str) -> None:
    """What `tms sim run` does once Python has started: read the scenario, ride, measure, write the bag."""
    scenario = load_scenario(name, EVERYTHING)
    run = simulate(scenario, np.random.default_rng(1))
    with (
        tempfile.TemporaryDirectory() as folder,
        BagWriter(Path(folder) / "bag", custom_data=run.custom_data()) as bag,
    ):
        for record in run.records():
            bag.write(record, topics.QOS[record.topic.removeprefix("/")])


if __name__ == "__main__":
    main()
