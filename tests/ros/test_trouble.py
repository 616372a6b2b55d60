"""Nodes under trouble: deaths and returns, jumps of time, storms of requests, and signals at every stage."""

from __future__ import annotations

import fcntl
import itertools
import os
import random
import shutil
import signal
import struct
import subprocess
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import UInt32
from tms_bag import BagReader, BagWriter, RecordingError, topics
from tms_bag.nodes.interfaces import message_class, offered_profile
from tms_bag.writing.repair import repair
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import INPUTS, LiveFit
from tms_msgs.msg import Handled
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario

GREETING = 2**32 - 1
PRESSURE = Path("/proc/pressure/cpu")
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def run_of(**changes: object) -> Any:
    scenario = load_scenario("tms_strike", {"duration": 4.0, **changes})
    return simulate(scenario, np.random.default_rng(scenario.integer("seed")))


def inputs(run: Any) -> list[Any]:
    return [record for record in run.records() if record.topic.removeprefix("/") in INPUTS]


def offline(records: list[Any]) -> dict[str, list[bytes]]:
    """What a LiveFit publishes when it is given messages in order, without any ROS."""
    live = LiveFit(Settings())
    answers = [a for r in records for a in live.process(r.topic.removeprefix("/"), r.data)] + live.finish()
    found: dict[str, list[bytes]] = {"/estimate": [], "/filter_state": []}
    for answer in answers:
        found[answer.topic].append(answer.data)
    return found


class Source:
    """Publishes records as a sensor's driver would; goes away and returns."""

    def __init__(self, participant: Any, records: list[Any]) -> None:
        self._participant = participant
        kinds = {record.topic: record.type for record in records}
        self.publishers = {
            topic: participant.create_publisher(
                message_class(kind), topic, offered_profile([topics.QOS[topic.removeprefix("/")]], 1)
            )
            for topic, kind in kinds.items()
        }

    def wait_for(self, *nodes: str) -> None:
        """Wait until these nodes hear every topic: then all arrives, and in the order of sending."""
        counts = [publisher.get_subscription_count for publisher in self.publishers.values()]
        self._participant.spin_until(lambda: all(c() >= len(nodes) for c in counts), "listeners")
        for node in nodes:
            self._participant.reach(node)

    def send(self, records: list[Any], pause: float = 0.0005) -> None:
        for record in records:
            self.publishers[record.topic].publish(record.data)
            time.sleep(pause)
        self._participant.acknowledged(*self.publishers.values())

    def leave(self) -> None:
        for publisher in self.publishers.values():
            self._participant.destroy_publisher(publisher)


class Answers:
    """What estimators say."""

    def __init__(self, participant: Any, prefix: str = "") -> None:
        self.found: dict[str, list[bytes]] = {"/estimate": [], "/filter_state": []}
        for topic, kind in (("/estimate", "Estimate"), ("/filter_state", "FilterState")):
            profile = LATCHED if topic == "/estimate" else QoSProfile(depth=20_000)
            kind_class = message_class(f"tms_msgs/msg/{kind}")
            take = self.found[topic].append
            participant.create_subscription(kind_class, prefix + topic, take, profile, raw=True)

    def wait_for(self, participant: Any, expected: dict[str, list[bytes]]) -> None:
        """Wait for as many answers of each kind."""
        participant.spin_until(
            lambda: all(len(self.found[topic]) == len(those) for topic, those in expected.items()), "answers"
        )


def heard(participant: Any, node: str = "/estimator") -> dict[str, int]:
    """What a node has handled, kept up to date."""
    counts: dict[str, int] = {}
    participant.create_subscription(
        Handled,
        f"{node}/handled",
        lambda message: counts.update(zip(message.topics, message.counts, strict=True)),
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    )
    return counts


@pytest.mark.long
def test_a_publisher_that_dies_and_returns_begins_a_new_run(nodes: Any, participant: Any) -> None:
    first, second = inputs(run_of(seed=1)), inputs(run_of(seed=2))
    answers = Answers(participant)
    nodes.start("tms_fit", "estimator")
    expected: dict[str, list[bytes]] = {"/estimate": [], "/filter_state": []}
    for records in (first, second):
        source = Source(participant, records)
        source.wait_for("/estimator")
        source.send(records)
        for topic, those in offline(records).items():
            expected[topic] += those
        answers.wait_for(participant, expected)
        source.leave()
    assert answers.found == expected


def test_who_comes_late_gets_the_estimates_and_two_estimators_agree(nodes: Any, participant: Any) -> None:
    records = inputs(run_of(seed=3))
    expected = offline(records)["/estimate"]
    for name in ("one", "two"):
        nodes.start("tms_fit", "estimator", "-r", f"__ns:=/{name}", *remapped_inputs())
    handled = [heard(participant, f"/{name}/estimator") for name in ("one", "two")]
    source = Source(participant, records)
    source.wait_for("/one/estimator", "/two/estimator")
    source.send(records)
    samples = sum(record.topic == "/imu/data_raw" for record in records)
    participant.spin_until(
        lambda: all(counts.get("/imu/data_raw") == samples for counts in handled), "all is handled"
    )
    late = [Answers(participant, f"/{name}") for name in ("one", "two")]  # only now
    participant.spin_until(
        lambda: all(len(a.found["/estimate"]) == len(expected) for a in late), "latched estimates"
    )
    assert [answers.found["/estimate"] for answers in late] == [expected, expected]


def remapped_inputs() -> list[str]:
    """Composition: an estimator in a namespace that hears the topics outside of it."""
    return [word for topic in INPUTS for word in ("-r", f"{topic}:=/{topic}")]


@pytest.mark.long
def test_time_that_jumps_back_and_forward_begins_new_runs(nodes: Any, participant: Any) -> None:
    now, later = inputs(run_of(seed=4)), inputs(run_of(seed=4, start_time_ns=1_900_000_000_000_000_000))
    records = now + later + now
    expected = offline(records)
    answers = Answers(participant)
    estimator = nodes.start("tms_fit", "estimator")
    source = Source(participant, records)
    source.wait_for("/estimator")
    source.send(records)
    answers.wait_for(participant, expected)
    assert answers.found == expected
    nodes.stop(estimator)


@pytest.mark.long
def test_simulated_time_without_a_clock_stops_nobody(nodes: Any, participant: Any) -> None:
    records = inputs(run_of(seed=5))
    answers = Answers(participant)
    nodes.start("tms_fit", "estimator", "-p", "use_sim_time:=true")
    source = Source(participant, records)
    source.wait_for("/estimator")
    source.send(records)
    expected = offline(records)
    answers.wait_for(participant, expected)
    assert answers.found == expected


def test_a_storm_of_parameters_costs_no_sample(nodes: Any, participant: Any) -> None:
    records = inputs(run_of(seed=6))
    answers = Answers(participant)
    nodes.start("tms_fit", "estimator")
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=1.0)
    source = Source(participant, records)
    source.wait_for("/estimator")
    client = participant.client(SetParameters, "/estimator/set_parameters")
    asked = []
    for k, record in enumerate(records):
        source.publishers[record.topic].publish(record.data)
        if k % 3 == 0:
            request = SetParameters.Request(parameters=[Parameter(name=f"no_{k}", value=value)])
            asked.append(client.call_async(request))
            # ROS keeps ten requests of a service; more under way would go without an answer.
            participant.spin_until(lambda: sum(not f.done() for f in asked[-20:]) < 5, "answers")
    participant.spin_until(lambda: all(future.done() for future in asked), "an answer to each")
    assert not any(result.successful for future in asked for result in future.result().results)
    expected = offline(records)
    answers.wait_for(participant, expected)
    assert answers.found == expected


@pytest.mark.parametrize("delay", [0.0, 0.3, 0.8, 1.2, 1.6, 2.0, 2.5])
@pytest.mark.quick_for(delay=[0.3, 1.2])
def test_a_signal_at_any_stage_leaves_nothing_half_made(nodes: Any, tmp_path: Path, delay: float) -> None:
    recorder = nodes.start("tms_bag", "recorder", "-p", f"output:={tmp_path / 'bag'}")
    time.sleep(delay)
    recorder.send_signal(signal.SIGINT)
    code = recorder.wait(300.0)
    said = nodes.log("recorder").read_text()
    if (tmp_path / "bag").exists():
        assert code == 0, said
        assert "Traceback" not in said
        with BagReader(tmp_path / "bag") as reader:
            assert reader.complete
    else:  # Python was still starting, and says so in its own way
        assert code in (0, 1, 130, -signal.SIGINT), said


class Counting:
    """A recorder, and a publisher that counts in steps of 1 ms, to see how much of it is recorded."""

    def __init__(self, nodes: Any, participant: Any, bag: Path, topic: str) -> None:
        self._participant, self._bag, self._topic = participant, bag, topic
        self._publisher = participant.create_publisher(UInt32, topic, QoSProfile(depth=1000))
        self._times: list[int] = []  # [ns]
        self._waited = 0  # [ns], how long, meanwhile, any thread waited for a processor
        self.recorder = nodes.start("tms_bag", "recorder", "-p", f"output:={bag}", "-p", f"topics:=[{topic}]")
        # Matching takes its time on both sides: once one message is in the bag, none may be missing.
        participant.spin_until(self._is_recorded, "it records")

    def go_on(self, duration: float) -> None:
        """Publish for so long [s]."""
        before, stop_at = waited(), time.monotonic() + duration
        while time.monotonic() < stop_at:
            self._times.append(time.time_ns())
            self._publisher.publish(UInt32(data=len(self._times) - 1))
            time.sleep(0.001)
        self._waited += waited() - before

    def lasting(self, ended_ns: int, disk_delay: float) -> int:
        """How many were sent a second before the end [ns since 1970], and what held up the recorder besides.

        On a machine that is too busy it waits for a processor, or is held up as the loop of 1 ms steps here
        is, where all processors stand still.
        """
        steps = itertools.pairwise([*self._times, ended_ns])
        held_up = 2 * max((later - when for when, later in steps), default=0) + self._waited
        return sum(when < ended_ns - 10**9 - held_up - round(disk_delay * 1e9) for when in self._times)

    def recorded(self) -> list[int]:
        """What the bag holds now."""
        with BagReader(self._bag) as reader:
            found = [int.from_bytes(r.data[4:8], "little") for r in reader.records([self._topic])]
        return [value for value in found if value != GREETING]

    def check(self, safe: int) -> None:
        """Repair the bag, which ended suddenly: the first `safe` messages, at least, must be there."""
        repair(self._bag)
        with BagReader(self._bag) as reader:
            assert reader.complete
        found = self.recorded()
        assert found == list(range(len(found)))
        assert len(found) >= safe, (len(found), safe, len(self._times), self._waited)
        self._participant.destroy_publisher(self._publisher)

    def _is_recorded(self) -> bool:
        """Publish a message that is none of those that count; returns whether one has been recorded."""
        self._publisher.publish(UInt32(data=GREETING))
        time.sleep(0.05)
        try:
            with BagReader(self._bag) as reader:
                return any(found.name == self._topic and found.count for found in reader.topics)
        except RecordingError:  # it has only just been begun
            return False


def waited() -> int:
    """How long, since the machine was started, any thread has waited for a processor [ns]."""
    if not PRESSURE.exists():
        return 0
    some = PRESSURE.read_text().splitlines()[0]
    return 1000 * int(some.rpartition("total=")[2])


@pytest.mark.parametrize("times", [2, pytest.param(200, marks=pytest.mark.long)])
def test_killed_at_random_moments_nothing_that_was_in_the_bag_is_missing(
    nodes: Any, participant: Any, tmp_path: Path, times: int
) -> None:
    rng = random.Random(7)
    for number in range(times):
        counting = Counting(nodes, participant, tmp_path / f"bag{number}", f"/n{number}")
        counting.go_on(rng.uniform(0.0, 3.0))
        safe = len(counting.recorded())
        counting.recorder.kill()
        counting.recorder.wait()
        counting.check(safe)


class Disk:
    """A file system in a file, that can lose its power: what it hasn't been told to keep is gone then."""

    SHUTDOWN, WITHOUT_JOURNAL = 0x8004587D, 2  # of linux/fs/ext4: EXT4_IOC_SHUTDOWN, GOING_FLAGS_NOLOGFLUSH

    def __init__(self, folder: Path) -> None:
        self._image, self.path = folder / "disk.img", folder / "disk"
        self.path.mkdir()
        with self._image.open("wb") as image:
            image.truncate(64 * 2**20)
        subprocess.run(["mkfs.ext4", "-q", str(self._image)], check=True, capture_output=True)
        self.mount()

    def mount(self) -> None:
        """Put it there, in the state in which it was left."""
        command = ["mount", "-o", "loop", str(self._image), str(self.path)]
        subprocess.run(command, check=True, capture_output=True)

    def lose_power(self) -> None:
        """From now on nothing more gets onto the disk, and what waited to be written is lost."""
        handle = os.open(self.path, os.O_RDONLY)
        fcntl.ioctl(handle, self.SHUTDOWN, struct.pack("I", self.WITHOUT_JOURNAL))
        os.close(handle)

    def unmount(self, check: bool = True) -> None:
        """Take it away.

        The kernel may keep a file system for a moment beyond its unmounting (pending write-back holds it).
        Mounted again meanwhile, it would be the same one, still without power, so this waits for the end of
        its loop device.
        """
        subprocess.run(["umount", str(self.path)], check=check, capture_output=True)
        stop_at = time.monotonic() + 30.0
        while self._is_attached() and time.monotonic() < stop_at:
            time.sleep(0.01)

    def _is_attached(self) -> bool:
        listing = subprocess.run(["losetup", "-j", str(self._image)], capture_output=True, check=False)
        return bool(listing.stdout.strip())

    def slowest_sync(self, stop: threading.Event) -> float:
        """Keep syncing a file where the image lies; returns the longest time that took [s]."""
        slowest = 0.0
        with self._image.with_name("probe").open("wb", buffering=0) as probe:
            while not stop.wait(0.1):
                began = time.monotonic()
                probe.write(bytes(100_000))
                os.fsync(probe.fileno())
                slowest = max(slowest, time.monotonic() - began)
        return slowest


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    if not PRESSURE.exists():
        pytest.skip("how busy the machine is can't be told without the kernel's pressure stall information")
    if not shutil.which("mkfs.ext4"):
        pytest.skip("a power failure needs a file system of its own: mkfs.ext4 (e2fsprogs)")
    try:
        disk = Disk(tmp_path)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"a file can't be mounted as a disk here: {error.stderr!r}")
    yield disk
    disk.unmount(check=False)


@pytest.mark.measures
@pytest.mark.parametrize("times", [2, pytest.param(50, marks=pytest.mark.long)])
def test_without_power_at_random_moments_at_most_the_last_second_is_missing(
    nodes: Any, participant: Any, disk: Disk, times: int
) -> None:
    rng = random.Random(8)
    for number in range(times):
        stop = threading.Event()
        with ThreadPoolExecutor() as pool:
            slowest = pool.submit(disk.slowest_sync, stop)
            try:
                counting = Counting(nodes, participant, disk.path / f"bag{number}", f"/n{number}")
                counting.go_on(rng.uniform(1.0, 4.0))
                disk.lose_power()
                ended = time.time_ns()
            finally:
                stop.set()
        nodes.finish(counting.recorder, 1)
        said = [line for line in nodes.log("recorder").read_text().splitlines() if "error" in line]
        assert len(said) == 1, said
        assert "can't be written any further" in said[0]
        disk.unmount()
        disk.mount()
        counting.check(counting.lasting(ended, slowest.result()))


@pytest.mark.long
def test_what_killed_nodes_leave_in_shared_memory_hinders_nobody(
    nodes: Any, participant: Any, tmp_path: Path
) -> None:
    for _ in range(3):
        killed = nodes.start("tms_fit", "estimator")
        nodes.wait_for("estimator", "estimator ready")
        killed.kill()
        killed.wait()
    records = inputs(run_of(seed=8))
    answers = Answers(participant)
    source = Source(participant, records)
    dead = listeners(participant, source.publishers)  # for others they are there until their lease ends
    estimator = nodes.start("tms_fit", "estimator")
    participant.spin_until(
        lambda: len(listeners(participant, source.publishers) - dead) == len(source.publishers), "a live one"
    )
    participant.reach("/estimator")
    source.send(records)
    expected = offline(records)
    answers.wait_for(participant, expected)
    assert answers.found == expected
    nodes.stop(estimator)


def listeners(participant: Any, names: Iterable[str]) -> set[bytes]:
    """Who listens to some topics, dead or alive."""
    return {
        bytes(info.endpoint_gid)
        for name in names
        for info in participant.get_subscriptions_info_by_topic(name)
    }


@pytest.mark.long
def test_a_consumer_that_is_held_up_gets_a_lossless_replay_in_its_order(
    nodes: Any, participant: Any, tmp_path: Path
) -> None:
    # What doesn't fit into shared memory is sent again, after what was sent later on other topics.
    records = inputs(run_of(seed=9, duration=8.0))
    with BagWriter(tmp_path / "bag") as bag:
        for record in records:
            bag.write(record, topics.QOS[record.topic.removeprefix("/")])
    estimator = nodes.start("tms_fit", "estimator", "-p", "idle:=30.0")
    participant.reach("/estimator")
    handled = heard(participant)
    player = nodes.start(
        *("tms_bag", "player", "-p", f"bag:={tmp_path / 'bag'}", "-p", "lossless:=true"),
        *("-p", "rate:=1000.0", "-p", "loop:=true"),
    )
    samples = sum(record.topic == "/imu/data_raw" for record in records)
    for number in range(1, 6):
        wanted = number * samples // 2
        participant.spin_until(lambda n=wanted: handled.get("/imu/data_raw", 0) >= n, "half a round")
        estimator.send_signal(signal.SIGSTOP)
        time.sleep(0.3)  # until the player has sent all that it may
        estimator.send_signal(signal.SIGCONT)
    nodes.stop(player)
    nodes.stop(estimator)
    assert "strikes" in nodes.log("estimator").read_text()
    assert "out_of_order" not in nodes.log("estimator").read_text()


@pytest.mark.long
@pytest.mark.parametrize("rounds", [16, 180])  # of 20 s each
def test_a_long_run_takes_no_memory_and_leaves_no_thread(
    nodes: Any, participant: Any, tmp_path: Path, rounds: int
) -> None:
    # The same run again and again, as fast as it is handled: no sample is lost, memory stays flat, and each
    # round gets the answers that the first one gets. The estimator keeps the samples of ten rounds, whose
    # strikes can be fitted again.
    records = inputs(run_of(seed=9, duration=20.0))
    with BagWriter(tmp_path / "bag") as bag:
        for record in records:
            bag.write(record, topics.QOS[record.topic.removeprefix("/")])
    answers: list[bytes] = []
    profile = QoSProfile(depth=20_000)
    participant.create_subscription(
        message_class("tms_msgs/msg/Estimate"), "/estimate", answers.append, profile, raw=True
    )
    estimator = nodes.start("tms_fit", "estimator", "-p", "idle:=30.0")
    participant.reach("/estimator")
    handled = heard(participant)
    samples = sum(record.topic == "/imu/data_raw" for record in records)
    player = nodes.start(
        *("tms_bag", "player", "-p", f"bag:={tmp_path / 'bag'}", "-p", "lossless:=true"),
        *("-p", "rate:=1000.0", "-p", "loop:=true"),
    )
    memory, threads = [], []
    for number in range(rounds):
        wanted = (number + 1) * samples
        participant.spin_until(lambda n=wanted: handled.get("/imu/data_raw", 0) >= n, "another round")
        memory.append(resident(estimator.pid))
        threads.append(len(list(Path(f"/proc/{estimator.pid}/task").iterdir())))
    expected = offline(records)["/estimate"] * rounds
    participant.spin_until(lambda: len(answers) >= len(expected), "every answer")
    nodes.stop(player)
    nodes.stop(estimator)  # with exit code 0 in time: no thread holds it up
    assert answers[: len(expected)] == expected
    settled = len(memory) * 3 // 4
    print(f"{rounds} rounds, MiB: {[round(bytes_ / 2**20, 1) for bytes_ in memory]}; {threads[-1]} threads")
    assert memory[-1] < memory[settled] + 8 * 2**20, memory
    assert threads[-1] <= threads[settled], threads
    assert "unreadable" not in nodes.log("estimator").read_text()


def resident(process: int) -> int:
    """Memory of a process [bytes]."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
