"""./tms bag ...: answers, and one line for bad input."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BAG = "tms_bag"
CSV = "t,lean_angle,lean_rate,speed,sil_command,y_acceleration\n" + "0,0.1,0.2,3.0,1.0,-1\n" * 3


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    path.write_text(CSV)
    return path


def test_info_as_json(command, bag, run):
    answer = command(BAG, "info", bag, "--json")
    assert answer.code == 0
    document = json.loads(answer.out)
    assert document["path"] == str(bag)
    assert document["duration"] == pytest.approx(2.99)
    assert document["message_count"] == len(run.records())
    assert {"name": "/imu/data_raw", "type": "sensor_msgs/msg/Imu", "count": 300} in document["topics"]
    assert document["metadata"]["seed"] == "1"
    assert document["metadata"]["configuration"] == run.info.configuration
    assert document["metadata"]["complete"] is True
    assert document["metadata"]["start_ns"] == run.info.start_ns


def test_info_for_people(command, bag, unfinished_bag):
    answer = command(BAG, "info", bag)
    assert "/imu/data_raw                sensor_msgs/msg/Imu                        300" in answer.out
    assert "2023-11-14T22:13:20.123+00:00" in answer.out
    assert "unfinished" not in answer.out
    assert "unfinished" in command(BAG, "info", unfinished_bag).out


def test_import_says_what_it_did_and_info_shows_it(command, log, tmp_path):
    bag = tmp_path / "bag"
    answer = command(BAG, "import-csv", log, "--mapping", "delft_sbw", "-o", bag)
    assert answer.code == 0
    first, *topics = answer.out.splitlines()
    assert first == f"{bag}: 3 rows of lean, lean_rate, speed, steer_torque, specific_force_y"
    assert [line.split() for line in topics] == [
        ["/bicycle/speed", "3"],
        ["/bicycle/steer_torque", "3"],
        ["/imu/data_raw", "3"],
        ["/imu/lean_yaw", "3"],
        ["/run_info", "1"],
    ]
    metadata = json.loads(command(BAG, "info", bag, "--json").out)["metadata"]
    assert set(metadata) == {"configuration", "seed", "version", "source_sha256", "complete", "start_ns"}


def test_import_with_another_column_without_one_and_with_rows_skipped(command, log, tmp_path):
    log.write_text("roll_rate,speed\n1,2\n,2\n3,4\n")
    flags = ["--column", "lean_rate=roll_rate", "--missing", "skip", "--bicycle", "benchmark"]
    flags += [word for name in ("lean", "steer_torque", "specific_force_y") for word in ("--without", name)]
    answer = command(BAG, "import-csv", log, "--mapping", "delft_sbw", "-o", tmp_path / "bag", *flags)
    assert ": 3 rows of lean_rate, speed\n  empty or NaN cells left out: 1 of lean_rate\n" in answer.out
    assert [line.split() for line in answer.out.splitlines()[2:4]] == [
        ["/bicycle/speed", "3"],
        ["/imu/data_raw", "2"],
    ]


def test_import_as_json(command, log, tmp_path):
    log.write_text(CSV.replace(",", ";") + "\n\n0;0.1;;3.0;1.0;-1\n")
    flags = ["--mapping", "delft_sbw", "-o", tmp_path / "bag", "--missing", "skip", "--json"]
    document = json.loads(command(BAG, "import-csv", log, *flags).out)
    assert document["rows"] == 4
    assert document["delimiter"] == ";"
    assert document["blank_lines"] == 2
    assert document["missing"] == {"lean_rate": 1}
    assert document["duration"] == pytest.approx(0.05)  # the blank lines may stand for lost rows
    assert {"name": "/bicycle/speed", "count": 4} in document["topics"]
    assert {"name": "/imu/data_raw", "count": 4} in document["topics"]  # its other columns are there


def test_a_bag_is_replaced_only_with_force(command, refused, log, bag):
    before = (bag / "metadata.yaml").read_bytes()
    assert "--force" in refused(BAG, "import-csv", log, "--mapping", "delft_sbw", "-o", bag)
    assert (bag / "metadata.yaml").read_bytes() == before
    assert command(BAG, "import-csv", log, "--mapping", "delft_sbw", "-o", bag, "--force").code == 0
    assert (bag / "metadata.yaml").read_bytes() != before


@pytest.mark.parametrize(
    ("text", "flags", "expected"),
    [
        (CSV, ["--mapping", "nope"], "unknown mapping 'nope'"),
        (CSV, ["--mapping", "delft_sbw", "--column", "lean_rate"], "--column: expected QUANTITY=NAME"),
        (CSV, ["--mapping", "delft_sbw", "--without", "gear"], "no quantity 'gear'"),
        (
            CSV,
            ["--mapping", "delft_sbw", "--without", "lean_rate"],
            "expected lean_rate or angular_velocity_x",
        ),
        (CSV, ["--mapping", "delft_sbw", "--bicycle", "nope"], "unknown bicycle 'nope'"),
        (CSV, ["--mapping", "delft_sbw", "--missing", "guess"], "invalid choice: 'guess'"),
        ("a,b\n1,2\n", ["--mapping", "delft_sbw"], "expected the columns 'lean_rate'"),
        (CSV.replace("0.2", "fast", 1), ["--mapping", "delft_sbw"], "line 2, column 'lean_rate'"),
        (CSV.replace("0.2", "", 1), ["--mapping", "delft_sbw"], "--missing skip"),
        (CSV.replace("0.2", "nan", 1), ["--mapping", "delft_sbw"], "--missing skip"),
        ("", ["--mapping", "delft_sbw"], "no rows"),
    ],
)
def test_bad_input_leaves_one_line_and_no_bag(refused, log, tmp_path, text, flags, expected):
    log.write_text(text)
    assert expected in refused(BAG, "import-csv", log, *flags, "-o", tmp_path / "out" / "bag")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.csv"]


@pytest.mark.parametrize("arguments", [["info"], ["info", "--json"], ["repair"], ["play"]])
@pytest.mark.parametrize("content", [None, b"", b"\x89MC", b"no bag", b"PK\x03\x04" + bytes(99)])
def test_a_file_that_is_no_bag_leaves_one_line(refused, tmp_path, arguments, content):
    path = tmp_path / "it.mcap"
    if content is not None:
        path.write_bytes(content)
    assert "expected" in refused(BAG, *arguments, path)


def test_repair_tells_what_it_saved(command, unfinished_bag):
    answer = command(BAG, "repair", unfinished_bag)
    assert answer.code == 0
    assert answer.out.startswith(
        f"{unfinished_bag}: 1200 messages recovered; damaged parts left out: 0;"
        " incomplete at the end: 0 bytes"
    )
    assert f"the original is {unfinished_bag}.unrepaired" in answer.out
    assert "nothing to repair" in command(BAG, "repair", unfinished_bag).out


def test_without_a_command_the_usage_is_told(refused):
    assert "the following arguments are required: command" in refused(BAG)


def test_the_package_without_its_nodes_needs_no_ros_at_run_time(tmp_path, bag):
    # Every module outside nodes/ is imported, and a bag is read, with rclpy and the message packages hidden.
    program = """
import importlib, pkgutil, sys
for name in ("rclpy", "sensor_msgs", "std_msgs", "geometry_msgs", "tms_msgs", "diagnostic_msgs"):
    sys.modules[name] = None
import tms_bag
names = [m.name for m in pkgutil.iter_modules(tms_bag.__path__) if m.name not in ("nodes", "__main__")]
for name in names:
    importlib.import_module(f"tms_bag.{name}")
print(len(names), tms_bag.read_recording(sys.argv[1]).imu.time_ns.size)
"""
    result = subprocess.run(
        [sys.executable, "-c", program, str(bag)], capture_output=True, text=True, check=True
    )
    modules, samples = map(int, result.stdout.split())
    assert modules > 15
    assert samples == 300


def test_a_sibling_log_without_the_optional_columns_says_what_it_lacks(command, tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("sil_command,speed,lean_rate\n" + "1.0,3.0,0.2\n" * 3)
    done = command("tms_bag", "import-csv", log, "--mapping", "delft_sbw", "-o", tmp_path / "bag")
    assert done.code == 0, done.err
    assert "not in this log, or empty: lean ('lean_angle'), specific_force_y ('y_acceleration')" in done.out
    flags = ("--mapping", "delft_sbw", "-o", tmp_path / "again", "--json")
    document = json.loads(command("tms_bag", "import-csv", log, *flags).out)
    assert document["absent"] == ["lean", "specific_force_y"]
