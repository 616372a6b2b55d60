"""What arrives on a topic, taken as it comes over the wire, whatever its publishers offer.

The executor's way of one callback for each message costs about 0.2 ms in rclpy. Here nothing waits for
messages: the middleware keeps them in a deep history, and whoever records takes all there is some hundred
times a second.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from tms_bag.losses import SequenceCounter
from tms_bag.nodes.interfaces import message_class

LONGEST_TURN = 1000  # [messages] of one topic, before others have their turn
REMEMBERED = 10_000  # [messages] of a topic whose doubles are known, should another subscription hear them

# CDR bytes, time of arrival and of sending [ns since 1970].
Take = Callable[[bytes, int, int], None]

# Reliable, latched: what decides whether publisher and subscription match.
Demand = tuple[bool, bool]


class _Drained(CallbackGroup):
    """Subscriptions that no executor looks at; their events it does."""

    def can_execute(self, entity: Any) -> bool:
        return not isinstance(entity, Subscription)

    def beginning_execution(self, entity: Any) -> bool:
        return not isinstance(entity, Subscription)

    def ending_execution(self, entity: Any) -> None:
        pass


class Intake:
    """A topic's messages. RecordingError if the type isn't installed.

    Each kind of publisher (reliable or best effort, latched or not) gets a subscription that asks for just
    that: a demand that all can meet would give up the reliability of some. A message that is heard twice then
    counts once.
    """

    def __init__(self, node: Node, name: str, type_name: str, depth: int) -> None:
        self._node, self.name, self._depth = node, name, depth
        self._kind = message_class(type_name)
        self._subscriptions: dict[Demand, Subscription] = {}
        self._told: dict[Demand, int] = {}  # messages that the middleware says are lost
        self._heard: set[tuple[int, int]] = set()
        self._heard_in_order: deque[tuple[int, int]] = deque()
        self._group = _Drained()
        self._sequence = SequenceCounter(self._publishers)

    @property
    def lost(self) -> int:
        """Messages that were sent and did not arrive, as far as that can be told."""
        return max(self._sequence.missing, *self._told.values(), 0)

    @property
    def sent_before(self) -> int:
        """Messages that were sent before the first one that arrived."""
        return self._sequence.missed_before or 0

    def adapt(self, offered: Iterable[QoSProfile]) -> None:
        """Subscribe so that all these publishers are heard; without any so far, so that most will be."""
        demands = {demand_of(profile) for profile in offered}
        if not demands and not self._subscriptions:
            demands = {(True, False)}
        self._sequence.refresh()
        for demand in demands:
            if demand not in self._subscriptions:
                self._subscriptions[demand] = self._subscribe(demand)

    def drain(self, take: Take) -> bool:
        """Hand over what has arrived; returns whether more may be waiting."""
        alone = len(self._subscriptions) == 1
        more = False
        for subscription in list(self._subscriptions.values()):
            handle, kind = subscription.handle, self._kind
            with handle:
                for _ in range(LONGEST_TURN):
                    taken = handle.take_message(kind, True)
                    if taken is None:
                        break
                    data, info = taken
                    if self._is_double(info):
                        continue
                    if alone:
                        self._sequence.follow(info["publication_sequence_number"])
                    take(data, info["received_timestamp"], info["source_timestamp"])
                else:
                    more = True
        return more

    def close(self) -> None:
        """Leave the topic."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def _subscribe(self, demand: Demand) -> Subscription:
        reliable, latched = demand
        profile = QoSProfile(
            depth=self._depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        events = SubscriptionEventCallbacks(
            message_lost=partial(self._count_lost, demand),
            incompatible_qos=lambda event: None,  # adapt() sees to it
        )
        return self._node.create_subscription(
            *(self._kind, self.name, lambda message: None, profile),
            callback_group=self._group,
            event_callbacks=events,
            raw=True,
        )

    def _count_lost(self, demand: Demand, event: Any) -> None:
        self._told[demand] = event.total_count

    def _is_double(self, info: dict[str, Any]) -> bool:
        key = (info["source_timestamp"], info["publication_sequence_number"])
        if key in self._heard:
            return True
        self._heard.add(key)
        self._heard_in_order.append(key)
        if len(self._heard_in_order) > REMEMBERED:
            self._heard.discard(self._heard_in_order.popleft())
        return False

    def _publishers(self) -> Sequence[object]:
        return [bytes(info.endpoint_gid) for info in self._node.get_publishers_info_by_topic(self.name)]


def demand_of(profile: QoSProfile) -> Demand:
    """What to ask for to match a publisher and lose nothing that it offers."""
    return (
        profile.reliability == ReliabilityPolicy.RELIABLE,
        profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
    )
