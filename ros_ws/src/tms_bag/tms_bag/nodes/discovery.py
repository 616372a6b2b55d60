"""Topics that appear, and publishers that join or change: found, and listened to."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from tms_bag.channel import Channel, installed_channel
from tms_bag.errors import RecordingError
from tms_bag.nodes.intake import Intake
from tms_bag.nodes.interfaces import recorded_qos
from tms_bag.selection import Selection

LOOK_AGAIN = 10  # looks at new topics, for each look at the publishers of known ones


class Discovery:
    """Finds the topics that are meant, and calls `announce` with each, before its first message."""

    def __init__(
        self,
        node: Node,
        selection: Selection,
        depth: int,
        unpublished: bool,
        announce: Callable[[Channel], None],
    ) -> None:
        self._node, self._selection, self._announce = node, selection, announce
        self._depth, self._unpublished = depth, unpublished
        self._types: dict[str, str] = {}
        self._looks = 0
        self.intakes: dict[str, Intake] = {}
        self.passed_over: dict[str, str] = {}  # topics that are meant and can't be recorded, with the reason

    @property
    def lost(self) -> dict[str, int]:
        """Messages that were sent and did not arrive, by topic."""
        return {name: intake.lost for name, intake in self.intakes.items() if intake.lost}

    @property
    def sent_before(self) -> dict[str, int]:
        """Messages that were sent before the first one that arrived, by topic."""
        return {name: intake.sent_before for name, intake in self.intakes.items() if intake.sent_before}

    def type_of(self, name: str) -> str:
        """Type of a topic that was found."""
        return self._types[name]

    def look(self) -> None:
        """Listen to new topics; at every tenth look to new publishers of known ones, too."""
        self._looks += 1
        for name, types in self._node.get_topic_names_and_types():
            known = name in self.intakes
            if name in self.passed_over or (known and self._looks % LOOK_AGAIN):
                continue
            if known or self._selection.means(name, types):
                self._listen(name, types)

    def _listen(self, name: str, types: list[str]) -> None:
        offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(name)]
        if name in self.intakes:
            self.intakes[name].adapt(offered)
            return
        if not offered and not self._unpublished:  # somebody listens, nobody speaks
            return
        try:
            if len(types) > 1:
                raise RecordingError(
                    f"expected one type, found {', '.join(types)}; give the topics different names"
                )
            intake = Intake(self._node, name, types[0], self._depth)
            profiles = tuple(dict.fromkeys(map(recorded_qos, offered)))
            self._announce(installed_channel(name, types[0], profiles))
        except RecordingError as error:
            self.passed_over[name] = str(error)
            self._node.get_logger().warning(f"{name} is not recorded: {error}")
            return
        intake.adapt(offered)
        self._types[name] = types[0]
        self.intakes[name] = intake
        self._node.get_logger().info(f"recording {name} [{types[0]}]")
