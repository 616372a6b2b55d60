"""The bicycle: parameters -> matrices -> stability, response, ideal IMU kinematics, frames. No ROS.

Conventions of the whole project, told here and in docs/conventions.md:

- SI units and radians everywhere; degrees only in YAML keys that end in `_deg`.
- Model axes are SAE: x forward, y right, z down, origin at the rear wheel contact. Lean, steer and yaw to the
  right are positive. `tms_model.frames` is the one place that turns them into REP-103 axes and back.
- The state order is lean, steer, lean_rate, steer_rate (`tms_model.response.STATE`).
- Arrays are float64; a run's times are float seconds since its start, integer nanoseconds at every border.
"""

from tms_model.bicycle import Bicycle, assemble
from tms_model.catalogue import bicycle_names, load_bicycle
from tms_model.changes import parse_changes, with_parameters
from tms_model.characteristic import RouthTest, characteristic_polynomial, coefficients, routh
from tms_model.modes import Mode, ModeCourse, follow_modes, modes
from tms_model.parameters import ParameterError, WhippleParameters
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
