"""What the speedometer of a scenario gives: noisy samples, the camera's one figure, or an encoder's."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_bag.samples import SpeedSamples
from tms_model import ParameterError

from tms_sim.motion import Trajectory
from tms_sim.scenario import Scenario
from tms_sim.sensors.wheel_speed import Camera, Rolled, camera_speed, encoder_speed, rolled
from tms_sim.truth import stamps

KINDS = ("noise", "camera", "encoder")
STEP = 4e-3  # [s] between the speeds that are summed up to the way that a wheel rolls


@dataclass(frozen=True, eq=False)
class SpeedStream:
    """Samples of the speed; camera's and encoder's know their variance and come when complete."""

    samples: SpeedSamples
    arrival_ns: NDArray[np.int64] | None  # (n,) [ns] by the host's clock; None: at their stamps


def speed_stream(scenario: Scenario, trajectory: Trajectory, rng: np.random.Generator) -> SpeedStream:
    """What the speedometer gives. Raises ParameterError."""
    kind, start_ns = scenario.text("speed_sensor.kind"), scenario.integer("start_time_ns")
    time_ns = stamps(scenario.number("speed_sensor.rate"), trajectory.end)
    if kind == "noise":
        noise = scenario.number("speed_sensor.noise") * rng.standard_normal(len(time_ns))
        speed = trajectory.at(time_ns / 1e9).speed + noise
        return SpeedStream(SpeedSamples(start_ns + time_ns, speed), None)
    diameter = scenario.number("speed_sensor.wheel_diameter")
    if kind == "camera":
        camera = Camera(
            scenario.number("speed_sensor.camera_start"),
            scenario.number("speed_sensor.frame_rate"),
            diameter,
            scenario.integer("speed_sensor.turns"),
        )
        filmed = camera_speed(_rolled(trajectory), camera, start_ns, rng)
        half = camera.turns * math.pi * diameter / filmed.speed / 2.0
        return SpeedStream(filmed, filmed.time_ns + np.round(1e9 * half).astype(np.int64))
    if kind == "encoder":
        ticks = scenario.integer("speed_sensor.ticks")
        counted = encoder_speed(_rolled(trajectory), time_ns, ticks, diameter, start_ns, rng)
        return SpeedStream(counted, start_ns + time_ns[1:])
    raise ParameterError(f"speed_sensor.kind: expected one of {', '.join(KINDS)}, found {kind!r}")


def _rolled(trajectory: Trajectory) -> Rolled:
    time = np.append(np.arange(0.0, trajectory.end, STEP), trajectory.end)
    return rolled(time, trajectory.at(time).speed)
