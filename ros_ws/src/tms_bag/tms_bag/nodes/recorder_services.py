"""The recorder's services: those of rosbag2's, with standard types that have the same fields."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Empty, Trigger

from tms_bag.writing.live_bag import LiveBag


def offer_services(node: Node, bag: LiveBag, drain: Callable[[], None], end: Callable[[], None]) -> None:
    """Pause, resume, is_paused, split_bagfile, snapshot and stop, under the node's name.

    `drain` takes what has arrived: it belongs to the time before the call. `end` lets the node end.
    """

    def pause(paused: bool, request: Any, response: Any) -> Any:
        drain()
        bag.paused = paused
        return response

    def is_paused(request: Any, response: Any) -> Any:
        response.success, response.message = bag.paused, "paused" if bag.paused else "recording"
        return response

    def split(request: Any, response: Any) -> Any:
        drain()
        bag.writer.split()
        return response

    def snapshot(request: Any, response: Any) -> Any:
        drain()
        response.success = bag.recent is not None
        response.message = "start the recorder with the parameter snapshot: the seconds to keep"
        if response.success:
            response.message = f"{bag.snapshot()} messages written"
        return response

    def stop(request: Any, response: Any) -> Any:
        end()
        return response

    node.create_service(Empty, "~/pause", partial(pause, True))
    node.create_service(Empty, "~/resume", partial(pause, False))
    node.create_service(Trigger, "~/is_paused", is_paused)
    node.create_service(Empty, "~/split_bagfile", split)
    node.create_service(Trigger, "~/snapshot", snapshot)
    node.create_service(Empty, "~/stop", stop)
