"""Reads runs: strikes, least squares, Kalman filter and smoother, Figure 3B. Never imports the simulator.

    from tms_fit import fit
    result = fit(time, angular_velocity, speed=4.6, bicycle="tms_eq_10_1")
    print(result[0]["initial_lean_rate"])

Times are seconds, angular velocities rad/s in REP-103 axes; results carry the model's SAE signs (lean and yaw
to the right are positive), SI units and radians. Nothing here prints; only `tms_fit.nodes` needs ROS.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tms_fit.api import FitResult, fit, fit_recording, fit_window
    from tms_fit.estimate import Estimate, Estimates, Parameter, Status
    from tms_fit.recording_fit import find_strikes
    from tms_fit.settings import Settings
    from tms_fit.strike_fit import StrikeFit
    from tms_fit.window import Window

__version__ = "0.1.0"

__all__ = [
    "Estimate",
    "Estimates",
    "FitResult",
    "Parameter",
    "Settings",
    "Status",
    "StrikeFit",
    "Window",
    "find_strikes",
    "fit",
    "fit_recording",
    "fit_window",
]

# Modules of the public names, loaded when a name is first used: `--help` must not wait for numpy and scipy.
_MODULES = {
    "Estimate": "estimate",
    "Estimates": "estimate",
    "FitResult": "api",
    "Parameter": "estimate",
    "Settings": "settings",
    "Status": "estimate",
    "StrikeFit": "strike_fit",
    "Window": "window",
    "find_strikes": "recording_fit",
    "fit": "api",
    "fit_recording": "api",
    "fit_window": "api",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
