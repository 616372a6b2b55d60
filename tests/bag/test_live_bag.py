"""Bags in the making: packed in every way, split by size and time, paused, kept in memory until asked for."""

import errno
import os
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from tms_bag import BagReader, BagWriter, Record, RecordingError
from tms_bag.writing import live_bag
from tms_bag.writing.live_bag import LiveBag
from tms_bag.writing.mcap_file import McapFile
from tms_bag.writing.presets import PRESETS
from tms_bag.writing.recent import RecentRecords
from tms_bag.writing.repair import repair
from tms_bag.writing.writer import Splitting

VECTOR = "geometry_msgs/msg/Vector3"


def record(number: int, topic: str = "/v") -> Record:
    return Record(topic, VECTOR, 10**9 + number * 10**7, b"\x00\x01\x00\x00" + number.to_bytes(8, "big") * 3)


def written(path: Path, count: int = 2000, **options) -> list[Record]:
    records = [record(number, "/odd" if number % 2 else "/even") for number in range(count)]
    with BagWriter(path, **options) as bag:
        for one in records:
            bag.write(one)
    return records


def contents(path: Path) -> list[tuple[str, int, bytes]]:
    with BagReader(path) as bag:
        assert bag.complete
        return [(one.topic, one.time_ns, one.data) for one in bag.records()]


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_every_preset_is_read_by_all(tmp_path, preset):
    records = written(tmp_path / "bag", preset=preset)
    expected = [(one.topic, one.time_ns, one.data) for one in records]
    assert contents(tmp_path / "bag") == expected
    with AnyReader([tmp_path / "bag"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as theirs:
        assert [(c.topic, when, bytes(data)) for c, when, data in theirs.messages()] == expected
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        found = make_reader(file, validate_crcs=True).iter_messages()
        assert sorted((c.topic, m.log_time, m.data) for _, c, m in found) == sorted(expected)


def test_presets_differ_in_size(tmp_path):
    # Guards our one use of the mcap library's inside: that the level of compression really is another.
    for preset in PRESETS:
        written(tmp_path / preset, preset=preset)
    size = {p: (tmp_path / p / f"{p}_0.mcap").stat().st_size for p in PRESETS}
    assert size["zstd_small"] < size["zstd"] < size["zstd_fast"] < size["none"]
    assert size["fastwrite"] < size["none"]  # no index


def test_an_unknown_preset_is_refused(tmp_path):
    with pytest.raises(RecordingError, match=r"compression: expected one of .*zstd_small.*, found 'gzip'"):
        BagWriter(tmp_path / "bag", preset="gzip")


@pytest.mark.parametrize("preset", ["none", "zstd", "fastwrite"])
def test_no_file_is_larger_than_asked(tmp_path, preset):
    records = written(tmp_path / "bag", count=5000, preset=preset, splitting=Splitting(size=60_000))
    files = sorted((tmp_path / "bag").glob("*.mcap"))
    assert len(files) > 2
    assert all(file.stat().st_size <= 1.1 * 60_000 for file in files)  # a short index comes on top
    assert contents(tmp_path / "bag") == [(one.topic, one.time_ns, one.data) for one in records]


def test_no_file_is_longer_than_asked_and_the_metadata_says_what_is_where(tmp_path):
    written(tmp_path / "bag", count=250, splitting=Splitting(duration_ns=10**9))  # 10 ms apart
    text = (tmp_path / "bag" / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == ["bag_0.mcap", "bag_1.mcap", "bag_2.mcap"]
    assert [file["message_count"] for file in information["files"]] == [101, 101, 48]
    starts = [file["starting_time"]["nanoseconds_since_epoch"] for file in information["files"]]
    assert starts == [10**9, 10**9 + 101 * 10**7, 10**9 + 202 * 10**7]
    assert information["files"][0]["duration"]["nanoseconds"] == 10**9
    assert information["duration"]["nanoseconds"] == 249 * 10**7
    assert information["message_count"] == 250
    counts = [topic["message_count"] for topic in information["topics_with_message_count"]]
    assert counts == [125, 125]


def test_a_split_bag_without_its_end_is_mended(tmp_path):
    writer = BagWriter(tmp_path / "bag", live=True, splitting=Splitting(duration_ns=10**9))
    writer.__enter__()
    for number in range(250):
        writer.write(record(number))
    writer.flush()
    killed = tmp_path / "killed"
    killed.mkdir()
    for file in (tmp_path / "bag").iterdir():
        (killed / file.name).write_bytes(file.read_bytes())
    writer.__exit__(None, None, None)
    repair(killed)
    assert [data for _, _, data in contents(killed)] == [record(number).data for number in range(250)]


def test_what_was_taken_is_on_the_disk_a_quarter_of_a_second_later(tmp_path, monkeypatch):
    now = 1000.0
    monkeypatch.setattr(live_bag, "time", SimpleNamespace(monotonic=lambda: now))
    bag = LiveBag(BagWriter(tmp_path / "bag", live=True))
    for number in range(10):
        bag.take(record(number), number)
    for later, expected in ((1000.24, 0), (1000.26, 10)):
        now = later
        bag.flush_when_due()
        with BagReader(tmp_path / "bag") as reader:
            assert reader.message_count == expected
    bag.close()


@pytest.mark.parametrize("preset", ["none", "zstd", "fastwrite"])
def test_a_bag_whose_disk_was_full_does_not_look_whole(tmp_path, no_room, preset):
    bag = LiveBag(BagWriter(tmp_path / "bag", live=True, preset=preset))

    def fill() -> None:
        for number in range(100_000):
            bag.take(record(number), number)
            if number % 500 == 499:
                bag.writer.flush()

    with no_room(200_000), pytest.raises(OSError, match="File too large"):
        fill()
    # Somebody makes room.
    with pytest.raises(OSError, match="File too large"):
        bag.close()
    assert not (tmp_path / "bag" / "metadata.yaml").exists()
    repair(tmp_path / "bag")
    found = [data for _, _, data in contents(tmp_path / "bag")]
    assert len(found) >= 500
    assert found == [record(number).data for number in range(len(found))]


def test_a_bag_that_the_disk_refused_once_does_not_look_whole(tmp_path, monkeypatch):
    bag = LiveBag(BagWriter(tmp_path / "bag", live=True))
    bag.take(record(0), 0)
    bag.writer.flush()

    def refuse(handle: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", refuse)
        with pytest.raises(OSError, match="Input/output"):
            bag.writer.sync()
    with pytest.raises(OSError, match="Input/output"):  # which the system tells only once
        bag.close()
    assert not (tmp_path / "bag" / "metadata.yaml").exists()


def test_a_file_is_not_closed_while_another_thread_takes_hold_of_it(tmp_path, monkeypatch):
    file = McapFile(tmp_path / "a.mcap", PRESETS["zstd"])
    finishing = Thread(target=file.finish, args=("",))

    def duplicate(handle: int) -> int:
        finishing.start()
        finishing.join(0.5)  # as far as it gets
        os.fstat(handle)  # EBADF if it is closed
        return real(handle)

    real = os.dup
    monkeypatch.setattr(os, "dup", duplicate)
    file.sync()
    finishing.join()
    file.sync()  # nothing to do any more


def test_a_pause_leaves_out_and_counts(tmp_path):
    bag = LiveBag(BagWriter(tmp_path / "bag", live=True), paused=True)
    for number in range(30):
        bag.paused = number % 3 == 0
        bag.take(record(number), number)
    bag.close()
    assert bag.left_out == 10
    assert len(contents(tmp_path / "bag")) == 20


def test_a_snapshot_holds_the_last_seconds_each_in_a_file_of_its_own(tmp_path):
    bag = LiveBag(BagWriter(tmp_path / "bag", live=True), RecentRecords(1.0, 10**6))
    for number in range(400):
        bag.take(record(number), record(number).time_ns)
        if number in (150, 380):
            assert bag.snapshot() == 101
    bag.close()
    numbers = [int.from_bytes(data[4:12], "big") for _, _, data in contents(tmp_path / "bag")]
    assert numbers == [*range(50, 151), *range(280, 381)]
    assert len(list((tmp_path / "bag").glob("*.mcap"))) == 2


def test_memory_for_snapshots_is_bounded():
    recent = RecentRecords(1000.0, 280)
    for number in range(50):
        recent.add(record(number), number)
        assert recent.bytes <= 280
    assert [one.time_ns for one in recent.take_all()] == [record(number).time_ns for number in range(40, 50)]
    assert recent.take_all() == []


def test_one_message_larger_than_the_memory_is_let_go():
    recent = RecentRecords(1.0, 10)
    recent.add(record(1), 1)
    assert recent.take_all() == []
