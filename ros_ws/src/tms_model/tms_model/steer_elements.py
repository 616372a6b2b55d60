"""What besides gravity and motion turns the steering: springs, dampers, and feedback of a controller.

    T_steer = -steer_spring steer - steer_damper steer_rate + lean_gain lean + lean_rate_gain lean_rate

A feedback of the steer angle or the steer rate is a spring or a damper of the other sign; a negative spring
is the decentering spring of SOM section 6.4 (T_delta = -k delta, k = -10 N m/rad).

Reference: Kooijman et al. 2011, supplement (SOM), doi 10.1126/science.1201959.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from tms_model.parameters import ParameterError


@dataclass(frozen=True)
class SteerElements:
    """Linear elements at the steering, zero where there is none. Raises ParameterError if not finite."""

    steer_spring: float = 0.0  # k [N m/rad], resists steer; negative: drives it away from the middle
    steer_damper: float = 0.0  # [N m s/rad], resists steer rate
    lean_gain: float = 0.0  # [N m/rad], steer torque per lean; positive steers into the fall
    lean_rate_gain: float = 0.0  # [N m s/rad], steer torque per lean rate; positive steers into the fall

    def __post_init__(self) -> None:
        for name in STEER_ELEMENT_NAMES:
            if not math.isfinite(getattr(self, name)):
                raise ParameterError(f"{name}: expected a finite number, found {getattr(self, name)}")

    @property
    def present(self) -> bool:
        """Whether there is any element at all."""
        return any(getattr(self, name) != 0.0 for name in STEER_ELEMENT_NAMES)

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """What they add to the stiffness matrix [N m/rad], (2, 2), rows and columns [lean, steer]."""
        return np.array([[0.0, 0.0], [0.0 - self.lean_gain, self.steer_spring]])

    @property
    def damping(self) -> NDArray[np.float64]:
        """What they add to the damping matrix [N m s/rad], (2, 2), rows and columns [lean, steer]."""
        return np.array([[0.0, 0.0], [0.0 - self.lean_rate_gain, self.steer_damper]])


STEER_ELEMENT_NAMES: tuple[str, ...] = tuple(field.name for field in fields(SteerElements))
