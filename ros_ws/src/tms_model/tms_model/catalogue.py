"""The catalogue of bicycles: one YAML file each, in the folder `bicycles/`, or any file of the same form.

A file says `description`, `source`, `uncertainty` and either `parameters` (the Whipple parameters, with
`standard_deviations` of some of them if one likes) or `geometry` and `matrices`; steer elements may stand
beside the parameters or the geometry. Or it says a `parent`, another bicycle, and its `changes`, with their
`calibration` (`tms_model.calibrated`) if they were found from recordings. Keys that end in `_deg` are
degrees, everything else SI units. Unknown and missing keys are errors. Parameter files of BicycleParameters
are read too (`tms_model.parameter_files`).
"""

from __future__ import annotations

import math
import re
import reprlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tms_model.bicycle import Array, Bicycle, assemble
from tms_model.calibrated import read_calibration
from tms_model.changes import with_parameters
from tms_model.errors import ParameterError
from tms_model.parameter_files import from_yaml, is_of_this_form, read_text_file
from tms_model.parameters import MAY_BE_UNKNOWN, PARAMETER_NAMES, WhippleParameters
from tms_model.physical import check_physical
from tms_model.steer_elements import STEER_ELEMENT_NAMES, SteerElements
from tms_model.yaml_text import NOT_YAML, load_yaml

FOLDER = Path(__file__).parent / "bicycles"
LARGEST_YAML = 2**20  # [bytes]
MOST_ENTRIES = 20_000
LARGEST_NUMBER = 1e30  # in SI units; the products of larger ones overflow, and a YAML integer has no end
_TEXT = ("description", "source", "uncertainty")
_GEOMETRY = ("wheelbase", "trail", "steer_axis_tilt", "gravity")


def bicycle_names() -> list[str]:
    """Names of the shipped bicycles, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def load_bicycle(name: str) -> Bicycle:
    """Bicycle by catalogue name, or from a file if `name` ends in .yaml, .yml or .txt. Raises ParameterError.

    A text file is one of BicycleParameters; YAML may be its or of the catalogue's form.
    """
    return _load(name, ())


def _load(name: str, children: tuple[str, ...]) -> Bicycle:
    """As `load_bicycle`; `children` are those on whose behalf it is loaded."""
    if name.endswith(".txt"):
        return read_text_file(Path(name))
    if name.endswith((".yaml", ".yml")):
        path = Path(name)
    elif name in bicycle_names():
        path = FOLDER / f"{name}.yaml"
    else:
        raise ParameterError(
            f"unknown bicycle {name!r}: expected one of {', '.join(bicycle_names())}, or the path of a .yaml"
            " file, or of a .txt file of BicycleParameters"
        )
    document = read_yaml(path)
    if is_of_this_form(document):
        return from_yaml(path, document)
    if "parent" in document:
        return _child(path, document, (*children, str(path)))
    return _bicycle(path.stem, document, str(path))


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML mapping from a file, by the safe loader. Raises ParameterError when there is none to be read."""
    try:
        if path.is_file() and path.stat().st_size > LARGEST_YAML:
            raise ParameterError(
                f"{path}: expected a YAML file of some kilobytes, found more than a megabyte"
            )
        document = load_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"{path}: expected a readable YAML file, found: {error.strerror}") from error
    except NOT_YAML as error:
        raise ParameterError(f"{path}: expected YAML, found: {' '.join(str(error).split())[:300]}") from error
    if not isinstance(document, dict):
        raise ParameterError(f"{path}: expected a mapping of keys, found {type(document).__name__}")
    if _written_out(document, {}) > MOST_ENTRIES:
        raise ParameterError(
            f"{path}: expected a YAML file of at most {MOST_ENTRIES} entries, found aliases that make it"
            " longer, or an alias of what it is in"
        )
    return document


def _written_out(value: Any, known: dict[int, float]) -> float:
    """Entries of a document with all aliases written out; infinite if one stands for what it is in."""
    if not isinstance(value, dict | list):
        return 1.0
    if id(value) not in known:
        known[id(value)] = math.inf  # until all that is in it is known
        parts = [*value, *value.values()] if isinstance(value, dict) else value
        known[id(value)] = 1.0 + sum(_written_out(part, known) for part in parts)
    return known[id(value)]


def check_keys(mapping: Any, required: tuple[str, ...], where: str, optional: tuple[str, ...] = ()) -> None:
    """Raise ParameterError unless `mapping` is a dictionary of all `required` and perhaps `optional` keys."""
    if not isinstance(mapping, dict):
        raise ParameterError(f"{where}: expected keys {', '.join(required)}, found {type(mapping).__name__}")
    missing = [key for key in required if key not in mapping]
    unknown = [str(key) for key in mapping if key not in required + optional]
    if missing:
        raise ParameterError(f"{where}: missing {', '.join(missing)}; expected {', '.join(required)}")
    if unknown:
        raise ParameterError(
            f"{where}: unknown {', '.join(unknown)}; expected {', '.join(required + optional)}"
        )


def unquoted(value: Any) -> Any:
    """`value`, as a number when it is one that YAML 1.1 takes for a text: 1e-3, where it wants 1.0e-3."""
    return float(value) if isinstance(value, str) and re.fullmatch(r"[-+]?\d+[eE][-+]?\d+", value) else value


def number(value: Any, where: str) -> float:
    """`value` as a float. Raises ParameterError for anything that is not a finite number."""
    value = unquoted(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < math.inf:
        raise ParameterError(f"{where}: expected a finite number, found {reprlib.repr(value)}")
    if abs(value) > LARGEST_NUMBER:
        raise ParameterError(
            f"{where}: expected a number of at most {LARGEST_NUMBER:g}, found {reprlib.repr(value)}"
        )
    return float(value)


def _bicycle(name: str, document: dict[str, Any], where: str) -> Bicycle:
    if "matrices" in document:
        check_keys(document, (*_TEXT, "geometry", "matrices"), where)
    else:
        check_keys(document, (*_TEXT, "parameters"), where, ("standard_deviations",))
    text = {key: str(document[key]) for key in _TEXT}
    if "parameters" in document:
        values, elements = _numbers(document["parameters"], PARAMETER_NAMES, f"{where}: parameters")
        return assemble(
            name,
            _physical(values, where),
            steer_elements=elements,
            description=text["description"],
            source=text["source"],
            uncertainty=text["uncertainty"],
            standard_deviations=_deviations(document.get("standard_deviations", {}), where),
        )
    check_keys(document["matrices"], ("M", "C1", "K0", "K2"), f"{where}: matrices")
    geometry, elements = _numbers(document["geometry"], _GEOMETRY, f"{where}: geometry")
    matrices = {key: _matrix(value, f"{where}: {key}") for key, value in document["matrices"].items()}
    return Bicycle(
        name=name,
        mass=matrices["M"],
        damping=matrices["C1"],
        stiffness0=matrices["K0"],
        stiffness2=matrices["K2"],
        wheelbase=geometry["wheelbase"],
        trail=geometry["trail"],
        steer_axis_tilt=geometry["steer_axis_tilt"],
        gravity=geometry["gravity"],
        steer_elements=elements,
        description=text["description"],
        source=text["source"],
        uncertainty=text["uncertainty"],
    )


def _physical(values: dict[str, float], where: str) -> WhippleParameters:
    try:
        parameters = WhippleParameters(**values)
        check_physical(parameters)
    except ParameterError as error:
        raise ParameterError(f"{where}: {error}") from error
    return parameters


def _child(path: Path, document: dict[str, Any], line: tuple[str, ...]) -> Bicycle:
    """A bicycle that is another one with changes; `line` are the files from the first child to this one."""
    where = str(path)
    check_keys(document, (*_TEXT, "parent", "changes"), where, ("calibration",))
    parent, changes = str(document["parent"]), document["changes"]
    if parent.endswith((".yaml", ".yml", ".txt")):
        parent = str(path.parent / parent)  # beside this file
    if line.count(where) > 1:
        raise ParameterError(f"{where}: expected a parent that is none of its own children, found {parent}")
    if not isinstance(changes, dict):
        raise ParameterError(f"{where}: changes: expected names and numbers, found {type(changes).__name__}")
    numbers = {str(key): number(value, f"{where}: changes.{key}") for key, value in changes.items()}
    whole = _load(parent, line)
    try:
        changed = with_parameters(whole, numbers, name=path.stem)
    except ParameterError as error:
        raise ParameterError(f"{where}: {error}") from error
    calibrated, deviations = None, dict(changed.standard_deviations)
    if "calibration" in document:
        calibrated = read_calibration(document["calibration"], tuple(numbers), f"{where}: calibration")
        stated = calibrated.standard_deviations
        deviations |= {name: stated[name] for name in calibrated.names if name in PARAMETER_NAMES}
    return replace(
        changed,
        description=str(document["description"]),
        source=str(document["source"]),
        uncertainty=str(document["uncertainty"]),
        standard_deviations=deviations,
        calibrated=calibrated,
    )


def _deviations(mapping: Any, where: str) -> dict[str, float]:
    where = f"{where}: standard_deviations"
    check_keys(mapping, (), where, _keys(PARAMETER_NAMES))
    names = tuple(name for name in PARAMETER_NAMES if _keys((name,))[0] in mapping)
    deviations, _ = _numbers(mapping, names, where)
    for name, value in deviations.items():
        if value < 0.0:
            raise ParameterError(f"{where}.{name}: expected zero or more, found {value:g}")
    return deviations


def _keys(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{name}_deg" if name == "steer_axis_tilt" else name for name in names)


def _numbers(mapping: Any, names: tuple[str, ...], where: str) -> tuple[dict[str, float], SteerElements]:
    """The named numbers, NaN for what may be unknown and is missing, and the steer elements beside them."""
    keys = _keys(names)
    required = tuple(key for key in keys if key not in MAY_BE_UNKNOWN)
    check_keys(mapping, required, where, tuple(k for k in keys if k in MAY_BE_UNKNOWN) + STEER_ELEMENT_NAMES)
    values = dict.fromkeys(keys, math.nan)
    values |= {key: number(value, f"{where}.{key}") for key, value in mapping.items()}
    elements = SteerElements(**{key: value for key, value in values.items() if key in STEER_ELEMENT_NAMES})
    return {
        name: math.radians(values[key]) if key.endswith("_deg") else values[key]
        for name, key in zip(names, keys, strict=True)
    }, elements


def _matrix(value: Any, where: str) -> Array:
    try:
        matrix = np.array(value, dtype=float)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (2, 2) or not np.isfinite(matrix).all():
        raise ParameterError(f"{where}: expected a 2 x 2 list of finite numbers, found {value!r}")
    return matrix
