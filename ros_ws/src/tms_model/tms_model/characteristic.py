"""The characteristic polynomial of the uncontrolled bicycle, its coefficients by name, and the Routh test.

    A s^4 + B s^3 + C s^2 + D s + E = det(M s^2 + C s + K) = 0         (4.1)
    X = B C D - A D^2 - E B^2                                          (4.6)

Each letter is a polynomial in the forward speed v: A_0, B_1 v, C_0 + C_2 v^2 ... (4.2), (4.3). Steer dampers
and lean-rate gains add the powers that those equations leave out. All is computed in rational arithmetic:
what is found from these polynomials is limited by the matrices' own digits only.

Reference: Kooijman et al. 2011, supplement (SOM), chapter 4, doi 10.1126/science.1201959.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.polynomial import polynomial

from tms_model.bicycle import Array, Bicycle
from tms_model.roots import positive_roots

LETTERS = "ABCDEX"
NAMES = ("A0", "B1", "C0", "C2", "D1", "D3", "E0", "E2", "X2", "X4", "X6")  # of (4.2) and (4.3)
ROUNDING = Fraction(1, 10**12)  # share of the terms' sizes below which their sum is called zero

Exact = list[Fraction]  # a polynomial in speed, the constant first
Matrix = list[list[Fraction]]

ROUTH = {"BCD": 1, "ADD": -1, "EBB": -1}  # (4.6)
DISCRIMINANT = {  # of a quartic: zero where two roots coincide
    "AAAEEE": 256,
    "AABDEE": -192,
    "AACCEE": -128,
    "AACDDE": 144,
    "AADDDD": -27,
    "ABBCEE": 144,
    "ABBDDE": -6,
    "ABCCDE": -80,
    "ABCDDD": 18,
    "ACCCCE": 16,
    "ACCCDD": -4,
    "BBBBEE": -27,
    "BBBCDE": 18,
    "BBBDDD": -4,
    "BBCCCE": -4,
    "BBCCDD": 1,
}


@dataclass(frozen=True)
class RouthTest:
    """The Routh test at one speed: asymptotically stable if and only if every value is positive."""

    speed: float  # [m/s]
    values: dict[str, float]  # of A, B, C, D, E, X

    @property
    def stable(self) -> bool:
        """Whether all eigenvalues have negative real parts."""
        return not self.failed

    @property
    def failed(self) -> tuple[str, ...]:
        """Letters whose values are not positive."""
        return tuple(letter for letter, value in self.values.items() if not value > 0.0)


def characteristic_polynomial(bicycle: Bicycle) -> dict[str, Array]:
    """Coefficients A...E of Eq. (4.1) and the Routh determinant X = BCD - ADD - EBB (4.3), over speed.

    Each value is an array of coefficients, the constant first: A (1,), B (2,), C (3,), D (4,), E (3,), X
    (7,). Powers that Eqs. (4.2) and (4.3) leave out are exactly zero without steer elements, and so is what
    only rounding tells from zero: on a two-mass skate E_2 and X_6 vanish, and a last digit in their place
    would make up a crossing.
    """
    return {letter: as_floats(p) for letter, p in exact_polynomials(bicycle).items()}


def coefficients(bicycle: Bicycle) -> dict[str, float]:
    """The coefficients of (4.2) and (4.3) by their names in `NAMES`, as A0 or X4; gravity is in them.

    Of a bicycle with steer elements, these are the coefficients of the same powers of speed, beside others.
    """
    letters = characteristic_polynomial(bicycle)
    return {name: float(letters[name[0]][int(name[1])]) for name in NAMES}


def routh(bicycle: Bicycle, speed: float) -> RouthTest:
    """The Routh test at a speed [m/s]."""
    letters = characteristic_polynomial(bicycle)
    return RouthTest(speed, {x: float(polynomial.polyval(speed, letters[x])) for x in LETTERS})


def positive_ranges(bicycle: Bicycle) -> dict[str, tuple[tuple[float, float], ...]]:
    """Speeds [m/s] at which each of A...X is positive: open intervals, of which the last may have no end."""
    ranges = {}
    for letter, exact in exact_polynomials(bicycle).items():
        edges = [0.0, *positive_roots(exact), math.inf]
        values = as_floats(exact)
        ranges[letter] = tuple(
            (low, high)
            for low, high in pairwise(edges)
            if polynomial.polyval(0.5 * (low + high) if math.isfinite(high) else 2.0 * low + 1.0, values)
            > 0.0
        )
    return ranges


def exact_polynomials(bicycle: Bicycle) -> dict[str, Exact]:
    """A...E and X as `characteristic_polynomial` has them, as fractions."""
    m, c1, k2 = (_matrix(p) for p in (bicycle.mass, bicycle.damping, bicycle.stiffness2))
    c0, spring = _matrix(bicycle.steer_elements.damping), _matrix(bicycle.steer_elements.stiffness)
    g, gravity = Fraction(bicycle.gravity), _matrix(bicycle.stiffness0)
    k0 = [[g * gravity[i][j] + spring[i][j] for j in range(2)] for i in range(2)]
    letters = {
        "A": _sums([_determinant(m)]),
        "B": _sums([_mixed(m, c0), _mixed(m, c1)]),
        "C": _sums([_mixed(m, k0) + _determinant(c0), _mixed(c0, c1), _mixed(m, k2) + _determinant(c1)]),
        "D": _sums([_mixed(c0, k0), _mixed(c1, k0), _mixed(c0, k2), _mixed(c1, k2)]),
        "E": _sums([_determinant(k0), [], _mixed(k0, k2)]),
    }
    return {**letters, "X": combination(letters, ROUTH)}


def combination(letters: Mapping[str, Exact], monomials: Mapping[str, int]) -> Exact:
    """Sum of products of polynomials, as {'BCD': 1, 'ADD': -1}; zero where only rounding is left."""
    length = max(sum(len(letters[x]) - 1 for x in factors) for factors in monomials) + 1
    terms: list[Exact] = [[] for _ in range(length)]
    for factors, number in monomials.items():
        value, size = [Fraction(number)], [Fraction(abs(number))]
        for letter in factors:
            value, size = _product(value, letters[letter]), _product(size, [abs(c) for c in letters[letter]])
        for power, (term, most) in enumerate(zip(value, size, strict=True)):
            # The sum of both is the term, the sum of their sizes what was added up to get it.
            terms[power] += [(term + most) / 2, (term - most) / 2]
    return _sums(terms)


def as_floats(exact: Exact) -> Array:
    """The polynomial's coefficients as float64, each rounded once."""
    return np.array([float(coefficient) for coefficient in exact])


def _product(p: Exact, q: Exact) -> Exact:
    result = [Fraction(0)] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(q):
            if a and b:
                result[i + j] += a * b
    return result


def _matrix(values: Array) -> Matrix:
    return [[Fraction(float(value)) for value in row] for row in values]


def _mixed(p: Matrix, q: Matrix) -> Exact:
    """Terms of the part of det(P s + Q t) that goes with s t."""
    return [p[0][0] * q[1][1], p[1][1] * q[0][0], -p[0][1] * q[1][0], -p[1][0] * q[0][1]]


def _determinant(p: Matrix) -> Exact:
    """Terms of det(P)."""
    return [p[0][0] * p[1][1], -p[0][1] * p[1][0]]


def _sums(groups: Iterable[Exact]) -> Exact:
    """Sum of each group of terms; exactly zero when they cancel to within rounding."""
    totals = []
    for terms in groups:
        total, size = sum(terms, Fraction(0)), sum((abs(term) for term in terms), Fraction(0))
        totals.append(total if abs(total) > ROUNDING * size else Fraction(0))
    return totals
