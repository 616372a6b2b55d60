"""The principal form of a bicycle's parameters: radii of gyration along principal axes, and a rider apart.

The rear frame D and the rider P are two bodies that make up body B; an inertia is a mass, two radii of
gyration in the plane of symmetry, one across it, and the angle of the first axis from x [rad].

Reference: J. K. Moore and M. Hubbard, "Expanded optimization for discovering optimal lateral handling
bicycles", Bicycle and Motorcycle Dynamics 2019; BicycleParameters, `Moore2019ParameterSet`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

PRINCIPAL_SYMBOLS: tuple[str, ...] = (
    *("w", "c", "lam", "g", "rR", "mR", "kRaa", "kRyy", "rF", "mF", "kFaa", "kFyy"),
    *("mH", "xH", "zH", "kHaa", "kHbb", "kHyy", "alphaH"),
    *("mD", "xD", "zD", "kDaa", "kDbb", "kDyy", "alphaD"),
    *("mP", "xP", "zP", "kPaa", "kPbb", "kPyy", "alphaP"),
)
_FOLLOWS = re.compile(r"v|lP|wP|k[RF]bb|alpha[RF]|[xyz][RF]|y[DHP]")  # known, and not needed or in the others


class _Inertia(NamedTuple):
    xx: float
    xz: float
    yy: float
    zz: float

    def plus(self, other: _Inertia) -> _Inertia:
        return _Inertia(*(one + two for one, two in zip(self, other, strict=True)))


def unknown_symbols(values: Iterable[str]) -> list[str]:
    """Those of the symbols that the principal form doesn't have."""
    return [key for key in values if key not in PRINCIPAL_SYMBOLS and not _FOLLOWS.fullmatch(key)]


def from_principal(values: Mapping[str, float]) -> dict[str, float]:
    """The symbols of Meijaard et al. 2007 from those of the principal form, of which all must be there."""
    p = values
    mass = p["mD"] + p["mP"]
    x, z = ((p["mD"] * p[f"{axis}D"] + p["mP"] * p[f"{axis}P"]) / (mass or 1.0) for axis in "xz")
    rear = _inertia(p, "D").plus(_point(p["mD"], p["xD"] - x, p["zD"] - z))
    rider = _inertia(p, "P").plus(_point(p["mP"], p["xP"] - x, p["zP"] - z))
    numbers = {key: p[key] for key in ("w", "c", "lam", "g", "rR", "mR", "rF", "mF", "mH", "xH", "zH")}
    numbers |= {"mB": mass, "xB": x, "zB": z}
    for body, inertia in (("B", rear.plus(rider)), ("H", _inertia(p, "H"))):
        numbers |= {f"I{body}{axes}": value for axes, value in inertia._asdict().items()}
    for wheel in "RF":
        numbers[f"I{wheel}xx"] = p[f"m{wheel}"] * p[f"k{wheel}aa"] ** 2
        numbers[f"I{wheel}yy"] = p[f"m{wheel}"] * p[f"k{wheel}yy"] ** 2
    return numbers


def _inertia(p: Mapping[str, float], body: str) -> _Inertia:
    """Central inertia in x, y, z: the principal axes are turned by -alpha about y."""
    aa, bb, yy = (p[f"m{body}"] * p[f"k{body}{axes}"] ** 2 for axes in ("aa", "bb", "yy"))
    cos, sin = math.cos(p[f"alpha{body}"]), math.sin(p[f"alpha{body}"])
    return _Inertia(aa * cos**2 + bb * sin**2, (bb - aa) * sin * cos, yy, aa * sin**2 + bb * cos**2)


def _point(mass: float, x: float, z: float) -> _Inertia:
    return _Inertia(mass * z**2, -mass * x * z, mass * (x**2 + z**2), mass * x**2)
