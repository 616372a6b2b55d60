"""The command `show`: what a bicycle is, where its numbers come from, and each of them with its unit."""

from __future__ import annotations

import argparse
import math
from typing import Any

from tms_model.bicycle import Bicycle
from tms_model.calibrated import calibration_yaml
from tms_model.command_line import print_json
from tms_model.parameter_files import SYMBOLS
from tms_model.physical import objections

_LETTERS = {name: symbol for symbol, name in SYMBOLS.items()}
_UNITS = {  # by the last word that names a quantity
    "wheelbase": "m",
    "trail": "m",
    "tilt": "rad",
    "gravity": "m/s^2",
    "radius": "m",
    "mass": "kg",
    "x": "m",
    "z": "m",
    "spring": "N m/rad",
    "damper": "N m s/rad",
    "M": "kg m^2",
    "C1": "kg m",
    "K0": "kg m",
    "K2": "kg",
}
_GAINS = {"lean_gain": "N m/rad", "lean_rate_gain": "N m s/rad", "steer_torque_gain": "1"}


def unit(name: str) -> str:
    """Unit of one of a bicycle's `numbers`."""
    if "_inertia_" in name:
        return "kg m^2"
    first, last = name.split("_")[0], name.split("_")[-1]
    return _GAINS.get(name) or _UNITS.get(first) or _UNITS[last]


def show(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    """Print description, source, uncertainty and numbers of a bicycle, and which of these no body has."""
    text = {key: getattr(bicycle, key) for key in ("description", "source", "uncertainty")}
    deviations = dict(bicycle.standard_deviations)
    impossible = objections(bicycle.parameters) if bicycle.parameters is not None else ()
    if bicycle.calibrated is not None:
        deviations |= bicycle.calibrated.standard_deviations
    if arguments.json:
        numbers: dict[str, Any] = {
            "parameters": bicycle.numbers,
            "standard_deviations": deviations,
            "objections": list(impossible),
        }
        if bicycle.calibrated is not None:
            numbers["calibration"] = calibration_yaml(bicycle.calibrated)
        print_json({"bicycle": bicycle.name, **text, **numbers})
        return
    for key, value in text.items():
        print(f"{key}: {value}")
    if bicycle.calibrated is not None:
        print(f"calibrated: {bicycle.calibrated.command}")
        for one in bicycle.calibrated.recordings:
            print(f"  {one['strikes']} strikes of {one['name']} (sha256 {one['sha256']})")
    for line in impossible:
        print(f"no body has this: {line}")
    for name, value in bicycle.numbers.items():
        deviation = f" +/- {deviations[name]:.2g}" if name in deviations else ""
        degrees = f"  ({math.degrees(value):.6g} deg)" if name == "steer_axis_tilt" else ""
        symbol = _LETTERS.get(name, "")
        print(f"  {name:26} {symbol:5} {value:<14.9g}{deviation} {unit(name)}{degrees}".rstrip())
