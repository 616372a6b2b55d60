"""Samples that are missing over a push leave no strike to fit; those missing after it don't hide it."""

from __future__ import annotations

import numpy as np
from tms_fit.strikes.detector import StrikeDetector


def found(missing: tuple[int, int]) -> list[int]:
    """Rows at which strikes are found in a push of 0.9 rad/s over rows 300-320, without some rows."""
    rows = np.arange(600)
    push = 0.45 * (1.0 - np.cos(np.pi * np.clip((rows - 300) / 20.0, 0.0, 1.0)))
    rate = push * np.exp(-np.maximum(rows - 320, 0) / 40.0)
    rate += 0.01 * np.random.default_rng(3).standard_normal(len(rows))
    detector = StrikeDetector()
    kept = [row for row in rows if not missing[0] <= row < missing[1]]
    strikes = [detector.push(int(row) * 10_000_000, float(rate[row])) for row in kept]
    return [strike.time_ns // 10_000_000 for strike in strikes if strike is not None]


def test_whole() -> None:
    (row,) = found((0, 0))
    assert abs(row - 320) <= 3


def test_missing_over_the_push() -> None:
    assert found((300, 325)) == []


def test_missing_after_the_push() -> None:
    (row,) = found((325, 360))
    assert abs(row - 320) <= 3
