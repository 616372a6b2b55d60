"""The bicycle: parameters -> matrices -> stability, response, ideal IMU kinematics, frames. No ROS.

Conventions of the whole project, stated here and in docs/conventions.md:

- SI units and radians everywhere; degrees only in YAML keys that end in `_deg`.
- Model axes are SAE: x forward, y right, z down, origin at the rear wheel contact. Lean, steer and yaw to the
  right are positive. `tms_model.frames` is the one place that turns them into REP-103 axes and back.
- The state order is lean, steer, lean_rate, steer_rate (`tms_model.response.STATE`).
- Arrays are float64; a run's times are float seconds since its start, integer nanoseconds at every border.

>>> from tms_model import eigenvalues, load_bicycle, stability
>>> bicycle = load_bicycle("benchmark")
>>> [f"{root.real:.3f} {root.imag:+.3f}i" for root in eigenvalues(bicycle, speed=5.0)]
['-14.078 +0.000i', '-0.775 -4.465i', '-0.775 +4.465i', '-0.323 +0.000i']
>>> f"{stability(bicycle).weave_speed:.4f} m/s"
'4.2924 m/s'
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tms_model.bicycle import Bicycle, assemble
    from tms_model.catalogue import bicycle_names, load_bicycle
    from tms_model.changes import parse_changes, with_parameters
    from tms_model.characteristic import RouthTest, characteristic_polynomial, coefficients, routh
    from tms_model.errors import ParameterError
    from tms_model.modes import Mode, ModeCourse, follow_modes, modes
    from tms_model.parameters import WhippleParameters
    from tms_model.response import LinearSystem, discretise, linear_system, response, yaw_rate
    from tms_model.stability import (
        Boundary,
        DoubleRoot,
        Stability,
        boundaries,
        double_roots,
        eigenvalues,
        stability,
    )
    from tms_model.steer_elements import SteerElements

__version__ = "0.1.0"

__all__ = [
    "Bicycle",
    "Boundary",
    "DoubleRoot",
    "LinearSystem",
    "Mode",
    "ModeCourse",
    "ParameterError",
    "RouthTest",
    "Stability",
    "SteerElements",
    "WhippleParameters",
    "assemble",
    "bicycle_names",
    "boundaries",
    "characteristic_polynomial",
    "coefficients",
    "discretise",
    "double_roots",
    "eigenvalues",
    "follow_modes",
    "linear_system",
    "load_bicycle",
    "modes",
    "parse_changes",
    "response",
    "routh",
    "stability",
    "with_parameters",
    "yaw_rate",
]

# Modules of the public names, loaded when a name is first used: `--help` must not wait for numpy and scipy.
_MODULES = {
    "Bicycle": "bicycle",
    "Boundary": "stability",
    "DoubleRoot": "stability",
    "LinearSystem": "response",
    "Mode": "modes",
    "ModeCourse": "modes",
    "ParameterError": "errors",
    "RouthTest": "characteristic",
    "Stability": "stability",
    "SteerElements": "steer_elements",
    "WhippleParameters": "parameters",
    "assemble": "bicycle",
    "bicycle_names": "catalogue",
    "boundaries": "stability",
    "characteristic_polynomial": "characteristic",
    "coefficients": "characteristic",
    "discretise": "response",
    "double_roots": "stability",
    "eigenvalues": "stability",
    "follow_modes": "modes",
    "linear_system": "response",
    "load_bicycle": "catalogue",
    "modes": "modes",
    "parse_changes": "changes",
    "response": "response",
    "routh": "characteristic",
    "stability": "stability",
    "with_parameters": "changes",
    "yaw_rate": "response",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


class _Package(ModuleType):
    """Package in which `stability`, `response` and `modes` are functions, not the modules of these names."""

    def __setattr__(self, name: str, value: Any) -> None:
        hides_function = isinstance(value, ModuleType) and _MODULES.get(name) == name
        super().__setattr__(name, getattr(value, name) if hides_function else value)


sys.modules[__name__].__class__ = _Package
