"""Nodes among others: how they start and stop, who waits for whom, what a lossless replay counts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Empty
from tms_bag import BagReader, BagWriter, Record
from tms_bag.nodes.answering import Answering
from tms_bag.nodes.sending import Sending
from tms_bag.qos import LATCHED
from tms_bag.transport import Transport
from tms_msgs.msg import Handled

DEADLINE = 300.0  # [s]; tells what hangs from what is slow
EXECUTABLES = ("tms_bag", "tms_sim", "tms_fit")
LATEST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def python(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options
    )


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.quick_for(how=[signal.SIGINT])
def test_a_signal_while_modules_load_ends_a_node_without_a_word(tmp_path: Path, how: signal.Signals) -> None:
    (tmp_path / "slow.py").write_text(
        "from pathlib import Path\nPath('loading').touch()\nimport time; time.sleep(600)"
    )
    path = os.pathsep.join([str(tmp_path), *sys.path])
    process = python(
        "-m", "tms_bag.nodes.starting", "slow", cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}
    )
    deadline = time.monotonic() + DEADLINE
    while not (tmp_path / "loading").exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(how)
    assert process.communicate(timeout=DEADLINE) == ("", None)
    assert process.returncode == 0


@pytest.mark.parametrize("package", EXECUTABLES)
def test_before_a_node_catches_signals_next_to_nothing_is_loaded(package: str) -> None:
    code = f"import sys, {package}.nodes.executables; print(*sorted(sys.modules))"
    words, _ = python("-c", code).communicate(timeout=DEADLINE)
    tops = {module.partition(".")[0] for module in words.split()}
    assert package in tops
    assert not tops & {"numpy", "scipy", "rclpy", "mcap", "rosbags", "yaml"}


@pytest.mark.parametrize("arguments", [["-p", "rate"], ["nonsense"], ["--rate", "2"]])
def test_arguments_that_ros_would_ignore_are_refused(tmp_path: Path, arguments: list[str]) -> None:
    process = python("-m", "tms_bag.nodes.starting", "tms_bag.nodes.recorder", *arguments, cwd=tmp_path)
    words, _ = process.communicate(timeout=DEADLINE)
    assert process.returncode == 2
    assert words.startswith(f"error: unexpected argument '{arguments[0]}': parameters")
    assert words.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_help_tells_how_a_node_is_started(tmp_path: Path) -> None:
    process = python("-m", "tms_bag.nodes.starting", "tms_bag.nodes.recorder", "--help", cwd=tmp_path)
    words, _ = process.communicate(timeout=DEADLINE)
    assert process.returncode == 0
    assert "--ros-args" in words
    assert "writes a bag" in words
    assert not list(tmp_path.iterdir())


def test_answering_ends_silently_when_a_signal_comes_in_the_middle(
    domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    failures: list[Any] = []
    monkeypatch.setattr(threading, "excepthook", failures.append)
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    node = Node("test", context=context)
    publisher = node.create_publisher(Empty, "topic", 1)
    reached = threading.Event()

    def report() -> None:
        context.shutdown()  # as the handler of a signal does, at any moment
        reached.set()
        publisher.get_subscription_count()

    node.create_timer(0.01, report, clock=Clock(clock_type=ClockType.STEADY_TIME))
    answering = Answering(node)
    answering.start()
    assert reached.wait(DEADLINE)
    answering.stop()
    assert not failures


class FakePublisher:
    """What a replay needs of a publisher whose topic was renamed."""

    topic_name = "/lab/imu"

    def publish(self, data: bytes) -> None:
        """Nobody listens."""


class FakeWindow:
    """Notes which topics are counted."""

    def __init__(self) -> None:
        self.counted: list[str] = []

    def wait_for_room(self, topic: str, between: Any) -> None:
        self.counted.append(topic)

    count = lambda self, topic: self.counted.append(topic)  # noqa: E731


def test_a_lossless_replay_counts_by_the_names_that_are_sent() -> None:
    window: Any = FakeWindow()
    sending = Sending({"/imu": FakePublisher()}, window, Transport(0, 1.0, False), lambda: None)
    sending.send(Record("/imu", "sensor_msgs/msg/Imu", 1, b""), 0.0)
    assert window.counted == ["/lab/imu", "/lab/imu"]


def words(*parameters: str) -> list[str]:
    return [word for parameter in parameters for word in ("-p", parameter)]


def hear_handled(participant: Any, topic: str) -> dict[str, int]:
    counts: dict[str, int] = {}
    participant.create_subscription(
        Handled,
        topic,
        lambda message: counts.update(zip(message.topics, message.counts, strict=True)),
        LATEST,
    )
    return counts


def test_a_replay_is_lossless_under_other_names_and_beside_recorded_reports(
    nodes: Any, participant: Any, records: list[Record], tmp_path: Path
) -> None:
    old = Handled(node="/lab/estimator", topics=["/lab/imu/data_raw"], counts=[1_000_000])
    report = "/lab/estimator/handled"
    with BagWriter(tmp_path / "bag") as writer:
        for record in records:
            writer.write(record)
            if record.topic == "/run_info":
                data = serialize_message(old)
                writer.write(Record(report, "tms_msgs/msg/Handled", record.time_ns, data), LATCHED)
    counts = hear_handled(participant, report)
    estimator = nodes.start("tms_fit", "estimator", "-r", "__ns:=/lab", "-p", "bicycle:=benchmark")
    moved = [
        w for name in ("imu/data_raw", "bicycle/speed", "run_info") for w in ("-r", f"/{name}:=/lab/{name}")
    ]
    player = nodes.start(
        *("tms_bag", "player", "-r", "__ns:=/lab", *moved),
        *words(f"bag:={tmp_path / 'bag'}", "rate:=1000.0", "lossless:=true", "window:=5"),
    )
    nodes.finish(player)
    with BagReader(tmp_path / "bag") as reader:
        expected = {f"/lab{topic.name}": topic.count for topic in reader.topics if topic.name != report}
    assert report not in nodes.log("player").read_text()
    participant.spin_until(
        lambda: {name: counts.get(name) for name in expected} == expected, "all has been handled"
    )
    nodes.stop(estimator)


def test_the_simulator_waits_for_an_estimator_that_comes_late(nodes: Any, participant: Any) -> None:
    counts = hear_handled(participant, "/lab/estimator/handled")
    simulator = nodes.start(
        *("tms_sim", "simulator", "-r", "__ns:=/lab"),
        *words("handled_topics:=[estimator/handled]", "rate:=20.0", "duration:=3.0"),
    )
    participant.reach("/lab/simulator")
    estimator = nodes.start("tms_fit", "estimator", "-r", "__ns:=/lab")
    nodes.finish(simulator)
    participant.spin_until(lambda: counts.get("/lab/imu/data_raw") == 301, "every sample has been handled")
    nodes.stop(estimator)


def test_without_the_estimator_the_simulator_gives_up(nodes: Any) -> None:
    simulator = nodes.start(
        "tms_sim", "simulator", *words("handled_topics:=[estimator/handled]", "wait_timeout:=0.1")
    )
    nodes.finish(simulator, code=2)
    (line,) = nodes.log("simulator").read_text().splitlines()
    assert "and who reports on /estimator/handled within 0.1 s, found too few: /estimator/handled" in line
