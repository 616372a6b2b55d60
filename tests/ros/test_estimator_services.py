"""A user at the running estimator: a strike fitted once more, a bag fitted, while samples go on."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from tms_bag import BagWriter, read_recording, topics
from tms_fit.recording_fit import RecordingFit, bicycle_of, fit_recording
from tms_fit.settings import Settings
from tms_msgs.action import FitRecording
from tms_msgs.msg import Estimate
from tms_msgs.srv import Refit
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario

OTHER = {"free": ["initial_lean_rate", "initial_steer_rate"], "window": 1.0}


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    scenario = load_scenario("tms_strike", {"duration": 6.0})
    run = simulate(scenario, np.random.default_rng(scenario.integer("seed")))
    with BagWriter(tmp_path / "bag", custom_data=run.custom_data()) as writer:
        for record in run.records():
            writer.write(record, topics.QOS[record.topic.removeprefix("/")])
    return tmp_path / "bag"


def offline(bag: Path) -> RecordingFit:
    recording = read_recording(bag)
    settings = Settings(free=tuple(OTHER["free"]), window=OTHER["window"])  # type: ignore[arg-type]
    return fit_recording(recording, bicycle_of(recording, None), settings)


def assert_same(messages: list[Estimate], fit: RecordingFit) -> None:
    estimates = [one for strike in fit.strikes for one in strike.estimates]
    assert [message.estimator for message in messages] == [one.estimator for one in estimates]
    for message, one in zip(messages, estimates, strict=True):
        assert message.final
        assert list(message.values) == one.values.tolist()
        assert list(message.covariance) == one.covariance.ravel().tolist()


def test_refit_gives_what_the_offline_fit_gives(nodes: Any, participant: Any, bag: Path) -> None:
    heard: list[Estimate] = []
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    participant.create_subscription(Estimate, "estimate", heard.append, latched)
    estimator = nodes.start("tms_fit", "estimator")
    refused = participant.call(Refit, "/estimator/refit")
    assert not refused.success
    assert "expected one of none" in refused.message
    player = nodes.start("tms_bag", "player", "-p", f"bag:={bag}", "-p", "wait_for_subscriptions:=3")
    nodes.finish(player)
    participant.spin_until(lambda: sum(one.final for one in heard) == 2, "the strike is fitted")
    assert any(not one.final for one in heard)  # and was while its response unfolded
    again = participant.call(Refit, "/estimator/refit", Refit.Request(**OTHER))
    assert again.success, again.message
    assert_same(again.estimates, offline(bag))
    refused = participant.call(Refit, "/estimator/refit", Refit.Request(fixed_names=["speed"]))
    assert "fixed_values: expected 1" in refused.message
    nodes.stop(estimator)


def test_a_bag_is_fitted_with_progress(nodes: Any, participant: Any, bag: Path) -> None:
    estimator = nodes.start("tms_fit", "estimator")
    client = participant.action_client(FitRecording, "/estimator/fit_recording")
    told: list[float] = []

    def ask(**goal: Any) -> tuple[int, FitRecording.Result]:
        wish = FitRecording.Goal(**goal)
        sent = client.send_goal_async(wish, lambda message: told.append(message.feedback.progress))
        handle = participant.result(sent, "the goal is accepted")
        assert handle.accepted
        done = participant.result(handle.get_result_async(), "the bag is fitted")
        return done.status, done.result

    status, result = ask(bag=str(bag), **OTHER)
    assert status == GoalStatus.STATUS_SUCCEEDED, result.message
    assert_same(result.estimates, offline(bag))
    assert told == sorted(told)
    assert len(told) > 10
    fifo = bag.parent / "fifo"
    os.mkfifo(fifo)
    for wrong, text in (
        ({"bag": "nowhere"}, "nowhere"),
        ({"bag": str(bag), "bicycle": "nonsense"}, "nonsense"),
        ({"bag": ""}, "found nothing"),
        ({"bag": "/dev/zero"}, "isn't a file"),
        ({"bag": "/proc/self/mem"}, "can't be read"),
        ({"bag": str(fifo)}, "isn't a file"),
        ({"bag": str(bag.parent)}, "expected a bag"),
        ({"bag": str(bag), "window": float("nan")}, "window: expected"),
        ({"bag": str(bag), "fixed_names": ["speed"] * 2, "fixed_values": [1.0, 2.0]}, "speed: expected each"),
    ):
        status, result = ask(**wrong)
        assert status == GoalStatus.STATUS_ABORTED
        assert text in result.message
    # One bag at a time: the second is cancelled before its turn has come, and does not hold up the first.
    goals = [client.send_goal_async(FitRecording.Goal(bag=str(bag))) for _ in range(2)]
    first, second = (participant.result(goal, "accepted") for goal in goals)
    participant.result(second.cancel_goal_async(), "the goal is cancelled")
    ends = [participant.result(goal.get_result_async(), "its end").status for goal in (first, second)]
    assert ends == [GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED]
    nodes.stop(estimator)
