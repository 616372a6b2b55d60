"""Simulator and estimator as processes over real DDS: what they publish is what the offline tools compute."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from tms_bag import BagReader, BagWriter, Recording, read_recording, topics
from tms_bag.messages import deserialize
from tms_fit.recording_fit import bicycle_of, fit_recording
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import INPUTS, LiveFit
from tms_sim.run import SimulatedRun, simulate
from tms_sim.scenario import load_scenario


def run_of(**changes: object) -> SimulatedRun:
    scenario = load_scenario("tms_strike", changes)
    return simulate(scenario, np.random.default_rng(scenario.integer("seed")))


def write(run: SimulatedRun, path: Path) -> Recording:
    with BagWriter(path, custom_data=run.custom_data()) as bag:
        for record in run.records():
            bag.write(record, topics.QOS[record.topic.removeprefix("/")])
    return read_recording(path)


def test_simulator_at_ten_times_real_time_is_recorded_byte_for_byte(nodes: Any, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    recorder = nodes.start("tms_bag", "recorder", "-p", f"output:={bag}")
    simulator = nodes.start(
        "tms_sim", "simulator", "-p", "rate:=10.0", "-p", "seed:=5", "-p", "wait_for_subscribers:=1"
    )
    nodes.finish(simulator)
    nodes.stop(recorder)
    expected: dict[str, list[bytes]] = {}
    for record in run_of(seed=5).records():
        expected.setdefault(record.topic, []).append(record.data)
    with BagReader(bag) as reader:
        assert reader.complete
        found = {topic: [record.data for record in reader.records([topic])] for topic in expected}
        others = {entry.name for entry in reader.topics} - set(expected)
    assert {topic: len(data) for topic, data in found.items()} == {
        t: len(data) for t, data in expected.items()
    }
    assert found == expected
    assert {"/clock", "/diagnostics"} <= others


def test_replayed_bag_gives_the_estimates_of_the_offline_fit(nodes: Any, tmp_path: Path) -> None:
    recording = write(run_of(seed=6, duration=4.0), tmp_path / "bag")
    listener = nodes.start(
        "tms_bag", "recorder", "-p", f"output:={tmp_path / 'live'}", "-p", "topics:=[estimate,filter_state]"
    )
    estimator = nodes.start("tms_fit", "estimator")
    for topic in ("estimate", "filter_state"):
        nodes.wait_for("recorder", f"recording /{topic}")
    inputs = [topic for topic in INPUTS if topic not in (topics.STEER_TORQUE, topics.SPEED_COVARIANCE)]
    player = nodes.start(
        "tms_bag",
        "player",
        *("-p", f"bag:={tmp_path / 'bag'}", "-p", "rate:=4.0"),
        *("-p", f"topics:=[{','.join(inputs)}]", "-p", f"wait_for_subscriptions:={len(inputs)}"),
    )
    nodes.finish(player)
    expected = expected_messages(tmp_path / "bag")
    wanted = len(expected["/filter_state"])
    nodes.wait_until(lambda: len(recorded(tmp_path / "live", "/filter_state")) >= wanted, "all is recorded")
    nodes.stop(estimator)
    nodes.stop(listener)
    with BagReader(tmp_path / "live") as reader:
        for topic, messages in expected.items():
            assert [record.data for record in reader.records([topic])] == messages
        values = {
            message.estimator: message.values[0]
            for record in reader.records(["/estimate"])
            for message in [deserialize(record.data, "tms_msgs/msg/Estimate")]
        }
    offline = fit_recording(recording, bicycle_of(recording, None), Settings())
    assert values == {one.estimator: one.values[0] for one in offline.strikes[0].estimates}


@pytest.mark.parametrize("window", [500, 7])
@pytest.mark.long
def test_a_lossless_replay_as_fast_as_it_goes_gives_the_answer_of_the_offline_fit(
    nodes: Any, tmp_path: Path, window: int
) -> None:
    write(run_of(seed=6, duration=4.0), tmp_path / "bag")
    listener = nodes.start(
        "tms_bag", "recorder", "-p", f"output:={tmp_path / 'live'}", "-p", "topics:=[estimate,filter_state]"
    )
    estimator = nodes.start("tms_fit", "estimator", "-p", "idle:=5.0")
    for topic in ("estimate", "filter_state"):
        nodes.wait_for("recorder", f"recording /{topic}")
    parameters = [f"bag:={tmp_path / 'bag'}", "rate:=1000.0", "lossless:=true", f"window:={window}"]
    player = nodes.start("tms_bag", "player", *(word for text in parameters for word in ("-p", text)))
    nodes.finish(player)
    expected = expected_messages(tmp_path / "bag")
    nodes.wait_until(
        lambda: all(
            len(recorded(tmp_path / "live", topic)) >= len(messages) for topic, messages in expected.items()
        ),
        "all is recorded",
    )
    nodes.stop(estimator)
    nodes.stop(listener)
    assert {topic: recorded(tmp_path / "live", topic) for topic in expected} == expected


def expected_messages(bag: Path) -> dict[str, list[bytes]]:
    """What a live fit publishes when it is given the bag's messages in order, without any ROS."""
    live = LiveFit(Settings())
    expected: dict[str, list[bytes]] = {}
    with BagReader(bag) as reader:
        answers = [
            answer
            for record in reader.records()
            if record.topic.removeprefix("/") in INPUTS
            for answer in live.process(record.topic.removeprefix("/"), record.data)
        ] + live.finish()
    for answer in answers:
        expected.setdefault(answer.topic, []).append(answer.data)
    return expected


def recorded(bag: Path, topic: str) -> list[bytes]:
    """What has been recorded of a topic so far."""
    with BagReader(bag) as reader:
        there = any(one.name == topic for one in reader.topics)
        return [record.data for record in reader.records([topic])] if there else []


def test_every_sample_gets_a_filter_state(tmp_path: Path) -> None:
    run = run_of(seed=6, duration=4.0)
    write(run, tmp_path / "bag")
    assert len(expected_messages(tmp_path / "bag")["/filter_state"]) == len(run.imu.time_ns)


def test_namespace_moves_all_topics(nodes: Any, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    recorder = nodes.start("tms_bag", "recorder", "-p", f"output:={bag}")
    simulator = nodes.start(
        "tms_sim",
        "simulator",
        *("-r", "__ns:=/bike1", "-p", "rate:=10.0", "-p", "duration:=4.0", "-p", "wait_for_subscribers:=1"),
    )
    nodes.finish(simulator)
    nodes.stop(recorder)
    with BagReader(bag) as reader:
        names = {entry.name for entry in reader.topics}
    made = (topics.IMU, topics.LEAN_YAW, topics.SPEED, topics.STATE, topics.RUN_INFO)
    assert {f"/bike1/{topic}" for topic in made} <= names
    recording = read_recording(bag)
    assert len(fit_recording(recording, bicycle_of(recording, None), Settings()).strikes) == 1


def test_stamps_by_the_nodes_clock(nodes: Any, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    before = time.time_ns()
    recorder = nodes.start("tms_bag", "recorder", "-p", f"output:={bag}")
    simulator = nodes.start(
        "tms_sim",
        "simulator",
        *(
            "-p",
            "clock:=node",
            "-p",
            "duration:=1.0",
            "-p",
            "strike.time:=0.5",
            "-p",
            "wait_for_subscribers:=1",
        ),
    )
    nodes.finish(simulator)
    nodes.stop(recorder)
    stamps = read_recording(bag).imu.time_ns
    assert before < stamps[0] < time.time_ns()
    assert set(np.diff(stamps)) == {10_000_000}
    with BagReader(bag) as reader:
        assert "/clock" not in {entry.name for entry in reader.topics}


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("package", "executable", "ready"),
    [("tms_sim", "simulator", "simulating"), ("tms_fit", "estimator", "estimator ready")],
)
@pytest.mark.quick_for(how=[signal.SIGINT])
def test_signals_end_a_node_cleanly(
    nodes: Any, package: str, executable: str, ready: str, how: signal.Signals
) -> None:
    process = nodes.start(package, executable)
    nodes.wait_for(executable, ready)
    nodes.stop(process, how)
    assert "Traceback" not in nodes.log(executable).read_text()


def test_parameters_are_checked_at_run_time(nodes: Any, participant: Any) -> None:
    nodes.start("tms_sim", "simulator", "-p", "rate:=0.1", "-p", "stay:=true")

    def ask(name: str, value: float) -> tuple[bool, str]:
        wish = Parameter(
            name=name, value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        )
        request = SetParameters.Request(parameters=[wish])
        result = participant.call(SetParameters, "/simulator/set_parameters", request).results[0]
        return result.successful, result.reason

    assert ask("rate", 0.2) == (True, "")
    for name, value in (("rate", -1.0), ("rate", 1e9), ("speed", 4.0)):
        accepted, reason = ask(name, value)
        assert not accepted
        assert name in reason


@pytest.mark.parametrize(
    ("package", "executable", "parameter", "expected"),
    [
        ("tms_sim", "simulator", "scenario:=nonsense", "unknown scenario"),
        ("tms_sim", "simulator", "bicycle:=nonsense", "unknown bicycle"),
        ("tms_sim", "simulator", "speed:=0.0", "speed"),
        ("tms_sim", "simulator", "speed:=-3.0", "speed"),
        ("tms_sim", "simulator", "speed:=4", "speed"),
        ("tms_sim", "simulator", "strike.time:=9.0", "inside the record"),
        ("tms_sim", "simulator", "imu.position:=[1.0]", "three numbers"),
        ("tms_sim", "simulator", "clock:=moon", "clock"),
        ("tms_sim", "simulator", "nonsense:=1.0", "unknown parameter nonsense"),
        ("tms_fit", "estimator", "nonsense:=1.0", "unknown parameter nonsense"),
        ("tms_fit", "estimator", "bicycle:=nonsense", "unknown bicycle"),
        ("tms_fit", "estimator", "free:=[lean]", "unknown 'lean'"),
        ("tms_fit", "estimator", "window:=0.01", "window"),
        ("tms_fit", "estimator", "estimators:=[magic]", "unknown 'magic'"),
    ],
)
@pytest.mark.quick_for(parameter=["scenario:=nonsense", "nonsense:=1.0", "window:=0.01"])
def test_bad_parameters_are_one_line(
    nodes: Any, package: str, executable: str, parameter: str, expected: str
) -> None:
    process = nodes.start(package, executable, "-p", parameter)
    nodes.finish(process, 2)
    lines = nodes.log(executable).read_text().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert expected in lines[0]
