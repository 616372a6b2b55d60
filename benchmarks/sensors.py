"""What the simulated sensors cost, against real time and imufusion alone. See benchmarks/README.md."""

from __future__ import annotations

import argparse
from collections.abc import Callable

import imufusion
import numpy as np
from measure import in_turn, print_machine, print_timings
from tms_sim.protocol import ride
from tms_sim.scenario import Scenario, load_scenario
from tms_sim.sensors.imu_stream import imu_stream
from tms_sim.sensors.speed_stream import speed_stream
from tms_sim.truth import stamps

DURATION = 10.0  # [s]
EVERYTHING = {
    "imu.errors": "all",
    "imu.misalignment_deg": [1.0, -0.5, 0.8],
    "fusion.enabled": True,
    "floor_vibration.rms": 3.5,
    "padding.natural_frequency": 15.0,
    "wireless.range": 100.0,
    "wireless.loss": 0.02,
    "wireless.burst_start": 0.005,
    "wireless.latency": 0.01,
    "wireless.jitter": 0.005,
    "wireless.duplicates": 0.01,
    "wireless.clock_offset": 0.05,
    "wireless.clock_drift": 3e-5,
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few repeats: does it run?")
    repeats = 3 if parser.parse_args().quick else 41
    print_machine(("numpy", "scipy", "imufusion"))
    print(f"medians of {repeats} repeats, quartiles in brackets; a run of {DURATION:g} s, tms_strike")
    timings = in_turn(
        {
            "imufusion alone, 1000 updates": lambda: alone(1000),
            "inertial sensor, 100 Hz, noise and limits": sensing(rate=100.0),
            "inertial sensor, 100 Hz, everything on": sensing(rate=100.0, **EVERYTHING),
            "inertial sensor, 1 kHz, everything on": sensing(rate=1000.0, **EVERYTHING),
            "camera, motion at its instants included": filming(),
        },
        repeats,
    )
    print_timings("sensors", timings, "inertial sensor, 100 Hz, everything on")
    for name, timing in list(timings.items())[1:]:
        print(f"  {name}: {DURATION / timing.median:.0f} times faster than real time")


def sensing(rate: float, **changes: object) -> Callable[[], object]:
    """What the inertial sensor of a scenario makes of a known motion."""
    scenario = changed(**{"imu.rate": rate, **changes})
    trajectory = ride(scenario, np.random.default_rng(1))
    time_ns = stamps(rate, trajectory.end)
    motion = trajectory.at(time_ns / 1e9)
    return lambda: imu_stream(scenario, motion, time_ns, 9.81, np.random.default_rng(1))


def filming() -> Callable[[], object]:
    """What the camera makes of it."""
    scenario = changed(**{"speed_sensor.kind": "camera"})
    trajectory = ride(scenario, np.random.default_rng(1))
    return lambda: speed_stream(scenario, trajectory, np.random.default_rng(1))


def changed(**changes: object) -> Scenario:
    """The reference strike, 10 s long, with changes."""
    return load_scenario("tms_strike", {"duration": DURATION, **changes})


def alone(count: int) -> None:
    """The filter's own work."""
    ahrs = imufusion.Ahrs()
    rate, up, north = np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([20.0, 0.0, -40.0])
    for _ in range(count):
        ahrs.update(rate, up, north)
        ahrs.get_quaternion()


if __name__ == "__main__":
    main()
