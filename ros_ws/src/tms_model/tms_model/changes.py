"""A bicycle like another but for some numbers: parameters and steer elements overridden one by one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace

from tms_model.bicycle import Bicycle, assemble
from tms_model.parameters import PARAMETER_NAMES, ParameterError, WhippleParameters
from tms_model.physical import check_physical
from tms_model.steer_elements import STEER_ELEMENT_NAMES, SteerElements

TILT_IN_DEGREES = "steer_axis_tilt_deg"  # may stand for steer_axis_tilt [rad]
_OF_MATRICES = ("gravity", *STEER_ELEMENT_NAMES)  # what a bicycle given by matrices can change


def with_parameters(bicycle: Bicycle, changes: Mapping[str, float], *, name: str | None = None) -> Bicycle:
    """The same bicycle with some numbers changed; its description says which.

    changes: by name, as `Bicycle.numbers` has them, SI units and radians; `steer_axis_tilt_deg` in degrees. A
    changed parameter loses its standard deviation. Raises ParameterError for a name that the bicycle doesn't
    have, and for numbers that no bicycle has.
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
    _check_names(bicycle, values)
    elements = SteerElements(
        **{**asdict(bicycle.steer_elements), **{k: v for k, v in values.items() if k in STEER_ELEMENT_NAMES}}
    )
    changed = {key: value for key, value in values.items() if key not in STEER_ELEMENT_NAMES}
    description = f"{bicycle.description}; changed: {said}" if said else bicycle.description
    if bicycle.parameters is None:
        gravity = changed.get("gravity", bicycle.gravity)
        return replace(bicycle, name=label, gravity=gravity, steer_elements=elements, description=description)
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


def _check_names(bicycle: Bicycle, changes: Mapping[str, float]) -> None:
    known = _OF_MATRICES if bicycle.parameters is None else (*PARAMETER_NAMES, *STEER_ELEMENT_NAMES)
    for key in changes:
        if key not in known:
            why = " (it is given by its matrices)" if bicycle.parameters is None else ""
            raise ParameterError(f"{key}: bicycle {bicycle.name}{why} can change {', '.join(known)}")
