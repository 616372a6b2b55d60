"""A user at the running simulator: holds it, strikes the bicycle, looks at it in a viewer."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
from geometry_msgs.msg import TransformStamped
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from tms_msgs.msg import BicycleState, RunInfo
from tms_msgs.srv import Strike
from visualization_msgs.msg import Marker

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def listen(participant: Any, kind: Any, name: str, qos: Any = 1000) -> list[Any]:
    heard: list[Any] = []
    participant.create_subscription(kind, name, heard.append, qos)
    return heard


def test_start_strike_stop_reset(nodes: Any, participant: Any) -> None:
    states = listen(participant, BicycleState, "bicycle/state")
    infos = listen(participant, RunInfo, "run_info", LATCHED)
    process = nodes.start(
        "tms_sim", "simulator", "-p", "autostart:=false", "-p", "stay:=true", "-p", "rate:=0.3",
        "-p", "scenario:=tms_strike_ideal",
    )  # fmt: skip
    assert participant.call(Trigger, "/simulator/stop").success
    assert states == []  # it waits for the start
    participant.client(Strike, "/simulator/strike")  # now, so that it doesn't take time of the run
    assert participant.call(Trigger, "/simulator/start").success
    participant.spin_until(lambda: len(states) > 20, "the run goes on")
    struck = participant.call(Strike, "/simulator/strike", Strike.Request(lean_rate=0.3))
    assert struck.success, struck.message
    participant.spin_until(lambda: any(abs(one.lean_rate) > 0.2 for one in states), "the strike is felt")
    participant.spin_until(lambda: len(infos) == 2, "run_info tells of the strike")
    assert "- 0.3" in infos[1].configuration
    refused = participant.call(Strike, "/simulator/strike", Strike.Request(lean_rate=99.0))
    assert not refused.success
    assert "strike.lean_rate" in refused.message
    participant.call(Trigger, "/simulator/stop")
    last = states[-1].header.stamp
    participant.call(Trigger, "/simulator/reset")
    participant.call(Trigger, "/simulator/start")
    participant.spin_until(lambda: states[-1].header.stamp.sec < last.sec or states[-1].lean == 0.0, "back")
    nodes.stop(process)


def test_faults_set_while_the_run_goes_on(nodes: Any, participant: Any) -> None:
    states = listen(participant, BicycleState, "bicycle/state")
    infos = listen(participant, RunInfo, "run_info", LATCHED)
    process = nodes.start(
        "tms_sim",
        "simulator",
        "-p",
        "autostart:=false",
        "-p",
        "stay:=true",
        "-p",
        "rate:=0.3",
        "-p",
        "scenario:=tms_strike_ideal",
    )
    for kind, name in ((SetParameters, "set_parameters"), (GetParameters, "get_parameters")):
        participant.client(kind, f"/simulator/{name}")  # now, so that it doesn't take time of the run
    assert participant.call(Trigger, "/simulator/start").success
    participant.spin_until(lambda: len(states) > 20 and len(infos) == 1, "the run goes on")
    assert set_faults(participant, "bias_jump") == ""
    participant.spin_until(lambda: len(infos) == 2, "run_info tells of the fault")
    (faults,) = participant.call(
        GetParameters, "/simulator/get_parameters", GetParameters.Request(names=["faults"])
    ).values
    assert re.fullmatch(r"bias_jump:time=\d+\.\d{6}", faults.string_value)
    assert f"faults: {faults.string_value}\n" in infos[1].configuration
    begun = len(states)
    participant.spin_until(lambda: len(states) > begun + 20, "the fault has begun")
    assert "those that have begun as they are, which is 'bias_jump:time=" in set_faults(participant, "none")
    assert "unknown 'moon'" in set_faults(participant, f"{faults.string_value}; moon")
    assert len(infos) == 2
    nodes.stop(process)


def set_faults(participant: Any, text: str) -> str:
    """Set the simulator's faults; returns the reason of a refusal."""
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
    request = SetParameters.Request(parameters=[Parameter(name="faults", value=value)])
    (result,) = participant.call(SetParameters, "/simulator/set_parameters", request).results
    assert result.successful == (result.reason == "")
    return str(result.reason)


def test_viewers_get_a_bicycle_that_moves(nodes: Any, participant: Any) -> None:
    moving = listen(participant, TFMessage, "/tf")
    fixed = listen(participant, TFMessage, "/tf_static", LATCHED)
    joints = listen(participant, JointState, "joint_states")
    paths = listen(participant, Marker, "bicycle/path")
    described = listen(participant, String, "robot_description", LATCHED)
    states = listen(participant, BicycleState, "bicycle/state")
    process = nodes.start("tms_sim", "simulator", "-p", "stay:=true", "-p", "autostart:=false")
    participant.call(Trigger, "/simulator/start")
    participant.spin_until(lambda: any(abs(one.lean) > 0.02 for one in states), "the bicycle leans")
    participant.spin_until(lambda: described and fixed and len(joints) > 5 and len(paths) > 5, "all is shown")
    assert described[0].data.startswith('<robot name="tms_eq_10_1">')
    assert [one.child_frame_id for one in fixed[0].transforms] == ["imu_link"]
    frames = [(one.header.frame_id, one.child_frame_id) for one in moving[-1].transforms]
    assert frames == [
        ("world", "rear_frame"),
        ("rear_frame", "front_frame"),
        ("rear_frame", "rear_wheel"),
        ("front_frame", "front_wheel"),
    ]
    by_stamp = {(one.header.stamp.sec, one.header.stamp.nanosec): one for one in states}
    shown = [message.transforms[0] for message in moving]
    known = [(one, by_stamp[key]) for one in shown if (key := stamp_of(one)) in by_stamp]
    assert known
    for transform, state in known:
        assert transform.transform.translation.x == pytest.approx(state.rear_contact[0], abs=1e-12)
        assert transform.transform.translation.y == pytest.approx(-state.rear_contact[1], abs=1e-12)
        assert roll(transform) == pytest.approx(state.lean, abs=1e-9)
    assert joints[-1].name == ["rear_axle", "steer", "front_axle"]
    assert len(paths[-1].points) > 3
    nodes.stop(process)


def stamp_of(transform: TransformStamped) -> tuple[int, int]:
    return transform.header.stamp.sec, transform.header.stamp.nanosec


def roll(transform: TransformStamped) -> float:
    q = transform.transform.rotation
    return math.atan2(2.0 * (q.w * q.x + q.y * q.z), 1.0 - 2.0 * (q.x**2 + q.y**2))
