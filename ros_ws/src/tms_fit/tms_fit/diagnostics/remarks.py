"""What an estimate assumes that was not measured, or that the equations don't hold."""

from __future__ import annotations

from dataclasses import replace

from tms_fit.diagnostics.linear_range import linear_range_warning
from tms_fit.estimate import Estimate
from tms_fit.speed_source import speed_remark
from tms_fit.window import Window


def estimate_remarks(window: Window, estimate: Estimate) -> list[str]:
    """Clauses about the speed used and the range of the linear equations; empty where there is nothing."""
    speed = "" if "speed" in estimate.names else speed_remark(window)
    return [text for text in (speed, linear_range_warning(window, estimate)) if text]


def with_remarks(window: Window, estimate: Estimate) -> Estimate:
    """The estimate, its message completed by its remarks."""
    found = estimate_remarks(window, estimate)
    return replace(estimate, message="; ".join([estimate.message, *found])) if found else estimate
