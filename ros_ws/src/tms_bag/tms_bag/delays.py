"""How late messages were sent: quantiles over a whole replay, in little memory."""

from __future__ import annotations

import math
from collections import Counter

STEP = 0.1  # of the decimal logarithm: quantiles are right to 25 %
LEAST = 1e-6  # [s]


class Delays:
    """A histogram of delays [s] with logarithmic steps."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self.largest = 0.0  # [s]

    def add(self, delay: float) -> None:
        """Take one delay [s]."""
        self._counts[math.ceil(math.log10(max(delay, LEAST)) / STEP)] += 1
        self.largest = max(self.largest, delay)

    def figures(self) -> dict[str, str]:
        """Median, 99 % and largest delay as texts, by name."""
        return {
            "median delay [s]": f"{self.quantile(0.5):.6f}",
            "99 % delay [s]": f"{self.quantile(0.99):.6f}",
            "largest delay [s]": f"{self.largest:.4f}",
        }

    def quantile(self, share: float) -> float:
        """Delay [s] that a share of the messages did not exceed; 0 without messages."""
        wanted, seen = share * sum(self._counts.values()), 0
        for step in sorted(self._counts):
            seen += self._counts[step]
            if seen >= wanted:
                return min(math.pow(10.0, step * STEP), self.largest)
        return 0.0
