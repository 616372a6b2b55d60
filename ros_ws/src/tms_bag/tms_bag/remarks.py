"""What a bag says about how it was recorded, among its custom data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import yaml


def recording_remarks(
    recorder: str,
    stamps: str,
    lost: Mapping[str, int],
    sent_before: Mapping[str, int],
    not_recorded: Mapping[str, str],
    left_out_while_paused: int,
) -> dict[str, str]:
    """Texts by name; figures by topic as YAML mappings."""
    return {
        "recorder": recorder,
        "stamps": stamps,  # wall or simulated
        "lost": _text(lost),  # messages by topic, sent and not in the bag
        "sent_before_recording": _text(sent_before),  # messages by topic
        "not_recorded": _text(not_recorded),  # reason by topic
        "left_out_while_paused": str(left_out_while_paused),
    }


def closing_words(counts: Mapping[str, int], lost: Mapping[str, int], not_recorded: Mapping[str, str]) -> str:
    """What a recorder says when it ends."""
    words = f"{sum(counts.values())} messages of {len(counts)} topics"
    if lost:
        by_topic = ", ".join(f"{topic} {count}" for topic, count in lost.items())
        words += f", {sum(lost.values())} lost ({by_topic})"
    return words + (f"; not recorded: {', '.join(not_recorded)}" if not_recorded else "")


@contextmanager
def disk_told(bag: Path) -> Iterator[None]:
    """Where the disk takes no more, let the OSError say of which bag, and what becomes of it."""
    try:
        yield
    except OSError as error:
        raise OSError(
            f"{bag}: can't be written any further ({error.strerror}); `tms bag repair {bag}` makes a clean"
            " bag of what is there"
        ) from error


def _text(values: Mapping[str, object]) -> str:
    return yaml.safe_dump(dict(values), default_flow_style=True, width=2**20).strip()
