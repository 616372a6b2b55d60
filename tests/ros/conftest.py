"""Nodes as processes over real DDS, each test in a domain of its own; waiting for conditions, not times."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from ament_index_python.packages import get_package_prefix
from domain_coordinator import domain_id as unused_domain_id
from rcl_interfaces.srv import ListParameters
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from tms_bag import BagWriter, Record, conversion, topics
from tms_bag.nodes.loopback import LOOPBACK, PROFILES, stay_on_this_machine
from tms_bag.record import merged
from tms_bag.samples import ImuSamples, RunInfo, SpeedSamples

DEADLINE = 300.0  # [s]; tells what hangs from what is slow: a busy machine takes 20 s to start a node
ASK_AGAIN = 1.0  # [s]; an answer that is lost is never sent again
PERIOD = "<sec>0</sec><nanosec>100000000</nanosec>"
OFTEN = {  # additions to a profile of Fast DDS, by what they are added before
    "</builtin>": f"<discovery_config><leaseAnnouncement>{PERIOD}</leaseAnnouncement></discovery_config>",
    "</profiles>": '<data_writer profile_name="often" is_default_profile="true">'
    f"<times><heartbeatPeriod>{PERIOD}</heartbeatPeriod></times></data_writer>",
}


class Nodes:
    """Installed nodes, started as `ros2 run` starts them."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.folder = folder
        local = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self._environment = os.environ | local
        self._processes: list[subprocess.Popen[bytes]] = []
        self._newest: dict[str, subprocess.Popen[bytes]] = {}  # by executable

    def start(self, package: str, executable: str, *arguments: str) -> "subprocess.Popen[bytes]":
        """Start an executable; what it says goes to its log."""
        program = Path(get_package_prefix(package)) / "lib" / package / executable
        patience = ["-p", f"wait_timeout:={DEADLINE}"] if executable in ("player", "simulator") else []
        with self.log(executable).open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, program, "--ros-args", *patience, *arguments],
                env=self._environment,
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=self.folder,
            )
        self._processes.append(process)
        self._newest[executable] = process
        return process

    def log(self, executable: str) -> Path:
        """Where an executable's output goes."""
        return self.folder / f"{executable}.log"

    def wait_for(self, executable: str, text: str) -> None:
        """Wait until an executable has said something."""
        log = self.log(executable)

        def said() -> bool:
            ended = self._newest[executable].poll() is not None
            there = text in log.read_text()
            assert there or not ended, f"{executable} ended without saying {text!r}:\n{log.read_text()}"
            return there

        self.wait_until(said, f"{executable} says {text!r}")

    def wait_until(self, condition: Callable[[], Any], what: str) -> None:
        """Return as soon as the condition holds; fail the test if it doesn't before the deadline."""
        end = time.monotonic() + DEADLINE
        while not condition():
            assert time.monotonic() < end, f"not within {DEADLINE:g} s: {what}"
            time.sleep(0.02)

    def finish(self, process: "subprocess.Popen[bytes]", code: int = 0) -> None:
        """Wait until a process ends by itself, with an exit code."""
        assert process.wait(DEADLINE) == code

    def stop(self, process: "subprocess.Popen[bytes]", how: signal.Signals = signal.SIGINT) -> None:
        """Stop a process by a signal; it must end with exit code 0."""
        process.send_signal(how)
        self.finish(process)

    def kill_all(self) -> None:
        """End what still runs."""
        for process in self._processes:
            if process.poll() is None:
                process.kill()
                process.wait()


class Participant(Node):
    """A node inside the test."""

    def __init__(self, context: Context) -> None:
        super().__init__("test", context=context)
        self._spinner = SingleThreadedExecutor(context=context)
        self._spinner.add_node(self)
        self._reached: dict[tuple[Any, str], Any] = {}  # clients by type and name

    def spin_until(self, condition: Callable[[], Any], what: str) -> None:
        """Handle what arrives until the condition holds; fail the test if it doesn't before the deadline."""
        end = time.monotonic() + DEADLINE
        while not condition():
            assert time.monotonic() < end, f"not within {DEADLINE:g} s: {what}"
            self.spin()

    def spin(self) -> None:
        """Handle what has arrived, or wait a little for it."""
        self._spinner.spin_once(timeout_sec=0.01)

    def result(self, future: Any, what: str) -> Any:
        """The result of a future, when it is there."""
        self.spin_until(future.done, what)
        return future.result()

    def reach(self, node: str) -> None:
        """Wait until a node knows all publishers, subscriptions and clients that were made here so far.

        That they know the node does not say so: discovery goes both ways separately. A service that doesn't
        know the reader of its answer waits 0.1 s and drops it (rmw_fastrtps), and a best-effort subscription
        passes over the messages of a publisher that it doesn't know. DDS announces endpoints reliably and in
        the order of their making, so that a node that answers the latest client knows the earlier ones, too.
        """
        client = self.create_client(ListParameters, f"{node}/list_parameters")
        asked: list[Any] = []
        ask_at = 0.0

        def answered() -> bool:
            nonlocal ask_at
            if time.monotonic() >= ask_at and client.service_is_ready():
                asked.append(client.call_async(ListParameters.Request()))
                ask_at = time.monotonic() + ASK_AGAIN
            return any(future.done() for future in asked)

        self.spin_until(answered, f"{node} answers")
        self.destroy_client(client)

    def acknowledged(self, *publishers: Any) -> None:
        """Wait until all that was sent reliably has arrived."""
        for publisher in publishers:
            arrived = publisher.wait_for_all_acked(Duration(seconds=DEADLINE))
            assert arrived, f"not within {DEADLINE:g} s: {publisher.topic_name} is acknowledged"

    def client(self, kind: Any, service: str) -> Any:
        """A client of a service `NODE/NAME` that the node knows."""
        if (kind, service) not in self._reached:
            self._reached[kind, service] = client = self.create_client(kind, service)
            self.reach(service.rpartition("/")[0])
            self.spin_until(client.service_is_ready, f"{service} is there")
        return self._reached[kind, service]

    def action_client(self, kind: Any, action: str) -> Any:
        """A client of an action `NODE/NAME` that the node knows."""
        client = ActionClient(self, kind, action)
        self.reach(action.rpartition("/")[0])
        self.spin_until(client.server_is_ready, f"{action} is there")
        return client

    def call(self, kind: Any, service: str, request: Any = None) -> Any:
        """Call a service `NODE/NAME`; returns its response."""
        future = self.client(kind, service).call_async(request or kind.Request())
        return self.result(future, f"{service} answers")

    def close(self) -> None:
        """Leave the domain."""
        self._spinner.shutdown()
        self.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Any:
    """What fails shows the logs of the nodes that the test started."""
    report = yield
    folder = getattr(item, "funcargs", {}).get("tmp_path")
    if report.failed and folder:
        report.sections += [(log.name, log.read_text()) for log in sorted(folder.glob("*.log"))]
    return report


@pytest.fixture(scope="session", autouse=True)
def _interruptible() -> None:
    """A shell's background job ignores SIGINT, and so would all that these tests start."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A ROS domain that no other test uses at this time."""
    with unused_domain_id() as number:
        yield number


@pytest.fixture
def nodes(domain_id: int, tmp_path: Path) -> Iterator[Nodes]:
    """Starts nodes in the test's domain and ends them with the test."""
    these = Nodes(domain_id, tmp_path)
    yield these
    these.kill_all()


@pytest.fixture(scope="session", autouse=True)
def surroundings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment variables for a node inside the test, which calls others every 0.1 s.

    Fast DDS announces a node, and asks for acknowledgements, every 3 s; a participant that misses the first
    waits for the next. A process reads its profile once, with its first node, so that one is made here.
    """
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    stay_on_this_machine(environment)
    if PROFILES in environment:
        profile = tmp_path_factory.mktemp("profiles") / "often.xml"
        text = LOOPBACK.read_text()
        for place, addition in OFTEN.items():
            text = text.replace(place, addition + place)
        profile.write_text(text)
        environment[PROFILES] = str(profile)
    with unused_domain_id() as number, pytest.MonkeyPatch.context() as while_made:
        participant_of(number, environment, while_made).close()
    return environment


def participant_of(
    domain_id: int, surroundings: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> Participant:
    """A node made with these environment variables."""
    for name, value in surroundings.items():
        monkeypatch.setenv(name, value)
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    return Participant(context)


@pytest.fixture
def participant(domain_id: int, surroundings: dict[str, str]) -> Iterator[Participant]:
    """A node inside the test, in the test's domain."""
    with pytest.MonkeyPatch.context() as while_made:
        node = participant_of(domain_id, surroundings, while_made)
    yield node
    node.close()


def made_up_records(
    count: int = 200, rate: float = 100.0, start_ns: int = 1_700_000_000_000_000_000
) -> list[Record]:
    """Run information, IMU and (every tenth sample) speed of a run with random values."""
    rng = np.random.default_rng(count)
    time_ns = start_ns + np.rint(np.arange(count) * 1e9 / rate).astype(np.int64)
    imu = ImuSamples(time_ns, rng.normal(size=(count, 3)), rng.normal(size=(count, 3)))
    speed = SpeedSamples(time_ns[::10], rng.normal(size=time_ns[::10].size))
    info = RunInfo(start_ns, "benchmark", {"wheelbase": 1.02}, source="tests", configuration="a: 1\n")
    return list(
        merged(
            conversion.run_info_records(info), conversion.imu_records(imu), conversion.speed_records(speed)
        )
    )


@pytest.fixture
def records() -> list[Record]:
    """Two seconds of a made-up run."""
    return made_up_records()


@pytest.fixture
def make_records() -> Callable[..., list[Record]]:
    """Makes records of made-up runs."""
    return made_up_records


@pytest.fixture
def bag(tmp_path: Path, records: list[Record]) -> Path:
    """A bag with those two seconds."""
    with BagWriter(tmp_path / "bag", {"seed": "1"}) as writer:
        for record in records:
            writer.write(record, topics.QOS[record.topic.removeprefix("/")])
    return tmp_path / "bag"
