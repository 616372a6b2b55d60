"""Action server ~/fit_recording of the estimator: fits of all strikes of a bag on its disk.

A worker thread fits one bag at a time while the node continues to process samples.
"""

from __future__ import annotations

from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from threading import Event
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from tms_bag import RecordingError, read_recording
from tms_model import ParameterError
from tms_msgs.action import FitRecording

from tms_fit.nodes.refit import estimates_of
from tms_fit.nodes.requests import asked_for
from tms_fit.recording_fit import RecordingFit, bicycle_of, fit_recording
from tms_fit.settings import Settings
from tms_fit.speed_source import speed_sentence

POLL_PERIOD_S = 0.1  # between checks for finished fits


class BagFits:
    """Action server with its goals and worker thread."""

    def __init__(self, node: Node, settings: Settings) -> None:
        self._settings, self._closing = settings, Event()
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="fit_recording")
        self._under_way: list[ServerGoalHandle] = []
        self._futures: dict[bytes, Future[RecordingFit]] = {}  # by the goal's id
        self._server = ActionServer(
            node,
            FitRecording,
            "~/fit_recording",
            execute_callback=self._result,
            handle_accepted_callback=self._begin,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        node.create_timer(
            POLL_PERIOD_S, self._execute_finished, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def close(self) -> None:
        """Cancel all fits and stop the worker thread."""
        self._closing.set()
        self._pool.shutdown(cancel_futures=True)

    def _begin(self, goal: ServerGoalHandle) -> None:
        self._futures[bytes(goal.goal_id.uuid)] = self._pool.submit(self._fit, goal)
        self._under_way.append(goal)

    def _execute_finished(self) -> None:
        """Execute the goals whose fits have finished; ROS counts a goal as executing from then on."""
        done = [goal for goal in self._under_way if self._futures[bytes(goal.goal_id.uuid)].done()]
        self._under_way = [goal for goal in self._under_way if goal not in done]
        for goal in done:
            goal.execute()

    def _result(self, goal: ServerGoalHandle) -> FitRecording.Result:
        future = self._futures.pop(bytes(goal.goal_id.uuid))
        result = FitRecording.Result()
        try:
            fit = future.result()
        except CancelledError:
            goal.canceled()
            result.message = "stopped before the end"
        except (ParameterError, RecordingError, OSError) as error:
            goal.abort()
            result.message = str(error)
        else:
            goal.succeed()
            result.success = True
            result.estimates = [message for strike in fit.strikes for message in estimates_of(strike)]
            result.message = f"{len(fit.strikes)} strikes; {speed_sentence(fit.recording, fit.settings)}"
        return result

    def _fit(self, goal: ServerGoalHandle) -> RecordingFit:
        """Fit of a goal's bag; runs in the worker thread."""
        request: Any = goal.request
        settings = asked_for(self._settings, request)
        if not request.bag:  # an empty path is the working directory
            raise RecordingError("bag: expected the path of a bag, found nothing")
        recording = read_recording(request.bag)
        return fit_recording(
            recording,
            bicycle_of(recording, request.bicycle or None),
            settings,
            progress=lambda share, strikes: self._publish_feedback(goal, share, strikes),
        )

    def _publish_feedback(self, goal: ServerGoalHandle, share: float, strikes: int) -> None:
        if self._closing.is_set() or goal.is_cancel_requested:
            raise CancelledError
        goal.publish_feedback(FitRecording.Feedback(progress=share, strikes=strikes))
