"""Writing: all or nothing, nothing but bags is replaced, a live bag keeps what it has."""

import dataclasses
import os
from pathlib import Path

import pytest
from tms_bag import BagReader, BagWriter, Record, RecordingError
from tms_bag.channel import installed_channel
from tms_bag.qos import LATCHED, SENSOR

RECORD = Record("/speed", "geometry_msgs/msg/Vector3", 5, b"\x00\x01\x00\x00" + bytes(24))


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write_and_fail(path: Path, **options) -> None:
    with BagWriter(path, **options) as writer:
        writer.write(RECORD)
        raise ZeroDivisionError


def test_something_that_is_there_is_not_touched(tmp_path):
    for name in ("file", "folder", "link"):
        path = tmp_path / name
        if name == "file":
            path.write_text("mine")
        elif name == "folder":
            path.mkdir()
        else:
            path.symlink_to(tmp_path / "nowhere")
        with pytest.raises(RecordingError, match=r"exists already.*--force"):
            BagWriter(path)
    assert names(tmp_path) == ["file", "folder", "link"]
    assert (tmp_path / "file").read_text() == "mine"


def test_after_an_exception_nothing_is_left(tmp_path):
    with pytest.raises(ZeroDivisionError):
        write_and_fail(tmp_path / "new" / "parents" / "bag")
    assert names(tmp_path) == []


def test_parents_that_were_there_stay(tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(ZeroDivisionError):
        write_and_fail(tmp_path / "there" / "new" / "bag")
    assert names(tmp_path) == ["there"]
    assert names(tmp_path / "there") == []


def test_a_bag_is_replaced_only_at_a_clean_end(bag, run, make_run, write_bag):
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    with pytest.raises(ZeroDivisionError):
        write_and_fail(bag, overwrite=True)
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before
    write_bag(bag, make_run(count=10).records(), overwrite=True)
    with BagReader(bag) as reader:
        assert list(reader.records()) == make_run(count=10).records()
    assert names(bag.parent) == ["bag"]


def test_what_a_kill_left_beside_the_metadata_keeps_no_bag_from_being_replaced(bag, make_run, write_bag):
    (bag / "metadata.yaml").rename(bag / ".metadata.yaml.partial")
    write_bag(bag, make_run(count=10).records(), overwrite=True)
    assert names(bag) == ["bag_0.mcap", "metadata.yaml"]


def test_what_a_killed_process_of_the_same_number_left_is_in_nobodys_way(bag, make_run, write_bag):
    left = [bag.with_name(f".bag.{os.getpid()}.{end}") for end in ("partial", "replaced")]
    for folder in left:
        folder.mkdir()
        (folder / "bag_0.mcap").write_bytes(b"left")
    write_bag(bag, make_run(count=10).records(), overwrite=True)
    with BagReader(bag) as reader:
        assert list(reader.records()) == make_run(count=10).records()
    assert names(bag.parent) == [*sorted(folder.name for folder in left), "bag"]


@pytest.mark.parametrize(
    "what",
    [
        "a folder with other things",
        "a file",
        "a link to a bag",
        "a folder of bags",
        "two bags",
        "an sqlite3 bag",
        "a packed bag",
    ],
)
def test_what_is_no_bag_of_mcap_files_is_never_replaced(tmp_path, bag, what):
    path = tmp_path / "mine"
    if what == "a file":
        path.write_text("precious")
    elif what == "a link to a bag":
        path.symlink_to(bag)
    elif what == "a folder of bags":
        path.mkdir()
        bag.rename(path / "monday.mcap")
    elif what == "two bags":
        path.mkdir()
        for name in ("monday_0.mcap", "monday_1.mcap", "tuesday_0.mcap"):
            (path / name).write_bytes(b"precious")
    elif what in ("an sqlite3 bag", "a packed bag"):
        path.mkdir()
        (path / f"mine_0.{'db3' if what == 'an sqlite3 bag' else 'mcap.zstd'}").write_bytes(b"precious")
        (path / "metadata.yaml").write_text("")
    else:
        path.mkdir()
        (path / "thesis.tex").write_text("precious")
        (path / "metadata.yaml").write_text("")
    with pytest.raises(
        RecordingError, match=r"expected a bag of \.mcap files to replace, found .*; remove it yourself"
    ):
        BagWriter(path, overwrite=True)
    assert path.exists()


def test_a_place_that_can_not_be_written_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="can't make this folder"), BagWriter(tmp_path / "file" / "bag"):
        pass


def test_something_put_there_meanwhile_is_not_replaced(tmp_path):
    path = tmp_path / "bag"
    writer = BagWriter(path).__enter__()
    writer.write(RECORD)
    path.mkdir()
    (path / "other").write_text("precious")
    with pytest.raises(RecordingError, match="while the bag was written"):
        writer.__exit__(None, None, None)
    assert names(tmp_path) == ["bag"]
    assert names(path) == ["other"]


def test_a_topic_has_one_type(tmp_path):
    other = dataclasses.replace(RECORD, type="geometry_msgs/msg/Point")
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(RECORD)
        with pytest.raises(RecordingError, match="/speed holds geometry_msgs/msg/Vector3"):
            writer.write(other)


@pytest.mark.parametrize("time_ns", [-1, 2**63])
def test_a_time_that_does_not_fit_is_refused(tmp_path, time_ns):
    with pytest.raises(RecordingError, match="expected times"), BagWriter(tmp_path / "bag") as writer:
        writer.write(dataclasses.replace(RECORD, time_ns=time_ns))


def test_a_live_bag_is_kept_whatever_happens(tmp_path):
    with pytest.raises(ZeroDivisionError):
        write_and_fail(tmp_path / "bag", live=True)
    with BagReader(tmp_path / "bag") as reader:
        assert reader.complete
        assert reader.message_count == 1


def test_a_flush_puts_all_messages_within_reach_of_other_processes(tmp_path):
    with BagWriter(tmp_path / "bag", {"seed": "3"}, live=True) as writer:
        for time_ns in range(5):
            writer.write(dataclasses.replace(RECORD, time_ns=time_ns))
        writer.flush()
        with BagReader(tmp_path / "bag") as reader:  # opens the file anew, as another process would
            assert [record.time_ns for record in reader.records()] == list(range(5))
            assert reader.custom_data == {"seed": "3"}
            assert not reader.complete


def test_an_announced_topic_stands_in_the_bag_without_messages(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_channel(installed_channel("/quiet", "std_msgs/msg/String", (LATCHED, SENSOR)))
        writer.write(RECORD)
    with BagReader(tmp_path / "bag") as reader:
        assert [tuple(topic) for topic in reader.topics] == [
            ("/quiet", "std_msgs/msg/String", 0),
            ("/speed", "geometry_msgs/msg/Vector3", 1),
        ]
        assert {channel.name: channel.qos for channel in reader.channels} == {
            "/quiet": (LATCHED, SENSOR),
            "/speed": (SENSOR,),
        }


def test_the_path_may_be_relative_and_have_spaces(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with BagWriter("my runs/first run/") as writer:
        writer.write(RECORD)
    with BagReader("my runs/first run") as reader:
        assert reader.complete
    assert names(tmp_path / "my runs" / "first run") == ["first run_0.mcap", "metadata.yaml"]
