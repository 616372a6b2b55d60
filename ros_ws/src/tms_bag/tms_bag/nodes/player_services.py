"""The player's services: those of rosbag2's, with types that have the same fields."""

from __future__ import annotations

from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Empty, Trigger
from tms_msgs.srv import Seek, SetRate

from tms_bag.transport import Transport


def offer_services(node: Node, transport: Transport, start_ns: int, end_ns: int) -> None:
    """Offer them under the node's name; `seek` goes to times from `start_ns` to `end_ns` of the bag."""

    def pause(paused: bool | None, request: Any, response: Any) -> Any:
        transport.pause(not transport.paused if paused is None else paused)
        return response

    def is_paused(request: Any, response: Any) -> Any:
        response.success, response.message = transport.paused, "paused" if transport.paused else "playing"
        return response

    def play_next(request: Any, response: Any) -> Any:
        response.success = transport.step()
        response.message = "" if response.success else "expected a player that is paused; call ~/pause first"
        return response

    def seek(request: Any, response: Any) -> Any:
        time_ns = request.time.sec * 10**9 + request.time.nanosec
        response.success = start_ns <= time_ns <= end_ns
        if response.success:
            transport.seek(time_ns)
        return response

    def set_rate(request: Any, response: Any) -> Any:
        result = node.set_parameters([Parameter("rate", value=float(request.rate))])[0]
        response.success = bool(result.successful)
        return response

    def get_rate(request: Any, response: Any) -> Any:
        response.success, response.message = True, f"{transport.rate:g}"
        return response

    def stop(request: Any, response: Any) -> Any:
        transport.stop()
        return response

    node.create_service(Empty, "~/pause", partial(pause, True))
    node.create_service(Empty, "~/resume", partial(pause, False))
    node.create_service(Empty, "~/toggle_paused", partial(pause, None))
    node.create_service(Trigger, "~/is_paused", is_paused)
    node.create_service(Trigger, "~/play_next", play_next)
    node.create_service(Seek, "~/seek", seek)
    node.create_service(SetRate, "~/set_rate", set_rate)
    node.create_service(Trigger, "~/get_rate", get_rate)
    node.create_service(Empty, "~/stop", stop)
