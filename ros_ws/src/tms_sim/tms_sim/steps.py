"""Linear systems with coefficients that are polynomials in time: one Taylor series for each short step.

    z' = (G0 + G1 t + G2 t^2) z,   t since the begin of the step

z(t) = sum of c_n t^n, (n + 1) c_(n+1) = G0 c_n + G1 c_(n-1) + G2 c_(n-2). The series are right to rounding
when a step is short beside the system (`longest_step`), and give the motion at every instant, not only at the
steps' ends.
"""

from __future__ import annotations

import numpy as np
from tms_model.bicycle import Array

ORDER = 16
PHASE = 1.5  # [rad]; of the fastest oscillation in a step: 1.5^17 / 17! is 3e-12 of what it still adds


def longest_step(generator: Array) -> float:
    """How long a step may be [s] for a generator (d, d)."""
    scale = float(np.sqrt(np.abs(np.linalg.matrix_power(generator, 2)).max()))
    return PHASE / max(scale, 1e-9)


def series(generators: tuple[Array, Array, Array], lengths: Array, initial: Array) -> tuple[Array, Array]:
    """Coefficients (k, ORDER + 1, d) of z in k steps, one after the other, and z (d,) at the end.

    generators: (k, d, d) each; lengths: (k,) [s]; initial: (d,).
    """
    constant, linear, square = generators
    count, size, _ = constant.shape
    terms = np.empty((ORDER + 1, count, size, size))
    terms[0] = np.eye(size)
    has_linear, has_square = bool(linear.any()), bool(square.any())
    for n in range(ORDER):
        term = constant @ terms[n]
        if has_linear and n >= 1:
            term += linear @ terms[n - 1]
        if has_square and n >= 2:
            term += square @ terms[n - 2]
        terms[n + 1] = term / (n + 1)
    whole = terms[ORDER].copy()
    for n in range(ORDER - 1, -1, -1):
        whole *= lengths[:, None, None]
        whole += terms[n]
    states = np.empty((count + 1, size))
    states[0] = initial
    for k in range(count):
        states[k + 1] = whole[k] @ states[k]
    return np.einsum("nkij,kj->kni", terms, states[:-1]), states[-1]


def shifted(coefficients: Array, by: float) -> Array:
    """The same polynomials (..., m) about a later instant."""
    moved = coefficients.copy()
    size = coefficients.shape[-1]
    for low in range(size - 1):
        for n in range(size - 2, low - 1, -1):
            moved[..., n] += by * moved[..., n + 1]
    return moved


def bridge(start: Array, end: Array, duration: float) -> Array:
    """Polynomials (m, 6) from value, rate and second rate (m, 3) at the start to those (m, 3) at the end."""
    T = duration
    low = start * np.array([1.0, 1.0, 0.5])
    powers = np.arange(3, 6)
    matrix = np.array(
        [T**powers, powers * T ** (powers - 1), powers * (powers - 1) * T ** (powers - 2)], dtype=float
    )
    missing = np.stack(
        [
            end[:, 0] - low @ np.array([1.0, T, T**2]),
            end[:, 1] - low @ np.array([0.0, 1.0, 2.0 * T]),
            end[:, 2] - 2.0 * low[:, 2],
        ],
        axis=1,
    )
    return np.concatenate([low, np.linalg.solve(matrix, missing.T).T], axis=1)
