"""The nodes under the real `ros2` command: looked at, told, dumped, launched, stopped.

`ros2` isn't among ROS's wheels; a full ROS install has it on PATH.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from tms_bag import BagReader, read_recording
from tms_fit.recording_fit import bicycle_of, fit_recording
from tms_fit.settings import Settings

pytestmark = pytest.mark.skipif(
    shutil.which("ros2") is None, reason="needs the command ros2, which isn't among ROS's wheels"
)
needs_launch = pytest.mark.skipif(
    importlib.util.find_spec("ros2launch") is None, reason="needs ros2launch, which isn't among ROS's wheels"
)

DEADLINE = 120.0  # [s]; each call of ros2 starts a Python and looks for nodes
SOURCES = Path(__file__).parents[2] / "ros_ws" / "src"
OF_EVERY_NODE = ("use_sim_time", "start_type_description_service")


class Ros2:
    """The command in the test's domain."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.folder = folder
        self.has_daemon = False
        local = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self.environment = {**os.environ, **local, "ROS_LOG_DIR": str(folder / "ros_log"), "NO_COLOR": "1"}

    def __call__(self, *words: str) -> str:
        """What a command says; it must succeed."""
        done = self.run(*words)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """A command, however it ends."""
        self.has_daemon |= words[0] not in ("pkg", "interface")
        return subprocess.run(
            ["ros2", *words],
            env=self.environment,
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=DEADLINE,
            check=False,
        )

    def start(self, *words: str) -> subprocess.Popen[str]:
        """A command that goes on, in a process group as a terminal makes one."""
        return subprocess.Popen(
            ["ros2", *words],
            env=self.environment,
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def wait_for(self, text: str, *words: str) -> str:
        """Ask until the answer holds a text: what the command knows comes by and by."""
        deadline = time.monotonic() + DEADLINE
        while text not in (said := self.run(*words).stdout):
            assert time.monotonic() < deadline, f"{words}: no {text!r} in\n{said}"
        return said

    def wait_until_known(self, node: str) -> None:
        """Wait until the node, and its services, are known to the command's daemon."""
        self.wait_for(node, "node", "list")
        self.wait_for(f"{node}/set_parameters", "service", "list")


@pytest.fixture
def ros2(domain_id: int, tmp_path: Path) -> Iterator[Ros2]:
    """The command `ros2`; its daemon ends with the test."""
    command = Ros2(domain_id, tmp_path)
    yield command
    if command.has_daemon:
        command.run("daemon", "stop")


def test_packages_and_their_executables(ros2: Ros2) -> None:
    found = {
        line
        for package in ("tms_bag", "tms_sim", "tms_fit")
        for line in ros2("pkg", "executables", package).splitlines()
    }
    assert found == {"tms_bag player", "tms_bag recorder", "tms_sim simulator", "tms_fit estimator"}
    assert "<license>Apache-2.0</license>" in ros2("pkg", "xml", "tms_bag")


@pytest.mark.parametrize("path", sorted((SOURCES / "tms_msgs").glob("*/*.*")), ids=lambda path: path.name)
def test_interfaces_are_shown_with_their_comments(ros2: Ros2, path: Path) -> None:
    shown = ros2("interface", "show", f"tms_msgs/{path.parent.name}/{path.stem}")
    own = [line for line in shown.splitlines() if not line.startswith("\t")]
    assert own == path.read_text().splitlines()


def test_a_simulator_is_looked_at_told_and_struck(ros2: Ros2, nodes: Any) -> None:
    nodes.start("tms_sim", "simulator", "-p", "stay:=true", "-p", "autostart:=false")
    ros2.wait_until_known("/simulator")
    info = ros2.wait_for("/simulator/strike", "node", "info", "/simulator")
    assert "/imu/data_raw: sensor_msgs/msg/Imu" in info
    assert "Durability: TRANSIENT_LOCAL" in ros2("topic", "info", "-v", "/run_info")
    rate = ros2("param", "describe", "/simulator", "rate")
    assert all(
        text in rate for text in ("simulated seconds per real second", "Min value: 0.01", "Max value: 100.0")
    )
    assert "successful" in ros2("param", "set", "/simulator", "rate", "50.0")
    for name, value, reason in (("rate", "1000.0", "out of range"), ("seed", "4", "read-only parameter")):
        refused = ros2.run("param", "set", "/simulator", name, value)
        assert reason in refused.stdout + refused.stderr
    assert "success=True" in ros2("service", "call", "/simulator/start", "std_srvs/srv/Trigger")
    late = ros2(
        "service", "call", "/simulator/strike", "tms_msgs/srv/Strike", "{lean_rate: 0.3, time: {sec: 1000}}"
    )
    assert "expected before the run's end" in late
    (values,) = yaml.safe_load_all(
        ros2("topic", "echo", "--once", "--field", "bicycle", "/run_info").split("---")[0]
    )
    assert values == "tms_eq_10_1"


def test_what_is_dumped_makes_the_same_node_again(ros2: Ros2, nodes: Any) -> None:
    first = nodes.start(
        "tms_sim", "simulator", "-p", "stay:=true", "-p", "strike.lean_rate:=0.3", "-p", "rate:=2.5"
    )
    ros2.wait_until_known("/simulator")
    dumped = ros2("param", "dump", "/simulator")
    (ros2.folder / "mine.yaml").write_text(dumped)
    loaded = ros2.run("param", "load", "/simulator", "mine.yaml")
    assert "Set parameter rate successful" in loaded.stdout
    assert "Trying to set a read-only parameter: seed" in loaded.stdout + loaded.stderr
    nodes.stop(first)
    second = nodes.start("tms_sim", "simulator", "--params-file", str(ros2.folder / "mine.yaml"))
    ros2.wait_until_known("/simulator")
    assert yaml.safe_load(ros2("param", "dump", "/simulator")) == yaml.safe_load(dumped)
    nodes.stop(second)


def test_a_bag_is_fitted_by_an_action(ros2: Ros2, nodes: Any, bag: Path) -> None:
    nodes.start("tms_fit", "estimator", "-r", "__ns:=/lab")
    ros2.wait_until_known("/lab/estimator")
    ros2.wait_for("/lab/estimator/fit_recording", "action", "list")
    goal = (
        "action",
        "send_goal",
        "--feedback",
        "/lab/estimator/fit_recording",
        "tms_msgs/action/FitRecording",
    )
    said = ros2(*goal, f"{{bag: {bag}, bicycle: benchmark}}")
    assert "strikes: 0" in said
    assert "Goal finished with status: SUCCEEDED" in said
    said = ros2(*goal, "{bag: /nowhere}")
    assert "expected a bag (a folder) or an .mcap file, found nothing there" in said
    assert "Goal finished with status: ABORTED" in said


@pytest.mark.parametrize(
    ("package", "executable", "ready"),
    [
        ("tms_sim", "simulator", "simulating"),
        ("tms_fit", "estimator", "ready"),
        ("tms_bag", "recorder", "recording to"),
    ],
)
def test_ctrl_c_ends_a_node_that_ros2_run_started(
    ros2: Ros2, package: str, executable: str, ready: str
) -> None:
    process = ros2.start("run", package, executable)
    assert process.stdout
    said = ""
    while ready not in said:
        line = process.stdout.readline()
        assert line, said
        said += line
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to ros2 and to the node
    rest, _ = process.communicate(timeout=DEADLINE)
    assert "Traceback" not in said + rest
    assert "[ros2run]" not in rest
    assert process.returncode == 0


def launch(ros2: Ros2, file: str, *arguments: str) -> str:
    process = ros2.start("launch", str(SOURCES / file), *arguments)
    said, _ = process.communicate(timeout=DEADLINE)
    assert process.returncode == 0, said
    assert "Traceback" not in said, said
    return said


@needs_launch
def test_an_experiment_and_its_replay_are_launched(ros2: Ros2) -> None:
    (ros2.folder / "mine.yaml").write_text("/**/simulator:\n  ros__parameters:\n    duration: 5.0\n")
    common = ("namespace:=lab", "params_file:=mine.yaml")
    said = launch(ros2, "tms_study/launch/experiment.launch.py", "output:=run", "rate:=4", *common)
    assert said.count("process has finished cleanly") == 3
    recording = read_recording(ros2.folder / "run")
    assert len(recording.imu.time_ns) == 501
    assert len(fit_recording(recording, bicycle_of(recording, None), Settings()).strikes) == 1
    with BagReader(ros2.folder / "run") as reader:
        names = {topic.name for topic in reader.topics}
    assert {"/lab/estimate", "/lab/clock", "/lab/tf", "/lab/tf_static"} <= names
    assert all(name.startswith("/lab/") or name == "/diagnostics" for name in names)
    said = launch(ros2, "tms_fit/launch/replay.launch.py", "bag:=run", "rate:=100", *common)
    assert said.count("process has finished cleanly") == 2
    assert "'imu/data_raw': 501" in said  # the estimator's last words: nothing was lost


@needs_launch
def test_a_launch_ends_when_one_of_its_nodes_can_not_begin(ros2: Ros2) -> None:
    (ros2.folder / "run").mkdir()
    said = launch(ros2, "tms_study/launch/experiment.launch.py", "output:=run")
    assert "error: run: exists already" in said
    assert "was required: shutting down launched system" in said
