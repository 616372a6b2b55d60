"""What the recorder can be asked for: its parameters, declared and checked."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from rclpy.node import Node

from tms_bag.nodes.parameters import declare, declare_names, declare_texts, refuse_unknown_parameters
from tms_bag.selection import Selection
from tms_bag.writing.presets import PRESETS
from tms_bag.writing.writer import Splitting


@dataclass(frozen=True)
class RecorderSettings:
    """A recorder's parameters."""

    output: Path
    selection: Selection
    include_unpublished: bool
    compression: str
    splitting: Splitting
    snapshot: float  # [s]; 0: everything is written at once
    snapshot_memory: int  # [bytes]
    start_paused: bool
    history: int  # [messages]


def declare_recorder_settings(node: Node) -> RecorderSettings:
    """Declare the parameters. ParameterError or RecordingError if one doesn't fit, or isn't known."""
    output = declare(node, "output", "", "bag (a folder) to write; empty: bag_ and the time, in this folder")
    size = declare(node, "max_size", 0, "go on in another file at this size [bytes]; 0: never", 0, 10**15)
    duration = declare(
        node, "max_duration", 0.0, "go on in another file after this time [s]; 0: never", 0.0, 1e9
    )
    settings = RecorderSettings(
        output=Path(output or f"bag_{datetime.now():%Y-%m-%d_%H-%M-%S}"),
        selection=_declare_selection(node),
        include_unpublished=declare(
            node, "include_unpublished", False, "also topics that nobody publishes so far"
        ),
        compression=declare(node, "compression", "zstd", f"how files are packed: {', '.join(PRESETS)}"),
        splitting=Splitting(size, round(duration * 1e9)),
        snapshot=declare(
            node, "snapshot", 0.0, "keep only the last seconds, until ~/snapshot [s]; 0: off", 0.0, 86400.0
        ),
        snapshot_memory=declare(node, "snapshot_memory", 256, "memory for these [MiB]", 1, 1_000_000) * 2**20,
        start_paused=declare(node, "start_paused", False, "record nothing before ~/resume"),
        history=declare(
            node, "history", 5000, "messages of a topic that may wait for the disk", 1, 1_000_000
        ),
    )
    refuse_unknown_parameters(node)
    return settings


def _declare_selection(node: Node) -> Selection:
    return Selection(
        names=tuple(declare_names(node, "topics", "names of topics to record; empty: all but ROS's own")),
        pattern=declare(node, "regex", "", "regular expression: topics to record beside those named"),
        types=tuple(declare_texts(node, "types", "types to record, such as sensor_msgs/msg/Imu")),
        not_names=tuple(declare_names(node, "exclude_topics", "names of topics to leave out")),
        not_pattern=declare(node, "exclude_regex", "", "regular expression: topics to leave out"),
        not_types=tuple(declare_texts(node, "exclude_types", "types to leave out")),
        hidden=declare(node, "include_hidden", False, "also topics with a part that starts with _"),
    )
