"""What `ros2 run tms_sim` finds."""

from __future__ import annotations

from tms_bag.nodes.starting import start


def simulator() -> int:
    """The simulator as a process."""
    return start("tms_sim.nodes.simulator")
