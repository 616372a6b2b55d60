"""The keys of a scenario: for each its kind, unit, range, meaning and default.

A key without a default must stand in every scenario; the others stand there where they differ. As they are
when left out, nothing of their kind happens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from tms_model import ParameterError
from tms_model.catalogue import unquoted

Value = str | bool | int | float | tuple[float, ...]


@dataclass(frozen=True)
class Key:
    """One key of a scenario."""

    kind: type  # str, bool, int, float, tuple (of three floats) or list (one float, or one for each strike)
    meaning: str  # with its unit
    low: float = -math.inf
    high: float = math.inf
    default: Value | None = None  # None: must be said


KEYS: dict[str, Key] = {
    "bicycle": Key(str, "name in the catalogue of bicycles, or a .yaml file"),
    "speed": Key(
        float,
        "forward speed at the release [m/s]",
        0.1,
        30.0,
    ),
    "speed_at_strike": Key(
        float,
        "forward speed at the first strike instead; the launch is faster by what rolling"
        " costs until then; 0: speed holds [m/s]",
        0.0,
        30.0,
        0.0,
    ),
    "duration": Key(float, "longest that the run may last [s]", 0.1, 3600.0),
    "motion": Key(str, "linear or nonlinear: equations of the motion", default="linear"),
    "floor": Key(str, "name of the floor, or a .yaml file", default="ideal"),
    "wheels": Key(str, "name of the wheels, or a .yaml file", default="aluminium"),
    "intervention": Key(str, "what was changed at the bicycle, by name, or a .yaml file", default="none"),
    "effects.rolling_resistance": Key(bool, "the floor slows the bicycle down", default=False),
    "effects.slip": Key(bool, "wheels slide sideways where the floor's friction ends", default=False),
    "effects.steer_kick": Key(
        bool,
        "a strike turns the steering too; without it a hand holds the handlebars against the kick",
        default=False,
    ),
    "effects.scrub": Key(bool, "wheels resist turning on the spot", default=False),
    "effects.joints": Key(bool, "joints of the floor kick the steering", default=False),
    "effects.shimmy": Key(bool, "the steering oscillates by itself", default=False),
    "run_up.duration": Key(
        float, "time until the release, handlebars held; 0: released at the start [s]", 0.0, 600.0, 0.0
    ),
    "run_up.speed": Key(float, "speed at the start of the run-up [m/s]", 0.0, 30.0, 0.0),
    "release.lean_deg": Key(float, "standard deviation of the lean at the release [deg]", 0.0, 20.0, 0.0),
    "release.lean_rate": Key(
        float, "standard deviation of the lean rate at the release [rad/s]", 0.0, 2.0, 0.0
    ),
    "strike.time": Key(list, "when a strike falls [s since the start]", 0.0, 3600.0),
    "strike.lean_rate": Key(
        list, "lean rate that a strike gives to rolling wheels, positive to the right [rad/s]", -10.0, 10.0
    ),
    "strike.steer_rate": Key(
        list, "steer rate that a strike gives besides its kick, positive to the right [rad/s]", -100.0, 100.0
    ),
    "strike.duration": Key(float, "length of a strike, half a sine; 0: an instant [s]", 0.0, 1.0, 0.0),
    "strike.x": Key(float, "where it falls, ahead of the rear wheel contact [m]", -10.0, 10.0, 0.8),
    "strike.height": Key(float, "where it falls, above the floor [m]", 0.01, 10.0, 0.65),
    "catch.lean_deg": Key(
        float, "lean at which the experimenter catches the bicycle; 0: lets it fall [deg]", 0.0, 57.0, 0.0
    ),
    "catch.speed": Key(
        float, "speed at which the experimenter catches it; 0: lets it roll [m/s]", 0.0, 30.0, 0.0
    ),
    "catch.duration": Key(float, "time from the catch to a stand [s]", 0.05, 10.0, 0.5),
    "asymmetry.rear_frame": Key(
        float, "mass times its offset to the right, on the rear frame [kg m]", -1.0, 1.0, 0.0
    ),
    "asymmetry.front_frame": Key(
        float, "mass times its offset to the right, on the front frame [kg m]", -1.0, 1.0, 0.0
    ),
    "shimmy.frequency": Key(float, "of the steering's own oscillation [Hz]", 1.0, 100.0, 20.0),
    "shimmy.amplitude_deg": Key(float, "steer angle it tends to at high speed [deg]", 0.0, 5.0, 0.2),
    "shimmy.onset_speed": Key(float, "speed from which it grows [m/s]", 0.01, 30.0, 1.4),
    "shimmy.growth": Key(float, "growth rate at high speed [1/s]", 0.0, 1000.0, 10.0),
    "steer_torque.lean_rate_gain": Key(
        float, "steer torque per lean rate, 0: none [N m s/rad]", -1000.0, 1000.0
    ),
    "imu.grade": Key(str, "name of the inertial sensor"),
    "imu.rate": Key(float, "samples a second [Hz]", 1.0, 4000.0),
    "imu.position": Key(
        tuple, "place in rear_frame, REP-103 axes, from the rear wheel contact [m]", -10.0, 10.0
    ),
    "imu.orientation_deg": Key(
        tuple, "roll, pitch, yaw of imu_link in rear_frame, REP-103 [deg]", -360.0, 360.0
    ),
    "speed_sensor.rate": Key(float, "samples a second [Hz]", 0.1, 1000.0),
    "speed_sensor.noise": Key(float, "standard deviation of one sample [m/s]", 0.0, 10.0),
    "state_rate": Key(float, "samples of the truth a second [Hz]", 1.0, 4000.0),
    "seed": Key(int, "seed of all noise", 0, 2**63 - 1),
    # ROS counts the seconds of a stamp in 31 bits, and the longest run takes 3600 of them.
    "start_time_ns": Key(
        int, "time stamp of the start [ns]; ROS takes 0 for 'no time'", 1, (2**31 - 3601) * 10**9
    ),
}


def checked(key: str, value: Any) -> Value:
    """The value in the key's kind and range. Raises ParameterError."""
    rule = KEYS[key]
    if rule.kind is str or rule.kind is bool:
        if isinstance(value, rule.kind) and value != "":
            return bool(value) if rule.kind is bool else str(value)
        truth = ", true or false" if rule.kind is bool else ""
        raise ParameterError(f"{key}: expected {rule.meaning}{truth}, found {value!r}")
    many = rule.kind in (tuple, list) and isinstance(value, list | tuple)
    items = [unquoted(item) for item in value] if many else [unquoted(value)]
    note = {tuple: ", three numbers", int: ", a whole number", list: ", one or more"}.get(rule.kind, "")
    wanted = f"{rule.meaning}, from {rule.low:g} to {rule.high:g}{note}"
    if len(items) != 3 if rule.kind is tuple else not items:
        raise ParameterError(f"{key}: expected {wanted}, found {value!r}")
    for item in items:
        kinds = (int,) if rule.kind is int else (int, float)
        if isinstance(item, bool) or not isinstance(item, kinds) or not rule.low <= item <= rule.high:
            raise ParameterError(f"{key}: expected {wanted}, found {value!r}")
    if rule.kind is int:
        return int(items[0])
    numbers = tuple(float(item) for item in items)
    return numbers if rule.kind is tuple or len(numbers) > 1 else numbers[0]
