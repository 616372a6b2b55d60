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


@dataclass(frozen=True)
class Stability:
    """Where the uncontrolled bicycle is asymptotically stable."""

    stable_speed_ranges: tuple[
        tuple[float, float], ...
    ]  # [m/s] open intervals, the upper end may be infinite
    weave_speed: float | None  # [m/s] lowest speed at which an unstable oscillation becomes stable (X = 0)
    capsize_speed: float | None  # [m/s] lowest speed at which a real root becomes unstable (E = 0)


def eigenvalues(bicycle: Bicycle, speed: float) -> NDArray[np.complex128]:
    """Roots of det(M s^2 + v C1 s + g K0 + v^2 K2) = 0 (3.3) [1/s], complex (4,), sorted by re, then im."""
    roots: NDArray[np.complex128] = np.linalg.eigvals(state_matrix(bicycle, speed)).astype(np.complex128)
    return roots[np.lexsort((roots.imag, roots.real))]


def characteristic_polynomial(bicycle: Bicycle) -> dict[str, Array]:
    """Coefficients A...E of Eq. (4.1) and the Routh determinant X = BCD - ADD - EBB (4.3), over speed.

    Each value is an array of coefficients, the constant first: A (1,), B (2,), C (3,), D (4,), E (3,), X
    (7,); powers that Eq. (4.2) leaves out are exactly zero.
    """
    m, c, k0, k2 = bicycle.mass, bicycle.damping, bicycle.gravity * bicycle.stiffness0, bicycle.stiffness2

    def entry(i: int, j: int) -> list[Array]:  # powers of s: 0, 1, 2; each a polynomial in v
        return [np.array([k0[i, j], 0.0, k2[i, j]]), np.array([0.0, c[i, j]]), np.array([m[i, j]])]

    def product(a: list[Array], b: list[Array]) -> list[Array]:
        out: list[Array] = [np.zeros(1)] * 5
        for i, left in enumerate(a):
            for j, right in enumerate(b):
                out[i + j] = np.asarray(
                    polynomial.polyadd(out[i + j], polynomial.polymul(left, right)), float
                )
        return out

    determinant = [
        polynomial.polysub(left, right)
        for left, right in zip(
            product(entry(0, 0), entry(1, 1)), product(entry(0, 1), entry(1, 0)), strict=True
        )
    ]
    powers = {"A": (0,), "B": (1,), "C": (0, 2), "D": (1, 3), "E": (0, 2)}
    result = {}
    for letter, coefficients in zip("EDCBA", determinant, strict=True):
        exact = np.zeros(max(powers[letter]) + 1)
        for power in powers[letter]:
            exact[power] = coefficients[power] if power < len(coefficients) else 0.0
        result[letter] = exact
    a, b, cc, d, e = (result[letter] for letter in "ABCDE")
    x = polynomial.polysub(
        polynomial.polysub(
            polynomial.polymul(polynomial.polymul(b, cc), d), polynomial.polymul(a, polynomial.polymul(d, d))
        ),
        polynomial.polymul(e, polynomial.polymul(b, b)),
    )
    result["X"] = np.pad(x, (0, 7 - len(x)))
    return {letter: result[letter] for letter in "ABCDEX"}


def stability(bicycle: Bicycle) -> Stability:
    """Stable speed ranges, bounded by positive roots of E and X (SOM chapter 4): solved for, not scanned."""
    coefficients = characteristic_polynomial(bicycle)
    real_crossings = _positive_roots(coefficients["E"])
    weave_crossings = _positive_roots(coefficients["X"])
    # B, C and D can change sign only together with X or E unless stability is lost anyway; they cut intervals
    # all the same.
    cuts = sorted(
        {*real_crossings, *weave_crossings, *(r for c in "BCD" for r in _positive_roots(coefficients[c]))}
    )
    edges = [0.0, *cuts, math.inf]
    ranges: list[tuple[float, float]] = []
    for low, high in pairwise(edges):
        inside = 0.5 * (low + high) if math.isfinite(high) else 2.0 * low + 1.0
        if (eigenvalues(bicycle, inside).real < 0.0).all():
            if ranges and ranges[-1][1] == low:
                ranges[-1] = (ranges[-1][0], high)
            else:
                ranges.append((low, high))
    starts, ends = {low for low, _ in ranges}, {high for _, high in ranges}
    weave = [speed for speed in weave_crossings if speed in starts]
    capsize = [speed for speed in real_crossings if speed in ends]
    return Stability(tuple(ranges), weave[0] if weave else None, capsize[0] if capsize else None)


def _positive_roots(coefficients: Array) -> list[float]:
    """Real positive roots, sorted. The polynomials are odd or even in speed: solved for its square."""
    nonzero = np.flatnonzero(coefficients)
    if len(nonzero) < 2:
        return []
    squared = polynomial.polyroots(coefficients[nonzero[0] : nonzero[-1] + 1 : 2])
    real = squared[np.abs(squared.imag) <= 1e-9 * np.abs(squared)].real
    return sorted(float(root) for root in np.sqrt(real[real > 0.0]))
