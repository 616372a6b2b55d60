"""Manually specified strikes, in place of a detector."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from tms_fit.strikes.classification import noise_of
from tms_fit.strikes.strike import NANOSECONDS, Rejected, Strike

NOISE_SAMPLES = 200  # from which the noise is estimated


class ManualStrikes:
    """Strikes at given times [ns], with the interface of `StrikeDetector`."""

    def __init__(self, times_ns: tuple[int, ...]) -> None:
        self._open = deque(sorted(times_ns))
        self._recent: deque[tuple[int, float]] = deque(maxlen=NOISE_SAMPLES)
        self.rejected: deque[Rejected] = deque()

    @property
    def latency(self) -> float:
        """Seconds after the start of a free response until it is reported, at most."""
        return 0.0

    @property
    def least_change(self) -> float:
        """Least change of the lean rate [rad/s] by a strike: none."""
        return 0.0

    def push(self, time_ns: int, lean_rate: float) -> Strike | None:
        """Process one sample; return the strike whose free response it begins, if any."""
        before_ns, before = self._recent[-1] if self._recent else (time_ns - 1, math.nan)
        noise = noise_of(np.array([rate for _, rate in self._recent]))
        if math.isfinite(lean_rate):
            self._recent.append((time_ns, lean_rate))
        if not self._open or time_ns < self._open[0]:
            return None
        start_ns = self._open.popleft()
        return Strike(
            time_ns=time_ns,
            before_ns=before_ns,
            onset_ns=min(before_ns, start_ns),
            change=lean_rate - before,
            noise=noise,
            sharp=False,
            end_ns=start_ns,
            end_std=0.0,
            kind="given",
            rise=0.0,
            needed=0.0,
            why=f"given by hand: the free response starts at {start_ns / NANOSECONDS:.6f} s of the stamps",
        )

    def withdraw(self, why: str) -> None:
        """No-op: manually specified strikes are never rejected."""
