"""Tables of messages say the same as rosbags, message by message."""

import dataclasses

import numpy as np
import pytest
from tms_bag import Record, RecordingError, conversion, topics
from tms_bag.messages import _store, deserialize, message_type, serialize
from tms_bag.reading.one_message import read_numbers, write_numbers
from tms_bag.reading.tables import MessageError, new_table, read_table, rows, stamps
from tms_bag.samples import ImuSamples

TYPES = [
    *sorted(set(topics.TYPES.values()) - {"tms_msgs/msg/RunInfo", "tms_msgs/msg/Event"}),
    "tms_msgs/msg/FilterState",
]
FRAMES = ["", "a", "imu_link", "rear_frame", "a name of 23 letters...", "Rad/größe"]


def flat(message, prefix: str = "") -> dict[str, object]:
    """Numbers of a message by their names, header left out."""
    found = {}
    for field in dataclasses.fields(message):
        value = getattr(message, field.name)
        if field.name.isupper() or field.name in ("__msgtype__", "header"):
            continue
        if dataclasses.is_dataclass(value):
            found |= flat(value, f"{prefix}{field.name}.")
        else:
            found[prefix + field.name] = value.tolist() if isinstance(value, np.ndarray) else value
    return found


def random_message(type_name: str, rng: np.random.Generator, frame_id: str):
    """A message with a random value in every number."""

    def fill(message):
        values = {}
        for field in dataclasses.fields(message):
            value = getattr(message, field.name)
            if field.name.isupper() or field.name in ("__msgtype__", "header"):
                continue
            if dataclasses.is_dataclass(value):
                values[field.name] = fill(value)
            elif isinstance(value, np.ndarray):
                values[field.name] = rng.normal(size=value.size)
            elif isinstance(value, bool):
                values[field.name] = bool(rng.integers(2))
            else:
                values[field.name] = int(rng.integers(256)) if isinstance(value, int) else float(rng.normal())
        return dataclasses.replace(message, **values)

    empty = new_table(type_name, np.array([0]), frame_id)
    message = fill(deserialize(next(rows(empty)), type_name))
    stamp = message_type("builtin_interfaces/msg/Time")(int(rng.integers(2**31)), int(rng.integers(10**9)))
    return dataclasses.replace(message, header=dataclasses.replace(message.header, stamp=stamp))


@pytest.fixture(params=TYPES)
def type_name(request) -> str:
    return request.param


@pytest.mark.parametrize("length", [2**15, 2**16, 2**20])
def test_a_frame_longer_than_any_is_told(length):
    message = random_message("geometry_msgs/msg/TwistStamped", np.random.default_rng(1), "")
    header = dataclasses.replace(message.header, frame_id="x" * length)
    data = serialize(dataclasses.replace(message, header=header))
    record = Record("/bicycle/speed", "geometry_msgs/msg/TwistStamped", 1, data)
    for read in (conversion.speed_reading, lambda record: conversion.speed_samples([record])):
        with pytest.raises(RecordingError, match="/bicycle/speed at 1 ns: expected a geometry_msgs"):
            read(record)


@pytest.mark.parametrize("frame_id", FRAMES)
def test_an_empty_table_is_a_message_of_zeros(type_name, frame_id):
    data = next(rows(new_table(type_name, np.array([1_500_000_002_000_000_003]), frame_id)))
    message = deserialize(data, type_name)
    assert message.header.frame_id == frame_id
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_500_000_002, 3)
    assert not any(np.any(value) for value in flat(message).values())
    assert serialize(message) == data


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("extra", [0, 1, 3])
def test_messages_of_all_frames_and_byte_orders_are_read_as_rosbags_reads_them(type_name, order, extra):
    rng = np.random.default_rng(7)
    messages = [random_message(type_name, rng, FRAMES[number % len(FRAMES)]) for number in range(40)]
    data = [
        bytes(_store().serialize_cdr(message, type_name, little_endian=order == "little")) + bytes(extra)
        for message in messages
    ]
    table, frames = read_table(type_name, data)
    assert frames == [message.header.frame_id for message in messages]
    assert stamps(table).tolist() == [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]
    for row, message in enumerate(messages):
        expected = flat(message)
        assert {name: table[name][row].tolist() for name in expected} == expected
    assert set(table.dtype.names) == {*flat(messages[0]), "stamp.sec", "stamp.nanosec"}


def test_written_columns_are_what_rosbags_reads(type_name):
    rng = np.random.default_rng(8)
    expected = [random_message(type_name, rng, "imu_link") for _ in range(20)]
    times = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in expected])
    table = new_table(type_name, times, "imu_link")
    for row, message in enumerate(expected):
        for name, value in flat(message).items():
            table[name][row] = value
    assert list(rows(table)) == [serialize(message) for message in expected]


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[:3],
        lambda data: data[:14],
        lambda data: data[:-4],
        lambda data: data + bytes(4),
        lambda data: b"\x00\x07" + data[2:],
        lambda data: data[:12] + b"\xff\xff\xff\xff" + data[16:],
        lambda data: data[:12] + b"\x03\x00\x00\x00" + data[16:],
    ],
)
@pytest.mark.parametrize("others", [0, 5])
def test_bytes_that_are_no_message_are_refused_with_their_row(type_name, damage, others):
    rng = np.random.default_rng(9)
    data = [serialize(random_message(type_name, rng, "imu_link")) for _ in range(others + 1)]
    data[others // 2] = damage(data[others // 2])
    with pytest.raises(MessageError, match=f"expected a {type_name} message") as refused:
        read_table(type_name, data)
    assert refused.value.row == others // 2


@pytest.mark.parametrize("type_name", ["tms_msgs/msg/RunInfo", "tms_msgs/msg/Estimate"])
def test_types_with_texts_have_no_table(type_name):
    with pytest.raises(TypeError, match="has no fixed size"):
        new_table(type_name, np.array([0]), "x")


@pytest.mark.parametrize("type_name", TYPES)
def test_one_message_alone_is_read_and_written_as_among_others(type_name: str) -> None:
    rng = np.random.default_rng(1)
    for frame in FRAMES:
        data = serialize(random_message(type_name, rng, frame))
        table, _ = read_table(type_name, [data])
        names = tuple(name for name in table.dtype.names or () if not name.startswith("stamp."))
        stamp, *numbers = read_numbers(type_name, names, data)
        expected = [value for name in names for value in np.ravel(table[name][0]).tolist()]
        assert stamp == stamps(table)[0]
        np.testing.assert_array_equal(numbers, expected)
        assert read_numbers(type_name, names[-1:], data)[1:] == tuple(
            numbers[-np.size(table[names[-1]][0]) :]
        )
        assert write_numbers(type_name, names, frame, stamp, numbers) == data
        for wrong in (data[:-4], data[:8], b"", data + b"\x00" * 4, b"\x01" + data[1:]):
            with pytest.raises(
                MessageError, match=f"expected a {type_name} message, found {len(wrong)} bytes"
            ):
                read_numbers(type_name, names, wrong)
        with pytest.raises(TypeError, match="expected the numbers"):
            write_numbers(type_name, names[1:], frame, stamp, numbers)


def test_a_reading_alone_is_read_as_a_stream_is() -> None:
    rng = np.random.default_rng(2)
    rates = rng.standard_normal((3, 3))
    rates[1, 2] = np.nan
    for variance in (np.full(3, np.nan), np.array([1e-4, np.nan, 2e-4])):
        samples = ImuSamples(np.arange(3) + 5, rates, np.zeros((3, 3)), variance)
        for row, record in enumerate(conversion.imu_records(samples)):
            stamp, angular_velocity, told = conversion.imu_reading(record)
            whole = conversion.imu_samples([record])
            assert stamp == whole.time_ns[0] == row + 5
            np.testing.assert_array_equal(angular_velocity, whole.angular_velocity[0])
            np.testing.assert_array_equal(told, whole.angular_velocity_variance)
    absent = deserialize(record.data, record.type)
    none = np.array([-1.0] + [0.0] * 8)  # REP-145: it has no gyroscopes
    absent = dataclasses.replace(absent, angular_velocity_covariance=none)
    assert np.isnan(conversion.imu_reading(dataclasses.replace(record, data=serialize(absent)))[1]).all()
    with pytest.raises(RecordingError, match="/imu/data_raw at 7 ns: expected a"):
        conversion.imu_reading(dataclasses.replace(record, data=record.data[:40]))
