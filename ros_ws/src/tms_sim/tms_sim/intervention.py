"""What the experimenters changed at the bicycle to find out about its shimmy, and what became of it, as data.

One YAML file each in `interventions/`; the outcomes are those that the supplement tells in chapter 11, which
the tests compare with simulated runs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tms_model import Bicycle, ParameterError, load_bicycle, with_parameters
from tms_model.acceleration import STAND_INS
from tms_model.catalogue import check_keys, number, read_yaml

from tms_sim.floor import named_file

FOLDER = Path(__file__).parent / "interventions"
_NUMBERS = ("steer_damper", "vertical_load", "added_resistance")
_PLACE = ("mass", "x", "z")
_SIZE = ("diameter", "length")


@dataclass(frozen=True)
class RemovedMass:
    """A body taken off the front frame: a cylinder along the steer axis, or a point."""

    mass: float  # [kg]
    x: float  # [m] of its centre, SAE, from the rear contact
    z: float  # [m]
    diameter: float = 0.0  # [m]
    length: float = 0.0  # [m]


@dataclass(frozen=True)
class Intervention:
    """A change, and what became of the bicycle."""

    parameters: Mapping[str, float]  # changed numbers of the bicycle, by name
    removed: RemovedMass | None
    steer_damper: float  # [N m s/rad], added
    vertical_load: float  # [N], pressed down between the wheels, shared as the weight is
    added_resistance: float  # by weight, added to C_r
    outcome: Mapping[str, bool | None]  # shimmy, self_stable, slows_drastically; None: not told


def load_intervention(name: str) -> Intervention:
    """Intervention by name or file. Raises ParameterError."""
    path = named_file(FOLDER, name, "intervention")
    document = read_yaml(path)
    text = ("description", "source", "uncertainty")
    check_keys(document, (*text, "parameters", "removed_mass", *_NUMBERS, "outcome"), str(path))
    if not isinstance(document["parameters"], dict):
        raise ParameterError(f"{path}: parameters: expected names and numbers")
    check_keys(document["outcome"], ("shimmy", "self_stable", "slows_drastically"), f"{path}: outcome")
    values = {key: number(document[key], f"{path}: {key}") for key in _NUMBERS}
    for key, value in values.items():
        if value < 0.0:
            raise ParameterError(f"{path}: {key}: expected zero or more, found {value:g}")
    return Intervention(
        parameters={k: number(v, f"{path}: parameters.{k}") for k, v in document["parameters"].items()},
        removed=_removed(document["removed_mass"], f"{path}: removed_mass"),
        outcome=document["outcome"],
        **values,
    )


def changed_bicycle(bicycle: Bicycle, intervention: Intervention) -> Bicycle:
    """The bicycle after the intervention.

    One given by matrices only is changed as its stand-in is. Raises ParameterError for a change that leaves
    no bicycle.
    """
    damper = bicycle.steer_elements.steer_damper + intervention.steer_damper
    changes = dict(intervention.parameters)
    if bicycle.parameters is None and (changes or intervention.removed) and bicycle.name in STAND_INS:
        bicycle = load_bicycle(STAND_INS[bicycle.name])
    if intervention.removed:
        changes |= _without(bicycle, intervention.removed)
    if intervention.steer_damper:
        changes["steer_damper"] = damper
    return with_parameters(bicycle, changes, name=bicycle.name) if changes else bicycle


def _removed(entry: Any, where: str) -> RemovedMass | None:
    if entry is None:
        return None
    check_keys(entry, _PLACE, where, _SIZE)
    return RemovedMass(**{key: number(value, f"{where}.{key}") for key, value in entry.items()})


def _without(bicycle: Bicycle, removed: RemovedMass) -> dict[str, float]:
    """Mass, centre and inertias of the front frame when a part of it is gone; parallel axes."""
    p = bicycle.parameters
    if p is None:
        raise ParameterError(
            f"intervention: expected a bicycle with masses and geometry, found {bicycle.name}, which has only"
            " matrices"
        )
    mass = p.front_frame_mass - removed.mass
    if mass <= 0.0:
        raise ParameterError(
            f"intervention: expected a front frame heavier than {removed.mass:g} kg, found"
            f" {p.front_frame_mass:g} kg"
        )
    whole, part = np.array([p.front_frame_x, p.front_frame_z]), np.array([removed.x, removed.z])
    centre = (p.front_frame_mass * whole - removed.mass * part) / mass
    tensor = np.diag([p.front_frame_inertia_xx, p.front_frame_inertia_yy, p.front_frame_inertia_zz])
    tensor[0, 2] = tensor[2, 0] = p.front_frame_inertia_xz
    tensor = tensor + _about_origin(p.front_frame_mass, whole) - _about_origin(removed.mass, part)
    tensor = tensor - _about_origin(mass, centre) - _cylinder(removed, p.steer_axis_tilt)
    return {
        "front_frame_mass": mass,
        "front_frame_x": float(centre[0]),
        "front_frame_z": float(centre[1]),
        "front_frame_inertia_xx": float(tensor[0, 0]),
        "front_frame_inertia_yy": float(tensor[1, 1]),
        "front_frame_inertia_zz": float(tensor[2, 2]),
        "front_frame_inertia_xz": float(tensor[0, 2]),
    }


def _about_origin(mass: float, place: np.ndarray) -> np.ndarray:
    x, z = place
    return mass * np.array([[z * z, 0.0, -x * z], [0.0, x * x + z * z, 0.0], [-x * z, 0.0, x * x]])


def _cylinder(body: RemovedMass, tilt: float) -> np.ndarray:
    """Inertia about its centre, its axis along the steer axis (sin tilt, 0, cos tilt)."""
    along = body.mass * body.diameter**2 / 8.0
    across = body.mass * (body.diameter**2 / 16.0 + body.length**2 / 12.0)
    axis = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    return across * np.eye(3) + (along - across) * np.outer(axis, axis)
