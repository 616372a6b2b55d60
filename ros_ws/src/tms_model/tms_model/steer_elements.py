"""What besides gravity and motion turns the steering: springs, dampers, feedback, a controller's actuator.

    T_steer = -steer_spring steer - steer_damper steer_rate + lean_gain lean + lean_rate_gain lean_rate
              + steer_torque_gain T_known

A feedback of the steer angle or the steer rate is a spring or a damper of the other sign; a negative spring
is the decentering spring of SOM section 6.4 (T_delta = -k delta, k = -10 N m/rad).

T_known is what a run's controller commands, or what its recording says; how much of it arrives at the fork
(motor constant, gear) belongs to the bicycle, what was commanded to the run.

Reference: Kooijman et al. 2011, supplement (SOM), doi 10.1126/science.1201959.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from tms_model.errors import ParameterError


@dataclass(frozen=True)
class SteerElements:
    """Linear elements at the steering; the defaults do nothing. Raises ParameterError if not finite."""

    steer_spring: float = 0.0  # k [N m/rad], resists steer; negative: drives it away from the middle
    steer_damper: float = 0.0  # [N m s/rad], resists steer rate
    lean_gain: float = 0.0  # [N m/rad], steer torque per lean; positive steers into the fall
    lean_rate_gain: float = 0.0  # [N m s/rad], steer torque per lean rate; positive steers into the fall
    steer_torque_gain: float = 1.0  # [-], torque at the fork per N m that is commanded or recorded

    def __post_init__(self) -> None:
        for name in STEER_ELEMENT_NAMES:
            if not math.isfinite(getattr(self, name)):
                raise ParameterError(f"{name}: expected a finite number, found {getattr(self, name)}")

    @property
    def present(self) -> bool:
        """Whether there is any element at all."""
        return bool(self.acting)

    @property
    def acting(self) -> dict[str, float]:
        """Those that do something, by name."""
        values = {one.name: float(getattr(self, one.name)) for one in fields(self)}
        return {one.name: values[one.name] for one in fields(self) if values[one.name] != one.default}

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """What they add to the stiffness matrix [N m/rad], (2, 2), rows and columns [lean, steer]."""
        return np.array([[0.0, 0.0], [0.0 - self.lean_gain, self.steer_spring]])

    @property
    def damping(self) -> NDArray[np.float64]:
        """What they add to the damping matrix [N m s/rad], (2, 2), rows and columns [lean, steer]."""
        return np.array([[0.0, 0.0], [0.0 - self.lean_rate_gain, self.steer_damper]])


STEER_ELEMENT_NAMES: tuple[str, ...] = tuple(field.name for field in fields(SteerElements))
