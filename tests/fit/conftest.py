"""Runs, and their fit, without the way over a bag."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tms_fit.recording_fit import fit_recording
from tms_fit.settings import Settings
from tms_fit.strike_fit import StrikeFit
from tms_model import load_bicycle
from tms_sim.run import SimulatedRun, simulate
from tms_sim.scenario import load_scenario

MakeRun = Callable[..., SimulatedRun]
FitRun = Callable[..., list[StrikeFit]]


@pytest.fixture(scope="session")
def make_run() -> MakeRun:
    """A run of a scenario, keys with their dot written as two underscores."""

    def make(name: str = "tms_strike", **changes: Any) -> SimulatedRun:
        scenario = load_scenario(name, {key.replace("__", "."): value for key, value in changes.items()})
        return simulate(scenario, np.random.default_rng(scenario.integer("seed")))

    return make


@pytest.fixture(scope="session")
def fit_run() -> FitRun:
    """Strikes of a run and their estimates; settings as those of Settings."""

    def fit(run: SimulatedRun, **settings: Any) -> list[StrikeFit]:
        fits = fit_recording(run.recording(), load_bicycle(run.info.bicycle), Settings(**settings))
        return list(fits.strikes)

    return fit
