"""Parameters of recorder and player: bad ones end in one line and exit code 2, or are refused at run time."""

import dataclasses
import json
import os
import resource
import signal

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.node import Node
from tms_bag import BagReader, BagWriter, Record
from tms_bag.channel import installed_channel
from tms_bag.qos import Qos


def only_line(nodes, executable: str) -> str:
    lines = [line for line in nodes.log(executable).read_text().splitlines() if "[INFO]" not in line]
    assert len(lines) == 1, lines
    return lines[0]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "parameter bag: expected the path of a bag, found nothing"),
        (
            ["bag:=/nowhere/bag"],
            "/nowhere/bag: expected a bag (a folder) or an .mcap file, found nothing there",
        ),
        (["bag:=BAG", "rate:=0.0"], "parameter rate: expected times real time, from 0.01 to 1000"),
        (["bag:=BAG", "rate:=-1.0"], "parameter rate: expected times real time"),
        (["bag:=BAG", "rate:=.nan"], "parameter rate: expected times real time"),
        (["bag:=BAG", "rate:=fast"], "parameter rate: expected times real time"),
        (["bag:=BAG", "rate:=2"], "parameter rate: expected times real time"),
        (["bag:=BAG", "start_offset:=-1.0"], "parameter start_offset: expected start this much into the bag"),
        (["bag:=BAG", "start_offset:=100.0"], "parameter start_offset: expected at most 1.99 s, found 100 s"),
        (
            ["bag:=BAG", "topics:=[/nope]"],
            "no topic /nope; there are: /bicycle/speed, /imu/data_raw, /run_info",
        ),
        (["bag:=BAG", "topics:=[a b]"], "parameter topics: expected topic names"),
        (
            ["bag:=BAG", "wait_for_subscriptions:=1", "wait_timeout:=0.1"],
            "expected 1 subscriptions within 0.1 s, found 0",
        ),
    ],
)
@pytest.mark.quick_for(
    arguments=[[], ["bag:=BAG", "rate:=0.0"], ["bag:=BAG", "rate:=fast"], ["bag:=BAG", "topics:=[/nope]"]]
)
def test_bad_parameters_of_the_player(nodes, bag, arguments, expected):
    flags = [word for text in arguments for word in ("-p", text.replace("BAG", json.dumps(str(bag))))]
    nodes.finish(nodes.start("tms_bag", "player", *flags), code=2)
    last = nodes.log("player").read_text().splitlines()[-1]
    assert expected in nodes.log("player").read_text()
    assert "Traceback" not in nodes.log("player").read_text()
    assert last


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["output:=BAG"], "exists already"),
        (["output:=BAG/metadata.yaml/bag"], "can't make this folder"),
        (["output:=7"], "parameter output: expected bag (a folder) to write"),
        (["output:=new", "topics:=[1, 2]"], "parameter topics: expected names of topics"),
        (["output:=new", "topics:=['a//b']"], "parameter topics: expected topic names"),
    ],
)
@pytest.mark.quick_for(arguments=[["output:=BAG"], ["output:=7"]])
def test_bad_parameters_of_the_recorder(nodes, bag, arguments, expected):
    before = sorted(path.name for path in bag.parent.iterdir())
    flags = [word for text in arguments for word in ("-p", text.replace("BAG", str(bag)))]
    nodes.finish(nodes.start("tms_bag", "recorder", *flags), code=2)
    assert expected in only_line(nodes, "recorder")
    assert sorted(path.name for path in bag.parent.iterdir()) == sorted([*before, "recorder.log"])


def number(name: str, value: float) -> Parameter:
    return Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value))


def text(name: str, value: str) -> Parameter:
    return Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value))


def test_the_player_refuses_what_is_out_of_range_while_it_plays(nodes, participant, bag):
    player = nodes.start("tms_bag", "player", "-p", f"bag:={bag}", "-p", "rate:=0.01")
    request = SetParameters.Request(
        parameters=[
            number("rate", 5000.0),
            text("rate", "fast"),
            text("bag", "/other"),
            number("rate", 100.0),
        ]
    )
    results = participant.call(SetParameters, "/player/set_parameters", request).results
    assert [result.successful for result in results] == [False, False, False, True]
    assert all(result.reason for result in results[:3])
    nodes.finish(player)  # 200 s at the first rate, at once at the last


def test_parameters_are_described_with_their_ranges(nodes, participant, bag):
    player = nodes.start("tms_bag", "player", "-p", f"bag:={bag}", "-p", "rate:=0.01")
    names = ["bag", "rate", "start_offset", "loop", "publish_clock", "topics", "wait_for_subscriptions"]
    request = DescribeParameters.Request(names=names)
    described = participant.call(DescribeParameters, "/player/describe_parameters", request).descriptors
    assert [descriptor.name for descriptor in described] == names
    assert all(descriptor.description for descriptor in described)
    rate = described[1].floating_point_range[0]
    assert (rate.from_value, rate.to_value) == (0.01, 1000.0)
    nodes.stop(player)


def test_the_recorder_reports_its_counts(nodes, participant, bag, tmp_path):
    reports: list[DiagnosticArray] = []
    participant.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 10)
    recorder = nodes.start("tms_bag", "recorder", "-p", f"output:={tmp_path / 'new'}")
    player = nodes.start("tms_bag", "player", "-p", f"bag:={bag}", "-p", "wait_for_subscriptions:=3")

    def counts() -> list[str]:
        values = [v for r in reports for s in r.status if s.name == "/recorder" for v in s.values]
        return [value.value for value in values if value.key == "/imu/data_raw"]

    participant.spin_until(lambda: "200" in counts(), "the recorder reports 200 messages")
    nodes.finish(player)
    nodes.stop(recorder)


def test_a_type_that_is_not_installed_is_left_out_with_a_warning(nodes, bag, tmp_path):
    with BagReader(bag) as reader, BagWriter(tmp_path / "foreign") as writer:
        known = installed_channel("/known", "std_msgs/msg/UInt8", ())
        writer.add_channel(dataclasses.replace(known, name="/foreign", type="elsewhere_msgs/msg/Thing"))
        writer.add_channel(known)
        start = reader.start_ns
        writer.write(Record("/foreign", "elsewhere_msgs/msg/Thing", start, b"\x00\x01\x00\x00\x07"))
        writer.write(Record("/known", "std_msgs/msg/UInt8", start + 1, b"\x00\x01\x00\x00\x07"))
    path = tmp_path / "foreign"
    nodes.finish(nodes.start("tms_bag", "player", "-p", f"bag:={path}"))
    said = nodes.log("player").read_text()
    assert "/foreign is not played: message type elsewhere_msgs/msg/Thing is not installed" in said
    assert f"{path}: 1 messages played" in said


@pytest.mark.parametrize("executable", ["recorder", "player"])
@pytest.mark.parametrize("argument", ["--nope", "-p", "rate"])
@pytest.mark.quick_for(argument=["--nope"])
def test_arguments_that_ros_does_not_know_are_refused(nodes, executable, argument):
    nodes.finish(nodes.start("tms_bag", executable, argument), code=2)
    assert "Traceback" not in nodes.log(executable).read_text()


def test_a_full_disk_ends_the_recorder_and_leaves_what_was_written(nodes, bag, tmp_path):
    # A limit on the size of files fails as a full disk does, in the middle of a write.
    recorder = nodes.start("tms_bag", "recorder", "-p", f"output:={tmp_path / 'new'}")
    nodes.wait_for("recorder", "recording to")
    player = nodes.start(
        *("tms_bag", "player", "-p", f"bag:={bag}", "-p", "wait_for_subscriptions:=3", "-p", "loop:=true"),
        *("-p", "rate:=5.0"),
    )
    (file,) = (tmp_path / "new").glob("*.mcap")

    def replayed() -> bool:  # the recorder's own reports come before
        return any(
            topic.name == "/imu/data_raw" and topic.count for topic in BagReader(tmp_path / "new").topics
        )

    nodes.wait_until(replayed, "messages are on the disk")
    full = file.stat().st_size + 1000
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (full, full))
    nodes.finish(recorder, code=1)
    nodes.stop(player)
    line = only_line(nodes, "recorder")
    assert line.startswith("error: ")
    assert "can't be written any further (File too large); `tms bag repair" in line
    with BagReader(tmp_path / "new") as reader:
        assert reader.message_count > 0
        assert not reader.complete


def test_a_disk_that_is_full_at_the_end_is_told_with_the_bag(nodes, tmp_path):
    recorder = nodes.start(
        *("tms_bag", "recorder", "-p", f"output:={tmp_path / 'new'}", "-p", "topics:=[/nobody/speaks]")
    )
    nodes.wait_for("recorder", "recording to")
    (file,) = (tmp_path / "new").glob("*.mcap")
    full = file.stat().st_size
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (full, full))
    recorder.send_signal(signal.SIGINT)
    nodes.finish(recorder, code=1)
    assert only_line(nodes, "recorder").startswith(
        f"error: {tmp_path / 'new'}: can't be written any further (File too large); `tms bag repair"
    )


def test_names_and_depths_that_ros_does_not_know_keep_nothing_else_from_being_played(
    nodes, records, tmp_path
):
    with BagWriter(tmp_path / "odd") as writer:
        for record in records:
            writer.write(record, Qos(depth=2**40, durability="transient_local"))
        for name in ("/a name", "/speed!", "/slash/", ""):
            writer.write(dataclasses.replace(records[0], topic=name, time_ns=records[-1].time_ns))
    nodes.finish(nodes.start("tms_bag", "player", "-p", f"bag:={tmp_path / 'odd'}", "-p", "rate:=100.0"))
    said = nodes.log("player").read_text()
    assert said.count("is not played: no topic of ROS has such a name") == 4
    assert f"{len(records)} messages played" in said


@pytest.mark.parametrize("name", ["plain", "größer", "記録", '🚲 "1"', "a\\b: #c"])
def test_a_bag_may_have_any_name(command, monkeypatch, tmp_path, name):
    programs = []
    monkeypatch.setattr(os, "execv", lambda program, arguments: programs.append(arguments))
    assert command("tms_bag", "record", "-o", tmp_path / name).code == 0
    (arguments,) = programs
    context = rclpy.Context()
    rclpy.init(args=arguments[arguments.index("--ros-args") :], context=context)
    try:
        node = Node("recorder", context=context)
        assert node.declare_parameter("output", "").value == str(tmp_path / name)
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
