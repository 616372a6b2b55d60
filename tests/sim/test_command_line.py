"""`tms sim`: the same samples as in memory, the same bytes every time, refusals that leave nothing behind."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import BagReader, Record, read_recording
from tms_bag.samples import in_time_order
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario, scenario_names

DIGEST = """
import hashlib, sys
import numpy as np
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario
scenario = load_scenario(sys.argv[1], {"seed": int(sys.argv[2])})
run = simulate(scenario, np.random.default_rng(scenario.integer("seed")))
digest = hashlib.sha256(repr(sorted(run.custom_data().items())).encode())
for record in run.records():
    digest.update(f"{record.topic} {record.type} {record.time_ns} {record.publish_time_ns}".encode() +
    record.data)
print(digest.hexdigest())
"""


def digest(name: str, seed: int, hash_seed: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", DIGEST, name, str(seed)],
        env={**os.environ, "PYTHONHASHSEED": hash_seed},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_same_seed_same_bytes_in_any_process() -> None:
    first, again, other = (
        digest("delft_push", 3, "1"),
        digest("delft_push", 3, "2"),
        digest("delft_push", 4, "1"),
    )
    assert first == again
    assert first != other


@pytest.mark.parametrize("name", scenario_names())
@pytest.mark.quick_for(name=["tms_strike", "gym_run", "delft_push"])
def test_bag_holds_what_simulate_says(command: Any, tmp_path: Path, name: str) -> None:
    bag = tmp_path / "bag"
    scenario = load_scenario(name)
    count = len(scenario.numbers("strike.time"))
    time = [scenario.number("run_up.duration") + 1.3 + 1.5 * number for number in range(count)]
    changes = {"seed": 11, "strike.time": time}
    done = command("tms_sim", "run", name, "-o", bag, "--seed", 11, "--set", f"strike.time={time}")
    assert (done.code, done.out, done.err) == (0, "", "")
    result = simulate(load_scenario(name, changes), np.random.default_rng(11))
    with BagReader(bag) as reader:
        assert reader.custom_data == result.custom_data()
        assert list(reader.records()) == list(result.records())
    recording = read_recording(bag)
    imu, lean_yaw = in_time_order(result.imu)[0], in_time_order(result.lean_yaw)[0]  # as they're read
    np.testing.assert_array_equal(recording.imu.angular_velocity, imu.angular_velocity)
    np.testing.assert_array_equal(recording.imu.specific_force, imu.specific_force)
    np.testing.assert_array_equal(recording.imu.time_ns, imu.time_ns)
    assert recording.lean_yaw is not None
    np.testing.assert_array_equal(recording.lean_yaw.saturation, lean_yaw.saturation)
    assert recording.state is not None
    np.testing.assert_array_equal(recording.state.state, result.state.state)


def test_records_come_in_the_order_of_their_time() -> None:
    scenario = load_scenario("delft_push")
    records = list(simulate(scenario, np.random.default_rng(1)).records())
    assert [record.time_ns for record in records] == sorted(record.time_ns for record in records)
    assert records[0].topic == "/run_info"
    assert all(isinstance(record, Record) for record in records)
    assert [record.topic for record in records].count("/run_info") == 1


def test_same_files_twice(command: Any, tmp_path: Path) -> None:
    sums = []
    for folder in ("a", "b"):
        assert command("tms_sim", "run", "tms_strike", "-o", tmp_path / folder / "bag").code == 0
        files = sorted((tmp_path / folder / "bag").iterdir())
        sums.append([(path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in files])
    assert sums[0] == sums[1]
    assert len(sums[0]) == 2


def test_force_replaces_a_bag(command: Any, refused: Any, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    command("tms_sim", "run", "tms_strike", "-o", bag, "--seed", 1)
    assert "exists already" in refused("tms_sim", "run", "tms_strike", "-o", bag, "--seed", 2)
    with BagReader(bag) as reader:
        assert reader.custom_data["seed"] == "1"
    assert command("tms_sim", "run", "tms_strike", "-o", bag, "--seed", 2, "--force").code == 0
    with BagReader(bag) as reader:
        assert reader.custom_data["seed"] == "2"


def test_fall_is_told(command: Any, tmp_path: Path) -> None:
    done = command("tms_sim", "run", "tms_strike", "-o", tmp_path / "bag", "--set", "speed=1.5")
    assert done.code == 0
    assert done.err.startswith("the bicycle falls ")
    assert done.err.count("\n") == 1


def test_list(command: Any) -> None:
    done = command("tms_sim", "list", "--json")
    assert [entry["name"] for entry in json.loads(done.out)["scenarios"]] == scenario_names()
    assert [line.split()[0] for line in command("tms_sim", "list").out.splitlines()] == scenario_names()


REFUSED = {
    "unknown scenario": (["moon"], "unknown scenario 'moon': expected one of"),
    "missing file": (["moon.yaml"], "moon.yaml: expected a readable YAML file"),
    "unknown bicycle": (["tms_strike", "--set", "bicycle=tandem"], "unknown bicycle 'tandem'"),
    "unknown sensor": (["tms_strike", "--set", "imu.grade=best"], "imu.grade: unknown sensor 'best'"),
    "unknown key": (["tms_strike", "--set", "wind=3"], "unknown key 'wind'"),
    "speed zero": (["tms_strike", "--set", "speed=0"], "speed: expected"),
    "speed negative": (["tms_strike", "--set", "speed=-3.6"], "found -3.6"),
    "speed in words": (["tms_strike", "--set", "speed=fast"], "found 'fast'"),
    "strike after the end": (
        ["tms_strike", "--set", "strike.time=9"],
        "strike.time: expected a strike inside",
    ),
    "strike before the start": (["tms_strike", "--set", "strike.time=-1"], "strike.time: expected"),
    "no value": (["tms_strike", "--set", "speed"], "--set: expected KEY=VALUE, found 'speed'"),
    "broken value": (["tms_strike", "--set", "speed=["], "--set: expected KEY=VALUE"),
    "place of two numbers": (["tms_strike", "--set", "imu.position=[0, 1]"], "three numbers"),
    "negative seed": (["tms_strike", "--seed", "-1"], "seed: expected"),
    "seed in words": (["tms_strike", "--seed", "lucky"], "--seed"),
    "stamp beyond ROS": (
        ["tms_strike", "--set", "start_time_ns=4000000000000000000"],
        "start_time_ns: expected",
    ),
    "no time": (["tms_strike", "--set", "start_time_ns=0"], "ROS takes 0 for 'no time'"),
    "no scenario": ([], "required"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input(refused: Any, case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arguments, said = REFUSED[case]
    assert said in refused("tms_sim", "run", *arguments, "-o", "deep/bag")
    assert list(tmp_path.iterdir()) == []


def test_place_that_is_no_folder(refused: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    assert "file/bag" in refused("tms_sim", "run", "tms_strike", "-o", tmp_path / "file" / "bag")
    assert (tmp_path / "file").read_text() == "mine"
    assert "exists already" in refused("tms_sim", "run", "tms_strike", "-o", tmp_path / "file")
    assert (tmp_path / "file").read_text() == "mine"


def test_as_a_process(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tms_sim", "run", "tms_strike", "-o", "bag"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
