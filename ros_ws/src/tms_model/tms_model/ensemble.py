"""Many parameter sets at once: matrices, eigenvalues, and the speeds at which stability begins and ends.

An Ensemble holds n bicycles as arrays with a leading axis; everything here works on the whole axis without a
loop in Python. `tms_model.stability` answers the same questions for one bicycle in rational arithmetic; here
it is floating point, where what is less than ROUNDING of its terms counts as zero.

Reference: Kooijman et al. 2011, supplement (SOM), chapter 4, doi 10.1126/science.1201959.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from tms_model.bicycle import Array, Bicycle, whipple_matrices
from tms_model.errors import ParameterError
from tms_model.parameters import PARAMETER_NAMES
from tms_model.quartic import quadratic_eigenvalues
from tms_model.steer_elements import SteerElements

Complex = NDArray[np.complex128]
ROUNDING = 1e-12  # share of the terms' sizes below which their sum is called zero
_REAL = 1e-6  # imaginary share of a polynomial's root that may be real
_RESIDUAL = 1e-11  # share of its terms' sizes at which a polynomial counts as zero


@dataclass(frozen=True, eq=False)
class Ensemble:
    """n bicycles with the same steer elements. M, C1, K0, K2 of SOM Eq. (3.1), each (n, 2, 2)."""

    mass: Array  # M [kg m^2]
    damping: Array  # C1 [kg m]
    stiffness0: Array  # K0 [kg m]
    stiffness2: Array  # K2 [kg]
    gravity: Array  # (n,) [m/s^2]
    steer_elements: SteerElements = field(default_factory=SteerElements)

    def __len__(self) -> int:
        return len(self.mass)

    @property
    def physical(self) -> NDArray[np.bool_]:
        """Where M is positive definite, (n,)."""
        m = self.mass
        determinant = m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0]
        return np.asarray((m[:, 0, 0] > 0.0) & (determinant > 0.0))


@dataclass(frozen=True, eq=False)
class EnsembleStability:
    """For each of n bicycles what `tms_model.Stability` says of one [m/s]; NaN where there is none."""

    onset_speed: Array  # (n,) lowest speed above which the bicycle is stable
    weave_speed: Array  # (n,) lowest at which an unstable oscillation becomes stable
    capsize_speed: Array  # (n,) lowest at which a real root becomes unstable


def ensemble(bicycle: Bicycle, changed: Mapping[str, Array]) -> Ensemble:
    """Bicycles like `bicycle`, with the parameters in `changed` replaced by arrays (n,).

    Nothing but the names and shapes is checked: what isn't physical comes out as NaN in the answers. Raises
    ParameterError for a bicycle without parameters, an unknown name, or arrays that don't have one length.
    """
    if bicycle.parameters is None:
        raise ParameterError(
            f"bicycle {bicycle.name}: expected one that is given by its parameters, found one given by"
            " matrices only"
        )
    unknown = [name for name in changed if name not in PARAMETER_NAMES]
    if unknown:
        raise ParameterError(f"unknown {', '.join(unknown)}; expected some of {', '.join(PARAMETER_NAMES)}")
    shapes = sorted({np.shape(values) for values in changed.values()})
    if len(shapes) != 1 or len(shapes[0]) != 1:
        raise ParameterError(f"expected arrays of one length for the parameters, found the shapes {shapes}")
    values = {**asdict(bicycle.parameters), **changed}
    p = SimpleNamespace(**{name: np.broadcast_to(value, shapes[0]) for name, value in values.items()})
    spins = (
        np.divide(inertia, radius, out=np.zeros(shapes[0]), where=np.not_equal(inertia, 0.0))
        for inertia, radius in (
            (p.rear_wheel_inertia_yy, p.rear_wheel_radius),
            (p.front_wheel_inertia_yy, p.front_wheel_radius),
        )
    )
    tilt = p.steer_axis_tilt
    matrices = whipple_matrices(p, np.cos(tilt), np.sin(tilt), *spins)
    return Ensemble(*matrices, gravity=p.gravity, steer_elements=bicycle.steer_elements)


def ensemble_eigenvalues(bicycles: Ensemble, speed: float) -> Complex:
    """Eigenvalues [1/s] of each bicycle at a speed [m/s], (n, 4), sorted by re, then im; or NaN."""
    elements, good = bicycles.steer_elements, bicycles.physical
    mass, gravity = bicycles.mass[good], bicycles.gravity[good, None, None]
    stiffness = (
        gravity * bicycles.stiffness0[good] + speed**2 * bicycles.stiffness2[good] + elements.stiffness
    )
    damping = speed * bicycles.damping[good] + elements.damping
    roots = np.full((len(bicycles), 4), np.nan + 0j)
    roots[good] = quadratic_eigenvalues(mass, damping, stiffness)
    return roots


def ensemble_stability(bicycles: Ensemble) -> EnsembleStability:
    """Speeds at which each bicycle becomes stable, and loses weave or gains capsize; solved, not scanned."""
    p = _polynomials(bicycles)
    roots = {letter: _positive_roots(p[letter]) for letter in "BCDEX"}
    edges = np.sort(np.concatenate(list(roots.values()), axis=1), axis=1)  # NaN last
    first = np.zeros((len(bicycles), 1))
    lower = np.concatenate([first, edges], axis=1)
    upper = np.concatenate([edges, np.full_like(first, np.nan)], axis=1)
    inside = np.where(np.isnan(upper), 2.0 * lower + 1.0, 0.5 * (lower + upper))
    # A range that a touching root divides begins where its first part begins: the first part is what counts.
    stable = np.all([_at(p[letter], inside) > 0.0 for letter in "ABCDEX"], axis=0)
    onset = _lowest(lower, stable & bicycles.physical[:, None])
    x, e = roots["X"], roots["E"]
    b, d = _at(p["B"], x), _at(p["D"], x)
    weave = _lowest(x, (b * d > 0.0) & (_at(_slope(p["X"]), x) * b > 0.0))
    capsize = _lowest(e, _at(_slope(p["E"]), e) * _at(p["D"], e) < 0.0)
    lost = np.where(bicycles.physical, 0.0, np.nan)
    return EnsembleStability(onset, weave + lost, capsize + lost)


def _lowest(speeds: Array, wanted: NDArray[np.bool_]) -> Array:
    lowest = np.min(np.where(wanted, speeds, np.inf), axis=1)
    return np.where(np.isfinite(lowest), lowest, np.nan)


def _polynomials(bicycles: Ensemble) -> dict[str, Array]:
    """A...E of (4.1) and X of (4.6) as polynomials in speed, constant first, each (n, powers)."""
    m, c1, k2 = bicycles.mass, bicycles.damping, bicycles.stiffness2
    c0 = np.broadcast_to(bicycles.steer_elements.damping, m.shape)
    k0 = bicycles.gravity[:, None, None] * bicycles.stiffness0 + bicycles.steer_elements.stiffness
    p = {
        "A": [_sum(_determinant(m))],
        "B": [_sum(_mixed(m, c0)), _sum(_mixed(m, c1))],
        "C": [
            _sum(_mixed(m, k0) + _determinant(c0)),
            _sum(_mixed(c0, c1)),
            _sum(_mixed(m, k2) + _determinant(c1)),
        ],
        "D": [_sum(_mixed(c0, k0)), _sum(_mixed(c1, k0)), _sum(_mixed(c0, k2)), _sum(_mixed(c1, k2))],
        "E": [_sum(_determinant(k0)), np.zeros(len(m)), _sum(_mixed(k0, k2))],
    }
    terms: list[list[Array]] = [[] for _ in range(7)]
    for sign, (one, two, three) in ((1.0, "BCD"), (-1.0, "ADD"), (-1.0, "EBB")):
        for i, a in enumerate(p[one]):
            for j, b in enumerate(p[two]):
                for k, c in enumerate(p[three]):
                    terms[i + j + k].append(sign * a * b * c)
    p["X"] = [_sum(group) for group in terms]
    return {letter: np.stack(coefficients, axis=1) for letter, coefficients in p.items()}


def _mixed(p: Array, q: Array) -> list[Array]:
    """Terms of the part of det(P s + Q t) that goes with s t."""
    return [
        p[:, 0, 0] * q[:, 1, 1],
        p[:, 1, 1] * q[:, 0, 0],
        -p[:, 0, 1] * q[:, 1, 0],
        -p[:, 1, 0] * q[:, 0, 1],
    ]


def _determinant(p: Array) -> list[Array]:
    return [p[:, 0, 0] * p[:, 1, 1], -p[:, 0, 1] * p[:, 1, 0]]


def _sum(terms: list[Array]) -> Array:
    """Sum of terms, exactly zero where they cancel to within rounding."""
    total = np.sum(terms, axis=0)
    return np.asarray(np.where(np.abs(total) > ROUNDING * np.sum(np.abs(terms), axis=0), total, 0.0))


def _at(coefficients: Array, speeds: Array) -> Array:
    """Polynomials (n, powers) at speeds (n, k)."""
    value = np.zeros_like(speeds)
    for coefficient in coefficients.T[::-1]:
        value = value * speeds + coefficient[:, None]
    return value


def _slope(coefficients: Array) -> Array:
    return coefficients[:, 1:] * np.arange(1, coefficients.shape[1])


def _positive_roots(coefficients: Array) -> Array:
    """Real positive roots of polynomials (n, powers), sorted, NaN where there are no more: (n, degree)."""
    if not coefficients[:, 1::2].any():  # even: solved for the square of the speed
        return np.sqrt(_general_roots(coefficients[:, ::2]))
    if not coefficients[:, ::2].any():
        return np.sqrt(_general_roots(coefficients[:, 1::2]))
    return _general_roots(coefficients)


def _general_roots(coefficients: Array) -> Array:
    """The same for any powers: eigenvalues of companion matrices, then Newton's method."""
    degree = coefficients.shape[1] - 1
    roots = np.full((len(coefficients), max(degree, 0)), np.nan)
    if degree < 1:
        return roots
    lower = coefficients[:, -1] == 0.0
    if lower.any():
        roots[lower, :-1] = _general_roots(coefficients[lower, :-1])
    p = coefficients[~lower]
    companion = np.zeros((len(p), degree, degree))
    companion[:, 1:, :-1] = np.eye(degree - 1)
    companion[:, :, -1] = -p[:, :-1] / p[:, -1:]
    found = np.linalg.eigvals(companion)
    real = (np.abs(found.imag) <= _REAL * np.abs(found)) & (found.real > 0.0)
    x = np.where(real, found.real, np.nan)
    for _ in range(3):
        slope = _at(_slope(p), x)
        step = np.divide(_at(p, x), slope, out=np.zeros_like(x), where=slope != 0.0)
        x = np.where(np.abs(step) < 0.1 * x, x - step, x)
    is_root = np.abs(_at(p, x)) <= _RESIDUAL * _at(np.abs(p), x)
    roots[~lower] = np.sort(np.where(is_root, x, np.nan), axis=1)
    return roots
