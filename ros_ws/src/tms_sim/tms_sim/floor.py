"""Floors and wheels as data: one YAML file each in `floors/` and `wheels/`, every number with its source."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tms_model import ParameterError
from tms_model.catalogue import check_keys, number, read_yaml

FLOORS = Path(__file__).parent / "floors"
WHEELS = Path(__file__).parent / "wheels"


@dataclass(frozen=True)
class Floor:
    """What a floor does to the experiment's aluminium wheels."""

    rolling_resistance: float  # C_r, force by weight
    lateral_friction: float  # largest lateral force of a wheel by the weight on it; infinite: never slides
    scrub: float  # [N m s/rad], moment of a wheel per rate at which it turns on the spot
    joint_spacing: float  # [m] of way from joint to joint, infinite: none
    joint_impulse: float  # [N m s], standard deviation of a joint's kick of the steering


@dataclass(frozen=True)
class Wheels:
    """What other wheels change."""

    friction_factor: float  # times the floor's lateral friction
    resistance_factor: float  # times the floor's rolling resistance
    scrub: float  # [N m s/rad], added to the floor's


def named_file(folder: Path, name: str, key: str) -> Path:
    """File of an entry of a folder by name, or the path of one's own .yaml file. Raises ParameterError."""
    if name.endswith((".yaml", ".yml")):
        return Path(name)
    known = sorted(path.stem for path in folder.glob("*.yaml"))
    if name not in known:
        raise ParameterError(
            f"{key}: unknown {key} {name!r}; expected one of {', '.join(known)}, or the path of a .yaml file"
        )
    return folder / f"{name}.yaml"


def load_floor(name: str) -> Floor:
    """Floor by name or file. Raises ParameterError."""
    values = _values(
        named_file(FLOORS, name, "floor"),
        ("rolling_resistance", "lateral_friction", "scrub", "joint_spacing", "joint_impulse"),
        ("lateral_friction", "joint_spacing"),
    )
    if values["joint_spacing"] < 0.01:
        raise ParameterError(
            f"{name}: joint_spacing: expected at least 0.01 m, found {values['joint_spacing']:g}"
        )
    return Floor(**values)


def load_wheels(name: str) -> Wheels:
    """Wheels by name or file. Raises ParameterError."""
    return Wheels(
        **_values(named_file(WHEELS, name, "wheels"), ("friction_factor", "resistance_factor", "scrub"), ())
    )


def _values(path: Path, keys: tuple[str, ...], without_limit: tuple[str, ...]) -> dict[str, float]:
    document = read_yaml(path)
    check_keys(document, ("description", *keys), str(path))
    return {key: _value(document[key], f"{path}: {key}", key in without_limit) for key in keys}


def _value(entry: Any, where: str, without_limit: bool) -> float:
    """A number of zero or more with its source; null stands for no limit where there may be none."""
    check_keys(entry, ("value", "source"), where)
    if entry["value"] is None and without_limit:
        return math.inf
    value = number(entry["value"], where)
    if value < 0.0:
        raise ParameterError(f"{where}: expected zero or more, found {value:g}")
    return value
