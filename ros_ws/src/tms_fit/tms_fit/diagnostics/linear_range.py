"""Range of the linearised equations: a warning where a response leans or steers beyond it.

Free responses of the nonlinear bicycle (`tms_model.nonlinear_response`), fitted by the linear one over 1.5 s:
the error of the initial lean rate grows with the square of the largest angle, lean or steer. With Table 8.1,
Table 7.1 and the benchmark at 3.6 to 5 m/s it is below 0.12 % per square degree up to 20 degrees, whatever
else is free: 4 % at 6 degrees, 12 % at 10; beyond some 30 degrees it is larger.
`tests/fit/test_linear_range.py` holds the figure.
"""

from __future__ import annotations

import math

import numpy as np
from tms_model import linear_system
from tms_model.response import FASTEST, LEAN, STEER, response

from tms_fit.estimate import Estimate, Status
from tms_fit.parameters import INITIAL
from tms_fit.window import Window

LARGEST_ANGLE_DEG = 6.0  # of lean or steer, beyond which the warning is given
ERROR_PER_SQUARE_DEGREE = 0.0012  # of the initial lean rate, at most, relative


def largest_angles(window: Window, estimate: Estimate) -> tuple[float, float]:
    """Largest lean and steer angle [rad] of the fitted response within the window, at its start speed.

    NaN where the response was not estimated.
    """
    parameters = estimate.complete
    speed = parameters.get("speed", window.start_speed)
    if estimate.status != Status.OK or not 0.0 < speed <= FASTEST:
        return math.nan, math.nan
    system = linear_system(window.bicycle, speed, parameters.get("lean_rate_gain", window.lean_rate_gain))
    initial = np.array([parameters.get(name, 0.0) for name in INITIAL])
    states = response(system, initial, window.time + window.delay)
    return float(np.abs(states[:, LEAN]).max()), float(np.abs(states[:, STEER]).max())


def linear_range_warning(window: Window, estimate: Estimate) -> str:
    """One clause where the fitted response leans or steers beyond `LARGEST_ANGLE_DEG`; else empty."""
    lean, steer = (math.degrees(angle) for angle in largest_angles(window, estimate))
    angle = max(lean, steer)
    if not angle > LARGEST_ANGLE_DEG:
        return ""
    share = ERROR_PER_SQUARE_DEGREE * angle**2
    size = f"up to {100.0 * share:.0f} %" if share < 0.5 else "any amount"
    return (
        f"the response leans up to {lean:.1f} and steers up to {steer:.1f} degrees;"
        f" beyond {LARGEST_ANGLE_DEG:.0f} degrees the linear equations don't hold, and the initial"
        f" lean rate may be off by {size} besides its interval; strike less, or use a shorter --window"
    )
