"""`sim run --blind`: nothing of the truth is in the bag, all of it is in the file beside it."""

from __future__ import annotations

import json
import shutil
import signal
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import BagReader, read_recording
from tms_sim.blind import KNOWN
from tms_sim.keys import KEYS
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario

# Numbers that can't be there by chance, for what an experimenter doesn't know.
HIDDEN: dict[str, Any] = {
    "strike.time": 3.5123456789,
    "strike.lean_rate": 0.1534567891,
    "strike.x": 0.8123456789,
    "speed_at_strike": 3.4567891234,
    "asymmetry.rear_frame": 0.000123456789,
    "shimmy.frequency": 19.123456789,
    "catch.lean_deg": 19.87654321,
    "seed": 918273645,
}
SETTINGS = [word for key, value in HIDDEN.items() for word in ("--set", f"{key}={value}")]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("made")


@pytest.fixture
def bag(command: Any, made: Path, tmp_path: Path) -> Path:
    if not any(made.iterdir()):
        done = command("tms_sim", "run", "gym_run", "-o", made / "run", "--blind", *SETTINGS)
        assert (done.code, done.out, done.err) == (0, "", "")
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return tmp_path / "run"


def every_byte(bag: Path) -> bytes:
    """The files as they are, and all that is packed in them."""
    with BagReader(bag) as reader:
        packed = [record.data + record.topic.encode() for record in reader.records()]
        packed += [json.dumps(reader.custom_data).encode()]
    return b"\n".join([path.read_bytes() for path in sorted(bag.iterdir())] + packed)


def test_no_byte_of_the_truth_is_left(bag: Path) -> None:
    with BagReader(bag) as reader:  # the definition of run_info names the topic bicycle/state in a comment
        assert not {"/bicycle/state", "/bicycle/events"} & {topic.name for topic in reader.topics}
    content = every_byte(bag)
    for word in ("gym_run", "bicycle/events", "BicycleState", "tms_msgs/msg/Event", "shimmy",
                 "steer_kick", "effects", "strike", "caught", "ended_by"):  # fmt: skip
        assert word.encode() not in content, word
    for key, value in HIDDEN.items():
        assert str(value).encode() not in content, key
        packed = struct.pack("<q", value) if isinstance(value, int) else struct.pack("<d", value)
        assert packed not in content, key


def test_no_true_angle_rate_or_place_is_left(bag: Path) -> None:
    content = every_byte(bag)
    run = simulate(load_scenario("gym_run", HIDDEN), np.random.default_rng(HIDDEN["seed"]))
    rows = np.arange(250, len(run.state.time_ns) - 60, 50)
    state = run.state
    hidden = [state.state[:, 1], state.state[:, 2], state.yaw, state.speed, state.yaw_rate]
    for values in (*(column[rows] for column in hidden), state.front_contact[rows, 1]):
        for value in values.tolist():
            assert struct.pack("<d", value) not in content


def test_truth_beside_the_bag_is_whole(bag: Path) -> None:
    document = json.loads(bag.with_name("run.truth.json").read_text())
    run = simulate(load_scenario("gym_run", HIDDEN), np.random.default_rng(HIDDEN["seed"]))
    assert document["scenario"] == "gym_run"
    assert document["seed"] == HIDDEN["seed"]
    assert set(document["configuration"]) == set(KEYS)
    assert all(document["configuration"][key] == value for key, value in HIDDEN.items())
    assert [event["kind"] for event in document["events"]] == [event.kind for event in run.events]
    np.testing.assert_array_equal(document["state"]["steer_rate"], run.state.state[:, 3])
    np.testing.assert_array_equal(document["state"]["rear_contact"], run.state.rear_contact)
    np.testing.assert_array_equal(document["state"]["phase"], run.state.phase)
    assert not list(bag.parent.glob("*.part"))


def test_what_the_sensors_say_is_the_same(bag: Path, command: Any, tmp_path: Path) -> None:
    command("tms_sim", "run", "gym_run", "-o", tmp_path / "seen", *SETTINGS)
    blind, seen = read_recording(bag), read_recording(tmp_path / "seen")
    np.testing.assert_array_equal(blind.imu.angular_velocity, seen.imu.angular_velocity)
    np.testing.assert_array_equal(blind.imu.specific_force, seen.imu.specific_force)
    assert blind.state is None
    assert seen.state is not None
    assert blind.run_info is not None
    assert seen.run_info is not None
    assert blind.run_info.parameters == seen.run_info.parameters  # of the bicycle as it was built
    np.testing.assert_array_equal(blind.run_info.imu_position, seen.run_info.imu_position)
    assert blind.run_info.seed == -1
    assert np.isnan(blind.run_info.speed)
    assert set(blind.custom_data) == {"configuration", "source", "version"}


def test_what_is_known_are_keys_that_say_nothing_of_the_motion() -> None:
    assert set(KNOWN) <= set(KEYS)
    assert not any(key.startswith(("strike", "effects", "shimmy", "asymmetry", "release")) for key in KNOWN)


def test_an_old_truth_is_not_left_beside_a_new_bag(bag: Path, command: Any, refused: Any) -> None:
    truth = bag.with_name("run.truth.json")
    assert "exists already" in refused("tms_sim", "run", "gym_run", "-o", bag, "--blind")
    moved = bag.rename(bag.with_name("other"))
    assert "run.truth.json: exists already" in refused("tms_sim", "run", "gym_run", "-o", bag)
    assert truth.exists()
    assert not bag.exists()
    moved.rename(bag)
    assert command("tms_sim", "run", "gym_run", "-o", bag, "--force").code == 0
    assert not truth.exists()


# Ends the process right before the n-th name of the run on the disk is changed, as a power failure would.
KILLED = """
import os, signal, sys
left = [int(sys.argv.pop(1))]
def look(event, arguments):
    if event in ("os.rename", "os.remove") and "run" in os.path.basename(arguments[0]):
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(look)
from tms_sim.__main__ import main
main(sys.argv[1:])
"""
SHORT: dict[str, Any] = {"duration": 2.0, "strike.time": 1.0}


# 0: before the old bag is put away; 1: before its truth is replaced or removed; 2: before the new bag gets
# its name; 3: after that.
@pytest.mark.parametrize("steps", range(4))
@pytest.mark.parametrize("replacing", [(), ("--blind",)], ids=["by a run with its truth", "by a blind run"])
@pytest.mark.quick_for(steps=[2])
def test_a_kill_at_any_time_leaves_no_blind_bag_without_its_truth(
    steps: int, replacing: tuple[str, ...], command: Any, tmp_path: Path
) -> None:
    bag, truth = tmp_path / "run", tmp_path / "run.truth.json"
    short = ["tms_strike", *(word for key, value in SHORT.items() for word in ("--set", f"{key}={value}"))]
    assert command("tms_sim", "run", *short, "-o", bag, "--blind", "--seed", "1").code == 0
    again = ["run", *short, "-o", str(bag), "--seed", "2", "--force", *replacing]
    killed = subprocess.run([sys.executable, "-B", "-c", KILLED, str(steps), *again], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert bag.exists() == (steps in (0, 3))
    if bag.exists():
        found = read_recording(bag)
        blind = "seed" not in found.custom_data
        assert blind == (steps == 0 or bool(replacing))
        assert truth.exists() == blind
        seed = json.loads(truth.read_text())["seed"] if blind else 2
        run = simulate(load_scenario("tms_strike", SHORT), np.random.default_rng(seed))
        np.testing.assert_array_equal(found.imu.angular_velocity, run.imu.angular_velocity)
