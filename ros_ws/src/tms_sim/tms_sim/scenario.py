"""Scenarios as data: what is run, how it is struck, how it is measured.

A file says its keys, or a `parent`, another scenario, and the keys that differ from it.
One table, `tms_sim.keys.KEYS`, says for each key its kind, unit, range, meaning and default. The YAML files
in `scenarios/`, the command line's `--set` and the simulator node's parameters all go by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from tms_model import ParameterError
from tms_model.catalogue import check_keys, read_yaml
from tms_model.yaml_text import NOT_YAML, load_yaml

from tms_sim.keys import KEYS, Value, checked

FOLDER = Path(__file__).parent / "scenarios"
TEXT = ("description", "source", "uncertainty")


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

    def numbers(self, key: str) -> tuple[float, ...]:
        """Values of a key that holds one number for each strike."""
        value = self.values[key]
        return value if isinstance(value, tuple) else (self.number(key),)

    def switch(self, key: str) -> bool:
        """Value of a key that is true or false."""
        value = self.values[key]
        assert isinstance(value, bool)
        return value

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

    @property
    def imu_every(self) -> int:
        """Samples of the inertial sensor for each that goes out on its topics other than imu/data_raw."""
        return round((self.number("imu.raw_rate") or self.number("imu.rate")) / self.number("imu.rate"))

    @property
    def imu_raw_rate(self) -> float:
        """Samples of the inertial sensor a second [Hz]."""
        return self.imu_every * self.number("imu.rate")

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
    values = _flat(_document(path), str(path))
    for key, value in (changes or {}).items():
        _check_key(key)
        values[key] = value
    return _consistent(Scenario(path.stem, {key: checked(key, values[key]) for key in KEYS}))


def changed_scenario(scenario: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """The scenario with some keys changed. Raises ParameterError."""
    for key in changes:
        _check_key(key)
    changed = {key: checked(key, value) for key, value in changes.items()}
    return _consistent(Scenario(scenario.name, {**scenario.values, **changed}))


def _check_key(key: str) -> None:
    if key not in KEYS:
        raise ParameterError(f"unknown key {key!r}: expected one of {', '.join(KEYS)}")


def _consistent(scenario: Scenario) -> Scenario:
    """The scenario, if its keys go together. Raises ParameterError."""
    _check_strikes(scenario)
    _check_rates(scenario)
    return scenario


def description(name: str) -> str:
    """What a shipped scenario is."""
    return str(read_yaml(FOLDER / f"{name}.yaml")["description"])


def parse_change(text: str) -> tuple[str, Any]:
    """`key=value` -> key and value, the value read as YAML. Raises ParameterError."""
    key, equals, value = text.partition("=")
    try:
        if equals:
            return key.strip(), load_yaml(value)
    except NOT_YAML:
        pass
    raise ParameterError(f"--set: expected KEY=VALUE, found {text!r}")


def _document(path: Path, children: tuple[Path, ...] = ()) -> dict[str, Any]:
    """What a file says, and what its parent says where it says nothing. Raises ParameterError."""
    document = read_yaml(path)
    if "parent" not in document:
        return document
    parent = str(document.pop("parent"))
    other = path.parent / parent if parent.endswith((".yaml", ".yml")) else FOLDER / f"{parent}.yaml"
    if path in children or (other.parent == FOLDER and parent not in scenario_names()):
        raise ParameterError(
            f"{path}: parent: expected a scenario of the catalogue or a .yaml file, and none of its own"
            f" children, found {parent!r}"
        )
    whole = {key: value for key, value in _document(other, (*children, path)).items() if key not in TEXT}
    for key, value in document.items():
        inherited = whole.get(key)
        if isinstance(value, dict) and isinstance(inherited, dict):
            value = {**inherited, **value}
        whole[key] = value
    return whole


def _flat(document: dict[str, Any], where: str) -> dict[str, Any]:
    """Every key with its value in the file, or the one that stands for it. Raises ParameterError."""
    groups: dict[str, list[str]] = {}
    for key in KEYS:
        group, _, leaf = key.rpartition(".")
        groups.setdefault(group, []).append(leaf)
    top = [*groups.pop(""), *groups]
    needed = {key.split(".")[0] for key, rule in KEYS.items() if rule.default is None}
    check_keys(
        document,
        (*TEXT, *(name for name in top if name in needed)),
        where,
        tuple(name for name in top if name not in needed),
    )
    found: dict[str, Any] = {}
    for group, leaves in groups.items():
        rules = {leaf: KEYS[f"{group}.{leaf}"] for leaf in leaves}
        said = document.get(group, {})
        check_keys(
            said,
            tuple(leaf for leaf, rule in rules.items() if rule.default is None),
            f"{where}: {group}",
            tuple(leaf for leaf, rule in rules.items() if rule.default is not None),
        )
        found |= {f"{group}.{leaf}": value for leaf, value in said.items()}
    found |= {name: document[name] for name in top if name not in groups and name in document}
    return {key: found.get(key, rule.default) for key, rule in KEYS.items()}


def _check_strikes(scenario: Scenario) -> None:
    """Raise ParameterError unless strikes fall inside the run, one by one, each told whole."""
    times, length = scenario.numbers("strike.time"), scenario.number("duration")
    for key in ("strike.lean_rate", "strike.steer_rate"):
        if len(scenario.numbers(key)) not in (1, len(times)):
            raise ParameterError(
                f"{key}: expected one number, or as many as strike.time ({len(times)}), found"
                f" {len(scenario.numbers(key))}"
            )
    before = scenario.number("run_up.duration")
    lasts = scenario.number("strike.duration")
    for time in times:
        if time < before:
            raise ParameterError(
                f"strike.time: expected strikes after the release and one after the other, found one at"
                f" {time:g} s, before {before:g} s"
            )
        if not time + lasts < length:
            raise ParameterError(
                f"strike.time: expected a strike inside the record of {length:g} s, found {time:g} s"
            )
        before = time + lasts


def _check_rates(scenario: Scenario) -> None:
    """Raise ParameterError unless the sensor's topics can hold every n-th sample of the raw one."""
    raw, rate = scenario.number("imu.raw_rate"), scenario.number("imu.rate")
    if raw and not (raw >= rate and abs(raw - scenario.imu_raw_rate) <= 1e-9 * raw):
        raise ParameterError(
            f"imu.raw_rate: expected 0, or a whole multiple of imu.rate ({rate:g} Hz), found {raw:g} Hz"
        )
