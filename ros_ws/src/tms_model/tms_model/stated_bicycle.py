"""A bicycle as the numbers that a recording states of it, beside one of the catalogue or of a file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import PurePath

import numpy as np

from tms_model.bicycle import Bicycle, assemble
from tms_model.catalogue import LARGEST_NUMBER
from tms_model.errors import ParameterError
from tms_model.parameters import MAY_BE_UNKNOWN, PARAMETER_NAMES, WhippleParameters
from tms_model.steer_elements import STEER_ELEMENT_NAMES, SteerElements

_GEOMETRY = ("wheelbase", "trail", "steer_axis_tilt", "gravity")
_ENTRIES = tuple(
    f"{letter}_{row}_{column}"
    for letter in ("M", "C1", "K0", "K2")
    for row in ("lean", "steer")
    for column in ("lean", "steer")
)
LONGEST_NAME = 100  # of which more is cut


def bicycle_from_numbers(name: str, numbers: Mapping[str, float]) -> Bicycle:
    """The bicycle whose `Bicycle.numbers` these are: by its parameters, or by geometry and matrices.

    Numbers are untrusted, SI units and radians; steer elements that are left out do nothing. Its name is the
    last part of `name`, without a file's ending. Standard deviations and provenance aren't among the numbers.
    Raises ParameterError for numbers that are missing, unknown or not finite, and for those that no bicycle
    has.
    """
    by_matrices = any(entry in numbers for entry in _ENTRIES)
    names = (*_GEOMETRY, *_ENTRIES) if by_matrices else PARAMETER_NAMES
    _check(numbers, names)
    own = {key: float(numbers.get(key, math.nan)) for key in names}
    elements = SteerElements(**{k: float(v) for k, v in numbers.items() if k in STEER_ELEMENT_NAMES})
    label = "".join(letter for letter in PurePath(name).stem if letter.isprintable())[:LONGEST_NAME]
    if not by_matrices:
        return assemble(label, WhippleParameters(**own), steer_elements=elements)
    for key in ("wheelbase", "gravity"):
        if not own[key] > 0.0:
            raise ParameterError(f"{key}: expected a positive number, found {own[key]:g}")
    if not abs(own["steer_axis_tilt"]) < math.pi / 2:
        raise ParameterError(
            f"steer_axis_tilt: expected less than 90 deg either way, found {own['steer_axis_tilt']:g} rad"
        )
    matrices = np.array([own[entry] for entry in _ENTRIES]).reshape(4, 2, 2)
    return Bicycle(
        label,
        mass=matrices[0],
        damping=matrices[1],
        stiffness0=matrices[2],
        stiffness2=matrices[3],
        wheelbase=own["wheelbase"],
        trail=own["trail"],
        steer_axis_tilt=own["steer_axis_tilt"],
        gravity=own["gravity"],
        steer_elements=elements,
    )


def _check(numbers: Mapping[str, float], names: tuple[str, ...]) -> None:
    known = (*names, *STEER_ELEMENT_NAMES)
    unknown = [key for key in numbers if key not in known]
    missing = [key for key in names if key not in numbers and key not in MAY_BE_UNKNOWN]
    if unknown or missing:
        what, which = ("unknown", unknown) if unknown else ("missing", missing)
        raise ParameterError(f"expected all numbers of a bicycle, found {what} {', '.join(which[:4])[:200]}")
    for key, value in numbers.items():
        if not abs(value) <= LARGEST_NUMBER:
            raise ParameterError(
                f"{key}: expected a finite number of at most {LARGEST_NUMBER:g}, found {value:g}"
            )
