"""Publishers wait until those who listen know them, as far as they can be asked."""

from __future__ import annotations

import signal
from typing import Any

import pytest
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from std_msgs.msg import String
from tms_bag.nodes.listeners import wait_until_known

TEXT, SPEED = "/text", "/bicycle/speed"


def test_a_listener_that_is_held_up_is_waited_for(nodes: Any, participant: Any) -> None:
    # By a name of its own: of two with one name, such as one just killed, ROS tells the services of one.
    estimator = nodes.start("tms_fit", "estimator", "-r", "__node:=held_up")
    participant.reach("/held_up")
    participant.spin_until(
        lambda: participant.get_subscriptions_info_by_topic(SPEED), "the estimator listens"
    )
    estimator.send_signal(signal.SIGSTOP)
    publisher = participant.create_publisher(TwistStamped, SPEED, 10)
    # The publisher has a subscription at once; the subscription can't know of it before the process goes on.
    participant.spin_until(publisher.get_subscription_count, "it matches")
    looks = 0

    def between() -> None:
        nonlocal looks
        participant.spin()
        looks += 1
        if looks == 50:
            estimator.send_signal(signal.SIGCONT)

    wait_until_known(participant, [SPEED], between, patience=60.0)
    assert looks >= 50
    nodes.stop(estimator)


def test_who_gives_no_answer_is_named_in_a_warning(
    participant: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    deaf = Node("deaf", context=participant.context, namespace="/far")  # that nobody spins
    deaf.create_subscription(String, TEXT, print, 10)
    wait_until_known(participant, [TEXT], participant.spin, patience=0.5)
    assert "no answer from /far/deaf, which may miss the first messages" in capfd.readouterr().err


def test_who_cannot_be_asked_is_not_waited_for(participant: Any) -> None:
    mute = Node("mute", context=participant.context, start_parameter_services=False)
    mute.create_subscription(String, TEXT, print, 10)

    def found() -> bool:
        return [info.node_name for info in participant.get_subscriptions_info_by_topic(TEXT)] == ["mute"]

    participant.spin_until(found, "it is known by name")
    wait_until_known(participant, [TEXT, "/nobody"], lambda: pytest.fail("it waits"), patience=60.0)
