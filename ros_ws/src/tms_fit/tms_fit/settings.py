"""Settings of a fit: one table of options for command line, ROS parameters, JSON and reference page.

A new option is one row of `Settings`. The module imports neither numpy nor the bicycle, for a fast `--help`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, Literal

from tms_model.errors import ParameterError
from tms_model.resistance import RESISTANCES, Resistance

from tms_fit.parameters import CHANNELS, FRICTION, PARAMETERS, PRIORS, check_known

AUTO = "auto"
ASSUMPTIONS = ("upright", "no_kick")
DEFAULT_PRIORS = {  # standard deviations about zero [rad], [rad/s], of the estimator `strike`
    "onset_lean": math.radians(3.0),
    "onset_steer": math.radians(3.0),
    "onset_lean_rate": 0.2,
    "onset_steer_rate": 0.5,
    "strike_steer_rate": 0.3,  # beside that of a blow on the frame
    "lean_rate_bias": 0.02,
    "yaw_rate_bias": 0.02,
}
Kind = Literal["number", "numbers", "angles", "choice", "names", "values", "priors"]


@dataclass(frozen=True)
class Option:
    """One row of the options table."""

    name: str  # field of Settings, key in JSON
    kind: Kind  # how its value is written: a number, NAME,NAME, NAME=VALUE, NAME=MEAN,STD, ...
    default: Any
    help: str
    unit: str = ""  # of a number
    low: float = -math.inf  # least number allowed
    high: float = math.inf  # largest number allowed
    positive: bool = False  # whether a number must be larger than zero
    choices: tuple[str, ...] = ()  # names allowed
    unset: str = ""  # meaning of an option that is not given and has no default value
    metavar: str = ""  # on the command line
    flag: str = ""  # on the command line; empty: not offered there
    repeated: bool = False  # whether the command line takes one name each time
    parameter: str = ""  # of the node; empty: not offered there

    @property
    def text(self) -> str:
        """Description in one line, with unit and choices."""
        listed = self.choices and self.kind not in ("values", "priors")
        lead = "; one of " if self.kind == "choice" else ": "
        one_of = f"{lead}{', '.join(self.choices)}" if listed else ""
        return f"{self.help}{one_of}{f' [{self.unit}]' if self.unit else ''}"

    @property
    def limits(self) -> str:
        """Range of a number in words, empty without limits."""
        if self.positive:
            return f"a positive number of {self.unit}, at most {self.high:g}"
        return f"{self.low:g} to {self.high:g} {self.unit}" if math.isfinite(self.high) else ""

    def check(self, value: Any) -> None:
        """Raise ParameterError for a value out of range or an unknown name."""
        where = (self.flag or self.parameter).strip("-").replace("-", " ").replace("_", " ")
        if self.choices:
            check_known((value,) if self.kind == "choice" else value or (), self.choices, where)
        if self.kind != "number" or value is None:
            return
        if not self.low <= value <= self.high or (self.positive and value <= 0.0):
            raise ParameterError(f"{where}: expected {self.limits}, found {value:g}")


def option(
    kind: Kind, default: Any, help: str, *, command_line: bool = True, node: bool = True, **row: Any
) -> Any:
    """Field of `Settings` with its row of the table: fields of `Option` but for the name.

    `flag` and `parameter` follow from the name, or are empty where the option isn't offered.
    """
    metadata = {"kind": kind, "help": help, **row}
    metadata |= {} if command_line else {"flag": ""}
    metadata |= {} if node else {"parameter": ""}
    if isinstance(default, dict):
        return field(default_factory=dict, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Settings:
    """Settings of a fit, the only definition of its defaults.

    Raises ParameterError for unknown names, a parameter both free and fixed, a prior on one that is not free,
    numbers out of range.
    """

    free: tuple[str, ...] | None = option(
        "names",
        None,
        "parameters to estimate",
        choices=PARAMETERS,
        unset="initial_lean_rate, lean_rate_bias, yaw_rate_bias, and what the data asks for",
    )
    fixed: Mapping[str, float] = option(
        "values",
        {},
        "known parameters, SI units, such as speed=3.6",
        flag="--fix",
        parameter="fix",
        choices=PARAMETERS,
        unset="0, or what was measured",
    )
    priors: Mapping[str, tuple[float, float]] = option(
        "priors",
        {},
        "what is known beforehand of a free parameter: mean and standard deviation, SI units",
        flag="--prior",
        parameter="prior",
        choices=PRIORS,
        unset="nothing; for the estimator strike, its table of priors",
    )
    assume: tuple[str, ...] = option(
        "names",
        (),
        "what the estimator strike takes for true in place of a prior: the bicycle was upright, straight and"
        " at rest sideways before the strike; the strike did not turn the steering",
        choices=ASSUMPTIONS,
        unset="nothing",
    )
    window: float = option("number", 1.5, "longest free response used", unit="s", low=0.3, high=60.0)
    gyroscope_noise: float = option(
        "number",
        0.02,
        "standard deviation of the gyroscope where the recording does not state it, for the running filter",
        command_line=False,
        unit="rad/s",
        positive=True,
        high=10.0,
    )
    steer_torque: str = option(
        "choice",
        "auto",
        "how a known steer torque enters; auto: feedback where it is proportional to the lean rate, else"
        " input",
        choices=("auto", "feedback", "input", "ignore"),
    )
    speed_model: str = option(
        "choice",
        "auto",
        "the speed after the strike: as measured, constant, falling by rolling resistance, or auto: as"
        " measured where the samples show beyond doubt that it changes, else constant",
        choices=("auto", "measured", "constant", "decelerating"),
    )
    resistance: Resistance = option(  # noqa: RUF009  # which is what dataclasses.field is
        "choice", "rolling", "by what a speed that changes is changed", choices=RESISTANCES
    )
    channels: tuple[str, ...] = option("names", CHANNELS, "rates to compare with the model", choices=CHANNELS)
    noise: str = option(
        "choice",
        "auto",
        "noise model: white; autoregressive, as intervals need when neighbouring residuals are alike; white"
        " with an oscillation, such as a shimmy; or auto: white, and when they are alike the likelier of the"
        " others",
        choices=("auto", "white", "ar", "oscillator"),
    )
    oscillator: tuple[float, ...] = option(
        "numbers",
        (),
        "what is known of the noise's oscillation: frequency [Hz], decay time [s], deviation [rad/s]",
        metavar="HZ[,S[,RATE]]",
        unset="found from the residuals",
    )
    loss: str = option(
        "choice",
        "auto",
        "how much a residual counts: squares; huber and student_t, which outliers don't move; or auto:"
        " squares, and huber when the residuals hold outliers",
        choices=("auto", "squares", "huber", "student_t"),
    )
    gyroscope_range: float | None = option(
        "number",
        None,
        "rate at which the gyroscopes saturate",
        unit="rad/s",
        positive=True,
        high=1000.0,
        unset="only where imu/lean_yaw marks a sample",
    )
    saturation: str = option(
        "choice",
        "drop",
        "saturated samples are left out, taken as at least that large, or used as they are",
        choices=("drop", "censor", "use"),
    )
    slip_window: float = option(
        "number", 0.0, "time after the strike in which the front wheel slips", unit="s", low=0.0, high=10.0
    )
    slip: str = option(
        "choice",
        "leave_out",
        "leave that time out, or find an offset of the yaw rate that fades over it",
        choices=("leave_out", "yaw_offset"),
    )
    intervals: str = option(
        "choice",
        "wald",
        "95 % intervals by the covariance, by profiles of the squares, or by resampled residuals",
        choices=("wald", "profile", "bootstrap"),
    )
    noise_std: float | None = option(
        "number",
        None,
        "standard deviation of one sample that the residuals are compared with, as reduced chi-square; no"
        " estimate depends on it",
        node=False,
        unit="rad/s",
        positive=True,
        high=1000.0,
        unset="what the covariance in the IMU's messages says",
    )
    imu_orientation: tuple[float, ...] | str | None = option(
        "angles",
        None,
        "orientation of the sensor on the rear frame: turns about the frame's fixed axes x (forward), y"
        " (left), z (up), in this order; or auto: as gravity and strikes of the whole recording show it (not"
        " in the node)",
        unit="deg",
        metavar="ROLL,PITCH,YAW|auto",
        unset="as the recording states it, else 0,0,0",
    )
    filter: str = option(
        "choice",
        "linear",
        "filter that runs along: the speed is given, or estimated with the rolling resistance",
        command_line=False,
        choices=("linear", "extended"),
    )
    estimators: tuple[str, ...] = option(
        "names",
        ("least_squares", "kalman_rts"),
        "estimators, in order",
        flag="--estimator",
        choices=("least_squares", "kalman_rts", "som2011", "strike"),
        repeated=True,
    )

    @property
    def stated_speed(self) -> float:
        """Fixed speed [m/s], else the mean of its prior; NaN without either."""
        mean, _ = self.priors.get("speed", (math.nan, math.nan))
        return self.fixed.get("speed", mean)

    def as_json(self) -> dict[str, Any]:
        """All settings by name as JSON values: SI units, lists in place of tuples."""
        return {name: _plain(getattr(self, name)) for name in OPTIONS}

    def __post_init__(self) -> None:
        for name, one in OPTIONS.items():
            one.check(getattr(self, name))
        if not self.channels:
            raise ParameterError(f"channels: expected at least one of {', '.join(CHANNELS)}, found none")
        self._check_free()
        self._check_fixed()
        if not self.slip_window < self.window:
            raise ParameterError(
                f"slip window: expected 0 s to less than the window of {self.window:g} s, found"
                f" {self.slip_window:g}"
            )
        self._check_saturation()
        self._check_oscillator()
        self._check_orientation()

    def _check_fixed(self) -> None:
        """Check that fixed values are finite, a speed positive, a friction not negative."""
        for name, value in self.fixed.items():
            if not math.isfinite(value) or (name == "speed" and value <= 0.0):
                wanted = "a positive number of m/s" if name == "speed" else "a finite number"
                raise ParameterError(f"{name}: expected {wanted}, found {value:g}")
        if self.fixed.get(FRICTION, 0.0) < 0.0:
            raise ParameterError(f"{FRICTION}: expected 0 N m or more, found {self.fixed[FRICTION]:g}")

    def _check_saturation(self) -> None:
        """Check that censoring goes with white noise, squared loss and Wald intervals."""
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
        """Check that an oscillator has one to three positive numbers, and a noise model that uses them."""
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

    def _check_orientation(self) -> None:
        """Check that an orientation is auto or three finite angles."""
        given = self.imu_orientation
        if given is None or given == AUTO:
            return
        if isinstance(given, str) or len(given) != 3 or not all(math.isfinite(angle) for angle in given):
            found = given if isinstance(given, str) else ",".join(f"{angle:g}" for angle in given)
            raise ParameterError(f"imu orientation: expected ROLL,PITCH,YAW [deg] or {AUTO}, found {found}")

    def _check_free(self) -> None:
        """Check that free parameters, fixed values and priors are consistent."""
        if self.free is not None and not self.free:
            raise ParameterError(f"free: expected at least one of {', '.join(PARAMETERS)}, found none")
        twice = [name for name in self.free or () if (self.free or ()).count(name) > 1]
        if twice:
            raise ParameterError(f"free: {twice[0]}: found twice, expected each name once")
        both = [name for name in self.fixed if name in (self.free or ())]
        if both:
            raise ParameterError(f"{both[0]}: found both free and fixed; leave it out of one of the two")
        for name, (mean, std) in self.priors.items():
            beside = name not in PARAMETERS
            if name in self.fixed or (self.free is not None and name not in self.free and not beside):
                raise ParameterError(f"prior: {name}: expected a free parameter; add it to what is free")
            if not (math.isfinite(mean) and math.isfinite(std) and std > 0.0):
                raise ParameterError(
                    f"prior: {name}: expected a finite mean and a positive standard deviation, found"
                    f" {mean:g} and {std:g}"
                )
            if name == "speed" and mean <= 0.0:
                raise ParameterError(f"prior: speed: expected a positive mean of m/s, found {mean:g}")


def _rows() -> dict[str, Option]:
    """Table of options by name, from the fields of Settings."""
    table = {}
    for one in fields(Settings):
        row = {"flag": f"--{one.name.replace('_', '-')}", "parameter": one.name, **one.metadata}
        table[one.name] = Option(one.name, default={} if one.default is MISSING else one.default, **row)
    return table


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return list(value) if isinstance(value, tuple) else value


OPTIONS = _rows()  # by name
