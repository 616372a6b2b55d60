"""Tables for spreadsheets: what stands in them, and the way back."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from tms_bag import RecordingError, conversion, read_recording
from tms_bag.logs.csv_export import export_csv
from tms_bag.logs.csv_import import import_csv
from tms_bag.logs.mapping import load_mapping
from tms_bag.samples import SpeedSamples

BAG = "tms_bag"


def table(path, delimiter: str = ","):
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file, delimiter=delimiter)
    return header, rows


def test_a_row_for_each_stamp_a_column_for_each_number_with_its_unit(bag, run, tmp_path):
    done = export_csv(bag, tmp_path / "it.csv", ["/imu/data_raw", "/bicycle/speed"])
    header, rows = table(tmp_path / "it.csv")
    assert header[:2] == ["time [ns]", "time since start [s]"]
    assert "/imu/data_raw angular_velocity.x [rad/s]" in header
    assert "/imu/data_raw linear_acceleration.z [m/s^2]" in header
    assert not [name for name in header if "covariance" in name]
    assert done.columns == tuple(header)
    assert len(rows) == done.rows == 300  # every fifth row has a speed, too
    assert [int(row[0]) for row in rows] == run.imu.time_ns.tolist()
    assert [float(row[1]) for row in rows] == pytest.approx(np.arange(300) / 100)
    column = header.index("/imu/data_raw angular_velocity.y [rad/s]")
    assert [float(row[column]) for row in rows] == run.imu.angular_velocity[:, 1].tolist()  # to the last bit
    column = header.index("/bicycle/speed twist.linear.x [m/s]")
    assert [row[column] != "" for row in rows] == [number % 5 == 0 for number in range(300)]
    column = header.index("/imu/data_raw linear_acceleration.y [m/s^2]")
    assert rows[0][column] == ""  # NaN


def test_the_way_back(bag, run, tmp_path):
    export_csv(bag, tmp_path / "it.csv")
    done = import_csv(tmp_path / "it.csv", load_mapping("export"), tmp_path / "again")
    found, expected = read_recording(tmp_path / "again"), read_recording(bag)
    assert done.counts["/imu/data_raw"] == 300
    for name in ("angular_velocity", "specific_force", "time_ns"):
        assert np.array_equal(getattr(found.imu, name), getattr(expected.imu, name), equal_nan=True)
    assert np.array_equal(found.speed.speed, expected.speed.speed)
    assert np.array_equal(found.speed.time_ns, expected.speed.time_ns)
    assert np.array_equal(found.steer_torque.steer_torque, expected.steer_torque.steer_torque)
    lean = expected.lean_yaw.lean  # rows without stand for nothing
    assert np.array_equal(found.lean_yaw.lean, lean[np.isfinite(lean)])


def test_the_way_back_with_a_decimal_comma(bag, tmp_path, command):
    flags = ["--delimiter", ";", "--decimal", ","]
    assert command(BAG, "export", bag, "-o", tmp_path / "it.csv", *flags).code == 0
    answer = command(
        BAG, "import-csv", tmp_path / "it.csv", "--mapping", "export", "--decimal", ",", "-o", tmp_path / "b"
    )
    assert answer.code == 0
    found, expected = read_recording(tmp_path / "b"), read_recording(bag)
    assert np.array_equal(found.imu.angular_velocity, expected.imu.angular_velocity)
    assert np.array_equal(found.imu.time_ns, expected.imu.time_ns)


def test_fields_are_chosen_by_patterns_and_arrays_have_a_column_for_each_element(bag, run, tmp_path):
    export_csv(bag, tmp_path / "it.csv", ["/imu/data_raw"], ["*.x", "angular_velocity_covariance"])
    header, rows = table(tmp_path / "it.csv")
    assert len(header) == 2 + 3 + 9
    column = header.index("/imu/data_raw angular_velocity_covariance[4]")
    assert {row[column] for row in rows} == {"2e-06"}


def test_messages_of_one_topic_with_the_same_stamp_keep_a_row_each(tmp_path, write_bag):
    samples = SpeedSamples(np.array([10, 20, 20, 30]) * 10**8, np.array([1.0, 2.0, 3.0, 4.0]))
    path = write_bag(tmp_path / "bag", list(conversion.speed_records(samples)))
    export_csv(path, tmp_path / "it.csv", fields=["twist.linear.x"])
    _, rows = table(tmp_path / "it.csv")
    assert [row[2] for row in rows] == ["1.0", "2.0", "3.0", "4.0"]


def test_a_topic_that_looks_like_a_formula_is_none(tmp_path, write_bag, run):
    records = [replace(record, topic="=1+1") for record in conversion.speed_records(run.speed)]
    export_csv(write_bag(tmp_path / "bag", records), tmp_path / "it.csv")
    assert all(name.startswith(("time", "'=1+1")) for name in table(tmp_path / "it.csv")[0])


def test_a_file_that_is_there_is_kept(bag, tmp_path, refused, command):
    path = tmp_path / "it.csv"
    path.write_text("mine")
    assert "exists already" in refused(BAG, "export", bag, "-o", path)
    assert path.read_text() == "mine"
    assert command(BAG, "export", bag, "-o", path, "--force").code == 0
    assert path.read_text() != "mine"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["bag", "it.csv"]


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (["--topics", "/nope"], "no topic /nope; there are: /bicycle/speed"),
        (["--columns", "nope"], "found none of nope"),
        (["--topics", "/run_info", "--columns", "nope"], "found none of nope"),
        (["--delimiter", "."], "one character that stands in no number"),
        (["--delimiter", ",", "--decimal", ","], "one character that stands in no number"),
        (["--delimiter", ""], "one character that stands in no number"),
    ],
)
def test_what_can_not_be_written_is_told_and_leaves_nothing(bag, tmp_path, refused, flags, expected):
    assert expected in refused(BAG, "export", bag, "-o", tmp_path / "it.csv", *flags)
    assert [entry.name for entry in tmp_path.iterdir()] == ["bag"]


def test_a_place_that_can_not_be_written_is_told(bag, tmp_path):
    with pytest.raises(RecordingError, match="can't be written"):
        export_csv(bag, tmp_path / "nowhere" / "it.csv")


def test_json_says_what_was_written(bag, tmp_path, command):
    document = json.loads(command(BAG, "export", bag, "-o", tmp_path / "it.csv", "--json").out)
    assert document["rows"] == 300
    assert document["columns"][0] == "time [ns]"
