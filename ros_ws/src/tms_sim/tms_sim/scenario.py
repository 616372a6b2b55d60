"""Scenarios as data: what is run, how it is struck, how it is measured.

One table, `KEYS`, says for each key its kind, unit, range and meaning. The YAML files in `scenarios/`, the
command line's `--set` and the simulator node's parameters all go by it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from tms_model import ParameterError
from tms_model.catalogue import check_keys, read_yaml, unquoted

FOLDER = Path(__file__).parent / "scenarios"
TEXT = ("description", "source", "uncertainty")
Value = str | int | float | tuple[float, ...]


@dataclass(frozen=True)
class Key:
    """One key of a scenario."""

    kind: type  # str, int, float or tuple (of three floats)
    meaning: str  # with its unit
    low: float = -math.inf
    high: float = math.inf


KEYS: dict[str, Key] = {
    "bicycle": Key(str, "name in the catalogue of bicycles, or a .yaml file"),
    "speed": Key(float, "constant forward speed [m/s]", 0.1, 30.0),
    "duration": Key(float, "length of the run [s]", 0.1, 3600.0),
    "strike.time": Key(float, "when the strike falls [s since the start]", 0.0, 3600.0),
    "strike.lean_rate": Key(
        float, "lean rate right after the strike, positive to the right [rad/s]", -10.0, 10.0
    ),
    "strike.steer_rate": Key(
        float, "steer rate right after the strike, positive to the right [rad/s]", -100.0, 100.0
    ),
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


@dataclass(frozen=True)
class Scenario:
    """A checked scenario; `values` holds every key of KEYS, SI units (degrees in keys that end in _deg)."""

    name: str
    values: dict[str, Value]

    def number(self, key: str) -> float:
        """Value of a numeric key."""
        value = self.values[key]
        assert isinstance(value, int | float)
        return float(value)

    def integer(self, key: str) -> int:
        """Value of an integer key."""
        value = self.values[key]
        assert isinstance(value, int)
        return value

    def text(self, key: str) -> str:
        """Value of a text key."""
        return str(self.values[key])

    def triple(self, key: str) -> tuple[float, ...]:
        """Value of a key that holds three numbers."""
        value = self.values[key]
        assert isinstance(value, tuple)
        return value

    def to_yaml(self) -> str:
        """All keys as YAML, nested again: what a bag records as its configuration."""
        nested: dict[str, Any] = {"scenario": self.name}
        for key, value in self.values.items():
            group, _, leaf = key.rpartition(".")
            place = nested.setdefault(group, {}) if group else nested
            place[leaf] = list(value) if isinstance(value, tuple) else value
        return str(yaml.safe_dump(nested, sort_keys=False))


def scenario_names() -> list[str]:
    """Names of the shipped scenarios, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def load_scenario(name: str, changes: dict[str, Any] | None = None) -> Scenario:
    """Scenario by name or .yaml file, with some keys changed. Raises ParameterError."""
    path = Path(name) if name.endswith((".yaml", ".yml")) else FOLDER / f"{name}.yaml"
    if path.parent == FOLDER and name not in scenario_names():
        raise ParameterError(
            f"unknown scenario {name!r}: expected one of {', '.join(scenario_names())}, or the path of a"
            " .yaml file"
        )
    values = _flat(read_yaml(path), str(path))
    for key, value in (changes or {}).items():
        if key not in KEYS:
            raise ParameterError(f"unknown key {key!r}: expected one of {', '.join(KEYS)}")
        values[key] = value
    checked = {key: _check(key, values[key]) for key in KEYS}
    if not float(checked["strike.time"]) < float(checked["duration"]):  # type: ignore[arg-type]
        raise ParameterError(
            f"strike.time: expected a strike inside the record of {checked['duration']:g} s, found"
            f" {checked['strike.time']:g} s"
        )
    return Scenario(path.stem, checked)


def description(name: str) -> str:
    """What a shipped scenario is."""
    return str(read_yaml(FOLDER / f"{name}.yaml")["description"])


def parse_change(text: str) -> tuple[str, Any]:
    """`key=value` -> key and value, the value read as YAML. Raises ParameterError."""
    key, equals, value = text.partition("=")
    try:
        if equals:
            return key.strip(), yaml.safe_load(value)
    except yaml.YAMLError:
        pass
    raise ParameterError(f"--set: expected KEY=VALUE, found {text!r}")


def _flat(document: dict[str, Any], where: str) -> dict[str, Any]:
    groups: dict[str, list[str]] = {}
    for key in KEYS:
        group, _, leaf = key.rpartition(".")
        groups.setdefault(group, []).append(leaf)
    top = tuple(groups.pop("")) + tuple(groups)
    check_keys(document, (*TEXT, *top), where)
    for group, leaves in groups.items():
        check_keys(document[group], tuple(leaves), f"{where}: {group}")
    return {
        key: document[key.rpartition(".")[0]][key.rpartition(".")[2]] if "." in key else document[key]
        for key in KEYS
    }


def _check(key: str, value: Any) -> Value:
    """The value in the key's kind and range. Raises ParameterError."""
    rule = KEYS[key]
    if rule.kind is str:
        if isinstance(value, str) and value:
            return value
        raise ParameterError(f"{key}: expected {rule.meaning}, found {value!r}")
    items = list(value) if rule.kind is tuple and isinstance(value, list | tuple) else [value]
    items = [unquoted(item) for item in items]
    note = {tuple: ", three numbers", int: ", a whole number"}.get(rule.kind, "")
    wanted = f"{rule.meaning}, from {rule.low:g} to {rule.high:g}{note}"
    if len(items) != (3 if rule.kind is tuple else 1):
        raise ParameterError(f"{key}: expected {wanted}, found {value!r}")
    for item in items:
        kinds = (int,) if rule.kind is int else (int, float)
        if isinstance(item, bool) or not isinstance(item, kinds) or not rule.low <= item <= rule.high:
            raise ParameterError(f"{key}: expected {wanted}, found {value!r}")
    if rule.kind is int:
        return int(items[0])
    numbers = tuple(float(item) for item in items)
    return numbers if rule.kind is tuple else numbers[0]
