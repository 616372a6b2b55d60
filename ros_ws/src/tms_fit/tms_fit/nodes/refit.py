"""Service ~/refit of the estimator: fit of a past strike with other settings."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from tms_model import ParameterError
from tms_msgs.msg import Estimate
from tms_msgs.srv import Refit

from tms_fit.messages import estimate_records
from tms_fit.nodes.requests import asked_for
from tms_fit.streaming.live_fit import LiveFit
from tms_fit.strike_fit import StrikeFit


def offer_refit(node: Node, live: LiveFit) -> None:
    """Create the service on a node."""

    def answer(request: Refit.Request, response: Refit.Response) -> Refit.Response:
        try:
            settings = asked_for(live.settings, request)
            fit = live.refit(Time.from_msg(request.strike).nanoseconds, settings, request.bicycle)
        except ParameterError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.estimates = True, estimates_of(fit)
        response.message = f"fitted {fit.end_ns / 1e9 - fit.start_ns / 1e9:.3f} s after the strike"
        return response

    node.create_service(Refit, "~/refit", answer)


def estimates_of(fit: StrikeFit) -> list[Estimate]:
    """Estimates of a strike as messages, equal to those of the topic `estimate`."""
    return [deserialize_message(record.data, Estimate) for record in estimate_records(fit)]
