"""Thresholds of the strike detector."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StrikeThresholds:
    """Thresholds of the strike detector."""

    least_change: float = 0.15  # [rad/s]
    rise: float = 0.3  # [s], longest push
    refractory: float = 1.0  # [s], between the starts of the free responses of two pushes
    memory: float = 0.6  # [s], time constant with which earlier swings decay
    steepness: float = 0.8  # steepest slope over 0.1 s times 0.2 s, per change
