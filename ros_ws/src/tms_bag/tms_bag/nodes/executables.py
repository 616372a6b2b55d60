"""What `ros2 run tms_bag` finds."""

from __future__ import annotations

from tms_bag.nodes.starting import start


def player() -> int:
    """The player as a process."""
    return start("tms_bag.nodes.player")


def recorder() -> int:
    """The recorder as a process."""
    return start("tms_bag.nodes.recorder")
