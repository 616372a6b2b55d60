"""CSV logs: columns arrive in the right place, unit and sign; bad logs end in one clear text."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from tms_bag import RecordingError, read_recording
from tms_bag.logs.csv_import import import_csv, read_csv
from tms_bag.logs.mapping import adapted, load_mapping, mapping_names
from tms_model import ParameterError

HEADER = "t,roll,roll_rate,yaw_rate,v,tau,ax,ay,az,note"
MAPPING = {
    "description": "made up",
    "source": "tests",
    "bicycle": "",
    "rate": 50,
    "columns": {
        "lean": {"column": "roll", "unit": "deg", "frame": "sae"},
        "lean_rate": {"column": "roll_rate", "unit": "deg/s", "frame": "sae"},
        "yaw_rate": {"column": "yaw_rate", "unit": "rad/s", "frame": "sae"},
        "speed": {"column": "v", "unit": "km/h"},
        "steer_torque": {"column": "tau", "unit": "N m", "frame": "sae"},
        "specific_force_x": {"column": "ax", "unit": "g", "frame": "sae"},
        "specific_force_y": {"column": "ay", "unit": "m/s^2", "frame": "sae"},
        "specific_force_z": {"column": "az", "unit": "m/s^2", "frame": "sae"},
    },
}
ROWS = ["0.00,90,180,0.5,36,2,1,3,-9.8,start", "0.02,-90,-180,-0.5,18,-2,-1,-3,-9.8,?"]
LEAN_RATE = {"column": "r", "unit": "rad/s", "frame": "sae"}


def mapping(tmp_path: Path, changes: dict | None = None):
    path = tmp_path / "mine.yaml"
    document = {key: value for key, value in (MAPPING | (changes or {})).items() if value is not None}
    path.write_text(yaml.safe_dump(document))
    return load_mapping(path)


def log(tmp_path: Path, rows=ROWS, header: str = HEADER) -> Path:
    path = tmp_path / "log.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def with_frame(frame: str) -> dict:
    columns = {k: v | ({"frame": frame} if "frame" in v else {}) for k, v in MAPPING["columns"].items()}
    return {"columns": columns}


def test_values_arrive_in_si_units_and_where_they_belong(tmp_path):
    import_csv(log(tmp_path), mapping(tmp_path), tmp_path / "bag")
    recording = read_recording(tmp_path / "bag")
    # tms_msgs carry SAE signs: as in the log.
    assert recording.lean_yaw.lean == pytest.approx([math.pi / 2, -math.pi / 2])
    assert recording.lean_yaw.lean_rate == pytest.approx([math.pi, -math.pi])
    assert recording.lean_yaw.yaw_rate.tolist() == [0.5, -0.5]
    assert recording.speed.speed == pytest.approx([10.0, 5.0])
    assert recording.steer_torque.steer_torque.tolist() == [2.0, -2.0]
    # sensor_msgs/Imu is REP-103: x forward as in SAE, y left, z up. A bicycle at rest feels +g upwards.
    assert recording.imu.angular_velocity[:, 0] == pytest.approx([math.pi, -math.pi])
    assert np.isnan(recording.imu.angular_velocity[:, 1]).all()
    assert recording.imu.angular_velocity[:, 2].tolist() == [-0.5, 0.5]
    assert recording.imu.specific_force[:, 0] == pytest.approx([9.80665, -9.80665])
    assert recording.imu.specific_force[:, 1:].tolist() == [[-3.0, 9.8], [3.0, 9.8]]


def test_a_log_in_rep_103_axes_gives_the_mirrored_run(tmp_path):
    sae = read_csv(log(tmp_path), mapping(tmp_path)).columns
    rep = read_csv(log(tmp_path), mapping(tmp_path, with_frame("rep103"))).columns
    for same in ("lean", "lean_rate", "speed", "specific_force_x"):
        assert rep[same].tolist() == sae[same].tolist()
    for turned in ("yaw_rate", "steer_torque", "specific_force_y", "specific_force_z"):
        assert rep[turned].tolist() == (-sae[turned]).tolist()


def test_a_sensor_mounted_the_other_way_round(tmp_path):
    columns = {"lean_rate": {"column": "roll_rate", "unit": "rad/s", "frame": "sae", "sign": -1}}
    assert read_csv(log(tmp_path), mapping(tmp_path, {"columns": columns})).columns["lean_rate"].tolist() == [
        -180,
        180,
    ]


def test_a_gyroscope_goes_to_the_imu_alone(tmp_path):
    names = {"x": "roll_rate", "y": "yaw_rate", "z": "v"}
    columns = {
        f"angular_velocity_{axis}": {"column": name, "unit": "rad/s", "frame": "rep103"}
        for axis, name in names.items()
    }
    import_csv(log(tmp_path), mapping(tmp_path, {"columns": columns}), tmp_path / "bag")
    recording = read_recording(tmp_path / "bag")
    assert recording.imu.angular_velocity.tolist() == [[180.0, 0.5, 36.0], [-180.0, -0.5, 18.0]]
    assert recording.lean_yaw is None
    assert recording.speed is None


def test_the_rate_gives_the_times(tmp_path):
    found = read_csv(log(tmp_path), mapping(tmp_path, {"rate": 30, "start_time_ns": 5})).time_ns
    assert found.tolist() == [5, 33_333_338]
    assert read_csv(log(tmp_path), mapping(tmp_path)).time_ns.tolist() == [1_000_000_000, 1_020_000_000]


@pytest.mark.parametrize(
    ("cells", "unit", "zero", "expected"),
    [
        (("0.00", "0.02"), "s", "first_row", [1_000_000_000, 1_020_000_000]),
        (("7", "27.5"), "ms", "first_row", [1_000_000_000, 1_020_500_000]),
        # A float would have lost the nanoseconds.
        (
            ("1700000000.123456789", "1700000000.123456790"),
            "s",
            "epoch",
            [1700000000123456789, 1700000000123456790],
        ),
        (
            ("1700000000123456789", "1700000000123456790"),
            "ns",
            "epoch",
            [1700000000123456789, 1700000000123456790],
        ),
    ],
)
def test_a_time_column_gives_the_times(tmp_path, cells, unit, zero, expected):
    rows = [cell + row[4:] for cell, row in zip(cells, ROWS, strict=True)]
    clock = {"rate": None, "time": {"column": "t", "unit": unit, "zero": zero}}
    assert read_csv(log(tmp_path, rows), mapping(tmp_path, clock)).time_ns.tolist() == expected


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (("0", "0"), "line 3, column 't': expected a later time"),
        (("1", "0"), "line 3, column 't': expected a later time"),
        (("0", ""), "line 3, column 't': expected a time in s, found ''"),
        (("0", "nan"), "expected a time in s, found 'nan'"),
        (("0", "1e999999999"), "expected a time in s, found '1e999999999'"),
        (("0", "9999999999"), "expected times from 1970 to 2038"),
    ],
)
def test_times_that_do_not_increase_are_refused(tmp_path, cells, expected):
    rows = [cell + row[4:] for cell, row in zip(cells, ROWS, strict=True)]
    clock = {"rate": None, "time": {"column": "t", "unit": "s", "zero": "first_row"}}
    with pytest.raises(RecordingError, match=expected):
        read_csv(log(tmp_path, rows), mapping(tmp_path, clock))


def test_missing_columns_are_all_named_with_what_is_there_and_what_to_do(tmp_path):
    path = log(tmp_path, ["1,2"], "v,other")
    expected = (
        r"columns 'roll' \(lean\), 'roll_rate' \(lean_rate\).*found only v, other; say --column lean=NAME"
    )
    with pytest.raises(RecordingError, match=expected):
        read_csv(path, mapping(tmp_path))


def test_a_missing_time_column_is_named(tmp_path):
    clock = {"rate": None, "time": {"column": "clock", "unit": "s", "zero": "first_row"}}
    with pytest.raises(RecordingError, match=r"'clock' \(time\), found only t, roll.*own \(--mapping"):
        read_csv(log(tmp_path), mapping(tmp_path, clock))


def test_another_name_or_no_column_makes_such_a_log_work(tmp_path):
    path = log(tmp_path, ["1,2", "3,4"], "v,other")
    others = [quantity for quantity in MAPPING["columns"] if quantity not in ("lean_rate", "speed")]
    mine = adapted(mapping(tmp_path), {"lean_rate": "other"}, others)
    columns = read_csv(path, mine).columns
    assert set(columns) == {"lean_rate", "speed"}
    assert columns["lean_rate"] == pytest.approx(np.radians([2.0, 4.0]))


@pytest.mark.parametrize("cell", ["", " ", "NaN", "nan", "-nan"])
def test_a_missing_value_is_an_error_that_names_the_remedy(tmp_path, cell):
    rows = [*ROWS, f"0.04,1,{cell},0,1,0,0,0,0,", f"0.06,1,{cell},{cell},1,0,0,0,0,"]
    expected = (
        r"'roll_rate' has 2 \(first in line 4\), 'yaw_rate' has 1 \(first in line 5\); say --missing skip"
    )
    with pytest.raises(RecordingError, match=expected):
        read_csv(log(tmp_path, rows), mapping(tmp_path))


def test_rows_with_missing_values_do_not_move_the_others(tmp_path):
    rows = [ROWS[0], "0.02,,1,0,1,0,0,0,0,", "", "0.06,1", ROWS[1], "", ""]
    found = read_csv(log(tmp_path, rows), mapping(tmp_path, {"missing": "skip"}))
    assert found.blank_lines == 1
    assert found.missing["lean"] == 1
    assert found.missing["yaw_rate"] == 1
    assert ((found.time_ns - found.time_ns[0]) // 20_000_000).tolist() == [0, 1, 3, 4]
    assert np.array_equal(found.columns["yaw_rate"], [0.5, 0.0, np.nan, -0.5], equal_nan=True)


def test_a_sparse_column_does_not_thin_the_others(tmp_path):
    """A speed every fifth row, a torque every third, an IMU in all but one."""
    lines = [
        f"{n / 10},{n / 4 if n % 5 == 0 else ''},{n if n % 3 == 0 else ''}" if n != 7 else ",,7"
        for n in range(30)
    ]
    path = log(tmp_path, lines, "r,v,torque")
    mine = mapping(
        tmp_path,
        {
            "missing": "skip",
            "columns": {
                "lean_rate": LEAN_RATE,
                "speed": {"column": "v", "unit": "m/s"},
                "steer_torque": {"column": "torque", "unit": "N m", "frame": "sae"},
            },
        },
    )
    done = import_csv(path, mine, tmp_path / "bag")
    assert done.log.missing == {"lean_rate": 1, "speed": 24, "steer_torque": 19}
    recording = read_recording(tmp_path / "bag")
    assert recording.imu.angular_velocity[:, 0].tolist() == [n / 10 for n in range(30) if n != 7]
    assert recording.speed.speed.tolist() == [n / 4 for n in range(0, 30, 5)]
    assert ((recording.speed.time_ns - recording.imu.time_ns[0]) // 20_000_000).tolist() == [*range(0, 30, 5)]
    assert recording.steer_torque.steer_torque.size == 11
    assert recording.run_info.speed == 3.125  # the median of those there are


def test_blank_lines_without_a_time_column_are_told(tmp_path):
    path = log(tmp_path, ["1,2", "", "3,4"], "r,v")
    columns = {"lean_rate": LEAN_RATE, "speed": {"column": "v", "unit": "m/s"}}
    with pytest.raises(RecordingError, match=r"1 blank lines \(first in line 3\).*--missing skip"):
        read_csv(path, mapping(tmp_path, {"columns": columns}))
    timed = {"rate": None, "time": {"column": "v", "unit": "s", "zero": "first_row"}, "columns": columns}
    found = read_csv(path, mapping(tmp_path, timed))
    assert (found.time_ns.size, found.blank_lines) == (2, 1)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
def test_the_delimiter_is_found_by_the_names_of_the_columns(tmp_path, delimiter):
    names = ["r", "a;b" if delimiter == "," else "a,b", "v"]
    path = log(tmp_path, [delimiter.join("123")] * 3, delimiter.join(names))
    columns = {"lean_rate": LEAN_RATE, "speed": {"column": "v", "unit": "m/s"}}
    found = read_csv(path, mapping(tmp_path, {"columns": columns}))
    assert found.delimiter == delimiter
    assert found.columns["speed"].tolist() == [3.0] * 3


def test_a_decimal_comma_is_advised_and_then_read(tmp_path):
    path = log(tmp_path, ["0,0;1,5;2", "0,01;-,5e1;3,25"], "t;r;v")
    columns = {"lean_rate": LEAN_RATE, "speed": {"column": "v", "unit": "m/s"}}
    timed = {"rate": None, "time": {"column": "t", "unit": "s", "zero": "first_row"}, "columns": columns}
    with pytest.raises(RecordingError, match=r"found '1,5'; say --decimal , \(or decimal: ','"):
        read_csv(path, mapping(tmp_path, timed))
    found = read_csv(path, mapping(tmp_path, timed | {"decimal": ","}))
    assert found.columns["lean_rate"].tolist() == [1.5, -5.0]
    assert found.columns["speed"].tolist() == [2.0, 3.25]
    assert np.diff(found.time_ns).tolist() == [10_000_000]
    path.write_text(path.read_text().replace("3,25", "3.25"))
    with pytest.raises(RecordingError, match=r"expected a finite number, found '3.25'"):
        read_csv(path, mapping(tmp_path, timed | {"decimal": ","}))


def test_how_the_sensor_sits_gets_into_the_bag(tmp_path):
    columns = {
        f"angular_velocity_{axis}": {"column": axis, "unit": "rad/s", "frame": "rep103"} for axis in "xyz"
    }
    mine = {"columns": columns, "imu_orientation": [0.0, 0.0, 1.0, 0.0]}
    import_csv(log(tmp_path, ["1,2,3"] * 3, "x,y,z"), mapping(tmp_path, mine), tmp_path / "bag")
    recording = read_recording(tmp_path / "bag")
    assert recording.run_info.imu_orientation.tolist() == [0.0, 0.0, 1.0, 0.0]
    assert recording.imu.angular_velocity[0].tolist() == [1.0, 2.0, 3.0]


def test_an_optional_column_may_be_absent_or_empty(tmp_path):
    columns = {
        "lean_rate": LEAN_RATE,
        "speed": {"column": "v", "unit": "m/s", "optional": True},
        "lean": {"column": "l", "unit": "rad", "frame": "sae", "optional": True},
    }
    found = read_csv(
        log(tmp_path, ["1,", "2,"], "r,l"), mapping(tmp_path, {"columns": columns, "missing": "skip"})
    )
    assert set(found.columns) == {"lean_rate"}


def test_a_column_without_any_value_is_told_even_when_skipping(tmp_path):
    rows = [",,1,0,1,0,0,0,0,"] * 3
    with pytest.raises(
        RecordingError, match=r"only empty or NaN cells in the columns 'roll'; .*--without lean"
    ):
        read_csv(log(tmp_path, rows), mapping(tmp_path, {"missing": "skip"}))


@pytest.mark.parametrize(
    "cell", ["abc", "1,5".replace(",", ";"), "inf", "-Infinity", "1_000", "0x10", "--", "1e999"]
)
@pytest.mark.parametrize("missing", ["error", "skip"])
def test_a_cell_that_is_no_number_is_always_an_error(tmp_path, cell, missing):
    rows = [*ROWS, f"0.04,1,{cell},0,1,0,0,0,0,"]
    with pytest.raises(RecordingError, match="line 4, column 'roll_rate': expected a finite number, found"):
        read_csv(log(tmp_path, rows), mapping(tmp_path, {"missing": missing}))


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "found 0 columns and no rows"),
        (HEADER.encode(), "found 10 columns and no rows"),
        (HEADER.encode() + b"\n\n\n", "found 10 columns and no rows"),
        (b"\x89PNG\r\n\x1a\n" + bytes(200), "expected a CSV text"),
        (b"a,b\n1,\x00\n", "zero bytes"),
        (b"a,b\n\xff\xfe,1\n", "UTF-8, found other bytes at 4"),
        ((HEADER + "\n" + ROWS[0] + ",1\n").encode(), "line 2: expected 10 cells as in the header, found 11"),
        ((HEADER + ",v\n" + ROWS[0] + ",1\n").encode(), "found more than one v"),
        ((HEADER + "\n" + '"' + "x" * 200_000).encode(), "can't be read as CSV"),
    ],
    ids=[
        "empty",
        "header",
        "blank lines",
        "image",
        "zero bytes",
        "latin-1",
        "long row",
        "same names",
        "long cell",
    ],
)
def test_what_is_no_log_is_refused(tmp_path, content, expected):
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=expected):
        read_csv(path, mapping(tmp_path))


def test_windows_line_ends_a_byte_order_mark_and_spaces_do_no_harm(tmp_path):
    path = tmp_path / "log.csv"
    text = "\r\n".join([HEADER.replace(",", " , "), *ROWS]).replace(",", " , ")
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert read_csv(path, mapping(tmp_path)).columns["yaw_rate"].tolist() == [0.5, -0.5]


def test_another_delimiter(tmp_path):
    path = log(tmp_path, [row.replace(",", ";") for row in ROWS], HEADER.replace(",", ";"))
    assert read_csv(path, mapping(tmp_path, {"delimiter": ";"})).columns["yaw_rate"].tolist() == [0.5, -0.5]


def test_the_bag_says_where_it_comes_from(tmp_path):
    import hashlib

    path = log(tmp_path)
    mine = mapping(tmp_path, {"bicycle": "benchmark", "imu_position": [0.1, 0.2, 0.3]})
    import_csv(path, mine, tmp_path / "bag")
    recording = read_recording(tmp_path / "bag")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    info = recording.run_info
    assert (info.bicycle, info.source, info.source_sha256, info.seed, info.simulated) == (
        "benchmark",
        "log.csv, mapping mine",
        digest,
        -1,
        False,
    )
    assert info.imu_position.tolist() == [0.1, 0.2, 0.3]
    assert info.parameters["wheelbase"] == 1.02  # of the benchmark bicycle
    assert info.speed == 7.5
    assert recording.custom_data["source_sha256"] == digest
    assert recording.custom_data["configuration"] == info.configuration
    assert yaml.safe_load(info.configuration)["columns"]["speed"]["name"] == "v"


def test_an_unknown_bicycle_leaves_no_bag(tmp_path):
    with pytest.raises(ParameterError, match="unknown bicycle 'penny_farthing'"):
        import_csv(log(tmp_path), mapping(tmp_path, {"bicycle": "penny_farthing"}), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"rate": None}, "missing rate"),
        ({"source": None}, "missing source"),
        ({"colour": "red"}, "unknown colour"),
        ({"rate": 0}, "rate: expected 0.001 to 1000000 Hz, found 0"),
        ({"rate": "fast"}, "rate: expected a finite number, found 'fast'"),
        ({"time": {"column": "t", "unit": "s", "zero": "epoch"}}, "unknown rate"),
        (
            {"rate": None, "time": {"column": "t", "unit": "h", "zero": "epoch"}},
            "time.unit: expected one of s, ms, us, ns",
        ),
        ({"rate": None, "time": {"column": "t", "unit": "s"}}, "time: missing zero"),
        ({"columns": {"lean_rat": LEAN_RATE}}, "columns: unknown lean_rat; expected lean, lean_rate"),
        (
            {"columns": {"lean_rate": LEAN_RATE | {"unit": "rpm"}}},
            "unit: expected one of rad/s, deg/s, found 'rpm'",
        ),
        (
            {"columns": {"lean_rate": LEAN_RATE | {"frame": "ned"}}},
            "frame: expected one of sae, rep103, found 'ned'",
        ),
        ({"columns": {"lean_rate": LEAN_RATE | {"sign": 2}}}, "sign: expected 1 or -1, found 2"),
        ({"columns": {"lean_rate": LEAN_RATE | {"sign": True}}}, "sign: expected 1 or -1, found True"),
        ({"columns": {"lean_rate": {"column": "r", "unit": "rad/s"}}}, "missing frame"),
        ({"columns": {"speed": {"column": "v", "unit": "m/s", "frame": "sae"}}}, "unknown frame"),
        ({"columns": {"speed": {"column": "v", "unit": "m/s"}}}, "expected lean_rate or angular_velocity_x"),
        ({"columns": {"lean_rate": LEAN_RATE, "angular_velocity_x": LEAN_RATE}}, "found both; leave one"),
        ({"columns": []}, "columns: expected keys"),
        ({"start_time_ns": 0}, "start_time_ns: expected an integer from 1"),
        ({"start_time_ns": 1.5}, "start_time_ns: expected an integer"),
        ({"missing": "ignore"}, "missing: expected one of error, skip"),
        ({"delimiter": ", "}, "delimiter: expected one character"),
        ({"delimiter": "a"}, "delimiter: expected one character"),
        ({"decimal": ";"}, "decimal: expected one of ., ,"),
        ({"imu_orientation": [0, 0, 0]}, r"imu_orientation: expected a quaternion \[x, y, z, w\]"),
        ({"imu_orientation": [0, 0, 0, 2]}, "imu_orientation: expected a quaternion of length 1"),
        (
            {"imu_orientation": [0, 0, 1, 0], "columns": {"lean_rate": LEAN_RATE}},
            "rates of the bicycle, not of a sensor",
        ),
        ({"columns": {"lean_rate": LEAN_RATE | {"optional": 1}}}, "optional: expected true or false"),
        ({"imu_position": [1, 2]}, r"imu_position: expected \[x, y, z\]"),
    ],
)
def test_a_mapping_is_checked_key_by_key(tmp_path, changes, expected):
    with pytest.raises(ParameterError, match=expected):
        mapping(tmp_path, changes)


@pytest.mark.parametrize("name", ["nope", "../delft_sbw", "", "delft_sbw.yaml"])
def test_an_unknown_mapping_is_told(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ParameterError, match=r"unknown mapping|expected a readable YAML file"):
        load_mapping(name)


@pytest.mark.parametrize(("columns", "without"), [({"lean_rat": "x"}, ()), ({}, ("gear",))])
def test_an_unknown_quantity_lists_the_mapped_ones(tmp_path, columns, without):
    with pytest.raises(ParameterError, match=r"no quantity '.*'; it maps lean, lean_rate"):
        adapted(mapping(tmp_path), columns, without)


@pytest.mark.parametrize("name", mapping_names())
def test_shipped_mappings_say_where_they_come_from(name):
    shipped = load_mapping(name)
    assert len(shipped.description) > 20
    assert len(shipped.source) > 20
