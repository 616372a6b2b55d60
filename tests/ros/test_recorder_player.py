"""Recorder and player as processes: what is published is what is in the bag, and the other way round."""

import re
import signal
import time

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from tms_bag import BagReader, messages
from tms_bag.nodes.interfaces import message_class, offered_profile
from tms_bag.qos import LATCHED, SENSOR
from tms_bag.writing.repair import repair

LATEST = QoSProfile(depth=1000)


def publishers_for(participant, records):
    """A publisher for each topic, as the project's nodes make them."""
    types = {record.topic: record.type for record in records}
    return {
        topic: participant.create_publisher(
            message_class(kind), topic, offered_profile([LATCHED if topic == "/run_info" else SENSOR], 1)
        )
        for topic, kind in types.items()
    }


def by_topic(records):
    found = {}
    for record in records:
        found.setdefault(record.topic, []).append(record.data)
    return found


def start_recorder(nodes, bag, *arguments):
    recorder = nodes.start("tms_bag", "recorder", "-p", f"output:={bag}", *arguments)
    nodes.wait_for("recorder", f"recording to {bag}")
    return recorder


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM], ids=lambda how: how.name)
@pytest.mark.quick_for(how=[signal.SIGINT])
def test_what_is_published_is_in_the_bag_after_a_signal(nodes, participant, records, tmp_path, how):
    recorder = start_recorder(nodes, tmp_path / "bag")
    publishers = publishers_for(participant, records)
    hidden = participant.create_publisher(message_class("std_msgs/msg/String"), "/_hidden/x", 1)
    matched = [publisher.get_subscription_count for publisher in publishers.values()]
    participant.spin_until(lambda: all(count() for count in matched), "the recorder finds all topics")
    before = time.time_ns()
    for record in records:
        publishers[record.topic].publish(record.data)
    hidden.publish(message_class("std_msgs/msg/String")(data="x"))
    participant.acknowledged(*publishers.values())
    after = time.time_ns()
    nodes.stop(recorder, how)
    with BagReader(tmp_path / "bag") as reader:
        assert reader.complete
        # /rosout, /parameter_events and hidden topics are left out, but its own reports are not.
        assert {topic.name for topic in reader.topics} == {*publishers, "/diagnostics"}
        found = list(reader.records(list(publishers)))
        assert by_topic(found) == by_topic(records)
        assert all(before <= record.publish_time_ns <= record.time_ns <= after + 10**9 for record in found)
        qos = {channel.name: channel.qos[0] for channel in reader.channels}
        assert (qos["/run_info"].durability, qos["/run_info"].reliability) == ("transient_local", "reliable")
        assert (qos["/imu/data_raw"].durability, qos["/imu/data_raw"].reliability) == ("volatile", "reliable")
        hashes = {channel.name: channel.type_hash for channel in reader.channels}
        assert hashes["/run_info"] == messages.type_hash("tms_msgs/msg/RunInfo")


def test_after_sigkill_all_is_there_that_was_on_the_disk(nodes, participant, make_records, tmp_path):
    recorder = start_recorder(nodes, tmp_path / "bag")
    records = [record for record in make_records(count=1500) if record.topic == "/imu/data_raw"]
    publisher = publishers_for(participant, records)["/imu/data_raw"]
    participant.spin_until(publisher.get_subscription_count, "the recorder finds the topic")
    for record in records[:1000]:
        publisher.publish(record.data)
        time.sleep(0.002)
    # By itself, with nothing that follows; how soon is tests/bag/test_live_bag.py's business.
    nodes.wait_until(lambda: BagReader(tmp_path / "bag").message_count >= 1000, "all is on the disk")
    for record in records[1000:]:
        publisher.publish(record.data)
        time.sleep(0.002)
    recorder.kill()
    recorder.wait()
    with BagReader(tmp_path / "bag") as reader:
        assert not reader.complete
        found = [record.data for record in reader.records(["/imu/data_raw"])]
    assert found == [record.data for record in records[: len(found)]]
    assert len(found) >= 1000
    repair(tmp_path / "bag")
    with AnyReader([tmp_path / "bag"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        chosen = [c for c in reader.connections if c.topic == "/imu/data_raw"]
        assert [bytes(data) for _, _, data in reader.messages(chosen)] == found


def test_only_chosen_topics_are_recorded_even_if_they_come_late(nodes, participant, records, tmp_path):
    recorder = start_recorder(nodes, tmp_path / "bag", "-p", "topics:=[bicycle/speed]")
    publishers = publishers_for(participant, records)
    participant.spin_until(
        publishers["/bicycle/speed"].get_subscription_count, "the recorder finds the topic"
    )
    for record in records:
        publishers[record.topic].publish(record.data)
    participant.acknowledged(publishers["/bicycle/speed"])
    nodes.stop(recorder)
    with BagReader(tmp_path / "bag") as reader:
        assert by_topic(reader.records()) == {"/bicycle/speed": by_topic(records)["/bicycle/speed"]}


def test_a_best_effort_publisher_is_recorded(nodes, participant, tmp_path):
    recorder = start_recorder(nodes, tmp_path / "bag")
    kind = message_class("std_msgs/msg/UInt8")
    profile = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = participant.create_publisher(kind, "/battery", profile)
    participant.spin_until(publisher.get_subscription_count, "the recorder finds the topic")

    def recorded() -> bool:
        publisher.publish(kind(data=7))  # one of them may be lost, that is what best effort means
        with BagReader(tmp_path / "bag") as reader:
            return any(topic.name == "/battery" and topic.count for topic in reader.topics)

    participant.spin_until(recorded, "a message is in the bag")
    nodes.stop(recorder)
    with BagReader(tmp_path / "bag") as reader:
        qos = {channel.name: channel.qos for channel in reader.channels}["/battery"]
    assert [profile.reliability for profile in qos] == ["best_effort"]


def test_a_played_bag_is_recorded_byte_for_byte(nodes, bag, records, tmp_path):
    recorder = start_recorder(nodes, tmp_path / "copy")
    player = nodes.start(
        "tms_bag", "player", "-p", f"bag:={bag}", "-p", "wait_for_subscriptions:=3", "-p", "rate:=5.0"
    )
    nodes.finish(player)
    nodes.stop(recorder)
    with BagReader(tmp_path / "copy") as reader:
        found = by_topic(reader.records(["/run_info", "/imu/data_raw", "/bicycle/speed"]))
    assert found == by_topic(records)


def test_rclpy_reads_every_message_as_we_do(bag):
    checked = 0
    with BagReader(bag) as reader:
        for record in reader.records():
            ours = messages.deserialize(record.data, record.type)
            theirs = deserialize_message(record.data, message_class(record.type))
            assert plain(theirs) == plain(ours)
            checked += 1
    assert checked == 221


def plain(message):
    """A message of either kind as nested lists, with NaN made comparable."""
    if hasattr(message, "get_fields_and_field_types"):
        return [plain(getattr(message, name)) for name in message.get_fields_and_field_types()]
    if hasattr(message, "__dataclass_fields__"):
        constants = {name for name in message.__dataclass_fields__ if name.isupper()} | {"__msgtype__"}
        return [
            plain(getattr(message, name)) for name in message.__dataclass_fields__ if name not in constants
        ]
    if isinstance(message, np.ndarray) or type(message).__name__ == "array":
        return [plain(value) for value in message.tolist()]
    if isinstance(message, list):
        return [plain(value) for value in message]
    return "nan" if message != message else message


def listen(participant, topic, kind, profile=LATEST):
    """Collects (time of arrival [s], bytes) of a topic."""
    arrived = []
    participant.create_subscription(
        message_class(kind), topic, lambda data: arrived.append((time.monotonic(), data)), profile, raw=True
    )
    return arrived


@pytest.mark.parametrize("rate", [1.0, 4.0])
@pytest.mark.quick_for(rate=[4.0])
def test_messages_come_with_their_timing(nodes, participant, bag, records, rate):
    sent = []  # (time of sending [ns], bytes)
    participant.create_subscription(
        message_class("geometry_msgs/msg/TwistStamped"),
        "/bicycle/speed",
        lambda data, info: sent.append((info["source_timestamp"], data)),
        LATEST,
        raw=True,
    )
    player = nodes.start(
        "tms_bag", "player", "-p", f"bag:={bag}", "-p", f"rate:={rate}", "-p", "wait_for_subscriptions:=1"
    )
    expected = [record for record in records if record.topic == "/bicycle/speed"]
    participant.spin_until(lambda: len(sent) == len(expected), "all messages arrive")
    nodes.finish(player)
    assert [data for _, data in sent] == [record.data for record in expected]
    due = np.array([record.time_ns - records[0].time_ns for record in expected]) / 1e9 / rate
    # None is sent before its time, however busy the machine is; the player begins after it says so.
    said = nodes.log("player").read_text()
    begun = float(re.search(r"\[INFO\] \[([0-9.]+)\] \[player\]: playing", said)[1])
    after = np.array([when for when, _ in sent]) / 1e9 - begun
    assert np.all(after > due - 0.005)  # the wall's clock may be slewed by 0.5 ms/s
    assert due[-1] > 0.4  # so that a player without timing would show


def test_the_start_offset_leaves_out_the_beginning_but_what_is_latched(nodes, participant, bag, records):
    latched = QoSProfile(
        depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, history=HistoryPolicy.KEEP_LAST
    )
    info = listen(participant, "/run_info", "tms_msgs/msg/RunInfo", latched)
    arrived = listen(participant, "/imu/data_raw", "sensor_msgs/msg/Imu")
    player = nodes.start(
        *("tms_bag", "player", "-p", f"bag:={bag}", "-p", "start_offset:=1.5"),
        *("-p", "wait_for_subscriptions:=2", "-p", "rate:=2.0"),
    )
    expected = [record.data for record in records if record.topic == "/imu/data_raw"][150:]
    participant.spin_until(lambda: len(arrived) == len(expected) and info, "all messages arrive")
    nodes.finish(player)
    assert [data for _, data in arrived] == expected
    assert [data for _, data in info] == [records[0].data]


def test_a_loop_goes_on_until_a_signal(nodes, participant, bag, records):
    arrived = listen(participant, "/bicycle/speed", "geometry_msgs/msg/TwistStamped")
    player = nodes.start(
        *("tms_bag", "player", "-p", f"bag:={bag}", "-p", "loop:=true", "-p", "rate:=10.0"),
        *("-p", "topics:=[/bicycle/speed]", "-p", "wait_for_subscriptions:=1"),
    )
    once = [record.data for record in records if record.topic == "/bicycle/speed"]
    participant.spin_until(lambda: len(arrived) >= 3 * len(once), "three rounds")
    nodes.stop(player)
    assert [data for _, data in arrived][: 3 * len(once)] == 3 * once


def test_the_clock_tells_the_time_of_the_bag(nodes, participant, bag, records):
    ticks = []
    participant.create_subscription(
        message_class("rosgraph_msgs/msg/Clock"),
        "/clock",
        lambda message: ticks.append(message.clock.sec * 10**9 + message.clock.nanosec),
        LATEST,
    )
    arrived = []
    participant.create_subscription(
        message_class("sensor_msgs/msg/Imu"),
        "/imu/data_raw",
        lambda message: arrived.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec),
        LATEST,
    )
    player = nodes.start(
        *("tms_bag", "player", "-p", f"bag:={bag}", "-p", "publish_clock:=true"),
        *("-p", "topics:=[imu/data_raw]", "-p", "wait_for_subscriptions:=1"),
    )
    participant.spin_until(lambda: len(arrived) == 200, "all messages arrive")
    nodes.finish(player)
    start, end = records[0].time_ns, records[-1].time_ns
    assert ticks == sorted(ticks)
    assert len(ticks) > 20
    assert all(start <= tick <= end + 10**9 for tick in ticks)
    assert ticks[-1] - ticks[0] > 10**9
