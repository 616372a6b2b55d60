"""Which topics are meant: by name, pattern and type, as rosbag2's recorder has them."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass

from tms_bag.errors import RecordingError

LEFT_OUT = ("/rosout", "/parameter_events")  # of ROS itself; meant only when asked for by name


@dataclass(frozen=True)
class Selection:
    """A choice of topics. Without names, patterns and types: all but ROS's own and hidden ones.

    RecordingError if a pattern isn't a regular expression.
    """

    names: tuple[str, ...] = ()  # full names
    pattern: str = ""  # regular expression, found anywhere in the name
    types: tuple[str, ...] = ()  # for example sensor_msgs/msg/Imu
    not_names: tuple[str, ...] = ()
    not_pattern: str = ""
    not_types: tuple[str, ...] = ()
    hidden: bool = False  # also topics with a part that starts with an underscore

    def __post_init__(self) -> None:
        for pattern in (self.pattern, self.not_pattern):
            try:
                re.compile(pattern)
            except re.error as error:
                raise RecordingError(
                    f"expected a regular expression, found {pattern!r}: {error}; '.*' stands for any text"
                ) from error

    def means(self, name: str, types: Collection[str]) -> bool:
        """Whether a topic with these types is meant. What is left out is left out even if it is named."""
        if name in self.not_names or set(types) & set(self.not_types):
            return False
        if self.not_pattern and re.search(self.not_pattern, name):
            return False
        if name in self.names:
            return True
        if not self.hidden and any(part.startswith("_") for part in name.split("/")):
            return False
        if self.names or self.pattern or self.types:
            by_pattern = bool(self.pattern) and re.search(self.pattern, name) is not None
            return by_pattern or bool(set(types) & set(self.types))
        return name not in LEFT_OUT
