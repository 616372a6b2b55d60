"""Eigenvalues, characteristic polynomial and stable speed ranges of the uncontrolled bicycle.

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
from tms_model.response import state_matrix

ROUNDING = 1e-12  # share of the terms' sizes below which their sum is called zero


@dataclass(frozen=True)
class Stability:
    """Where the uncontrolled bicycle is asymptotically stable."""

    stable_speed_ranges: tuple[tuple[float, float], ...]  # [m/s] open intervals, the last may have no end
    weave_speed: float | None  # [m/s] lowest speed at which an unstable oscillation becomes stable (X = 0)
    capsize_speed: float | None  # [m/s] lowest speed at which a real root becomes unstable (E = 0)


def eigenvalues(bicycle: Bicycle, speed: float) -> NDArray[np.complex128]:
    """Roots of det(M s^2 + v C1 s + g K0 + v^2 K2) = 0 (3.3) [1/s], complex (4,), sorted by re, then im."""
    roots: NDArray[np.complex128] = np.linalg.eigvals(state_matrix(bicycle, speed)).astype(np.complex128)
    return roots[np.lexsort((roots.imag, roots.real))]


def characteristic_polynomial(bicycle: Bicycle) -> dict[str, Array]:
    """Coefficients A...E of Eq. (4.1) and the Routh determinant X = BCD - ADD - EBB (4.3), over speed.

    Each value is an array of coefficients, the constant first: A (1,), B (2,), C (3,), D (4,), E (3,), X
    (7,); powers that Eqs. (4.2) and (4.3) leave out are exactly zero, and so is what only rounding tells from
    zero: on a two-mass skate E_2 and X_6 vanish, and a last digit in their place would make up a crossing.
    """
    m, c, k0, k2 = bicycle.mass, bicycle.damping, bicycle.gravity * bicycle.stiffness0, bicycle.stiffness2
    a0 = _mixed(m, m) / 2.0
    b1 = _mixed(m, c)
    c0, c2 = _mixed(m, k0), _sum(_mixed(m, k2), _mixed(c, c) / 2.0)
    d1, d3 = _mixed(c, k0), _mixed(c, k2)
    e0, e2 = _mixed(k0, k0) / 2.0, _mixed(k0, k2)
    x2 = _sum(b1 * c0 * d1, -a0 * d1**2, -e0 * b1**2)
    x4 = _sum(b1 * c0 * d3, b1 * c2 * d1, -2.0 * a0 * d1 * d3, -e2 * b1**2)
    x6 = _sum(b1 * c2 * d3, -a0 * d3**2)
    return {
        "A": np.array([a0]),
        "B": np.array([0.0, b1]),
        "C": np.array([c0, 0.0, c2]),
        "D": np.array([0.0, d1, 0.0, d3]),
        "E": np.array([e0, 0.0, e2]),
        "X": np.array([0.0, 0.0, x2, 0.0, x4, 0.0, x6]),
    }


def stability(bicycle: Bicycle) -> Stability:
    """Stable speed ranges by Routh's criterion (SOM chapter 4), A...E and X positive; solved, not scanned."""
    coefficients = characteristic_polynomial(bicycle)

    def at(letter: str, speed: float) -> float:
        return float(polynomial.polyval(speed, coefficients[letter]))

    edges = [
        0.0,
        *sorted({root for letter in "BCDEX" for root in _positive_roots(coefficients[letter])}),
        math.inf,
    ]
    ranges: list[tuple[float, float]] = []
    for low, high in pairwise(edges):
        inside = 0.5 * (low + high) if math.isfinite(high) else 2.0 * low + 1.0
        if all(at(letter, inside) > 0.0 for letter in "ABCDEX"):
            ranges.append((low, high))
    # At X = 0 a pair of roots stands at +-i sqrt(D / B); it comes from the right where B X grows.
    # At E = 0 a root near -E / D passes through zero.
    slope = {letter: polynomial.polyder(coefficients[letter]) for letter in "EX"}
    weave = [
        speed
        for speed in _positive_roots(coefficients["X"])
        if at("B", speed) * at("D", speed) > 0.0
        and polynomial.polyval(speed, slope["X"]) * at("B", speed) > 0.0
    ]
    capsize = [
        speed
        for speed in _positive_roots(coefficients["E"])
        if polynomial.polyval(speed, slope["E"]) * at("D", speed) < 0.0
    ]
    return Stability(tuple(ranges), weave[0] if weave else None, capsize[0] if capsize else None)


def _mixed(p: Array, q: Array) -> float:
    """The part of det(P s + Q t) that goes with s t; twice the determinant for P = Q."""
    return _sum(p[0, 0] * q[1, 1], p[1, 1] * q[0, 0], -p[0, 1] * q[1, 0], -p[1, 0] * q[0, 1])


def _sum(*terms: float) -> float:
    """Sum of terms; exactly zero when they cancel to within rounding."""
    total = math.fsum(terms)
    return total if abs(total) > ROUNDING * math.fsum(abs(term) for term in terms) else 0.0


def _positive_roots(coefficients: Array) -> list[float]:
    """Real positive roots, sorted. The polynomials are odd or even in speed: solved for its square."""
    nonzero = np.flatnonzero(coefficients)
    if len(nonzero) < 2:
        return []
    squared = polynomial.polyroots(coefficients[nonzero[0] : nonzero[-1] + 1 : 2])
    real = squared[np.abs(squared.imag) <= 1e-9 * np.abs(squared)].real
    return sorted(float(root) for root in np.sqrt(real[real > 0.0]))
