"""Names of the parameters of a fit, of its channels, and of how the response depends on them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from tms_model.errors import ParameterError

INITIAL = (  # the state at the start of the free response, in the order of tms_model.response.STATE
    "initial_lean",  # [rad]
    "initial_steer",  # [rad]
    "initial_lean_rate",  # [rad/s]
    "initial_steer_rate",  # [rad/s]
)
STRIKE = (  # changes that the force of a strike alone makes, M^-1 times its time integral
    "strike_lean_rate",  # [rad/s]
    "strike_steer_rate",  # [rad/s]
)
ONSET = ("onset_lean", "onset_steer", "onset_lean_rate", "onset_steer_rate")  # the state before the force
BIASES = ("lean_rate_bias", "yaw_rate_bias")  # [rad/s], one per channel, in this order
CHANNELS = ("lean_rate", "yaw_rate")
SLIP = "slip_yaw_rate"  # [rad/s] at the start, falling to zero in a straight line over the slip window
LINEAR = (*INITIAL, *BIASES, SLIP)
FRICTION = "steer_coulomb_friction"  # [N m] against the turning of the steering, whatever its rate
NONLINEAR = (
    "speed",  # [m/s] at the start of the free response
    "rolling_resistance",  # C_r [-]: the speed falls by C_r g m / m_eff per second
    "strike_time",  # [s] start of the free response, from the window's first sample on; not positive
    "lean_rate_gain",  # [N m s/rad] steer torque per lean rate, by a controller
    "steer_damper",  # [N m s/rad] steer torque against the steer rate, beside the bicycle's own
    "mounting_pitch",  # [rad] of the sensor, nose up: leaks lean rate into its yaw rate
    FRICTION,  # with it, the response isn't linear in INITIAL either
)
PARAMETERS = (*LINEAR, *NONLINEAR)
PRIORS = (*PARAMETERS, "strike_steer_rate", *ONSET)  # parameters that may have a prior
DEFAULT_FREE = ("initial_lean_rate", "lean_rate_bias", "yaw_rate_bias")
UNITS = {  # by parameter
    "strike_lean_rate": "rad/s",
    "strike_steer_rate": "rad/s",
    "initial_lean": "rad",
    "initial_steer": "rad",
    "initial_lean_rate": "rad/s",
    "initial_steer_rate": "rad/s",
    "lean_rate_bias": "rad/s",
    "yaw_rate_bias": "rad/s",
    SLIP: "rad/s",
    "speed": "m/s",
    "rolling_resistance": "1",
    "strike_time": "s",
    "lean_rate_gain": "N m s/rad",
    "steer_damper": "N m s/rad",
    "mounting_pitch": "rad",
    FRICTION: "N m",
}


def shaping(values: Mapping[str, float], names: Iterable[str] = ()) -> dict[str, float]:
    """Those of some values that a response isn't linear in, beside others that are given by name only."""
    rubbing = FRICTION in values or FRICTION in names
    return {
        name: value for name, value in values.items() if name in NONLINEAR or (rubbing and name in INITIAL)
    }


def check_known(names: Iterable[str], expected: Iterable[str], what: str) -> None:
    """Raise ParameterError for a name that is not expected; `what` says where it stands."""
    for name in names:
        if name not in expected:
            raise ParameterError(f"{what}: unknown {name!r}; expected of {', '.join(expected)}")
