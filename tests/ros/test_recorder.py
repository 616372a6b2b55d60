"""What the recorder is asked for, over real DDS: topics, all kinds of publishers, splits, snapshots, time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from builtin_interfaces.msg import Time
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String, UInt32
from std_srvs.srv import Empty, Trigger
from tms_bag import BagReader

BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=1000)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def record(nodes: Any, tmp_path: Path) -> Callable[..., Any]:
    """Starts a recorder of a bag in the test's folder."""

    def start(*arguments: str) -> Any:
        recorder = nodes.start("tms_bag", "recorder", "-p", f"output:={tmp_path / 'bag'}", *arguments)
        nodes.wait_for("recorder", "recording to")
        return recorder

    return start


def numbers(bag: Path, topic: str = "/n") -> list[int]:
    with BagReader(bag) as reader:
        return [int.from_bytes(record.data[4:8], "little") for record in reader.records([topic])]


def remarks(bag: Path) -> dict[str, Any]:
    with BagReader(bag) as reader:
        return {key: yaml.safe_load(text) for key, text in reader.custom_data.items()}


def heard(participant: Any, publisher: Any, count: int = 1) -> None:
    participant.spin_until(lambda: publisher.get_subscription_count() >= count, "the recorder listens")


def send(participant: Any, publisher: Any, values: range) -> None:
    for value in values:
        publisher.publish(UInt32(data=value))
        time.sleep(0.001)
    participant.acknowledged(publisher)


def test_topics_are_chosen_by_pattern_and_type_and_left_out(
    nodes: Any, participant: Any, tmp_path: Path, record: Any
) -> None:
    recorder = record(
        *(
            "-p",
            'regex:="^/bike/"',
            "-p",
            "types:=[std_msgs/msg/String]",
            "-p",
            "exclude_topics:=[/bike/not]",
        ),
        *("-p", "include_hidden:=true", "-p", "exclude_regex:=diagnostics"),
    )
    wanted = {"/bike/n": UInt32, "/text": String, "/bike/_hidden": UInt32}
    others = {"/n": UInt32, "/bike/not": UInt32}
    publishers = {
        name: participant.create_publisher(kind, name, 10) for name, kind in {**wanted, **others}.items()
    }
    for name in wanted:
        heard(participant, publishers[name])
    for publisher in publishers.values():
        publisher.publish(publisher.msg_type())
        participant.acknowledged(publisher)
    nodes.stop(recorder)
    with BagReader(tmp_path / "bag") as reader:
        assert {(topic.name, topic.count) for topic in reader.topics} == {(name, 1) for name in wanted}


def test_a_topic_that_nobody_publishes_stands_in_the_bag_on_request(
    nodes: Any, participant: Any, tmp_path: Path, record: Any
) -> None:
    participant.create_subscription(UInt32, "/wanted", lambda message: None, 10)
    recorder = record("-p", "include_unpublished:=true", "-p", "regex:=wanted")
    nodes.wait_for("recorder", "recording /wanted")
    nodes.stop(recorder)
    with BagReader(tmp_path / "bag") as reader:
        assert [tuple(topic) for topic in reader.topics] == [("/wanted", "std_msgs/msg/UInt32", 0)]


def test_publishers_of_every_kind_are_heard_each_message_once(
    nodes: Any, participant: Any, tmp_path: Path, record: Any
) -> None:
    recorder = record("-p", "topics:=[/n]")
    sent = []
    # A latched one is heard by two subscriptions, of which one asks for what it said before, too.
    for start, (profile, count) in enumerate([(RELIABLE, 1), (LATCHED, 2), (BEST_EFFORT, 1)]):
        publisher = participant.create_publisher(UInt32, "/n", profile)
        heard(participant, publisher, count)
        values = range(1000 * start, 1000 * start + 50)
        send(participant, publisher, values)
        sent += values
    nodes.stop(recorder)
    assert sorted(numbers(tmp_path / "bag")) == sent
    assert remarks(tmp_path / "bag")["lost"] == {}


def test_what_a_latched_publisher_said_before_is_recorded(
    nodes: Any, participant: Any, tmp_path: Path, record: Any
) -> None:
    publisher = participant.create_publisher(UInt32, "/n", LATCHED)
    send(participant, publisher, range(5))
    recorder = record("-p", "topics:=[/n]")
    heard(participant, publisher)
    participant.spin_until(lambda: len(numbers_so_far(tmp_path / "bag")) == 5, "five messages")
    nodes.stop(recorder)
    assert numbers(tmp_path / "bag") == [0, 1, 2, 3, 4]


def numbers_so_far(bag: Path) -> list[int]:
    with BagReader(bag) as reader:
        return numbers(bag) if any(topic.name == "/n" for topic in reader.topics) else []


def test_losses_are_counted_and_told_everywhere(
    nodes: Any, participant: Any, tmp_path: Path, record: Any
) -> None:
    # A history of one message, filled in one go: all but the last of each burst are overwritten.
    recorder = record("-p", "topics:=[/n]", "-p", "history:=1")
    publisher = participant.create_publisher(UInt32, "/n", RELIABLE)
    heard(participant, publisher)
    for value in range(2000):
        publisher.publish(UInt32(data=value))
    participant.acknowledged(publisher)
    send(participant, publisher, range(2000, 2001))
    nodes.stop(recorder)
    found = numbers(tmp_path / "bag")
    lost = 2001 - len(found)
    assert lost > 0
    assert found[-1] == 2000
    before = remarks(tmp_path / "bag")["sent_before_recording"].get("/n", 0)
    assert remarks(tmp_path / "bag")["lost"]["/n"] + before == lost
    assert f"{lost - before} lost (/n {lost - before})" in nodes.log("recorder").read_text()


def test_pause_resume_and_split_are_services(
    nodes: Any, participant: Any, tmp_path: Path, record: Any
) -> None:
    recorder = record("-p", "topics:=[/n]", "-p", "start_paused:=true")
    publisher = participant.create_publisher(UInt32, "/n", RELIABLE)
    heard(participant, publisher)
    send(participant, publisher, range(10))
    assert participant.call(Trigger, "/recorder/is_paused").success
    participant.call(Empty, "/recorder/resume")
    assert not participant.call(Trigger, "/recorder/is_paused").success
    send(participant, publisher, range(10, 20))
    participant.call(Empty, "/recorder/split_bagfile")
    send(participant, publisher, range(20, 30))
    participant.call(Empty, "/recorder/pause")
    send(participant, publisher, range(30, 40))
    nodes.stop(recorder)
    assert numbers(tmp_path / "bag") == list(range(10, 30))
    assert remarks(tmp_path / "bag")["left_out_while_paused"] == 20
    assert sorted(file.name for file in (tmp_path / "bag").glob("*.mcap")) == ["bag_0.mcap", "bag_1.mcap"]
    with BagReader(tmp_path / "bag" / "bag_0.mcap") as first:
        assert first.message_count == 10


def test_stop_ends_it_with_all_that_was_sent_before(
    nodes: Any, participant: Any, tmp_path: Path, record: Any
) -> None:
    recorder = record("-p", "topics:=[/n]")
    publisher = participant.create_publisher(UInt32, "/n", RELIABLE)
    heard(participant, publisher)
    stop = participant.client(Empty, "/recorder/stop")
    send(participant, publisher, range(10))
    stop.call_async(Empty.Request())
    nodes.finish(recorder)
    assert numbers(tmp_path / "bag") == list(range(10))
    with BagReader(tmp_path / "bag") as reader:
        assert reader.complete


def test_a_snapshot_is_what_came_last(nodes: Any, participant: Any, tmp_path: Path, record: Any) -> None:
    recorder = record("-p", "topics:=[/n]", "-p", "snapshot:=60.0")
    publisher = participant.create_publisher(UInt32, "/n", RELIABLE)
    heard(participant, publisher)
    send(participant, publisher, range(10))
    answer = participant.call(Trigger, "/recorder/snapshot")
    assert (answer.success, answer.message) == (True, "10 messages written")
    send(participant, publisher, range(10, 20))  # never asked for
    nodes.stop(recorder)
    assert numbers(tmp_path / "bag") == list(range(10))


def test_without_its_parameter_there_is_no_snapshot(
    nodes: Any, participant: Any, tmp_path: Path, record: Any
) -> None:
    recorder = record()
    answer = participant.call(Trigger, "/recorder/snapshot")
    assert not answer.success
    assert "parameter snapshot" in answer.message
    nodes.stop(recorder)


@pytest.mark.long
def test_simulated_time_stamps_what_came_with_it(
    nodes: Any, participant: Any, tmp_path: Path, record: Any
) -> None:
    clock = participant.create_publisher(Clock, "/clock", 10)
    publisher = participant.create_publisher(UInt32, "/n", RELIABLE)
    recorder = record("-p", "topics:=[/n]", "-p", "use_sim_time:=true")
    heard(participant, publisher)
    participant.spin_until(lambda: clock.get_subscription_count() >= 2, "the recorder listens to the clock")
    participant.reach("/recorder")  # and, without reliability, hears its first tick
    publisher.publish(UInt32(data=0))  # before the first tick: it waits for it
    participant.acknowledged(publisher)
    time.sleep(0.05)
    for second in (100, 101, 50):  # and once back
        clock.publish(Clock(clock=Time(sec=second)))
        participant.acknowledged(clock)
        time.sleep(0.05)
        publisher.publish(UInt32(data=second))
        participant.acknowledged(publisher)
        time.sleep(0.05)
    nodes.stop(recorder)
    with BagReader(tmp_path / "bag") as reader:
        stamps = {int.from_bytes(r.data[4:8], "little"): r.time_ns // 10**9 for r in reader.records(["/n"])}
    assert stamps == {0: 100, 100: 100, 101: 101, 50: 50}
    assert remarks(tmp_path / "bag")["stamps"] == "simulated"


def test_without_a_clock_nothing_is_lost_and_it_is_said(
    nodes: Any, participant: Any, tmp_path: Path, record: Any
) -> None:
    publisher = participant.create_publisher(UInt32, "/n", RELIABLE)
    recorder = record("-p", "topics:=[/n]", "-p", "use_sim_time:=true")
    heard(participant, publisher)
    before = time.time_ns()
    send(participant, publisher, range(20))
    nodes.stop(recorder)
    assert numbers(tmp_path / "bag") == list(range(20))
    assert "/clock has not ticked" in nodes.log("recorder").read_text()
    with BagReader(tmp_path / "bag") as reader:
        assert before <= reader.start_ns <= time.time_ns()


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("compression:=gzip", "compression: expected one of zstd, none"),
        ('regex:="*"', "expected a regular expression"),
        ("max_size:=-1", "parameter max_size: expected"),
        ("snapshot:=-1.0", "parameter snapshot: expected"),
        ("nonsense:=1", "unknown parameter nonsense"),
    ],
)
@pytest.mark.quick_for(argument=["compression:=gzip", "nonsense:=1"])
def test_bad_parameters_are_one_line(nodes: Any, tmp_path: Path, argument: str, expected: str) -> None:
    recorder = nodes.start("tms_bag", "recorder", "-p", f"output:={tmp_path / 'bag'}", "-p", argument)
    nodes.finish(recorder, 2)
    lines = nodes.log("recorder").read_text().splitlines()
    assert len(lines) == 1
    assert expected in lines[0]
    assert not (tmp_path / "bag").exists()
