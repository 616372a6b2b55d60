"""Where the uncontrolled bicycle is stable: speed ranges and their boundaries, solved for and not scanned.

Reference: Kooijman et al. 2011, supplement (SOM), chapters 3 and 4, doi 10.1126/science.1201959.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from tms_model.bicycle import Array, Bicycle
from tms_model.characteristic import (
    DISCRIMINANT,
    as_floats,
    characteristic_polynomial,
    combination,
    exact_polynomials,
)
from tms_model.quartic import quadratic_eigenvalues
from tms_model.response import state_matrix
from tms_model.roots import positive_roots

__all__ = [
    "Boundary",
    "DoubleRoot",
    "Stability",
    "boundaries",
    "characteristic_polynomial",
    "double_roots",
    "eigenvalues",
    "stability",
]


@dataclass(frozen=True)
class Boundary:
    """A speed at which eigenvalues cross the imaginary axis (SOM chapter 4, conditions A and B)."""

    speed: float  # [m/s]
    condition: str  # "E": a real eigenvalue passes zero; "X": a pair passes +-i frequency
    frequency: float  # [rad/s] of the pair, sqrt(D / B) (4.5); 0 for a real eigenvalue
    stabilises: bool  # whether the eigenvalues become stable as the speed grows


@dataclass(frozen=True)
class DoubleRoot:
    """A speed at which two real eigenvalues coincide: they become an oscillation, or came from one."""

    speed: float  # [m/s]
    eigenvalue: float  # [1/s]


@dataclass(frozen=True)
class Stability:
    """Where the uncontrolled bicycle is asymptotically stable."""

    stable_speed_ranges: tuple[tuple[float, float], ...]  # [m/s] open intervals, the last may have no end
    weave_speed: float | None  # [m/s] lowest speed at which an unstable oscillation becomes stable (X = 0)
    capsize_speed: float | None  # [m/s] lowest speed at which a real root becomes unstable (E = 0)

    @property
    def onset_speed(self) -> float | None:
        """Lowest speed [m/s] above which the bicycle is self-stable; None if it never is."""
        return self.stable_speed_ranges[0][0] if self.stable_speed_ranges else None


def eigenvalues(bicycle: Bicycle, speed: float | Array) -> NDArray[np.complex128]:
    """Roots of det(M s^2 + v C1 s + g K0 + v^2 K2) = 0 (3.3) [1/s], complex (4,), sorted by re, then im.

    speed: [m/s], or n of them for (n, 4), which is much faster than one after the other.
    """
    if np.ndim(speed):
        speeds = np.asarray(speed)
        return quadratic_eigenvalues(bicycle.mass, bicycle.damping_at(speeds), bicycle.stiffness_at(speeds))
    roots: NDArray[np.complex128] = np.linalg.eigvals(state_matrix(bicycle, speed)).astype(np.complex128)
    return roots[np.lexsort((roots.imag, roots.real))]


def stability(bicycle: Bicycle) -> Stability:
    """Stable speed ranges by Routh's criterion (SOM chapter 4), A...E and X positive; solved, not scanned."""
    exact = exact_polynomials(bicycle)
    values = {letter: as_floats(p) for letter, p in exact.items()}
    edges = [0.0, *sorted({root for letter in "BCDEX" for root in positive_roots(exact[letter])}), math.inf]
    ranges: list[tuple[float, float]] = []
    for low, high in pairwise(edges):
        inside = 0.5 * (low + high) if math.isfinite(high) else 2.0 * low + 1.0
        if all(polynomial.polyval(inside, values[letter]) > 0.0 for letter in "ABCDEX"):
            # Where a coefficient touches zero without a crossing, both sides are one range.
            if ranges and ranges[-1][1] == low and _stable_at(values, low):
                ranges[-1] = (ranges[-1][0], high)
            else:
                ranges.append((low, high))
    crossings = boundaries(bicycle)
    weave = [b.speed for b in crossings if b.condition == "X" and b.stabilises]
    capsize = [b.speed for b in crossings if b.condition == "E" and not b.stabilises]
    return Stability(tuple(ranges), weave[0] if weave else None, capsize[0] if capsize else None)


def boundaries(bicycle: Bicycle) -> tuple[Boundary, ...]:
    """All speeds above zero at which eigenvalues cross the imaginary axis, ascending.

    At X = 0 a pair of roots stands at +-i sqrt(D / B) if B and D have one sign (with different signs, two
    real roots are each other's negative, which is no boundary); it comes from the right where B X grows. At E
    = 0 a root near -E / D passes through zero.
    """
    exact = exact_polynomials(bicycle)
    values = {letter: as_floats(p) for letter, p in exact.items()}
    found = []
    for letter in "EX":
        for speed in positive_roots(exact[letter]):
            b, d = (float(polynomial.polyval(speed, values[x])) for x in "BD")
            slope = float(polynomial.polyval(speed, polynomial.polyder(values[letter])))
            if letter == "E":
                found.append(Boundary(speed, "E", 0.0, slope * d > 0.0))
            elif b * d > 0.0:
                found.append(Boundary(speed, "X", math.sqrt(d / b), slope * b > 0.0))
    return tuple(sorted(found, key=lambda boundary: boundary.speed))


def double_roots(bicycle: Bicycle) -> tuple[DoubleRoot, ...]:
    """All speeds above zero at which two real eigenvalues coincide, ascending: the discriminant's roots."""
    exact = exact_polynomials(bicycle)
    found = []
    for speed in positive_roots(combination(exact, DISCRIMINANT)):
        quartic = np.array([polynomial.polyval(speed, as_floats(exact[x])) for x in "ABCDE"])
        # A double root is one of the derivative too, and a simple one there: of its three, the one that is a
        # root.
        stationary = np.roots(np.polyder(quartic))
        share = np.abs(np.polyval(quartic, stationary)) / np.polyval(np.abs(quartic), np.abs(stationary))
        root = stationary[np.argmin(share)]
        if abs(root.imag) <= 1e-9 * abs(root):
            found.append(DoubleRoot(speed, float(root.real)))
    return tuple(found)


def _stable_at(values: dict[str, NDArray[np.float64]], speed: float) -> bool:
    return all(polynomial.polyval(speed, values[letter]) > 0.0 for letter in "ABCDEX")
