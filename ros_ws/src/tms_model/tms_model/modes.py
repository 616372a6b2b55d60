"""The modes of the uncontrolled bicycle: eigenvectors, names, their course through speed without swapping.

Two real eigenvalues can't pass each other without coinciding, and where they coincide is known
(`double_roots`). So between two such speeds real eigenvalues keep their order, and only two pairs of complex
ones have to be followed step by step; at such a speed the two that meet go on as one oscillation, or the
other way round. Nothing depends on which speeds are asked for.

Names follow SOM chapter 4: where the standing bicycle has four real eigenvalues, two of each sign, and the
two positive ones become an oscillation, that is the weave; of the other two, capsize is the one nearer to
zero and castering the fast one. When those two become an oscillation of their own, as on the experimental
bicycle above 4 m/s, it is called castering-capsize. On bicycles of another kind the modes are called by what
they are: oscillation 1, real 1 ...

Reference: Kooijman et al. 2011, supplement (SOM), chapter 4, doi 10.1126/science.1201959.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise, permutations

import numpy as np
from numpy.typing import NDArray

from tms_model.bicycle import Array, Bicycle
from tms_model.errors import ParameterError
from tms_model.response import state_matrix
from tms_model.stability import double_roots, eigenvalues

Complex = NDArray[np.complex128]
WEAVE, CASTERING, CAPSIZE, MERGED = "weave", "castering", "capsize", "castering-capsize"
REAL = 1e-9  # imaginary share of an eigenvalue that counts as real, away from double roots


@dataclass(frozen=True, eq=False)
class Mode:
    """One way in which the bicycle moves by itself: x(t) = Re(vector exp(eigenvalue t))."""

    name: str  # weave, castering, capsize, castering-capsize; or 'oscillation 1', 'real 2'
    eigenvalue: complex  # [1/s]; of an oscillation the one with positive imaginary part
    vector: Complex  # (4,) in the order of STATE; the larger of lean and steer is 1


@dataclass(frozen=True, eq=False)
class ModeCourse:
    """The four eigenvalues followed through speed: each column is one continuous curve."""

    speeds: Array  # (n,) [m/s], ascending
    eigenvalues: Complex  # (n, 4) [1/s]
    names: tuple[tuple[str, ...], ...]  # n rows of 4 names, of the modes to which the columns belong there


def modes(bicycle: Bicycle, speed: float) -> tuple[Mode, ...]:
    """The modes at a speed [m/s], by name; the two eigenvalues of an oscillation are one mode."""
    course = follow_modes(bicycle, np.array([speed]))
    values, vectors = np.linalg.eig(state_matrix(bicycle, speed))
    found = []
    for name, value in sorted(zip(course.names[0], course.eigenvalues[0], strict=True), key=lambda m: m[0]):
        if value.imag >= 0.0:
            vector = vectors[:, np.argmin(np.abs(values - value))].astype(np.complex128)
            largest = np.argmax(np.abs(vector[:2]))
            vector = vector / vector[largest]
            vector[largest] = 1.0  # division leaves a last digit
            found.append(Mode(name, complex(value), vector))
    return tuple(found)


def follow_modes(bicycle: Bicycle, speeds: Array) -> ModeCourse:
    """Eigenvalues at `speeds` [m/s] (n,), ascending, as four continuous curves with the names of their modes.

    Raises ParameterError for speeds that are not finite, negative or not ascending.
    """
    if not (np.isfinite(speeds).all() and (speeds >= 0.0).all() and (np.diff(speeds) >= 0.0).all()):
        raise ParameterError("speeds: expected finite speeds of zero or more in ascending order")
    stretches = _stretches(bicycle)
    values, names = np.empty((len(speeds), 4), dtype=np.complex128), []
    edges = [stretch.high for stretch in stretches[:-1]]
    for k, speed in enumerate(speeds):
        stretch = stretches[int(np.searchsorted(edges, speed))]
        values[k] = stretch.at(float(speed))
        names.append(stretch.names)
    return ModeCourse(np.asarray(speeds, dtype=float), values, tuple(names))


class _Stretch:
    """Speeds between two double roots: which eigenvalue stands in which column, and what it is called."""

    def __init__(self, bicycle: Bicycle, low: float, high: float) -> None:
        self.high = high
        self._bicycle = bicycle
        self._speed = 0.5 * (low + high) if np.isfinite(high) else 2.0 * low + 1.0
        # Real ones ascending, then of each pair the one with negative imaginary part first.
        roots = eigenvalues(bicycle, self._speed)
        real = np.abs(roots.imag) <= REAL * np.abs(roots)
        self.real_count = int(real.sum())
        upper = roots[~real & (roots.imag > 0.0)]
        pairs = np.array([[root.conjugate(), root] for root in upper]).ravel()
        self._sorted = np.concatenate([np.sort(roots[real].real).astype(np.complex128), pairs])
        self._known = {self._speed: self._sorted}
        self.order = np.arange(4)  # column -> place in the sorted eigenvalues
        self.names: tuple[str, ...] = ("",) * 4

    def at(self, speed: float) -> Complex:
        """Eigenvalues in the columns' order."""
        return self.sorted_at(speed)[self.order]

    def sorted_at(self, speed: float) -> Complex:
        """Eigenvalues as sorted in the middle of the stretch: by continuity if there are two pairs."""
        if speed not in self._known:
            roots = eigenvalues(self._bicycle, speed)
            if self.real_count:
                self._known[speed] = self._by_kind(roots)
            else:
                nearest = min(self._known, key=lambda known: abs(known - speed))
                self._known[speed] = self._continued(nearest, self._known[nearest], speed, roots)
        return self._known[speed]

    def _by_kind(self, roots: Complex) -> Complex:
        """The real ones ascending, then the pair: the two nearest to being each other's conjugates.

        Where rounding parts a double root into two real ones, those are still nearer to each other than to
        the rest.
        """
        if self.real_count == 4:
            return np.sort_complex(roots.real.astype(np.complex128))
        pair = min(combinations(range(4), 2), key=lambda two: abs(roots[two[0]] - roots[two[1]].conjugate()))
        rest = [k for k in range(4) if k not in pair]
        real = np.sort_complex(roots[rest])
        return np.concatenate([real, sorted(roots[list(pair)], key=lambda root: (root.imag, root.real))])

    def _continued(self, low: float, known: Complex, high: float, roots: Complex) -> Complex:
        """`roots` at `high` in the order of `known` at `low`, by halving until no confusion is possible."""
        ordered = min(
            (roots[list(order)] for order in permutations(range(4))),
            key=lambda candidate: float(np.abs(candidate - known).max()),
        )
        apart = min(abs(known[1] - known[3]), abs(ordered[1] - ordered[3]))
        if np.abs(ordered - known).max() < 0.25 * apart or abs(high - low) < 1e-9 * (1.0 + high):
            return np.asarray(ordered)
        middle = 0.5 * (low + high)
        halfway = self._continued(low, known, middle, eigenvalues(self._bicycle, middle))
        return self._continued(middle, halfway, high, roots)


def _stretches(bicycle: Bicycle) -> list[_Stretch]:
    meetings = double_roots(bicycle)
    edges = [0.0, *(meeting.speed for meeting in meetings), np.inf]
    stretches = [_Stretch(bicycle, low, high) for low, high in pairwise(edges)]
    for before, after, meeting in zip(stretches, stretches[1:], meetings, strict=False):
        after.order = _linked(before, after, meeting.speed)
    _name(stretches)
    return stretches


def _linked(before: _Stretch, after: _Stretch, speed: float) -> NDArray[np.intp]:
    """Order of the columns after a double root, such that each column goes on from where it was."""
    offset = 1e-7 * speed
    left, right = before.at(speed - offset), after.sorted_at(speed + offset)
    orders = (np.array(order) for order in permutations(range(4)))
    # The two that meet are equally near to the two that part: of a pair, the upper goes on from the upper
    # column.
    best = min(
        orders,
        key=lambda order: (round(float(np.abs(right[order] - left).max()), 6), tuple(order)),
    )
    return np.asarray(best)


def _name(stretches: list[_Stretch]) -> None:
    """Give the columns of every stretch their names; see the module's text."""
    first = stretches[0]
    standing = first.sorted_at(0.0)
    if first.real_count == 4 and len(stretches) > 1 and standing[1].real < 0.0 < standing[2].real:
        met = _pairs(stretches[1])
        if met == [frozenset({2, 3})]:
            _name_by_descent(stretches)
            return
    for stretch in stretches:
        _name_by_kind(stretch)


def _pairs(stretch: _Stretch) -> list[frozenset[int]]:
    """Columns that are each other's conjugates."""
    place = {int(where): column for column, where in enumerate(stretch.order)}
    return [frozenset({place[k], place[k + 1]}) for k in range(stretch.real_count, 4, 2)]


def _name_by_descent(stretches: list[_Stretch]) -> None:
    """Columns 2 and 3 become the weave; 0 is castering, 1 is capsize, while these keep to themselves."""
    for index, stretch in enumerate(stretches):
        pairs = _pairs(stretch)
        if any(len(pair & {0, 1}) == 1 for pair in pairs):  # weave has split and mixed with the others
            for later in stretches[index:]:
                _name_by_kind(later)
            return
        merged = frozenset({0, 1}) in pairs
        stretch.names = (MERGED, MERGED, WEAVE, WEAVE) if merged else (CASTERING, CAPSIZE, WEAVE, WEAVE)
        if not merged and index and stretch.order[0] > stretch.order[1]:
            stretch.names = (CAPSIZE, CASTERING, WEAVE, WEAVE)


def _name_by_kind(stretch: _Stretch) -> None:
    names = [""] * 4
    for number, pair in enumerate(sorted(_pairs(stretch), key=min), start=1):
        for column in pair:
            names[column] = f"oscillation {number}"
    real = [int(np.flatnonzero(stretch.order == place)[0]) for place in range(stretch.real_count)]
    for number, column in enumerate(real, start=1):
        names[column] = f"real {number}"
    stretch.names = tuple(names)
