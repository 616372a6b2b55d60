"""Every check finds the fault it is for, in a simulated bag with that fault, and nothing in one without."""

import dataclasses
import json
import math
import shlex
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from tms_bag import BagReader, Record, conversion, read_recording, topics
from tms_bag.checks import CHECKS, ERROR, NOTE, SEVERITIES, WARNING, findings, survey
from tms_bag.checks.mounting import aligned
from tms_bag.checks.poses import RestPose, direction
from tms_bag.checks.sensor import at_rest
from tms_bag.messages import deserialize, serialize
from tms_bag.samples import ImuSamples, RunInfo, SpeedSamples, selected
from tms_model.frames import quaternion, rotation_matrix

ROOT = Path(__file__).resolve().parents[2]
BAG = "tms_bag"


@dataclasses.dataclass(frozen=True)
class Run:
    """The parts of a bag that a fault changes."""

    imu: ImuSamples
    speed: SpeedSamples | None
    info: RunInfo | None

    def records(self) -> list[Record]:
        records = list(conversion.imu_records(self.imu))
        records += conversion.speed_records(self.speed) if self.speed else []
        records += conversion.run_info_records(self.info) if self.info else []
        return sorted(records, key=lambda record: record.time_ns)

    def with_imu(self, **changes) -> "Run":
        return replace(self, imu=replace(self.imu, **changes))


@pytest.fixture(scope="module")
def clean() -> Run:
    """A bag of the project, 100 s later: stamps must not go below 0."""
    recording = read_recording(ROOT / "bags" / "tms_strike")
    later = 100 * 10**9
    return Run(
        replace(recording.imu, time_ns=recording.imu.time_ns + later),
        replace(recording.speed, time_ns=recording.speed.time_ns + later),
        replace(recording.run_info, start_ns=recording.run_info.start_ns + later),
    )


def clipped(run: Run) -> Run:
    return run.with_imu(angular_velocity=np.clip(run.imu.angular_velocity, -0.1, 0.1))


def with_offset(run: Run, offset: float) -> Run:
    rates = run.imu.angular_velocity.copy()
    rates[:, 0] += offset
    return run.with_imu(angular_velocity=rates)


def turned(run: Run, *angles: float) -> Run:
    """The sensor turned without anybody saying so."""
    matrix = rotation_matrix(quaternion(*angles))
    return run.with_imu(
        angular_velocity=run.imu.angular_velocity @ matrix, specific_force=run.imu.specific_force @ matrix
    )


def at_times(run: Run, change: Callable[[np.ndarray], np.ndarray]) -> Run:
    return run.with_imu(time_ns=change(run.imu.time_ns))


def without(run: Run, rows: slice) -> Run:
    kept = np.ones(run.imu.time_ns.size, bool)
    kept[rows] = False
    return replace(run, imu=selected(run.imu, kept))


def speed_of(run: Run, change: Callable[[np.ndarray], np.ndarray]) -> Run:
    return replace(run, speed=replace(run.speed, speed=change(run.speed.speed)))


def renamed(records: list[Record], names: dict[str, str]) -> list[Record]:
    return [replace(record, topic=names.get(record.topic, record.topic)) for record in records]


def restamped(
    records: list[Record], stamp: Callable[[int, int], int], frame: str | None = None
) -> list[Record]:
    """IMU messages whose stamps say something else than when they were recorded."""
    out, number = [], 0
    for record in records:
        if record.topic == "/imu/data_raw":
            message = deserialize(record.data, record.type)
            header = message.header
            header.stamp.sec, header.stamp.nanosec = divmod(stamp(record.time_ns, number), 10**9)
            if frame and number % 2:
                header.frame_id = frame
            number += 1
            record = replace(record, data=serialize(message))
        out.append(record)
    return out


def noise(run: Run) -> Run:
    rng = np.random.default_rng(1)
    return run.with_imu(angular_velocity=rng.normal(0.0, 0.05, run.imu.angular_velocity.shape))


def even(time_ns: np.ndarray, step_ns: int) -> np.ndarray:
    return time_ns[0] + step_ns * np.arange(time_ns.size)


def jittered(time_ns: np.ndarray) -> np.ndarray:
    return time_ns + np.random.default_rng(2).integers(0, 9_000_000, time_ns.size)


def resting(run: Run) -> Run:
    """Three seconds of rest before the run, with a bias."""
    count = 300
    rng = np.random.default_rng(3)
    rates = rng.normal([0.03, 0.0, 0.0], 0.001, (count, 3))
    force = rng.normal([0.0, 0.0, 9.81], 0.01, (count, 3))
    time = run.imu.time_ns[0] - 10_000_000 * np.arange(count, 0, -1)
    speed = SpeedSamples(
        np.concatenate([time[::2], run.speed.time_ns]),
        np.concatenate([np.zeros(count // 2), run.speed.speed]),
    )
    imu = run.imu
    return Run(
        ImuSamples(
            np.concatenate([time, imu.time_ns]),
            np.concatenate([rates, imu.angular_velocity]),
            np.concatenate([force, imu.specific_force]),
        ),
        speed,
        run.info,
    )


# Check -> how to make a bag with its fault, and how grave that is.
FAULTS: dict[str, list[tuple[Callable[[Run], Run | list[Record]], str]]] = {
    "unreadable": [
        (
            lambda run: [
                replace(record, data=record.data[:50]) if record.topic == "/imu/data_raw" else record
                for record in run.records()
            ],
            WARNING,
        )
    ],
    "no_imu": [
        (lambda run: list(conversion.speed_records(run.speed)), ERROR),
        (lambda run: renamed(run.records(), {"/imu/data_raw": "/xsens/imu"}), NOTE),
    ],
    "no_bicycle": [(lambda run: replace(run, info=None), NOTE)],
    "no_speed": [
        (lambda run: replace(run, speed=None), NOTE),
        (lambda run: replace(run, speed=None, info=None), ERROR),
    ],
    "speed_topic": [
        (lambda run: renamed(run.records(), {"/bicycle/speed": "/wheel/speed"}), NOTE),
        (lambda run: renamed(run.records(), {"/bicycle/speed": "/cmd_vel"}), NOTE),
        (
            lambda run: [
                *renamed(run.records(), {"/bicycle/speed": "/wheel/speed"}),
                *renamed(conversion.speed_records(run.speed), {"/bicycle/speed": "/belt/speed"}),
            ],
            ERROR,
        ),
    ],
    "speed_values": [
        (lambda run: speed_of(run, lambda speed: 0.0 * speed), ERROR),
        (lambda run: speed_of(run, lambda speed: -speed), ERROR),
        (lambda run: speed_of(run, lambda speed: 3.6 * speed), WARNING),
        (lambda run: speed_of(run, lambda speed: speed * np.linspace(0.5, 1.5, speed.size)), NOTE),
    ],
    "mixed_frames": [(lambda run: restamped(run.records(), lambda time, _: time, "other"), WARNING)],
    "too_short": [(lambda run: without(run, slice(150, None)), ERROR)],
    "no_push": [(noise, WARNING)],
    "unstamped": [(lambda run: restamped(run.records(), lambda *_: 0), ERROR)],
    "rate": [
        (lambda run: at_times(run, lambda time: even(time, 50_000_000)), WARNING),
        (lambda run: at_times(run, lambda time: even(time, 1_000_000)), WARNING),
    ],
    "gaps": [
        (lambda run: without(run, slice(300, 330)), WARNING),
        (lambda run: without(run, slice(300, 500)), ERROR),
    ],
    "jitter": [(lambda run: at_times(run, jittered), WARNING)],
    "duplicates": [
        (
            lambda run: restamped(run.records(), lambda time, number: time - 10**7 * (number == 9)),
            NOTE,
        ),
        (lambda run: restamped(run.records(), lambda time, number: time - time % 20_000_000), WARNING),
    ],
    "out_of_order": [
        (
            lambda run: restamped(
                run.records(), lambda time, number: time - 33_000_000 * (number % 50 == 49)
            ),
            NOTE,
        )
    ],
    "clock_jumps": [
        (lambda run: restamped(run.records(), lambda time, number: time - 5 * 10**9 * (number > 400)), ERROR),
        (
            lambda run: restamped(run.records(), lambda time, number: time + 3600 * 10**9 * (number > 400)),
            ERROR,
        ),
    ],
    "clock_offset": [
        (lambda run: restamped(run.records(), lambda time, _: time + 3600 * 10**9), ERROR),
    ],
    "no_gyroscope": [
        (lambda run: run.with_imu(angular_velocity=np.nan * run.imu.angular_velocity), ERROR),
        (
            lambda run: run.with_imu(
                angular_velocity=np.where(
                    np.arange(run.imu.time_ns.size)[:, None] == 77, np.nan, run.imu.angular_velocity
                )
            ),
            WARNING,
        ),
    ],
    "dead_axis": [
        (lambda run: run.with_imu(angular_velocity=run.imu.angular_velocity * [1.0, 0.0, 1.0]), WARNING)
    ],
    "saturation": [(clipped, WARNING)],
    "force_units": [
        (lambda run: run.with_imu(specific_force=run.imu.specific_force / 9.81), ERROR),
        (lambda run: run.with_imu(specific_force=run.imu.specific_force * 1000 / 9.81), ERROR),
        (lambda run: run.with_imu(specific_force=run.imu.specific_force * 1.1), WARNING),
        (lambda run: run.with_imu(specific_force=run.imu.specific_force - [0, 0, 9.81]), WARNING),
    ],
    "rate_units": [(lambda run: run.with_imu(angular_velocity=np.degrees(run.imu.angular_velocity)), ERROR)],
    "gyro_bias": [(resting, WARNING), (lambda run: with_offset(run, 0.3), WARNING)],
    "gravity_direction": [
        (lambda run: run.with_imu(specific_force=-run.imu.specific_force), ERROR),
        (lambda run: turned(run, 0.0, math.pi / 2, 0.0), ERROR),
        (lambda run: turned(run, math.pi, 0.0, 0.0), ERROR),
        (lambda run: turned(run, math.radians(12.0), 0.0, 0.0), WARNING),
    ],
    "strike_axis": [
        (lambda run: turned(run, 0.0, 0.0, math.pi / 2), ERROR),
        (lambda run: turned(run, 0.0, 0.0, math.pi), ERROR),
        (lambda run: turned(run, 0.0, math.pi / 2, math.pi / 2), ERROR),
    ],
}
NEED_MORE = {"unfinished", "alignment"}  # tested below


def test_every_check_has_a_fault() -> None:
    assert set(FAULTS) | NEED_MORE == set(CHECKS)


@pytest.fixture
def bag_of(tmp_path, write_bag) -> Callable[[object], Path]:
    def make(run: object) -> Path:
        return write_bag(tmp_path / "bag", run.records() if isinstance(run, Run) else run)

    return make


def test_nothing_is_found_in_a_clean_bag(clean, bag_of):
    assert findings(survey(bag_of(clean))) == []


@pytest.mark.parametrize("name", ["tms_strike", "benchmark_strike", "delft_push"])
def test_nothing_is_found_in_the_bags_of_the_project(name):
    assert findings(survey(ROOT / "bags" / name)) == []


@pytest.mark.parametrize(
    ("name", "number"), [(name, n) for name, faults in FAULTS.items() for n in range(len(faults))]
)
def test_a_fault_is_found_and_told_whole(clean, bag_of, name, number):
    fault, severity = FAULTS[name][number]
    found = [finding for check, finding in findings(survey(bag_of(fault(clean)))) if check == name]
    assert found
    assert found[0].severity == severity, found[0]
    for finding in found:
        for text in (finding.evidence, finding.consequence, finding.remedy):
            assert len(text) > 6
            assert "  " not in text
        assert name == "no_gyroscope" or "nan" not in finding.evidence
        json.dumps(finding.values, allow_nan=False)


@pytest.mark.parametrize(
    ("name", "number", "others"),
    [
        ("force_units", 0, set()),
        ("rate_units", 0, set()),
        ("gaps", 0, set()),
        ("clock_offset", 0, set()),
        ("speed_values", 2, set()),
        ("saturation", 0, set()),
        ("gyro_bias", 0, set()),
        ("gravity_direction", 1, set()),
        ("gravity_direction", 2, set()),
        ("gravity_direction", 3, set()),
        ("strike_axis", 0, set()),
        ("strike_axis", 1, set()),
        ("strike_axis", 2, {"gravity_direction"}),
    ],
)
def test_a_fault_is_not_taken_for_another(clean, bag_of, name, number, others):
    names = {check for check, _ in findings(survey(bag_of(FAULTS[name][number][0](clean))))}
    assert names == {name} | others


def test_a_command_that_is_offered_is_one_that_exists(clean, bag_of):
    """Its words are parsed by the program they are for, placeholders filled in."""
    commands = set()
    for faults in FAULTS.values():
        for fault, _ in faults:
            path = bag_of(fault(clean))
            commands |= {finding.command for _, finding in findings(survey(path)) if finding.command}
            for file in path.iterdir():
                file.unlink()
            path.rmdir()
    assert len(commands) > 6
    program = """
import json, sys
from tms_bag.cli import _parser as bag
from tms_fit.cli import _parser as fit
parsers = {"bag": bag(), "fit": fit({})}
for name, *words in json.load(sys.stdin):
    parsers[name].parse_args(words)
"""
    words = [shlex.split(command.replace("speed=V", "speed=4.5"))[1:] for command in commands]
    done = subprocess.run(
        [sys.executable, "-c", program], input=json.dumps(words), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_evidence_carries_the_size_of_the_fault(clean, bag_of):
    found = dict(findings(survey(bag_of(without(clean, slice(300, 330))))))
    assert found["gaps"].values == {"gaps": 1, "missing": 30, "longest": pytest.approx(0.31)}
    assert "2.99 s after the first message" in found["gaps"].evidence


def test_a_stamp_decades_before_the_others_costs_no_memory(bag_of, clean: Run) -> None:
    def early(time_ns: np.ndarray) -> np.ndarray:
        return np.concatenate([time_ns[:1], time_ns[1:] + 1_700_000_000 * 10**9])

    found = survey(bag_of(at_times(clean, early)))
    tracemalloc.start()
    findings(found)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100 * 2**20


def test_a_bias_at_rest_is_measured(clean, bag_of):
    seen = survey(bag_of(resting(clean)))
    assert 200 <= np.count_nonzero(at_rest(seen)) <= 300
    (finding,) = [finding for name, finding in findings(seen) if name == "gyro_bias"]
    assert finding.values["bias"] == pytest.approx([0.03, 0.0, 0.0], abs=3e-4)


def test_rest_is_not_seen_while_the_bicycle_rolls_smoothly(clean, bag_of):
    rng = np.random.default_rng(1)
    still = clean.with_imu(
        angular_velocity=rng.normal(0.0, 1e-3, clean.imu.angular_velocity.shape),
        specific_force=rng.normal([0, 0, 9.81], 0.01, clean.imu.specific_force.shape),
    )
    assert not at_rest(survey(bag_of(still))).any()  # the speed says that it moves


def test_a_bag_that_was_cut_short_is_told(bag, tmp_path, command):
    path = tmp_path / "cut.mcap"
    content = next(bag.glob("*.mcap")).read_bytes()
    path.write_bytes(content[: len(content) - 300])
    found = json.loads(command(BAG, "check", path, "--json").out)["findings"]
    (finding,) = [finding for finding in found if finding["check"] == "unfinished"]
    assert "cut short" in finding["evidence"]
    assert finding["command"] == f"./tms bag repair {path} -o NEW"


# Alignment


@pytest.mark.parametrize(
    "angles", [(0.0, 0.0, 0.0), (0.3, -0.2, 1.0), (math.pi / 2, 0.0, math.pi / 2), (3.1, 0.1, -2.0)]
)
@pytest.mark.parametrize(
    "ups", [("z", "x"), ("z", "x", "y"), ("-x", "y", "z"), ("x", "-x", "y", "-y", "z", "-z")]
)
def test_the_mounting_is_found_from_poses(angles, ups):
    turn = quaternion(*angles)
    poses = [RestPose(up, 9.81 * rotation_matrix(turn).T @ direction(up), up) for up in ups]
    found = aligned(poses)
    assert abs(found.quaternion @ turn) == pytest.approx(1.0)
    assert found.misfit == pytest.approx(0.0, abs=1e-7)
    assert found.complete
    assert not found.mirrored


def test_one_direction_leaves_the_heading_open():
    assert not aligned([RestPose("z", np.array([0.0, 0.0, 9.8]), "a")]).complete
    assert not aligned([RestPose(up, 9.8 * direction(up), up) for up in ("z", "-z")]).complete


@pytest.mark.parametrize("flip", [[-1, 1, 1], [-1, -1, -1]])
def test_a_mirrored_sensor_is_known_by_three_poses(flip):
    poses = [RestPose(up, 9.8 * direction(up) * flip, up) for up in "xyz"]
    assert aligned(poses).mirrored


def test_the_poses_of_the_delft_bicycle_tell_how_its_sensor_sits(delft_data, bag, command):
    """The logs are named after the bicycle's SAE axis along which gravity points: -z, x and -y point up."""
    flags = []
    for up, name in (
        ("z", "Flat_on_ground_gravityZ.log"),
        ("x", "against_the_wall_gravity-X.log"),
        ("y", "hanging_parallel_groundY.log"),
    ):
        flags += ["--rest-pose", f"{up}={delft_data / name}"]
    found = json.loads(command(BAG, "check", bag, "--json", *flags).out)["findings"]
    scale, mounting = [finding for finding in found if finding["check"] == "alignment"]
    assert mounting["severity"] == NOTE
    matrix = rotation_matrix(np.array(mounting["values"]["imu_orientation"]))
    assert np.rint(matrix).tolist() == [[0, 0, 1], [0, -1, 0], [1, 0, 0]]  # x up, y to the right, z forward
    assert np.degrees(np.max(mounting["values"]["misfit"])) < 2.0
    assert "2.6 %" in scale["consequence"]


@pytest.mark.parametrize(
    ("text", "content", "expected"),
    [
        ("z", "", "expected AXIS=BAG_OR_LOG"),
        ("w=pose.csv", "", "expected AXIS=BAG_OR_LOG"),
        ("zz=pose.csv", "", "expected AXIS=BAG_OR_LOG"),
        ("z=nowhere.csv", "", "nothing there"),
        ("z=pose.csv", "", "three columns of an accelerometer"),
        ("z=pose.csv", "t,v\n1,2\n", "three columns of an accelerometer"),
        ("z=pose.csv", "acc_x,acc_y,acc_z\n" + "0,0,9.8\n" * 3, "10 or more readings"),
        ("z=pose.csv", "acc_x,acc_y,acc_z\n" + "0,0,0\n" * 30, "gravity in the readings"),
        ("z=pose.csv", "acc_x,acc_y,acc_z\n" + "0,0,9\n0,3,0\n" * 30, "accelerometer at rest"),
        ("z=pose.csv", "acc_x,acc_y,acc_z\n" + "a,b\n" * 30, "10 or more readings"),
    ],
)
def test_a_pose_that_tells_nothing_is_refused(bag, tmp_path, monkeypatch, refused, text, content, expected):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pose.csv").write_text(content)
    assert expected in refused(BAG, "check", bag, "--rest-pose", text)


def test_a_bag_can_be_a_pose(tmp_path, write_bag, clean, bag, command):
    upright = replace(clean.imu, specific_force=np.tile([0.0, 0.0, 9.81], (clean.imu.time_ns.size, 1)))
    pose = write_bag(tmp_path / "pose", list(conversion.imu_records(upright)))
    answer = command(BAG, "check", bag, "--rest-pose", f"z={pose}")
    assert "its heading is a guess" in " ".join(answer.out.split())


# Command line


def test_what_is_found_is_printed_and_the_way_on(clean, bag_of, command):
    path = bag_of(renamed(replace(clean, info=None).records(), {"/imu/data_raw": "/my imu"}))
    answer = command(BAG, "check", path)
    assert answer.code == 0
    assert f"./tms fit run {path} --bicycle NAME --imu-topic '/my imu'" in answer.out
    assert "note    no_imu on /my imu" in answer.out
    assert "0 errors, 0 warnings" in answer.out


def test_json_holds_the_findings_and_the_topics(clean, bag_of, command):
    path = bag_of(FAULTS["force_units"][0][0](clean))
    answer = command(BAG, "check", path, "--json")
    document = json.loads(answer.out)
    assert document["counts"] == {"error": 1, "warning": 0, "note": 0}
    (finding,) = document["findings"]
    assert {"check", "severity", "topic", "evidence", "consequence", "remedy", "command", "values"} == set(
        finding
    )
    assert finding["values"]["unit"] == "g"
    imu = next(topic for topic in document["topics"] if topic["name"] == "/imu/data_raw")
    assert imu["rate"] == pytest.approx(100.0)
    assert document["command"] == f"./tms fit run {path}"


@pytest.mark.parametrize(("strict", "code"), [([], 0), (["--strict"], 3)])
def test_the_exit_code_tells_of_findings_only_if_asked(clean, bag_of, command, strict, code):
    path = bag_of(FAULTS["gaps"][0][0](clean))
    assert command(BAG, "check", path, *strict).code == code
    assert command(BAG, "check", ROOT / "bags" / "tms_strike", *strict).code == 0


def test_a_csv_log_is_checked_with_its_mapping(tmp_path, command, refused):
    log = tmp_path / "log.csv"
    rows = "".join(
        f"{0.1 * math.sin(n / 9):.4f},{0.2 * math.cos(n / 9):.4f},-3.0,1.0,-1\n" for n in range(900)
    )
    log.write_text("lean_angle,lean_rate,speed,sil_command,y_acceleration\n" + rows)
    found = json.loads(command(BAG, "check", log, "--mapping", "delft_sbw", "--json").out)
    assert {finding["check"] for finding in found["findings"]} >= {"speed_values"}
    assert found["path"] == str(log)
    assert "import-csv" in found["command"]
    assert "expected" in refused(BAG, "check", log)


@pytest.mark.parametrize("topic", ["--imu-topic", "--speed-topic"])
def test_a_topic_that_is_not_there_is_told(bag, refused, topic):
    assert "expected a topic /nope" in refused(BAG, "check", bag, topic, "nope")


def test_a_topic_of_a_type_that_nobody_knows_is_told(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="x")
        channel = writer.register_channel(
            "/strange", "cdr", writer.register_schema("no_msgs/msg/Strange", "", b"")
        )
        writer.add_message(channel, 1, b"\x00\x01\x00\x00abc", 1)
        writer.finish()
    found = dict(findings(survey(path)))
    assert found["unreadable"].topic == "/strange"
    assert "no_msgs/msg/Strange is not known" in found["unreadable"].evidence
    with BagReader(path) as bag:
        assert bag.message_count == 1
    assert topics.IMU not in found
    assert SEVERITIES[0] == ERROR
