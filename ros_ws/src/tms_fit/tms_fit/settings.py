"""What a fit is asked to do."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from tms_model import ParameterError
from tms_model.acceleration import RESISTANCES, Resistance
from tms_model.response import STATE

from tms_fit.least_squares.losses import LOSSES

INITIAL = tuple(
    f"initial_{name}" for name in STATE
)  # initial_lean, initial_steer, initial_lean_rate, initial_steer_rate
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
DEFAULT_FREE = ("initial_lean_rate", "lean_rate_bias", "yaw_rate_bias")

STEER_TORQUES = ("auto", "feedback", "input", "ignore")
SPEED_MODELS = ("auto", "measured", "constant", "decelerating")
NOISE_MODELS = ("auto", "white", "ar", "oscillator")
SATURATIONS = ("drop", "censor", "use")
SLIPS = ("leave_out", "yaw_offset")
INTERVALS = ("wald", "profile", "bootstrap")
FILTERS = ("linear", "extended")


@dataclass(frozen=True)
class Settings:
    """Settings of a fit; a default stands here and nowhere else.

    Raises ParameterError for unknown names, a parameter both free and fixed, a prior on one that is not free,
    numbers out of range.
    """

    free: tuple[str, ...] | None = None  # of PARAMETERS; None: DEFAULT_FREE, no bias of an absent channel
    fixed: Mapping[str, float] = field(default_factory=dict)  # SI; others are 0, or what was measured
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # mean and standard deviation, SI
    window: float = 1.5  # [s], longest free response used
    gyroscope_noise: float = (
        0.02  # [rad/s], standard deviation where the recording does not state it (running filter)
    )
    steer_torque: str = "auto"  # how a known steer torque enters, of STEER_TORQUES
    speed_model: str = "auto"  # how the speed goes on after the strike, of SPEED_MODELS
    resistance: Resistance = "rolling"  # by what a speed that changes is changed, of RESISTANCES
    channels: tuple[str, ...] = CHANNELS  # compared with the model
    noise: str = "auto"  # of NOISE_MODELS; auto: white, unless residuals are alike
    oscillator: tuple[float, ...] = ()  # its frequency [Hz], decay time [s], deviation [rad/s]: what is known
    loss: str = "auto"  # how much a residual counts, of LOSSES; auto: squares, unless there are outliers
    gyroscope_range: float | None = None  # [rad/s], at which a reading is saturated; None: only flags say so
    saturation: str = "drop"  # what saturated samples are taken for, of SATURATIONS
    slip_window: float = 0.0  # [s] after the strike, in which the front wheel slips
    slip: str = "leave_out"  # what is done with that time, of SLIPS
    intervals: str = "wald"  # how 95 % intervals are found, of INTERVALS
    noise_std: float | None = None  # [rad/s] of one sample, to compare residuals with; None: as recorded
    filter: str = "linear"  # that runs along, of FILTERS: the speed is given, or estimated with C_r
    estimators: tuple[str, ...] = ("least_squares", "kalman_rts")

    @property
    def fixed_linear(self) -> dict[str, float]:
        """Those of the fixed parameters that the response is linear in."""
        return {name: value for name, value in self.fixed.items() if name in LINEAR}

    @property
    def stated_speed(self) -> float:
        """The speed [m/s] that is fixed, else what is known of it beforehand; NaN: neither."""
        mean, _ = self.priors.get("speed", (math.nan, math.nan))
        return self.fixed.get("speed", mean)

    def __post_init__(self) -> None:
        check_known(self.free or (), PARAMETERS, "free")
        check_known(self.fixed, PARAMETERS, "fix")
        check_known(self.priors, PARAMETERS, "prior")
        check_known((self.steer_torque,), STEER_TORQUES, "steer torque")
        check_known((self.speed_model,), SPEED_MODELS, "speed model")
        check_known((self.resistance,), RESISTANCES, "resistance")
        check_known(self.channels, CHANNELS, "channels")
        check_known((self.noise,), NOISE_MODELS, "noise")
        check_known((self.loss,), LOSSES, "loss")
        check_known((self.saturation,), SATURATIONS, "saturation")
        check_known((self.slip,), SLIPS, "slip")
        check_known((self.intervals,), INTERVALS, "intervals")
        check_known((self.filter,), FILTERS, "filter")
        if not self.channels:
            raise ParameterError(f"channels: expected at least one of {', '.join(CHANNELS)}, found none")
        self._check_free()
        for name, value in self.fixed.items():
            if not math.isfinite(value) or (name == "speed" and value <= 0.0):
                wanted = "a positive number of m/s" if name == "speed" else "a finite number"
                raise ParameterError(f"{name}: expected {wanted}, found {value:g}")
        if self.fixed.get(FRICTION, 0.0) < 0.0:
            raise ParameterError(f"{FRICTION}: expected 0 N m or more, found {self.fixed[FRICTION]:g}")
        if not 0.3 <= self.window <= 60.0:
            raise ParameterError(f"window: expected 0.3 to 60 s, found {self.window:g}")
        if not 0.0 <= self.slip_window < self.window:
            raise ParameterError(
                f"slip window: expected 0 s to less than the window of {self.window:g} s, found"
                f" {self.slip_window:g}"
            )
        self._check_saturation()
        self._check_oscillator()
        if self.noise_std is not None and not (math.isfinite(self.noise_std) and self.noise_std > 0.0):
            raise ParameterError(f"noise std: expected a positive number of rad/s, found {self.noise_std:g}")
        if not (math.isfinite(self.gyroscope_noise) and self.gyroscope_noise > 0.0):
            raise ParameterError(
                f"gyroscope noise: expected a positive number of rad/s, found {self.gyroscope_noise:g}"
            )

    def _check_saturation(self) -> None:
        """A range is positive; censoring needs white noise, squares, and intervals by them."""
        if self.gyroscope_range is not None and not self.gyroscope_range > 0.0:
            raise ParameterError(
                f"gyroscope range: expected a positive number of rad/s, found {self.gyroscope_range:g}"
            )
        coloured = self.noise not in ("auto", "white")
        if self.saturation == "censor" and (coloured or self.loss not in ("auto", "squares")):
            raise ParameterError(
                f"saturation: censor goes with white noise and squares, found noise {self.noise} and loss"
                f" {self.loss}; use drop"
            )
        if self.saturation == "censor" and self.intervals != "wald":
            raise ParameterError(
                f"saturation: censor goes with intervals wald, found {self.intervals}; use drop"
            )

    def _check_oscillator(self) -> None:
        """What is known of it: one to three positive numbers, where it may be chosen."""
        if not self.oscillator:
            return
        if self.noise not in ("auto", "oscillator"):
            raise ParameterError(f"oscillator: expected noise oscillator or auto, found {self.noise}")
        if len(self.oscillator) > 3 or not all(math.isfinite(one) and one > 0.0 for one in self.oscillator):
            found = ",".join(f"{one:g}" for one in self.oscillator)
            raise ParameterError(
                "oscillator: expected a frequency [Hz], then a decay time [s], then a deviation [rad/s], each"
                f" positive, found {found}"
            )

    def _check_free(self) -> None:
        """What is free, fixed and known beforehand must go together."""
        if self.free is not None and not self.free:
            raise ParameterError(f"free: expected at least one of {', '.join(PARAMETERS)}, found none")
        twice = [name for name in self.free or () if (self.free or ()).count(name) > 1]
        if twice:
            raise ParameterError(f"free: {twice[0]}: found twice, expected each name once")
        both = [name for name in self.fixed if name in (self.free or ())]
        if both:
            raise ParameterError(f"{both[0]}: found both free and fixed; leave it out of one of the two")
        for name, (mean, std) in self.priors.items():
            if name in self.fixed or (self.free is not None and name not in self.free):
                raise ParameterError(f"prior: {name}: expected a free parameter; add it to what is free")
            if not (math.isfinite(mean) and math.isfinite(std) and std > 0.0):
                raise ParameterError(
                    f"prior: {name}: expected a finite mean and a positive standard deviation, found"
                    f" {mean:g} and {std:g}"
                )
            if name == "speed" and mean <= 0.0:
                raise ParameterError(f"prior: speed: expected a positive mean of m/s, found {mean:g}")


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
