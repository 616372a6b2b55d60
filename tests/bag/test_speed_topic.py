"""Which topic of a bag holds the measured speed."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import Record, RecordingError, conversion, read_recording
from tms_bag.checks import survey
from tms_bag.checks.run import onwards
from tms_bag.speed_topic import is_command

WriteBag = Callable[[Path, Sequence[Record]], Path]
USUAL = "/bicycle/speed"


@pytest.fixture
def bag_with(tmp_path: Path, run: Any, write_bag: WriteBag) -> Callable[..., Path]:
    """A bag of a run whose speeds stand under other names, the first the right ones, others 1 m/s more."""

    def write(*names: str, imu: str = "/imu/data_raw", variance: bool = False) -> Path:
        records = [replace(record, topic=imu) for record in conversion.imu_records(run.imu)]
        for number, name in enumerate(names):
            speed = replace(run.speed, speed=run.speed.speed + number)
            if variance:
                speed = replace(speed, variance=np.full(len(speed.speed), 0.04))
            make = conversion.speed_covariance_records if variance else conversion.speed_records
            records += [replace(record, topic=name) for record in make(speed)]
        return write_bag(tmp_path / "bag", records)

    return write


@pytest.mark.parametrize("variance", [False, True], ids=["twist", "twist with covariance"])
def test_a_single_topic_of_another_name_is_taken_with_a_line(
    bag_with: Callable[..., Path], run: Any, variance: bool
) -> None:
    found = read_recording(bag_with("/wheel/speed", variance=variance))
    assert found.speed is not None
    assert found.speed.speed.tolist() == run.speed.speed.tolist()
    assert np.isfinite(found.speed.variance).all() == variance
    assert found.speed_topic.name == "/wheel/speed"
    line = found.speed_topic.remark
    assert line.startswith("the speed is that of /wheel/speed, the only topic that may hold a measured one")
    assert "--speed-topic NAME" in line


def test_the_usual_name_comes_first_without_a_line(bag_with: Callable[..., Path], run: Any) -> None:
    found = read_recording(bag_with(USUAL, "/wheel/speed"))
    assert found.speed is not None
    assert found.speed.speed.tolist() == run.speed.speed.tolist()
    assert found.speed_topic.remark == ""


@pytest.mark.parametrize(
    "name", ["/cmd_vel", "/controller/speed_command", "/bike/TargetSpeed", "/belt/setpoint"]
)
def test_a_command_is_not_taken_for_the_measured_speed(bag_with: Callable[..., Path], name: str) -> None:
    path = bag_with(name)
    found = read_recording(path)
    assert found.speed is None
    assert f"{name}: a command by its name, not taken" in found.speed_topic.remark
    asked = read_recording(path, speed_topic=name)  # by choice it is
    assert asked.speed is not None
    assert asked.speed_topic.remark == ""


def test_only_the_last_part_of_a_name_makes_a_command() -> None:
    assert not is_command("/cmd_mux/wheel_speed")
    assert is_command("/wheel/cmd_vel")


def test_beside_a_command_the_measured_speed_is_the_only_one(bag_with: Callable[..., Path]) -> None:
    assert read_recording(bag_with("/wheel/speed", "/cmd_vel")).speed_topic.name == "/wheel/speed"


def test_of_several_none_is_taken_and_each_has_its_flag(bag_with: Callable[..., Path], run: Any) -> None:
    path = bag_with("/wheel/speed", "/belt/speed")
    found = read_recording(path)
    assert found.speed is None
    assert "--speed-topic /belt/speed or --speed-topic /wheel/speed" in found.speed_topic.remark
    asked = read_recording(path, speed_topic="belt/speed")
    assert asked.speed is not None
    assert np.allclose(asked.speed.speed, run.speed.speed + 1)


def test_of_several_the_one_in_the_sensors_namespace_is_taken(bag_with: Callable[..., Path]) -> None:
    path = bag_with("/one/wheel", "/two/wheel", imu="/two/imu/data_raw")
    assert read_recording(path).speed_topic.name == "/two/wheel"


def test_a_name_that_is_not_there_is_answered_with_those_that_are(bag_with: Callable[..., Path]) -> None:
    with pytest.raises(RecordingError, match="found of this type /wheel; use --speed-topic /wheel"):
        read_recording(bag_with("/wheel"), speed_topic="/nope")


def test_bag_check_looks_at_what_the_fit_takes(bag_with: Callable[..., Path]) -> None:
    one = survey(bag_with("/wheel/speed", "/cmd_vel"))
    assert one.speed_topic == "/wheel/speed"
    assert "--speed-topic" not in onwards(one)


def test_bag_check_names_the_flag_where_there_is_a_choice(bag_with: Callable[..., Path]) -> None:
    path = bag_with("/wheel/speed", "/belt/speed")
    assert "--speed-topic" in onwards(survey(path))
    assert onwards(survey(path, speed_topic="/belt/speed")).endswith("--speed-topic /belt/speed")
