"""What `ros2 run tms_fit` finds."""

from __future__ import annotations

from tms_bag.nodes.starting import start


def estimator() -> int:
    """The estimator as a process."""
    return start("tms_fit.nodes.estimator")
