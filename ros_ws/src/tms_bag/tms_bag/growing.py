"""An array that is filled part by part, with room made for what is still to come."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Values = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Rows:
    """Where values belong: rows `members` of the `count` rows from `first` on; None: all of them."""

    first: int
    count: int
    members: NDArray[np.int64] | None = None


class Growing:
    """An array with room for more. Rows that nothing was put into are NaN, or 0 where there is no NaN.

    Room that nothing was put into takes no memory: the system gives it when it is written to.
    """

    def __init__(self, kind: np.dtype[Any], shape: tuple[int, ...], room: int) -> None:
        self.shape = shape
        self.used = 0  # rows that hold something, or the sign of absence
        self._array: Values = np.empty((room, *shape), kind)

    def put(self, rows: Rows, values: Values) -> None:
        """Values (m,) or (m, k) at the rows."""
        end = rows.first + rows.count
        if end > len(self._array):
            larger = np.empty((max(end, 2 * len(self._array)), *self.shape), self._array.dtype)
            larger[: self.used] = self._array[: self.used]
            self._array = larger
        if rows.members is None:
            self._fill(rows.first)
            self._array[rows.first : end] = values
            self.used = end
        else:
            self._fill(end)
            self._array[rows.first + rows.members] = values

    def whole(self, count: int) -> Values:
        """The first `count` rows, without the room behind them."""
        if count > len(self._array):
            self.put(Rows(count, 0), np.empty((0, *self.shape)))
        self._fill(count)
        array = self._array[:count]
        return array if 2 * count > len(self._array) else array.copy()

    def _fill(self, end: int) -> None:
        if end > self.used:
            self._array[self.used : end] = np.nan if self._array.dtype.kind == "f" else 0
            self.used = end
