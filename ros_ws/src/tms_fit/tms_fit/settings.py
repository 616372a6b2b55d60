"""What a fit is asked to do."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from tms_model import ParameterError
from tms_model.response import STATE

INITIAL = tuple(
    f"initial_{name}" for name in STATE
)  # initial_lean, initial_steer, initial_lean_rate, initial_steer_rate
BIASES = ("lean_rate_bias", "yaw_rate_bias")  # [rad/s], one per channel, in this order
CHANNELS = ("lean_rate", "yaw_rate")
LINEAR = (*INITIAL, *BIASES)
FIXED_ONLY = ("speed", "lean_rate_gain")  # [m/s], [N m s/rad]; never free
DEFAULT_FREE = ("initial_lean_rate", "lean_rate_bias", "yaw_rate_bias")


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit; a default stands here and nowhere else.

    Raises ParameterError for unknown names, a parameter both free and fixed, a window out of range.
    """

    free: tuple[str, ...] | None = None  # None: DEFAULT_FREE, without the bias of a channel that is not there
    fixed: dict[str, float] = field(
        default_factory=dict
    )  # SI; `speed` and any linear parameter; others are 0
    window: float = 1.5  # [s], longest free response used
    gyroscope_noise: float = (
        0.02  # [rad/s], standard deviation where the recording does not state it (running filter)
    )
    steer_torque: str = "auto"  # how a known steer torque enters: auto, feedback, input, ignore
    estimators: tuple[str, ...] = ("least_squares", "kalman_rts")

    @property
    def fixed_linear(self) -> dict[str, float]:
        """Those of the fixed parameters that the response is linear in."""
        return {name: value for name, value in self.fixed.items() if name in LINEAR}

    def __post_init__(self) -> None:
        check_known(self.free or (), LINEAR, "free")
        check_known(self.fixed, (*LINEAR, *FIXED_ONLY), "fix")
        check_known((self.steer_torque,), ("auto", "feedback", "input", "ignore"), "steer torque")
        if self.free is not None and not self.free:
            raise ParameterError(f"free: expected at least one of {', '.join(LINEAR)}, found none")
        twice = [name for name in self.free or () if (self.free or ()).count(name) > 1]
        if twice:
            raise ParameterError(f"free: {twice[0]}: found twice, expected each name once")
        both = [name for name in self.fixed if name in (self.free or ())]
        if both:
            raise ParameterError(f"{both[0]}: found both free and fixed; leave it out of one of the two")
        for name, value in self.fixed.items():
            if not math.isfinite(value) or (name == "speed" and value <= 0.0):
                wanted = "a positive number of m/s" if name == "speed" else "a finite number"
                raise ParameterError(f"{name}: expected {wanted}, found {value:g}")
        if not 0.3 <= self.window <= 60.0:
            raise ParameterError(f"window: expected 0.3 to 60 s, found {self.window:g}")
        if not (math.isfinite(self.gyroscope_noise) and self.gyroscope_noise > 0.0):
            raise ParameterError(
                f"gyroscope noise: expected a positive number of rad/s, found {self.gyroscope_noise:g}"
            )


def check_known(names: Iterable[str], expected: Iterable[str], what: str) -> None:
    """Raise ParameterError for a name that is not expected; `what` says where it stands."""
    for name in names:
        if name not in expected:
            raise ParameterError(f"{what}: unknown {name!r}; expected of {', '.join(expected)}")
