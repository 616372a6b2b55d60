"""The simulator's services: start, stop (holds the run), reset (back to the start), strike; its faults."""

from __future__ import annotations

from collections.abc import Callable

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.time import Time
from std_srvs.srv import Trigger
from tms_bag import Record, RecordingError
from tms_model import ParameterError
from tms_msgs.srv import Strike

from tms_sim.live_run import LiveRun

FAULTS = "faults"


class Controls:
    """What may be done to a run while it goes on; `changed` hears the run_info of a run made anew."""

    def __init__(
        self, node: Node, live: LiveRun, running: bool, changed: Callable[[Record | None], None]
    ) -> None:
        self._live, self._changed = live, changed
        self.running = running
        for name in ("start", "stop", "reset"):
            node.create_service(Trigger, f"~/{name}", getattr(self, f"_{name}"))
        node.create_service(Strike, "~/strike", self._strike)
        node.add_pre_set_parameters_callback(self._with_times)
        node.add_on_set_parameters_callback(self._faults)

    def _with_times(self, parameters: list[Parameter]) -> list[Parameter]:
        return [
            Parameter(one.name, one.type_, self._live.timed(one.value))
            if one.name == FAULTS and isinstance(one.value, str)
            else one
            for one in parameters
        ]

    def _faults(self, parameters: list[Parameter]) -> SetParametersResult:
        for one in parameters:
            if one.name != FAULTS:
                continue
            try:
                info = self._live.change_faults(one.value)
            except (ParameterError, RecordingError) as error:
                return SetParametersResult(successful=False, reason=str(error))
            self._changed(info)
        return SetParametersResult(successful=True)

    def _start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.running = True
        return self._answer(response, "running")

    def _stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.running = False
        return self._answer(response, "held; start goes on")

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._live.reset()
        self._changed(None)
        return self._answer(response, "back at the start")

    def _answer(self, response: Trigger.Response, text: str) -> Trigger.Response:
        response.success, response.message = True, f"{text}, {self._live.elapsed:.3f} s into the run"
        return response

    def _strike(self, request: Strike.Request, response: Strike.Response) -> Strike.Response:
        try:
            when = Time.from_msg(request.time).nanoseconds
            info = self._live.strike(request.lean_rate, request.steer_rate, when)
        except ParameterError as error:
            response.success, response.message = False, str(error)
            return response
        self._changed(info)
        response.success = True
        response.message = f"struck by {request.lean_rate:g} rad/s, {self._live.elapsed:.3f} s into the run"
        return response
