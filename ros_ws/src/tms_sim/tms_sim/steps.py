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
    factors = _factors(generators)
    count, size, wide = factors.shape
    alone = count == 1  # no matrices then: the state itself
    # Row by row the c_n, highest n first: c_n, c_(n-1) and c_(n-2) lie together; those below c_0 are 0.
    terms = np.zeros((count, (ORDER + 3) * size, 1 if alone else size))
    terms[:, ORDER * size : (ORDER + 1) * size] = initial[:, None] if alone else np.eye(size)
    for n in range(ORDER):
        row = (ORDER - n) * size
        higher = terms[:, row - size : row]
        np.matmul(factors, terms[:, row : row + wide], out=higher)
        higher /= n + 1
    terms = terms[:, : (ORDER + 1) * size]
    whole = terms[:, :size].copy()
    for row in range(size, (ORDER + 1) * size, size):
        whole *= lengths[:, None, None]
        whole += terms[:, row : row + size]
    if alone:
        return terms.reshape(1, ORDER + 1, size)[:, ::-1], whole[0, :, 0]
    states = np.empty((count + 1, size))
    states[0] = initial
    for k in range(count):
        states[k + 1] = whole[k] @ states[k]
    found = terms @ states[:-1, :, None]
    return found.reshape(count, ORDER + 1, size)[:, ::-1], states[-1]


def _factors(generators: tuple[Array, Array, Array]) -> Array:
    """G0, G1, G2 side by side (k, d, d to 3 d), without those that are zero throughout."""
    needed = 3 if generators[2].any() else 2 if generators[1].any() else 1
    return np.concatenate(generators[:needed], axis=2)


def shifted(coefficients: Array, by: Array | float) -> Array:
    """The same polynomials (..., m) about a later instant; by: one for all, or (...)."""
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
