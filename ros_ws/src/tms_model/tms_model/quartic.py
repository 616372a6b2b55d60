"""Eigenvalues of many bicycles or speeds at once: the roots of det(M s^2 + C s + K) = 0, a quartic each.

Ferrari's solution in real arithmetic gives two quadratic factors for every quartic; Newton's method on the
determinant itself then removes what rounding the coefficients has cost. Rows in which that is no safe way,
for roots nearly coincide or don't multiply out to the quartic again, go to numpy's eigenvalue routine, as one
bicycle alone does. That is three times faster than the routine for all rows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tms_model.response import first_order

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
APART = 1e-3  # roots nearer to each other than this share of their size are left to numpy
AGREES = 1e-9  # share of a coefficient's terms within which the roots must multiply out to it
STEPS = 2  # of Newton's method


def quadratic_eigenvalues(mass: Array, damping: Array, stiffness: Array) -> Complex:
    """Roots s of det(M s^2 + C s + K) = 0, (n, 4), sorted by re, then im.

    mass: (2, 2) or (n, 2, 2), positive definite; damping, stiffness: (n, 2, 2).
    """
    mass = np.broadcast_to(mass, damping.shape)
    with np.errstate(all="ignore"):  # what goes wrong in a row shows in it, and is done again
        coefficients = _coefficients(mass, damping, stiffness)
        roots = _newton(_ferrari(coefficients), mass, damping, stiffness)
        safe = _safe(roots, coefficients)
    roots = np.ascontiguousarray(roots.T)
    if not safe.all():
        rows = ~safe
        roots[rows] = np.linalg.eigvals(first_order(mass[rows], damping[rows], stiffness[rows]))
    return np.take_along_axis(roots, np.lexsort((roots.imag, roots.real), axis=-1), axis=-1)


def _coefficients(m: Array, c: Array, k: Array) -> Array:
    """b, c, d, e of s^4 + b s^3 + c s^2 + d s + e, (4, n)."""

    def determinant(p: Array, q: Array) -> Array:
        return np.asarray(p[:, 0, 0] * q[:, 1, 1] - p[:, 0, 1] * q[:, 1, 0])

    leading = determinant(m, m)
    terms = (
        determinant(m, c) + determinant(c, m),
        determinant(m, k) + determinant(k, m) + determinant(c, c),
        determinant(c, k) + determinant(k, c),
        determinant(k, k),
    )
    return np.stack(terms) / leading


def _ferrari(coefficients: Array) -> Complex:
    """Roots (4, n) by two real quadratic factors, to perhaps half of the digits."""
    b, c, d, e = coefficients
    shift = b / 4.0
    p = c - 6.0 * shift**2
    q = d - 2.0 * c * shift + 8.0 * shift**3
    r = e - d * shift + c * shift**2 - 3.0 * shift**4
    # y^4 + p y^2 + q y + r = (y^2 + u y + h) (y^2 - u y + k), u^2 the largest root of the resolvent
    square = np.maximum(_largest_cubic_root(2.0 * p, p**2 - 4.0 * r, -(q**2)), 0.0)
    u = np.sqrt(square)
    ratio = np.divide(q, u, out=np.zeros_like(q), where=u > 0.0)
    h, k = 0.5 * (p + square - ratio), 0.5 * (p + square + ratio)
    return np.asarray(np.stack([*_quadratic(u, h), *_quadratic(-u, k)]) - shift)


def _largest_cubic_root(a: Array, b: Array, c: Array) -> Array:
    """Largest real root of x^3 + a x^2 + b x + c."""
    q, r = (a**2 - 3.0 * b) / 9.0, (2.0 * a**3 - 9.0 * a * b + 27.0 * c) / 54.0
    three = r**2 < q**3
    root = np.sqrt(np.maximum(q, 0.0))
    angle = np.arccos(np.clip(r / np.where(three, root**3, 1.0), -1.0, 1.0))
    size = np.cbrt(np.abs(r) + np.sqrt(np.maximum(r**2 - q**3, 0.0)))
    single = -np.sign(r) * (size + np.divide(q, size, out=np.zeros_like(q), where=size > 0.0))
    return np.asarray(np.where(three, -2.0 * root * np.cos((angle + 2.0 * np.pi) / 3.0), single) - a / 3.0)


def _quadratic(u: Array, h: Array) -> tuple[Complex, Complex]:
    """Roots of y^2 + u y + h without cancellation; conjugates of each other where they are complex."""
    discriminant = 0.25 * u**2 - h
    root = np.sqrt(np.abs(discriminant))
    outer = -0.5 * u - np.where(u >= 0.0, root, -root)
    inner = np.divide(h, outer, out=np.zeros_like(h), where=outer != 0.0)
    real = discriminant >= 0.0
    one = np.where(real, outer, -0.5 * u) + 1j * np.where(real, 0.0, root)
    two = np.where(real, inner, -0.5 * u) - 1j * np.where(real, 0.0, root)
    return one, two


def _newton(roots: Complex, m: Array, c: Array, k: Array) -> Complex:
    for _ in range(STEPS):
        entries, slopes = {}, {}
        for i in range(2):
            for j in range(2):
                mass, damping = m[:, i, j], c[:, i, j]
                entries[i, j] = (mass * roots + damping) * roots + k[:, i, j]
                slopes[i, j] = 2.0 * mass * roots + damping
        value = entries[0, 0] * entries[1, 1] - entries[0, 1] * entries[1, 0]
        slope = slopes[0, 0] * entries[1, 1] + entries[0, 0] * slopes[1, 1]
        slope = slope - slopes[0, 1] * entries[1, 0] - entries[0, 1] * slopes[1, 0]
        roots = roots - value / slope
    return roots


def _safe(roots: Complex, coefficients: Array) -> NDArray[np.bool_]:
    """Rows (n,) whose roots are apart from each other and multiply out to the coefficients."""
    one, two, three, four = roots
    size = np.abs(roots)
    a, b, c, d = size
    products = (
        (-(one + two + three + four), a + b + c + d),
        ((one + two) * (three + four) + one * two + three * four, (a + b) * (c + d) + a * b + c * d),
        (-(one * two * (three + four) + three * four * (one + two)), a * b * (c + d) + c * d * (a + b)),
        (one * two * three * four, a * b * c * d),
    )
    good = np.isfinite(roots).all(axis=0)
    for (product, bound), coefficient in zip(products, coefficients, strict=True):
        good &= np.abs(product - coefficient) <= AGREES * bound
    for i in range(4):
        for j in range(i):
            good &= np.abs(roots[i] - roots[j]) > APART * np.maximum(size[i], size[j])
    return np.asarray(good)
