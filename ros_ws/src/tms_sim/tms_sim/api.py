"""Simulated runs: the public function of `tms_sim`."""

from __future__ import annotations

from typing import Any

import numpy as np

from tms_sim import run
from tms_sim.run import SimulatedRun
from tms_sim.scenario import Scenario, changed_scenario, load_scenario


def simulate(scenario: str | Scenario, seed: int | None = None, **changes: Any) -> SimulatedRun:
    """Run of a scenario: samples of its sensors and the truth.

    Parameters
    ----------
    scenario : str or Scenario
        Name (of `scenario_names()`), .yaml file, or scenario.
    seed : int, optional
        Seed of all noise; None: the scenario's. Same scenario and seed: same samples.
    **changes
        Keys of the scenario with other values; a dot is written as two underscores, `strike__lean_rate=0.3`.
        SI units, degrees where a key ends in `_deg`.

    Raises
    ------
    ParameterError
        For unknown scenarios and keys, and for values that don't go together.

    Examples
    --------
    >>> run = simulate("tms_strike", seed=2, strike__lean_rate=0.3)
    >>> run.imu.angular_velocity.shape[1], run.info.seed
    (3, 2)
    >>> run.write("struck")  # doctest: +SKIP

    """
    keys = {name.replace("__", "."): value for name, value in changes.items()}
    keys |= {} if seed is None else {"seed": seed}
    loaded = load_scenario(scenario) if isinstance(scenario, str) else scenario
    chosen = changed_scenario(loaded, keys)
    return run.simulate(chosen, np.random.default_rng(chosen.integer("seed")))
