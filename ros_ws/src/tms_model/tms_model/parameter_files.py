"""Other people's bicycles: the parameter files of BicycleParameters, as text and as YAML.

    IBxx = 0.5296+/-0.0025      text: symbol = value+/-standard deviation, one to a line, # for comments
    IBxx: 0.5296                YAML: the same symbols, at the top or under `values`

The symbols are those of Meijaard et al. 2007, doi 10.1098/rspa.2007.1857, in SI units and radians; YAML may
hold the principal form of Moore and Hubbard 2019 instead (`tms_model.principal_form`). What such files say
beside the 26 symbols is known, and either agrees or isn't needed: the speed v, which belongs to a run; IRzz
and IFzz, the same as IRxx and IFxx; yB and yH, zero; handlebar G and fork S, which are parts of H.

Reference: J. K. Moore, BicycleParameters (BSD licence), https://bicycleparameters.readthedocs.io.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tms_model.bicycle import Bicycle, assemble
from tms_model.errors import ParameterError
from tms_model.measured import Measured, parse
from tms_model.parameters import WhippleParameters
from tms_model.principal_form import PRINCIPAL_SYMBOLS, from_principal, unknown_symbols

SYMBOLS: dict[str, str] = {
    "w": "wheelbase",
    "c": "trail",
    "lam": "steer_axis_tilt",
    "g": "gravity",
    "rR": "rear_wheel_radius",
    "mR": "rear_wheel_mass",
    "rF": "front_wheel_radius",
    "mF": "front_wheel_mass",
    "IRxx": "rear_wheel_inertia_xx",
    "IRyy": "rear_wheel_inertia_yy",
    "IFxx": "front_wheel_inertia_xx",
    "IFyy": "front_wheel_inertia_yy",
    "xB": "rear_frame_x",
    "zB": "rear_frame_z",
    "xH": "front_frame_x",
    "zH": "front_frame_z",
    "mB": "rear_frame_mass",
    "mH": "front_frame_mass",
    "IBxx": "rear_frame_inertia_xx",
    "IBxz": "rear_frame_inertia_xz",
    "IByy": "rear_frame_inertia_yy",
    "IBzz": "rear_frame_inertia_zz",
    "IHxx": "front_frame_inertia_xx",
    "IHxz": "front_frame_inertia_xz",
    "IHyy": "front_frame_inertia_yy",
    "IHzz": "front_frame_inertia_zz",
}  # symbol of BicycleParameters -> name in WhippleParameters
_NOT_NEEDED = re.compile(r"v|[mxz][GS]|I[GS](xx|xz|yy|zz)")
_EQUAL = {"IRzz": "IRxx", "IFzz": "IFxx"}
_ZERO = ("yB", "yH")
_BENCHMARK_FORM = ("benchmark", "Meijaard2007")
_PRINCIPAL_FORM = ("principal", "Moore2019")
_META = ("parameterization", "parameters", "rider", "description", "values")


def read_text_file(path: Path) -> Bicycle:
    """Bicycle from a text file of `symbol = value+/-standard deviation`. Raises ParameterError."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ParameterError(f"{path}: expected a readable text file, found: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ParameterError(f"{path}: expected a text file, found bytes that are no UTF-8") from error
    values: dict[str, Measured] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        symbol, equals, right = (part.strip() for part in content.partition("="))
        if not equals or not symbol:
            raise ParameterError(
                f"{path}: line {number}: expected 'symbol = value' or 'symbol = value+/-deviation', found"
                f" {content!r}"
            )
        if symbol in values:
            raise ParameterError(f"{path}: line {number}: {symbol} stands there for the second time")
        values[symbol] = parse(right, f"{path}: line {number}: {symbol}")
    return _bicycle(path, values, f"{path.stem}, from a parameter file")


def is_of_this_form(document: Mapping[str, Any]) -> bool:
    """Whether a YAML document is one of BicycleParameters, and not of the catalogue's own form."""
    return "values" in document or ("w" in document and "lam" in document)


def from_yaml(path: Path, document: Mapping[str, Any]) -> Bicycle:
    """Bicycle from the YAML document in the file `path`. Raises ParameterError."""
    values, form, description = document, "", ""
    if "values" in document:
        unknown = [str(key) for key in document if key not in _META]
        if unknown:
            raise ParameterError(f"{path}: unknown {', '.join(unknown)}; expected {', '.join(_META)}")
        values, form = document["values"], str(document.get("parameterization", ""))
        description = " ".join(str(document.get("description") or "").split())
    if not isinstance(values, Mapping):
        raise ParameterError(f"{path}: values: expected symbols with numbers, found {type(values).__name__}")
    if form and form not in _BENCHMARK_FORM + _PRINCIPAL_FORM:
        raise ParameterError(
            f"{path}: expected the parameterization {' or '.join(_BENCHMARK_FORM + _PRINCIPAL_FORM)}, found"
            f" {form!r}; BicycleParameters converts between them"
        )
    numbers = {str(key): _measured(value, f"{path}: {key}") for key, value in values.items()}
    if form in _PRINCIPAL_FORM or (not form and "mD" in numbers):
        numbers = _without_principal_form(path, numbers)
    return _bicycle(path, numbers, description or f"{path.stem}, from a parameter file")


def _measured(value: Any, where: str) -> Measured:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ParameterError(f"{where}: expected a number, found {value!r}")
    return parse(repr(value) if isinstance(value, float) else str(value), where)


def _without_principal_form(path: Path, numbers: dict[str, Measured]) -> dict[str, Measured]:
    _check_symbols(path, numbers, PRINCIPAL_SYMBOLS, unknown_symbols(numbers))
    measured = [symbol for symbol, number in numbers.items() if number.deviation]
    if measured:
        raise ParameterError(
            f"{path}: expected uncertainties in the symbols of Meijaard et al. 2007 only, found one of"
            f" {measured[0]}, of the principal form"
        )
    return {key: Measured(v) for key, v in from_principal({k: n.value for k, n in numbers.items()}).items()}


def _check_symbols(
    path: Path, numbers: Mapping[str, Measured], required: tuple[str, ...], unknown: list[str]
) -> None:
    missing = [symbol for symbol in required if symbol not in numbers]
    for word, symbols in (("missing", missing), ("unknown", unknown)):
        if symbols:
            raise ParameterError(f"{path}: {word} {', '.join(symbols)}; expected {', '.join(required)}")


def _bicycle(path: Path, numbers: Mapping[str, Measured], description: str) -> Bicycle:
    known = {*SYMBOLS, *_EQUAL, *_ZERO}
    unknown = [symbol for symbol in numbers if symbol not in known and not _NOT_NEEDED.fullmatch(symbol)]
    _check_symbols(path, numbers, tuple(SYMBOLS), unknown)
    for symbol, other in _EQUAL.items():
        value = numbers.get(symbol, numbers[other]).value
        if not math.isclose(value, numbers[other].value, rel_tol=1e-6):
            raise ParameterError(
                f"{path}: {symbol}: expected {numbers[other].value:g}, as {other}, since wheels are round,"
                f" found {value:g}"
            )
    for symbol in _ZERO:
        if symbol in numbers and abs(numbers[symbol].value) > 1e-6:
            raise ParameterError(
                f"{path}: {symbol}: expected 0, since the model is symmetric, found"
                f" {numbers[symbol].value:g} m"
            )
    deviations = {SYMBOLS[s]: numbers[s].deviation for s in SYMBOLS if numbers[s].deviation > 0.0}
    try:
        parameters = WhippleParameters(**{name: numbers[symbol].value for symbol, name in SYMBOLS.items()})
        return assemble(
            path.stem,
            parameters,
            description=description,
            source=f"{path.name}, a parameter file in the form of BicycleParameters",
            uncertainty="one standard deviation per parameter" if deviations else "none stated in the file",
            standard_deviations=deviations,
        )
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error
