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
    "effects.nonlinear": Key(
        bool,
        "the nonlinear bicycle rides, on wheels that roll; the run tells how far it departs",
        default=False,
    ),
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
    "imu.raw_rate": Key(
        float,
        "samples a second on imu/data_raw, a whole multiple of imu.rate; 0: imu.rate [Hz]",
        0.0,
        4000.0,
        0.0,
    ),
    "imu.position": Key(
        tuple, "place in rear_frame, REP-103 axes, from the rear wheel contact [m]", -10.0, 10.0
    ),
    "imu.orientation_deg": Key(
        tuple, "roll, pitch, yaw of imu_link in rear_frame, REP-103 [deg]", -360.0, 360.0
    ),
    "imu.errors": Key(
        str,
        "errors of its grade that act, with commas between: noise_density, random_walk, bias, scale,"
        " misalignment, resolution, limit; or all, none",
        default="noise_density, limit",
    ),
    "imu.misalignment_deg": Key(
        tuple,
        "roll, pitch, yaw by which imu_link really sits turned from there, told to nobody [deg]",
        -180.0,
        180.0,
        (0.0, 0.0, 0.0),
    ),
    "fusion.enabled": Key(
        bool,
        "the sensor finds its own orientation: imu/data, imu/mag, and imu/lean_yaw goes by it; without it"
        " imu/lean_yaw goes by the true lean",
        default=False,
    ),
    "fusion.gain": Key(float, "how fast accelerometers and magnetometers pull [1/s]", 0.0, 10.0, 0.5),
    "fusion.acceleration_rejection_deg": Key(
        float, "accelerometers farther off are not believed; 0: always believed [deg]", 0.0, 90.0, 0.0
    ),
    "fusion.magnetic_rejection_deg": Key(
        float, "magnetometers farther off are not believed; 0: always believed [deg]", 0.0, 90.0, 0.0
    ),
    "fusion.rejection_timeout": Key(float, "after which they are believed again [s]", 0.0, 3600.0, 5.0),
    "magnetic_field.flux_density": Key(float, "of the Earth's field [T]", 0.0, 1e-3, 49e-6),
    "magnetic_field.inclination_deg": Key(float, "of it below the horizontal [deg]", -90.0, 90.0, 67.0),
    "magnetic_field.heading_deg": Key(
        float, "heading at the start, clockwise from magnetic north [deg]", -360.0, 360.0, 90.0
    ),
    "floor_vibration.rms": Key(
        float, "vertical acceleration of the frame at 3.6 m/s, from 20 to 300 Hz [m/s^2]", 0.0, 100.0, 0.0
    ),
    "padding.natural_frequency": Key(
        float, "of the sensor on its padding; 0: no padding [Hz]", 0.0, 300.0, 0.0
    ),
    "padding.damping_ratio": Key(float, "of the padding [1]", 0.01, 10.0, 0.2),
    "wireless.range": Key(float, "beyond it from the start nothing arrives; 0: no limit [m]", 0.0, 1e6, 0.0),
    "wireless.loss": Key(float, "probability that a packet is lost, each by itself [1]", 0.0, 1.0, 0.0),
    "wireless.burst_start": Key(
        float, "probability that the link turns bad with a packet [1]", 0.0, 1.0, 0.0
    ),
    "wireless.burst_end": Key(float, "probability that it turns good again [1]", 1e-6, 1.0, 0.2),
    "wireless.burst_loss": Key(float, "probability of a loss while it is bad [1]", 0.0, 1.0, 1.0),
    "wireless.latency": Key(float, "shortest time that a packet takes [s]", 0.0, 60.0, 0.0),
    "wireless.jitter": Key(float, "mean of what comes on top, exponential [s]", 0.0, 60.0, 0.0),
    "wireless.duplicates": Key(float, "probability that a packet arrives twice [1]", 0.0, 1.0, 0.0),
    "wireless.clock_offset": Key(float, "sensor's clock ahead of the host's [s]", -3600.0, 3600.0, 0.0),
    "wireless.clock_drift": Key(
        float, "how much faster the sensor's clock runs than the host's [s/s]", -0.01, 0.01, 0.0
    ),
    "speed_sensor.rate": Key(float, "samples a second [Hz]", 0.1, 1000.0),
    "speed_sensor.noise": Key(float, "standard deviation of one sample [m/s]", 0.0, 10.0),
    "speed_sensor.kind": Key(str, "noise, camera or encoder", default="noise"),
    "speed_sensor.wheel_diameter": Key(float, "of the wheel that is watched [m]", 0.01, 3.0, 0.1),
    "speed_sensor.camera_start": Key(
        float, "time from which the camera's turns are counted [s since the start]", 0.0, 3600.0, 0.0
    ),
    "speed_sensor.frame_rate": Key(float, "of the camera [Hz]", 1.0, 1e5, 300.0),
    "speed_sensor.turns": Key(int, "of the wheel that are counted", 1, 1000, 3),
    "speed_sensor.ticks": Key(int, "of the encoder a turn", 1, 10**6, 256),
    "faults": Key(
        str,
        "faults put into the messages, NAME:key=value,... with ';' between (see `sim fault --list`), or none",
        default="none",
    ),
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
