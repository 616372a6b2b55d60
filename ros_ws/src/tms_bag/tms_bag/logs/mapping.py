"""What the columns of a logger's CSV mean: a YAML file of the folder `mappings/` or the user's own.

    description, source   texts
    bicycle               name in the catalogue, or '' if unknown
    rate                  rows per second [Hz]; or instead of it
    time                  {column, unit: s|ms|us|ns, zero: first_row|epoch}
    columns               quantity: {column, unit, frame: sae|rep103, sign: 1|-1, optional: true}; no frame
                          for the speed; sign may be left out; a log needn't have an optional column
    start_time_ns         time of the first row [ns since 1970], unless zero is epoch; default 1 s, since ROS
                          reads 0 as "no time"
    missing               error|skip: what to do with empty or NaN cells; with skip each topic gets the rows
                          that have something for it; default error
    delimiter             between cells, one character; default: whichever of , ; tab | the header has these
                          columns with
    decimal               '.' or ','; default '.'
    imu_position          [x, y, z] of the sensor [m], from the rear contact point in REP-103 axes; default
                          unknown
    imu_orientation       [x, y, z, w], quaternion that turns the sensor's axes into the rear frame's; default
                          [0, 0, 0, 1]: aligned

Frame sae: x forward, y right, z down, so that lean, yaw and steer to the right are positive; rep103: x
forward, y left, z up.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any

import yaml
from tms_model import ParameterError
from tms_model.catalogue import check_keys, number, read_yaml

from tms_bag.logs.mapping_files import DECIMALS, FOLDER, mapping_names

DEFAULT_START_NS = 10**9

UNITS: dict[str, dict[str, float]] = {
    "angle": {"rad": 1.0, "deg": pi / 180.0},
    "rate": {"rad/s": 1.0, "deg/s": pi / 180.0},
    "speed": {"m/s": 1.0, "km/h": 1.0 / 3.6},
    "acceleration": {"m/s^2": 1.0, "g": 9.80665},
    "torque": {"N m": 1.0},
}
TIME_UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


@dataclass(frozen=True)
class Quantity:
    """What can stand in a column."""

    kind: str  # key of UNITS
    axis: int | None  # 0, 1, 2: about or along x, y, z; None: has no sign that depends on the frame


QUANTITIES = {
    "lean": Quantity("angle", 0),
    "lean_rate": Quantity("rate", 0),
    "yaw_rate": Quantity("rate", 2),
    "speed": Quantity("speed", None),
    "steer_torque": Quantity("torque", 2),
    "angular_velocity_x": Quantity("rate", 0),
    "angular_velocity_y": Quantity("rate", 1),
    "angular_velocity_z": Quantity("rate", 2),
    "specific_force_x": Quantity("acceleration", 0),
    "specific_force_y": Quantity("acceleration", 1),
    "specific_force_z": Quantity("acceleration", 2),
}
# The same motion, told twice: which of the two counts would be a guess.
_EXCLUSIVE = (("lean_rate", "angular_velocity_x"), ("yaw_rate", "angular_velocity_z"))


@dataclass(frozen=True)
class Column:
    """A column of the log."""

    name: str  # in the header
    unit: str
    frame: str = ""  # sae or rep103; empty for a quantity without
    sign: int = 1  # -1: the sensor was mounted the other way round
    optional: bool = False  # a log without it is one without this quantity


@dataclass(frozen=True)
class Clock:
    """Where the time of a row comes from."""

    rate: float | None = None  # [Hz]; None: from a column
    column: str = ""
    unit: str = "s"
    zero: str = "first_row"  # or epoch: the column counts from 1970


@dataclass(frozen=True)
class LogMapping:
    """Meaning of a log's columns."""

    name: str
    description: str
    source: str
    bicycle: str
    clock: Clock
    columns: dict[str, Column]  # by quantity
    start_time_ns: int = DEFAULT_START_NS  # [ns since 1970] of the first row
    skip_missing: bool = False
    delimiter: str = ""  # empty: found by the header
    decimal: str = "."
    imu_position: tuple[float, float, float] | None = None  # [m] in rear_frame, REP-103 axes
    imu_orientation: tuple[float, float, float, float] | None = None  # x, y, z, w: imu -> rear_frame

    @property
    def configuration(self) -> str:
        """All of it as YAML, for the record."""
        return str(yaml.safe_dump(dataclasses.asdict(self), sort_keys=False, allow_unicode=True, width=100))


def load_mapping(name: str | Path) -> LogMapping:
    """Mapping by its name, or from a YAML file when `name` ends in .yaml or .yml. Raises ParameterError."""
    path = Path(name)
    if path.suffix not in (".yaml", ".yml"):
        path = FOLDER / f"{name}.yaml"
        if str(name) not in mapping_names():
            raise ParameterError(
                f"unknown mapping {str(name)!r}: expected one of {', '.join(mapping_names())}, or the path"
                " of a .yaml file"
            )
    return _mapping(path.stem, read_yaml(path), str(path))


def adapted(
    mapping: LogMapping,
    columns: Mapping[str, str] | None = None,
    without: Collection[str] = (),
    skip_missing: bool | None = None,
    bicycle: str | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> LogMapping:
    """The mapping with other column names, without some quantities, and so on. Raises ParameterError."""
    entries = dict(mapping.columns)
    for quantity in [*(columns or {}), *without]:
        if quantity not in entries:
            raise ParameterError(
                f"mapping {mapping.name}: no quantity {quantity!r}; it maps {', '.join(entries)}"
                " (for another one write a mapping file)"
            )
    for quantity, name in (columns or {}).items():
        entries[quantity] = dataclasses.replace(entries[quantity], name=name)
    for quantity in without:
        entries.pop(quantity, None)
    _check_quantities(entries, f"mapping {mapping.name}")
    return dataclasses.replace(
        mapping,
        columns=entries,
        skip_missing=mapping.skip_missing if skip_missing is None else skip_missing,
        bicycle=mapping.bicycle if bicycle is None else bicycle,
        delimiter=mapping.delimiter if delimiter is None else _delimiter(delimiter, "--delimiter"),
        decimal=mapping.decimal if decimal is None else _one_of(decimal, DECIMALS, "--decimal"),
    )


def _mapping(name: str, document: dict[str, Any], where: str) -> LogMapping:
    clock = "time" if "time" in document else "rate"
    optional = ("start_time_ns", "missing", "delimiter", "decimal", "imu_position", "imu_orientation")
    check_keys(document, ("description", "source", "bicycle", clock, "columns"), where, optional)
    columns = document["columns"]
    check_keys(columns, (), f"{where}: columns", tuple(QUANTITIES))
    entries = {key: _column(key, entry, f"{where}: columns.{key}") for key, entry in columns.items()}
    _check_quantities(entries, where)
    orientation = _orientation(document.get("imu_orientation"), f"{where}: imu_orientation")
    if orientation and {"lean_rate", "yaw_rate"} & entries.keys():
        raise ParameterError(
            f"{where}: expected angular_velocity_x, _y, _z with an imu_orientation, found lean_rate or"
            " yaw_rate:"
            " these are rates of the bicycle, not of a sensor that sits otherwise"
        )
    return LogMapping(
        name=name,
        description=str(document["description"]),
        source=str(document["source"]),
        bicycle=str(document["bicycle"] or ""),
        clock=_clock(document, where),
        columns=entries,
        start_time_ns=_start_time(document.get("start_time_ns", DEFAULT_START_NS), where),
        skip_missing=_one_of(document.get("missing", "error"), ("error", "skip"), f"{where}: missing")
        == "skip",
        delimiter=_delimiter(document.get("delimiter", ""), f"{where}: delimiter"),
        decimal=_one_of(document.get("decimal", "."), DECIMALS, f"{where}: decimal"),
        imu_position=_position(document.get("imu_position"), f"{where}: imu_position"),
        imu_orientation=orientation,
    )


def _column(quantity: str, entry: Any, where: str) -> Column:
    kind, axis = QUANTITIES[quantity].kind, QUANTITIES[quantity].axis
    required = ("column", "unit") if axis is None else ("column", "unit", "frame")
    check_keys(entry, required, where, ("optional",) if axis is None else ("sign", "optional"))
    unit = _one_of(entry["unit"], tuple(UNITS[kind]), f"{where}.unit")
    frame = "" if axis is None else _one_of(entry["frame"], ("sae", "rep103"), f"{where}.frame")
    sign = entry.get("sign", 1)
    if isinstance(sign, bool) or sign not in (1, -1):
        raise ParameterError(f"{where}.sign: expected 1 or -1, found {sign!r}")
    optional = entry.get("optional", False)
    if not isinstance(optional, bool):
        raise ParameterError(f"{where}.optional: expected true or false, found {optional!r}")
    return Column(str(entry["column"]), unit, frame, sign, optional)


def _clock(document: dict[str, Any], where: str) -> Clock:
    if "rate" in document:
        rate = number(document["rate"], f"{where}: rate")
        if not 1e-3 <= rate <= 1e6:
            raise ParameterError(f"{where}: rate: expected 0.001 to 1000000 Hz, found {rate}")
        return Clock(rate=rate)
    entry = document["time"]
    check_keys(entry, ("column", "unit", "zero"), f"{where}: time")
    unit = _one_of(entry["unit"], tuple(TIME_UNITS_NS), f"{where}: time.unit")
    return Clock(
        None,
        str(entry["column"]),
        unit,
        _one_of(entry["zero"], ("first_row", "epoch"), f"{where}: time.zero"),
    )


def _check_quantities(columns: Mapping[str, Column], where: str) -> None:
    for first, second in _EXCLUSIVE:
        if first in columns and second in columns:
            raise ParameterError(f"{where}: expected {first} or {second}, found both; leave one of them out")
    if not any(quantity in columns for quantity in ("lean_rate", "angular_velocity_x")):
        raise ParameterError(
            f"{where}: expected lean_rate or angular_velocity_x among the columns, found neither"
        )


def _start_time(value: Any, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 < value < 2**31 * 10**9:
        raise ParameterError(
            f"{where}: start_time_ns: expected an integer from 1 to 2^31 * 10^9 ns, found {value!r}"
        )
    return value


def _position(value: Any, where: str) -> tuple[float, float, float] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 3:
        raise ParameterError(f"{where}: expected [x, y, z] in metres, found {value!r}")
    x, y, z = (number(entry, where) for entry in value)
    return x, y, z


def _orientation(value: Any, where: str) -> tuple[float, float, float, float] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 4:
        raise ParameterError(f"{where}: expected a quaternion [x, y, z, w], found {value!r}")
    x, y, z, w = (number(entry, where) for entry in value)
    size = math.hypot(x, y, z, w)
    if not 0.99 < size < 1.01:
        raise ParameterError(f"{where}: expected a quaternion of length 1, found one of length {size:.4g}")
    return x / size, y / size, z / size, w / size


def _delimiter(value: Any, where: str) -> str:
    """One character that can stand between numbers; empty: to be found."""
    if (
        not isinstance(value, str)
        or len(value) > 1
        or value in ('"', "\n", "\r", "\0", ".", "-")
        or value.isalnum()
    ):
        raise ParameterError(f"{where}: expected one character such as , or ; found {value!r}")
    return value


def _one_of(value: Any, allowed: tuple[str, ...], where: str) -> str:
    if value not in allowed:
        raise ParameterError(f"{where}: expected one of {', '.join(allowed)}, found {value!r}")
    return str(value)
