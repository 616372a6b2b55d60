"""Makes runs: scenarios, strike, sensors. Same scenario and seed: same samples, in a bag or from the node.

from tms_sim import simulate
simulate("tms_strike", seed=2).write("my_bag")
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tms_sim.api import simulate
    from tms_sim.run import SimulatedRun
    from tms_sim.scenario import Scenario, load_scenario, scenario_names

__version__ = "0.1.0"

__all__ = ["Scenario", "SimulatedRun", "load_scenario", "scenario_names", "simulate"]

# Modules of the public names, loaded when a name is first used: `--help` must not wait for numpy and scipy.
_MODULES = {
    "Scenario": "scenario",
    "SimulatedRun": "run",
    "load_scenario": "scenario",
    "scenario_names": "scenario",
    "simulate": "api",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
