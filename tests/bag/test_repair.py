"""Repair: a clean bag that others read too, and nothing of the original lost."""

import dataclasses
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.typesys import Stores, get_typestore
from tms_bag import BagReader, BagWriter, RecordingError
from tms_bag.writing.repair import repair


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_an_unfinished_bag_becomes_one_that_rosbags_reads(unfinished_bag, run):
    store = get_typestore(Stores.ROS2_JAZZY)
    with (
        pytest.raises(AnyReaderError, match="magic"),
        AnyReader(list(unfinished_bag.glob("*.mcap")), default_typestore=store),
    ):
        pass
    done = repair(unfinished_bag)
    kept = len(run.records()) // 100 * 100
    assert (done.message_count, done.damaged_chunks, done.output) == (kept, 0, unfinished_bag)
    with AnyReader([unfinished_bag], default_typestore=store) as reader:
        assert reader.message_count == kept
        found = sorted((c.topic, time, bytes(data)) for c, time, data in reader.messages())
        extras = [c.ext for c in reader.connections if isinstance(c.ext, ConnectionExtRosbag2)]
    assert found == sorted((r.topic, r.time_ns, r.data) for r in run.records()[:kept])
    assert sorted(ext.offered_qos_profiles[0].depth for ext in extras) == [1, 100, 100, 100, 100, 100]


def test_the_original_is_kept(unfinished_bag):
    before = files(unfinished_bag)
    done = repair(unfinished_bag)
    assert done.original == unfinished_bag.with_name("killed.unrepaired")
    assert files(done.original) == before
    assert sorted(files(unfinished_bag)) == ["killed_0.mcap", "metadata.yaml"]


def test_an_earlier_original_is_not_lost(unfinished_bag):
    before = files(unfinished_bag)
    unfinished_bag.with_name("killed.unrepaired").mkdir()
    with pytest.raises(RecordingError, match="from an earlier repair"):
        repair(unfinished_bag)
    assert files(unfinished_bag) == before


def test_definitions_and_custom_data_are_taken_over_as_they_are(unfinished_bag, tmp_path):
    done = repair(unfinished_bag, tmp_path / "clean")
    with BagReader(unfinished_bag) as old, BagReader(tmp_path / "clean") as new:
        assert new.channels == old.channels
        assert new.custom_data == old.custom_data == {"seed": "1"}
        assert list(new.records()) == list(old.records())
        assert new.complete
    assert done.original is None


def test_topics_of_types_that_are_not_installed_survive(tmp_path, unfinished_bag):
    clean = tmp_path / "foreign"
    with BagReader(unfinished_bag) as old, BagWriter(clean) as writer:
        renamed = {c.name: dataclasses.replace(c, type="elsewhere_msgs/msg/Thing") for c in old.channels}
        for channel in renamed.values():
            writer.add_channel(channel)
        for record in old.records():
            writer.write(dataclasses.replace(record, type="elsewhere_msgs/msg/Thing"))
    (clean / "metadata.yaml").unlink()
    repair(clean, tmp_path / "repaired")
    with BagReader(tmp_path / "repaired") as new:
        assert {topic.type for topic in new.topics} == {"elsewhere_msgs/msg/Thing"}
        assert new.channels == list(renamed.values())


def test_a_damaged_chunk_is_left_out_and_counted(tmp_path, unfinished_bag, run):
    file = next(unfinished_bag.glob("*.mcap"))
    with BagReader(unfinished_bag) as reader:
        span = reader.indexes[0].spans[3]  # messages 300 to 399
    content = bytearray(file.read_bytes())
    middle = (span.frame.start + span.frame.stop) // 2
    content[middle : middle + 4] = b"\xde\xad\xbe\xef"
    file.write_bytes(content)
    done = repair(unfinished_bag)
    assert done.damaged_chunks == 1
    kept = len(run.records()) // 100 * 100
    with BagReader(unfinished_bag) as reader:
        assert list(reader.records()) == run.records()[:300] + run.records()[400:kept]


def test_a_bag_without_or_with_a_broken_metadata_yaml_gets_a_new_one(bag, run):
    (bag / "metadata.yaml").write_text("{")
    done = repair(bag)
    assert (done.message_count, done.damaged_chunks, done.unread_bytes) == (len(run.records()), 0, 0)
    with BagReader(bag) as reader:
        assert reader.complete
        assert list(reader.records()) == run.records()
        assert reader.custom_data["seed"] == "1"


def test_a_complete_bag_is_left_alone(bag):
    before = files(bag)
    done = repair(bag)
    assert (done.output, done.original) == (None, None)
    assert files(bag) == before
    assert [path.name for path in bag.parent.iterdir()] == ["bag"]


def test_split_files_become_one_even_if_the_last_is_empty(tmp_path, bag, run):
    folder = tmp_path / "split"
    folder.mkdir()
    shutil.copy(bag / "bag_0.mcap", folder / "split_0.mcap")
    (folder / "split_1.mcap").write_bytes(b"")
    assert repair(folder).message_count == len(run.records())
    assert sorted(files(folder)) == ["metadata.yaml", "split_0.mcap"]


def test_a_single_file_needs_a_name_for_the_bag(tmp_path, unfinished_bag):
    file = next(unfinished_bag.glob("*.mcap"))
    with pytest.raises(RecordingError, match="say -o NEW_BAG"):
        repair(file)
    repair(file, tmp_path / "clean")
    with BagReader(tmp_path / "clean") as reader:
        assert reader.complete


@pytest.mark.parametrize("content", [b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + bytes(5000)])
def test_where_nothing_can_be_recovered_nothing_is_changed(tmp_path, content):
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "bag_0.mcap").write_bytes(content)
    for output in (None, tmp_path / "out"):
        with pytest.raises(RecordingError, match="expected messages to recover, found none"):
            repair(folder, output)
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    assert files(folder) == {"bag_0.mcap": content}


def test_a_writer_killed_at_any_moment_leaves_what_it_has_flushed(tmp_path):
    # A process writes and flushes; it is killed while it goes on writing.
    program = """
import sys
from tms_bag import BagWriter, Record
with BagWriter(sys.argv[1], live=True) as writer:
    for number in range(10**9):
        data = b"\\0\\1\\0\\0" + number.to_bytes(8, "little")
        writer.write(Record("/n", "std_msgs/msg/UInt64", number, data))
        if number % 1000 == 999:
            writer.flush()
            print(number + 1, flush=True)
"""
    process = subprocess.Popen([sys.executable, "-c", program, str(tmp_path / "bag")], stdout=subprocess.PIPE)
    assert process.stdout is not None
    flushed = [int(process.stdout.readline()) for _ in range(20)][-1]
    process.kill()
    process.wait()
    with BagReader(tmp_path / "bag") as reader:
        times = [record.time_ns for record in reader.records()]
    assert times == list(range(len(times)))
    assert len(times) >= flushed
    assert repair(tmp_path / "bag").message_count == len(times)
