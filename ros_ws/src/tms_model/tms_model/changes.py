"""A bicycle like another but for some numbers: parameters and steer elements overridden one by one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from typing import Any

from tms_model.bicycle import Bicycle, assemble
from tms_model.errors import ParameterError
from tms_model.parameters import PARAMETER_NAMES, WhippleParameters
from tms_model.physical import check_physical
from tms_model.steer_elements import STEER_ELEMENT_NAMES, SteerElements

TILT_IN_DEGREES = "steer_axis_tilt_deg"  # may stand for steer_axis_tilt [rad]
_MATRICES = {"M": "mass", "C1": "damping", "K0": "stiffness0", "K2": "stiffness2"}
_PLACES = {"lean": 0, "steer": 1}
# Entries of the matrices of Eq. (3.1) that may differ: M and K0 are symmetric, C1 and K2 begin with zeros.
MATRIX_ENTRIES: tuple[str, ...] = (
    *(f"{letter}_{entry}" for letter in ("M", "K0") for entry in ("lean_lean", "lean_steer", "steer_steer")),
    *(f"C1_{entry}" for entry in ("lean_steer", "steer_lean", "steer_steer")),
    *(f"K2_{entry}" for entry in ("lean_steer", "steer_steer")),
)
_OF_MATRICES = ("gravity", *STEER_ELEMENT_NAMES, *MATRIX_ENTRIES)  # what a bicycle given by them can change


def with_parameters(bicycle: Bicycle, changes: Mapping[str, float], *, name: str | None = None) -> Bicycle:
    """The same bicycle with some numbers changed; its description says which.

    changes: by name, as `Bicycle.numbers` has them, SI units and radians; `steer_axis_tilt_deg` in degrees. A
    changed parameter loses its standard deviation. Entries of the matrices (MATRIX_ENTRIES; the entry across
    changes with it where a matrix is symmetric) make the bicycle one that is given by its matrices. Raises
    ParameterError for a name that the bicycle doesn't have, and for numbers that no bicycle has.
    """
    if TILT_IN_DEGREES in changes and "steer_axis_tilt" in changes:
        raise ParameterError(f"expected steer_axis_tilt or {TILT_IN_DEGREES}, found both")
    said = ", ".join(f"{key} {value:g}" for key, value in changes.items())
    label = name or f"{bicycle.name} with {said}"
    values = {
        "steer_axis_tilt" if key == TILT_IN_DEGREES else key: math.radians(value)
        if key == TILT_IN_DEGREES
        else value
        for key, value in changes.items()
    }
    if any(key in MATRIX_ENTRIES for key in values):
        bicycle = replace(bicycle, parameters=None, standard_deviations={})
    _check_names(bicycle, values)
    elements = SteerElements(
        **{**asdict(bicycle.steer_elements), **{k: v for k, v in values.items() if k in STEER_ELEMENT_NAMES}}
    )
    changed = {key: value for key, value in values.items() if key not in STEER_ELEMENT_NAMES}
    description = f"{bicycle.description}; changed: {said}" if said else bicycle.description
    if bicycle.parameters is None:
        gravity = changed.get("gravity", bicycle.gravity)
        matrices = _matrices(bicycle, changed)
        return replace(
            bicycle,
            name=label,
            gravity=gravity,
            steer_elements=elements,
            description=description,
            calibrated=None,
            **matrices,
        )
    parameters = WhippleParameters(**{**asdict(bicycle.parameters), **changed})
    check_physical(parameters, before=bicycle.parameters)
    return assemble(
        label,
        parameters,
        steer_elements=elements,
        description=description,
        source=bicycle.source,
        uncertainty=bicycle.uncertainty,
        standard_deviations={k: v for k, v in bicycle.standard_deviations.items() if k not in changed},
    )


def parse_changes(texts: Iterable[str]) -> dict[str, float]:
    """Changes from texts such as 'trail=-0.02'. Raises ParameterError for anything else or a name twice."""
    changes: dict[str, float] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        key = key.strip()
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not (equals and key and math.isfinite(number)):
            raise ParameterError(f"expected NAME=VALUE with a finite number, as trail=-0.02, found {text!r}")
        if key in changes:
            raise ParameterError(f"{key}: expected once, found again in {text!r}")
        changes[key] = number
    return changes


def numbers_of(bicycle: Bicycle) -> dict[str, float]:
    """A bicycle's numbers by name, with all steer elements and the entries of its matrices."""
    entries = {}
    for name in MATRIX_ENTRIES:
        letter, row, column = name.split("_")
        entries[name] = float(getattr(bicycle, _MATRICES[letter])[_PLACES[row], _PLACES[column]])
    return {**asdict(bicycle.steer_elements), **entries, **bicycle.numbers}


def _matrices(bicycle: Bicycle, changed: Mapping[str, float]) -> dict[str, Any]:
    """The matrices of a bicycle with some entries changed, by the names of its fields."""
    matrices = {field: getattr(bicycle, field).copy() for field in _MATRICES.values()}
    for name, value in changed.items():
        if name in MATRIX_ENTRIES:
            letter, row, column = name.split("_")
            matrices[_MATRICES[letter]][_PLACES[row], _PLACES[column]] = value
            if letter in ("M", "K0"):
                matrices[_MATRICES[letter]][_PLACES[column], _PLACES[row]] = value
    return matrices


def _check_names(bicycle: Bicycle, changes: Mapping[str, float]) -> None:
    known = _OF_MATRICES if bicycle.parameters is None else (*PARAMETER_NAMES, *STEER_ELEMENT_NAMES)
    for key in changes:
        if key not in known:
            why = " (it is given by its matrices)" if bicycle.parameters is None else ""
            raise ParameterError(f"{key}: bicycle {bicycle.name}{why} can change {', '.join(known)}")
