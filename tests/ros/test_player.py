"""The player told what to do while it plays, and a replay that loses nothing however fast."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from rclpy.qos import QoSProfile
from std_srvs.srv import Empty, Trigger
from tms_bag import BagWriter
from tms_bag.nodes.interfaces import message_class
from tms_msgs.srv import Seek, SetRate

SPEED, IMU = "/bicycle/speed", "/imu/data_raw"


def listen(participant: Any, topic: str, kind: str) -> list[bytes]:
    arrived: list[bytes] = []
    participant.create_subscription(
        message_class(kind), topic, arrived.append, QoSProfile(depth=5000), raw=True
    )
    return arrived


def call(participant: Any, kind: Any, name: str, **fields: Any) -> Any:
    return participant.call(kind, f"/player/{name}", kind.Request(**fields))


def of(records: list[Any], topic: str) -> list[Any]:
    return [record for record in records if record.topic == topic]


def start(nodes: Any, bag: Path, *parameters: str) -> Any:
    words = [word for parameter in parameters for word in ("-p", parameter)]
    return nodes.start("tms_bag", "player", "-p", f"bag:={json.dumps(str(bag))}", *words)


def test_told_by_services(nodes: Any, participant: Any, bag: Path, records: list[Any]) -> None:
    arrived = listen(participant, SPEED, "geometry_msgs/msg/TwistStamped")
    speeds = of(records, SPEED)
    player = start(nodes, bag, "start_paused:=true", "wait_for_subscriptions:=1", f"topics:=[{SPEED}]")
    assert call(participant, Trigger, "is_paused").success
    for number in (1, 2, 3):  # one at a time
        assert call(participant, Trigger, "play_next").success
        participant.spin_until(lambda n=number: len(arrived) == n, "one more")
    middle = speeds[12].time_ns
    where = Time(sec=middle // 10**9, nanosec=middle % 10**9)
    assert call(participant, Seek, "seek", time=where).success
    assert not call(participant, Seek, "seek", time=Time(sec=5)).success
    assert call(participant, Trigger, "play_next").success
    participant.spin_until(lambda: len(arrived) == 4, "the one in the middle")
    assert not call(participant, SetRate, "set_rate", rate=-1.0).success
    assert call(participant, SetRate, "set_rate", rate=5.0).success
    assert call(participant, Trigger, "get_rate").message == "5"
    call(participant, Empty, "toggle_paused")
    nodes.finish(player)
    expected = speeds[:3] + speeds[12:]
    participant.spin_until(lambda: len(arrived) == len(expected), "the rest")
    assert arrived == [record.data for record in expected]


def test_one_that_plays_takes_no_steps(nodes: Any, participant: Any, bag: Path) -> None:
    player = start(nodes, bag, "rate:=0.01")
    answer = call(participant, Trigger, "play_next")
    assert not answer.success
    assert "call ~/pause first" in answer.message
    call(participant, Empty, "pause")
    assert call(participant, Trigger, "is_paused").success
    call(participant, Empty, "resume")
    assert not call(participant, Trigger, "is_paused").success
    nodes.stop(player)


@pytest.mark.parametrize(
    "parameters",
    [
        ["loop:=true"],
        ["delay:=1000.0"],
        ["start_paused:=true"],
        ["wait_for_subscriptions:=1000", "wait_timeout:=1000.0"],
        ["lossless:=true", "wait_timeout:=1000.0"],
    ],
)
@pytest.mark.quick_for(parameters=[["delay:=1000.0"], ["lossless:=true", "wait_timeout:=1000.0"]])
def test_stop_ends_it_whatever_it_waits_for(
    nodes: Any, participant: Any, bag: Path, parameters: list[str]
) -> None:
    player = start(nodes, bag, *parameters)
    participant.client(Empty, "/player/stop").call_async(Empty.Request())
    nodes.finish(player)
    assert "Traceback" not in nodes.log("player").read_text()


def test_a_part_of_the_bag_by_other_names_and_quality(
    nodes: Any, participant: Any, bag: Path, records: list[Any]
) -> None:
    arrived = listen(participant, "/mine", "sensor_msgs/msg/Imu")
    arguments = ["start_offset:=0.5", "duration:=1.0", "regex:=imu", "wait_for_subscriptions:=1", "rate:=4.0"]
    override = "qos_overrides./mine.publisher.reliability:=reliable"
    words = [word for argument in [*arguments, override] for word in ("-p", argument)]
    player = nodes.start("tms_bag", "player", "-p", f"bag:={bag}", *words, "-r", f"{IMU}:=/mine")
    first = records[0].time_ns
    expected = [r.data for r in of(records, IMU) if 0.5 <= (r.time_ns - first) / 1e9 <= 1.5]
    participant.spin_until(lambda: len(arrived) >= len(expected), "one second of it")
    nodes.finish(player)
    assert arrived == expected
    assert f"{len(expected)} messages played" in nodes.log("player").read_text()


def test_overridden_quality_is_what_is_offered(nodes: Any, participant: Any, bag: Path) -> None:
    name = f"qos_overrides.{IMU}.publisher.reliability"
    player = start(nodes, bag, f"{name}:=best_effort", "start_paused:=true")
    participant.spin_until(lambda: participant.get_publishers_info_by_topic(IMU), "the player is there")
    (info,) = participant.get_publishers_info_by_topic(IMU)
    assert info.qos_profile.reliability.name == "BEST_EFFORT"
    nodes.wait_for("player", "playing")
    nodes.stop(player)


def test_an_override_of_a_topic_that_is_not_played_is_refused(nodes: Any, bag: Path) -> None:
    player = start(nodes, bag, "qos_overrides./nope.publisher.reliability:=best_effort")
    nodes.finish(player, 2)
    assert "unknown parameter qos_overrides./nope" in nodes.log("player").read_text()


def test_without_its_consumer_a_lossless_replay_gives_up(nodes: Any, bag: Path) -> None:
    player = start(nodes, bag, "lossless:=true", "wait_timeout:=0.2")
    nodes.finish(player, 2)
    lines = nodes.log("player").read_text().splitlines()
    assert any("expected /estimator/handled to say what has been handled" in line for line in lines)


def test_parameters_come_from_a_yaml_file(nodes: Any, participant: Any, bag: Path, tmp_path: Path) -> None:
    parameters = {"bag": str(bag), "rate": 8.0, "start_paused": True}
    document = {"/**": {"ros__parameters": parameters}}
    (tmp_path / "player.yaml").write_text(json.dumps(document))  # JSON is YAML, too
    player = nodes.start("tms_bag", "player", "--params-file", str(tmp_path / "player.yaml"))
    assert call(participant, Trigger, "get_rate").message == "8"
    assert call(participant, Trigger, "is_paused").success
    nodes.stop(player)


@pytest.mark.parametrize(("parameters", "rounds", "period"), [([], 100, 0.01), (["delay:=0.3"], 4, 0.3)])
def test_a_loop_of_one_message_leaves_time_for_others(
    nodes: Any,
    participant: Any,
    records: list[Any],
    tmp_path: Path,
    parameters: list[str],
    rounds: int,
    period: float,
) -> None:
    with BagWriter(tmp_path / "one") as writer:
        writer.write(of(records, IMU)[0])
    sent: list[float] = []  # [s], as the sender's machine says

    def hear(message: Any, info: Any) -> None:
        sent.append(info["source_timestamp"] / 1e9)

    participant.create_subscription(message_class("sensor_msgs/msg/Imu"), IMU, hear, QoSProfile(depth=5000))
    player = start(nodes, tmp_path / "one", "loop:=true", "wait_for_subscriptions:=1", *parameters)
    participant.spin_until(lambda: len(sent) > rounds, "many rounds")
    nodes.stop(player)
    assert sent[rounds] - sent[0] > rounds * period / 2  # the first may be held up on a busy machine
