"""Messages as arrays say the same as rosbags, message by message, whatever the file looks like."""

import dataclasses
import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tms_bag import BagReader, RecordingError, conversion, read_recording
from tms_bag.messages import schema_text
from tms_bag.reading.definitions import message_of
from tms_bag.samples import ImuSamples

STORE = get_typestore(Stores.ROS2_JAZZY)
IMU, JOINTS = "sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState"
STEP_NS = 2_500_000

# How rosbag2's storage presets set its writer, and what other writers do.
PRESETS = {
    "none": {"compression": CompressionType.NONE, "chunk_size": 786_432},
    "fastwrite": {"use_chunking": False, "enable_crcs": False},
    "zstd_fast": {"compression": CompressionType.ZSTD, "chunk_size": 786_432, "enable_crcs": False},
    "zstd_small": {"compression": CompressionType.ZSTD, "chunk_size": 4_194_304},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 65_536},
    "no index": {"index_types": IndexType.NONE, "use_statistics": False},
}


def imu(number: int, rng: np.random.Generator, frame_id: str = "imu_link"):
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(10**18 + number * STEP_NS, 10**9))
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    return types[IMU](
        types["std_msgs/msg/Header"](stamp, frame_id),
        quaternion(*rng.normal(size=4)),
        rng.normal(size=9),
        vector(*rng.normal(size=3)),
        rng.normal(size=9),
        vector(*rng.normal(size=3)),
        rng.normal(size=9),
    )


def joints(number: int, rng: np.random.Generator, names: list[str]):
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(10**18 + number * STEP_NS, 10**9))
    header = types["std_msgs/msg/Header"](stamp, "")
    return types[JOINTS](header, names, *(rng.normal(size=size) for size in (len(names), 0, len(names))))


def write_mcap(path: Path, messages, options=None, finish: bool = True, schema=schema_text) -> Path:
    """(topic, type, log time, bytes) as another recorder would write them."""
    with path.open("wb") as file:
        writer = Writer(file, **(options or {}))
        writer.start(profile="ros2", library="another")
        channels: dict[str, int] = {}
        for topic, kind, time, data in messages:
            if topic not in channels:
                number = writer.register_schema(kind, "ros2msg", schema(kind).encode())
                channels[topic] = writer.register_channel(topic, "cdr", number, {})
            writer.add_message(channels[topic], time, data, max(time - 5, 0))
        writer.flush()
        if finish:
            writer.finish()
    return path


def cdr(message, little_endian: bool = True) -> bytes:
    return bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=little_endian))


def numbers_of(message, prefix: str = "") -> dict[str, object]:
    found: dict[str, object] = {}
    for field in dataclasses.fields(message):
        value, name = getattr(message, field.name), prefix + field.name
        if field.name == "__msgtype__" or field.name.isupper():
            continue
        if dataclasses.is_dataclass(value):
            found |= numbers_of(value, name + ".")
        elif isinstance(value, np.ndarray):
            found[name] = value.tolist()
        elif not isinstance(value, str | list):
            found[name] = value
    return {name: value for name, value in found.items() if ".stamp." not in name}


def mixed_drive(count: int = 1200):
    """An IMU with two frames (as when a driver is started anew), joints, and their messages."""
    rng = np.random.default_rng(4)
    messages = []
    for number in range(count):
        reading = imu(number, rng, "imu_link" if number < count // 2 else "imu")
        messages.append(("/xsens/imu", reading, 10**18 + number * STEP_NS + 300))
        if number % 5 == 0:
            messages.append(("/joints", joints(number, rng, ["steer", "rear"]), 10**18 + number * STEP_NS))
    return messages


@pytest.fixture(scope="module")
def drive():
    return mixed_drive()


def rows_of(drive, topic: str):
    """Log times and numbers of a topic's messages."""
    return [(time, numbers_of(message)) for name, message, time in drive if name == topic]


@pytest.mark.parametrize("finish", [True, False], ids=["finished", "killed"])
@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_of_the_recorder_is_read_as_rosbags_reads_each_message(tmp_path, drive, preset, finish):
    messages = [(topic, m.__msgtype__, time, cdr(m)) for topic, m, time in drive]
    path = write_mcap(tmp_path / "a.mcap", messages, PRESETS[preset], finish)
    with BagReader(path) as bag:
        found = bag.columns({"/xsens/imu": None, "/joints": None})
        assert bool(bag.warnings) is not finish
    for topic, columns in found.items():
        expected = rows_of(drive, topic)
        assert columns.log_time_ns.tolist() == [time for time, _ in expected]
        assert columns.publish_time_ns.tolist() == [time - 5 for time, _ in expected]
        assert set(columns.values) == {*expected[0][1]}
        for name in columns.values:
            assert columns[name].tolist() == [numbers[name] for _, numbers in expected]
    assert found["/xsens/imu"].texts["header.frame_id"] == ("imu_link", "imu")
    assert found["/joints"].texts["name[0]"] == ("steer",)
    assert found["/joints"]["position"].shape == (240, 2)
    assert found["/joints"].stamp_ns[1] == 10**18 + 5 * STEP_NS


@pytest.mark.parametrize("little_endian", [True, False])
@pytest.mark.parametrize("filling", [0, 1, 3])
def test_byte_order_and_filling_may_change_from_message_to_message(tmp_path, little_endian, filling):
    rng = np.random.default_rng(1)
    drive = [imu(number, rng, "a" * (number % 7)) for number in range(500)]
    messages = [
        ("/imu", IMU, number, cdr(m, little_endian if number % 3 else True) + bytes(filling * (number % 2)))
        for number, m in enumerate(drive)
    ]
    with BagReader(write_mcap(tmp_path / "a.mcap", messages)) as bag:
        columns = bag.columns({"/imu": ["linear_acceleration.y", "angular_velocity_covariance"]})["/imu"]
    assert set(columns.values) == {"linear_acceleration.y", "angular_velocity_covariance"}
    assert columns["linear_acceleration.y"].tolist() == [m.linear_acceleration.y for m in drive]
    assert np.array_equal(
        columns["angular_velocity_covariance"], [m.angular_velocity_covariance for m in drive]
    )


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:40],
        lambda data: data + bytes(4),
        lambda data: b"\x00\x07" + data[2:],
        lambda _: b"",
    ],
    ids=["short", "long", "encapsulation", "empty"],
)
def test_one_wrong_message_among_many_is_named(tmp_path, damage):
    rng = np.random.default_rng(1)
    messages = [["/imu", IMU, number, cdr(imu(number, rng))] for number in range(300)]
    messages[123][3] = damage(messages[123][3])
    with (
        BagReader(write_mcap(tmp_path / "a.mcap", messages)) as bag,
        pytest.raises(RecordingError, match="/imu at 123 ns: expected a sensor_msgs/msg/Imu message"),
    ):
        bag.columns({"/imu": None})


def test_a_stretch_of_time_is_that_of_the_records(tmp_path, drive):
    messages = [(topic, m.__msgtype__, time, cdr(m)) for topic, m, time in drive]
    path = write_mcap(tmp_path / "a.mcap", messages, {"chunk_size": 50_000})
    first, last = 10**18 + 300 * STEP_NS, 10**18 + 934 * STEP_NS
    with BagReader(path) as bag:
        columns = bag.columns({"/joints": []}, first, last)["/joints"]
        records = list(bag.records(["/joints"], first, last))
    assert columns.log_time_ns.tolist() == [record.time_ns for record in records]
    assert columns.log_time_ns[0] == first
    assert columns.values == {}


def test_parts_without_the_topic_or_the_time_are_not_read(tmp_path, monkeypatch):
    """A slow topic stands in few chunks: the others are neither read nor unpacked."""
    rng = np.random.default_rng(1)
    messages = [("/imu", IMU, number, cdr(imu(number, rng))) for number in range(2000)]
    messages[1000:1000] = [("/slow", IMU, 1000, cdr(imu(1000, rng)))]
    path = write_mcap(tmp_path / "a.mcap", messages, {"chunk_size": 20_000})
    from tms_bag.reading import index

    read: list[int] = []
    unpack = index.frames.chunk_content
    monkeypatch.setattr(
        index.frames, "chunk_content", lambda record: read.append(len(record)) or unpack(record)
    )
    with BagReader(path) as bag:
        assert len(bag.indexes[0].spans) > 20
        assert len(bag.columns({"/slow": None})["/slow"]) == 1
        assert len(read) == 1
        assert len(bag.columns({"/imu": None}, 100, 110)["/imu"]) == 10
        assert len(list(bag.records(["/imu"], 100, 110))) == 10
        assert len(read) <= 5


def test_out_of_order_messages_are_sorted_by_log_time_and_equal_times_stay(tmp_path):
    rng = np.random.default_rng(3)
    times = [*((number * 37) % 500 for number in range(500)), *[250] * 50]
    messages = [("/imu", IMU, time, cdr(imu(number, rng))) for number, time in enumerate(times)]
    with BagReader(write_mcap(tmp_path / "a.mcap", messages, {"chunk_size": 9000})) as bag:
        columns = bag.columns({"/imu": None})["/imu"]
        records = list(bag.records())
    expected = sorted(range(550), key=lambda number: times[number])
    assert ((columns.stamp_ns - 10**18) // STEP_NS).tolist() == expected
    assert columns.log_time_ns.tolist() == [record.time_ns for record in records]


def test_a_bag_brings_its_own_definition_of_a_type(tmp_path):
    """As an older version of a package had it: a field less, another type, another order."""
    old = (
        "std_msgs/Header header\nfloat32 speed\nbool flag\nfloat64[3] place\n"
        + "=" * 80
        + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        + "=" * 80
        + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    kind = "tms_msgs/msg/BicycleState"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(old, kind))
    header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](7, 9), "world")
    data = [
        bytes(
            store.serialize_cdr(
                store.types[kind](header=header, speed=n / 2, flag=n % 2 == 0, place=np.arange(3.0) + n), kind
            )
        )
        for n in range(20)
    ]
    messages = [("/bicycle/state", kind, n, one) for n, one in enumerate(data)]
    with BagReader(write_mcap(tmp_path / "a.mcap", messages, schema=lambda _: old)) as bag:
        columns = bag.columns({"/bicycle/state": None})["/bicycle/state"]
    assert set(columns.values) == {"speed", "flag", "place"}
    assert columns["speed"].tolist() == [n / 2 for n in range(20)]
    assert columns["flag"].tolist() == [True, False] * 10
    assert columns["place"][4].tolist() == [4.0, 5.0, 6.0]
    state = conversion.state_samples(columns)
    assert state.speed.tolist() == [n / 2 for n in range(20)]
    assert np.isnan(state.state).all()  # which that version didn't have
    assert state.rear_contact.shape == (20, 2)


@pytest.mark.parametrize(
    "schema", ["", "not a definition", "float64[", "float64 x", "A" * 300_000], ids=lambda schema: schema[:20]
)
def test_a_definition_that_is_none_leaves_the_installed_one(tmp_path, schema):
    rng = np.random.default_rng(1)
    messages = [("/imu", IMU, n, cdr(imu(n, rng))) for n in range(3)]
    path = write_mcap(tmp_path / "a.mcap", messages, schema=lambda _: schema)
    with BagReader(path) as bag:
        if schema == "float64 x":  # a definition, but not of these bytes
            with pytest.raises(RecordingError, match="another version of this type"):
                bag.columns({"/imu": None})
        else:
            assert len(bag.columns({"/imu": None})["/imu"]) == 3


def test_a_message_larger_than_what_is_read_at_once(tmp_path):
    kind = "sensor_msgs/msg/JointState"
    rng = np.random.default_rng(1)
    large = joints(1, rng, ["a"] * 9)
    large.position = np.arange(1e6)
    messages = [("/joints", kind, n, cdr(large)) for n in range(3)]
    path = write_mcap(tmp_path / "a.mcap", messages, {"use_chunking": False})
    with BagReader(path) as bag:
        assert bag.complete
        assert bag.columns({"/joints": ["position"]})["/joints"]["position"].sum() == 3 * np.arange(1e6).sum()


def test_sequences_that_change_their_length_can_not_be_a_column(tmp_path):
    rng = np.random.default_rng(1)
    names = [["a"], ["a", "b"]]
    messages = [("/joints", JOINTS, n, cdr(joints(n, rng, names[n % 2]))) for n in range(4)]
    with BagReader(write_mcap(tmp_path / "a.mcap", messages)) as bag:
        with pytest.raises(RecordingError, match="expected position of the same length in all messages"):
            bag.columns({"/joints": None})
        assert len(bag.columns({"/joints": []})["/joints"]) == 4


@pytest.mark.parametrize("count", [0, 10**9, 2**63])
def test_a_count_in_the_summary_is_not_believed(tmp_path, monkeypatch, count):
    rng = np.random.default_rng(1)
    messages = [("/imu", IMU, n, cdr(imu(n, rng))) for n in range(100)]
    with BagReader(write_mcap(tmp_path / "a.mcap", messages)) as bag:
        bag.indexes[0].counts.update(dict.fromkeys(bag.indexes[0].counts, count))
        assert len(bag.columns({"/imu": None})["/imu"]) == 100


MEMORY = """
import re, sys
import numpy as np
from tms_bag import BagReader, read_recording
def peak():  # of this process alone: getrusage's counts the parent's before the start too
    return 1024 * int(re.search(r"VmHWM:\\s+(\\d+) kB", open("/proc/self/status").read())[1])
read_recording(sys.argv[1])  # everything is imported and every table is made
before = peak()
if sys.argv[3] == "columns":
    with BagReader(sys.argv[2]) as bag:
        found = bag.columns({"/imu/data_raw": None})["/imu/data_raw"]
    arrays = [found.log_time_ns, found.publish_time_ns, found.stamp_ns, *found.values.values()]
else:
    imu = read_recording(sys.argv[2]).imu
    arrays = [imu.time_ns, imu.angular_velocity, imu.specific_force]
print(peak() - before, sum(array.nbytes for array in arrays))
"""


@pytest.mark.long
def test_memory_is_at_most_twice_the_arrays_and_a_chunk(tmp_path, write_bag):
    count = 200_000
    time = 10**18 + np.arange(count, dtype=np.int64) * STEP_NS
    ramp = np.arange(3.0 * count).reshape(count, 3)
    large = write_bag(tmp_path / "large", conversion.imu_records(ImuSamples(time, ramp, -ramp)))
    small = write_bag(
        tmp_path / "small", conversion.imu_records(ImuSamples(time[:9999], ramp[:9999], ramp[:9999]))
    )
    for way, least in (("columns", 60e6), ("recording", 11e6)):
        done = subprocess.run(
            [sys.executable, "-c", MEMORY, small, large, way], capture_output=True, text=True, check=True
        )
        peak, arrays = map(int, done.stdout.split())
        assert arrays >= least
        assert peak < 2 * arrays + 2**20, way


def test_a_recording_of_a_killed_recorder_says_so(unfinished_bag, bag):
    (warning,) = read_recording(unfinished_bag).warnings
    assert "unfinished: its recorder was killed, or the copy is cut short" in warning
    assert "tms bag repair" in warning
    assert read_recording(bag).warnings == ()


def test_a_bag_cut_before_its_first_messages_says_so(bag, tmp_path):
    content = next(bag.glob("*.mcap")).read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(content[:9000])
    with pytest.raises(RecordingError, match=r"the bag holds no topics.*; .*cut short; no message is here"):
        read_recording(path)


def test_the_fit_of_a_bag_cut_short_says_so(tmp_path, command):
    """Messages in several chunks; the copy ends in the last of them."""
    source = Path(__file__).resolve().parents[2] / "bags" / "tms_strike"
    with BagReader(source) as bag:
        messages = [(r.topic, r.type, r.time_ns, r.data) for r in bag.records()]
    whole = write_mcap(tmp_path / "whole.mcap", messages, {"chunk_size": 100_000}, finish=False)
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.read_bytes()[: int(0.9 * whole.stat().st_size)])
    answer = command("tms_fit", "run", path)
    assert answer.code == 0
    assert "warning: " in answer.out
    assert "cut short" in answer.out
    document = json.loads(command("tms_fit", "run", path, "--json").out)
    assert "cut short" in document["warnings"][0]
    assert json.loads(command("tms_fit", "run", whole.parent / "whole.mcap", "--json").out)["warnings"]
    warnings = json.loads(command("tms_fit", "run", source, "--json").out)["warnings"]
    assert all("linear equations" in text for text in warnings)


def test_a_message_in_a_message_that_holds_nothing_takes_a_byte(tmp_path):
    """As rosidl lays out types of constants only; rosbags writes it so too."""
    kind = "elsewhere_msgs/msg/Thing"
    definition = (
        "elsewhere_msgs/Nothing[3] nothing\nuint8 flag\nelsewhere_msgs/Nothing one\nfloat64 value\n"
        + "=" * 80
        + "\nMSG: elsewhere_msgs/Nothing\nuint8 CONSTANT=7\n"
    )
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, kind))
    nothing = store.types["elsewhere_msgs/msg/Nothing"]
    data = [
        bytes(store.serialize_cdr(store.types[kind]([nothing()] * 3, n, nothing(), n / 4), kind))
        for n in range(20)
    ]
    assert data[9][4:].hex() == "000000" + "09" + "00" + "000000" + np.float64(2.25).tobytes().hex()
    messages = [("/thing", kind, n, one) for n, one in enumerate(data)]
    with BagReader(write_mcap(tmp_path / "a.mcap", messages, schema=lambda _: definition)) as bag:
        columns = bag.columns({"/thing": None})["/thing"]
    assert columns["flag"].tolist() == [*range(20)]
    assert columns["value"].tolist() == [n / 4 for n in range(20)]


def test_messages_of_a_type_without_fields_have_their_times(tmp_path):
    messages = [("/button", "elsewhere_msgs/msg/Pressed", n, b"\0\1\0\0\0") for n in range(9)]
    with BagReader(write_mcap(tmp_path / "a.mcap", messages, schema=lambda _: "")) as bag:
        columns = bag.columns({"/button": None})["/button"]
    assert columns.log_time_ns.tolist() == [*range(9)]
    assert columns.values == {}


def test_events_of_a_service_are_laid_out_by_the_definition_of_the_service(tmp_path):
    """REP-2012: when, by whom, and the request or the response, as rosbag2 records introspected services."""
    head = struct.Struct("<4xB3xiI16s4xq")  # encapsulation, kind, stamp, client, sequence number
    sent = [  # numbers are aligned to their size, from behind the encapsulation on
        head.pack(1, 10, 500, bytes(range(16)), 7) + struct.pack("<I4xqqI", 1, 2, 3, 0),
        head.pack(2, 11, 600, bytes(range(16)), 7) + struct.pack("<IIq", 0, 1, 5),
    ]
    kind = "elsewhere_msgs/srv/Add_Event"
    messages = [("/add/_service_event", kind, n, b"\0\1\0\0" + data[4:]) for n, data in enumerate(sent)]
    definition = "int64 a\nint64 b\n---\nint64 sum\n"
    with BagReader(write_mcap(tmp_path / "a.mcap", messages, schema=lambda _: definition)) as bag:
        columns = bag.columns({"/add/_service_event": None})["/add/_service_event"]
        (channel,) = bag.channels
        asked, answered = (message_of(channel, record.data) for record in bag.records())
    assert columns["info.event_type"].tolist() == [1, 2]
    assert columns["info.client_gid"][1].tolist() == [*range(16)]
    assert columns["info.sequence_number"].tolist() == [7, 7]
    assert (columns["request[0].b"][0], columns["response[0].sum"][1]) == (3, 5)
    assert (asked.request[0].a, asked.response, answered.request) == (2, [], [])
    assert (answered.response[0].sum, answered.info.stamp.sec) == (5, 11)


def test_feedback_of_an_action_is_read_as_any_message(tmp_path):
    kind = "elsewhere_msgs/action/Turn_FeedbackMessage"
    messages = [("/turn/_action/feedback", kind, n, b"\0\1\0\0" + struct.pack("<d", n / 2)) for n in range(5)]
    with BagReader(write_mcap(tmp_path / "a.mcap", messages, schema=lambda _: "float64 angle\n")) as bag:
        columns = bag.columns({"/turn/_action/feedback": None})["/turn/_action/feedback"]
    assert columns["angle"].tolist() == [n / 2 for n in range(5)]
