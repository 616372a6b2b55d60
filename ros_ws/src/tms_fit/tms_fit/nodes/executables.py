"""Entry points of `ros2 run tms_fit`."""

from __future__ import annotations

from tms_bag.nodes.starting import start


def estimator() -> int:
    """Run the estimator as a process; its exit code."""
    return start("tms_fit.nodes.estimator")
