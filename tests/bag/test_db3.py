"""Bags in sqlite3, as ROS 2 recorded before Iron, and as the rosbags library writes them."""

import errno
import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.rosbag2.enums import StoragePlugin
from rosbags.typesys import Stores, get_typestore
from tms_bag import BagReader, RecordingError, conversion, read_recording
from tms_bag.writing.repair import repair


@pytest.fixture(params=[8, 9])
def db3_bag(tmp_path, run, request):
    """All records of a run, written by rosbags."""
    path = tmp_path / "old"
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(path, version=request.param, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {}
        for record in [*conversion.imu_records(run.imu), *conversion.speed_records(run.speed)]:
            if record.topic not in connections:
                connections[record.topic] = writer.add_connection(record.topic, record.type, typestore=store)
            writer.write(connections[record.topic], record.time_ns, record.data)
    return path


def test_a_db3_bag_is_read_as_any_other(db3_bag, run):
    recording = read_recording(db3_bag)
    assert np.array_equal(recording.imu.angular_velocity, run.imu.angular_velocity)
    assert np.array_equal(recording.imu.specific_force, run.imu.specific_force, equal_nan=True)
    assert np.array_equal(recording.speed.speed, run.speed.speed)
    assert np.array_equal(recording.imu.time_ns, run.imu.time_ns)
    with BagReader(db3_bag) as bag:
        assert bag.complete
        assert [(topic.name, topic.count) for topic in bag.topics] == [
            ("/bicycle/speed", run.speed.time_ns.size),
            ("/imu/data_raw", 300),
        ]
        first, last = int(run.imu.time_ns[17]), int(run.imu.time_ns[40])
        records = list(bag.records(["/imu/data_raw"], first, last))
        assert [record.time_ns for record in records] == run.imu.time_ns[17:40].tolist()
        columns = bag.columns({"/imu/data_raw": ["angular_velocity.x"]}, first, last)["/imu/data_raw"]
        assert columns["angular_velocity.x"].tolist() == run.imu.angular_velocity[17:40, 0].tolist()


def test_the_db3_file_alone_is_a_bag_and_a_folder_without_metadata_too(db3_bag, run):
    (db3_bag / "metadata.yaml").unlink()
    (file,) = db3_bag.glob("*.db3")
    for path in (file, db3_bag):
        assert read_recording(path).imu.time_ns.size == 300


def test_a_db3_bag_becomes_an_mcap_bag(db3_bag, tmp_path, run):
    done = repair(db3_bag, tmp_path / "new")
    assert done.message_count == 300 + run.speed.time_ns.size
    assert np.array_equal(read_recording(tmp_path / "new").imu.angular_velocity, run.imu.angular_velocity)


def test_many_messages_come_in_parts(tmp_path):
    path = tmp_path / "many"
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        store = get_typestore(Stores.ROS2_JAZZY)
        connection = writer.add_connection("/a", "std_msgs/msg/Float64", typestore=store)
        kind = store.types["std_msgs/msg/Float64"]
        for number in range(10_000):
            data = store.serialize_cdr(kind(number / 4), "std_msgs/msg/Float64")
            writer.write(connection, 10**18 + number // 3, data)
    with BagReader(path) as bag:
        assert len(bag.indexes[0].spans) == 3
        columns = bag.columns({"/a": None})["/a"]
        assert columns["data"].tolist() == [number / 4 for number in range(10_000)]
        assert columns.stamp_ns is None
        assert columns.time_ns.tolist() == [10**18 + number // 3 for number in range(10_000)]


@pytest.mark.parametrize("content", [b"", b"SQLite format 3\x00" + bytes(4000), b"no database" * 99])
def test_a_file_that_is_no_database_is_refused_in_one_line(tmp_path, content, refused):
    path = tmp_path / "it.db3"
    path.write_bytes(content)
    assert "expected an sqlite3 file of rosbag2" in refused("tms_bag", "info", path)


def test_another_database_is_refused(tmp_path):
    path = tmp_path / "it.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE messages (x)")
    with pytest.raises(RecordingError, match="expected an sqlite3 file of rosbag2"):
        BagReader(path)


def test_a_damaged_database_is_told(db3_bag):
    (file,) = db3_bag.glob("*.db3")
    content = bytearray(file.read_bytes())
    content[8192 : len(content) - 4096] = bytes(len(content) - 12288)
    file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"sqlite3|damaged"):
        read_recording(db3_bag)


@pytest.mark.parametrize("name", ["run #3", "what?", "100%20", "ü b"])
def test_a_folder_may_be_called_as_one_likes(db3_bag, name):
    assert read_recording(db3_bag.rename(db3_bag.with_name(name))).imu.time_ns.size == 300


def test_stamps_that_are_no_numbers_are_told(db3_bag):
    (file,) = db3_bag.glob("*.db3")
    with closing(sqlite3.connect(file)) as connection:
        connection.execute("UPDATE messages SET timestamp = 'noon' WHERE id = 7")
        connection.commit()
    with pytest.raises(RecordingError, match=r"damaged one \(its messages end before they begin\)"):
        read_recording(db3_bag)


def test_messages_that_a_killed_recorder_had_not_brought_into_the_file_are_read(db3_bag, tmp_path):
    """As rosbag2's preset `resilient` writes: into a log beside the file, taken over later."""
    (file,) = db3_bag.glob("*.db3")
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        (topic,) = database.execute("SELECT id FROM topics WHERE name = '/imu/data_raw'").fetchone()
        (last,) = database.execute("SELECT max(timestamp) FROM messages").fetchone()
        rows = database.execute("SELECT data FROM messages WHERE topic_id = ?", (topic,)).fetchall()
        for number, (data,) in enumerate(rows[:50]):
            row = (topic, last + 1 + number, data)
            database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
        database.commit()
        killed = tmp_path / "killed"
        killed.mkdir()
        for path in db3_bag.glob("*.db3*"):
            (killed / path.name).write_bytes(path.read_bytes())
    before = {path.name: path.read_bytes() for path in killed.iterdir()}
    assert any(name.endswith("-wal") for name in before)
    with BagReader(killed) as bag:
        assert next(topic.count for topic in bag.topics if topic.name == "/imu/data_raw") == 350
        assert "this file is unfinished" in bag.warnings[0]
        assert not bag.complete
    assert {path.name: path.read_bytes() for path in killed.iterdir()} == before
    assert repair(killed, tmp_path / "new").message_count == 350 + 60


def test_a_log_that_is_none_beside_the_file_changes_nothing(db3_bag):
    (file,) = db3_bag.glob("*.db3")
    for end in ("-wal", "-journal"):
        file.with_name(file.name + end).write_bytes(bytes(100) + b"no log of sqlite" * 99)
    with BagReader(db3_bag) as bag:
        assert bag.message_count == 360


def test_no_room_for_the_copy_of_a_file_that_was_not_closed_is_told(db3_bag, monkeypatch):
    (file,) = db3_bag.glob("*.db3")
    file.with_name(file.name + "-wal").write_bytes(b"left")

    def copy(source: object, target: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(shutil, "copyfile", copy)
    with pytest.raises(RecordingError, match=r"No space left on device.* set TMPDIR to a folder with room"):
        BagReader(db3_bag)
