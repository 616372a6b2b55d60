"""Who subscribes, and whether they know by now who publishes.

Discovery goes both ways separately: a publisher that knows a subscription may send before the subscription
knows it. A reliable message is then sent again, later than those on other topics; any other is lost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

PATIENCE = 10.0  # [s] for an answer; a node that is at work, or doesn't spin, gives none
ASK_AGAIN = 1.0  # [s]; an answer that the other node couldn't send is lost
STEP = 0.005  # [s]
ASKED = "get_parameters"
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # ROS's word for the node of an endpoint not told yet, or that isn't ROS's
NodeNameNonExistentError = rclpy_implementation.NodeNameNonExistentError


def wait_until_known(
    node: Node, topics: Iterable[str], between: Callable[[], None], patience: float = PATIENCE
) -> None:
    """Wait until each node that subscribes to one of `topics` knows the publishers made so far; else warn.

    `between` is called in between: it pauses, sees to it that answers are taken, and may raise to end the
    wait. Each is asked for no parameters at all: DDS announces endpoints in the order of their making, so
    that who answers a client has heard of what was made before it. Nodes without parameter services, such as
    `ros2 topic echo`, can't be asked, and aren't waited for.
    """
    topics, questions, answered = list(topics), dict[str, _Question](), set[str]()
    deadline = time.monotonic() + patience
    while silent := [name for name in _who_can_answer(node, topics) if name not in answered]:
        if time.monotonic() > deadline:
            names = ", ".join(silent).replace(UNKNOWN, "a subscriber without ROS")
            node.get_logger().warning(f"no answer from {names}, which may miss the first messages")
            break
        for name in set(silent) - {UNKNOWN}:
            if name not in questions:
                questions[name] = _Question(node, name)
            questions[name].ask_when_due()
        between()
        time.sleep(STEP)
        answered = {name for name, question in questions.items() if question.answered}
    for question in questions.values():
        node.destroy_client(question.client)


class _Question:
    """Asked again and again until it is answered."""

    def __init__(self, node: Node, name: str) -> None:
        self.client: Client = node.create_client(GetParameters, f"{name}/{ASKED}")
        self._asked: list[Any] = []
        self._ask_at = 0.0

    @property
    def answered(self) -> bool:
        return any(future.done() for future in self._asked)

    def ask_when_due(self) -> None:
        if time.monotonic() >= self._ask_at and self.client.service_is_ready():
            self._asked.append(self.client.call_async(GetParameters.Request()))
            self._ask_at = time.monotonic() + ASK_AGAIN


def _who_can_answer(node: Node, topics: Iterable[str]) -> list[str]:
    """Full names of the other nodes that subscribe and have parameter services, or may turn out to."""
    own = (node.get_name(), node.get_namespace())
    found = set().union(*(_subscribers(node, topic) for topic in topics)) - {own}
    return sorted(_full_name(*names) for names in found if _can_answer(node, *names))


def _subscribers(node: Node, topic: str) -> set[tuple[str, str]]:
    """Names and namespaces."""
    return {(i.node_name, i.node_namespace) for i in node.get_subscriptions_info_by_topic(topic)}


def _full_name(name: str, namespace: str) -> str:
    return UNKNOWN if name == UNKNOWN else f"{namespace.rstrip('/')}/{name}"


def _can_answer(node: Node, name: str, namespace: str) -> bool:
    if name == UNKNOWN:
        return True
    try:
        services = node.get_service_names_and_types_by_node(name, namespace)
    except NodeNameNonExistentError:  # it has just gone
        return False
    return any(service == f"{_full_name(name, namespace)}/{ASKED}" for service, _ in services)
