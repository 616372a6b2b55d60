"""What tests of the simulator share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tms_sim.motion import Trajectory
from tms_sim.protocol import ride
from tms_sim.scenario import load_scenario

Ride = Callable[..., Trajectory]


@pytest.fixture
def go() -> Ride:
    """A ride of a scenario, keys with their dot written as two underscores."""

    def run(name: str, **changes: Any) -> Trajectory:
        scenario = load_scenario(name, {key.replace("__", "."): value for key, value in changes.items()})
        return ride(scenario, np.random.default_rng(scenario.integer("seed")))

    return run
