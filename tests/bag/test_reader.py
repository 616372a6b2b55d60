"""Reading: order, intervals, several files, and bags from elsewhere."""

import itertools
import shutil
from pathlib import Path

import pytest
import yaml
from mcap.writer import CompressionType, IndexType, Writer
from tms_bag import BagReader, Record, RecordingError

TOPIC = "/speed"


def make_mcap(path: Path, times: list[int], finish: bool = True, flush_every: int = 10, **options) -> None:
    """An MCAP file as others write it: one topic, the message number as content."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2", library="another")
        schema = writer.register_schema(
            "geometry_msgs/msg/Vector3", "ros2msg", b"float64 x\nfloat64 y\nfloat64 z\n"
        )
        channel = writer.register_channel(TOPIC, "cdr", schema, {"offered_qos_profiles": ""})
        for number, time in enumerate(times):
            writer.add_message(channel, time, number.to_bytes(4, "little"), time + 1)
            if number % flush_every == flush_every - 1:
                writer.flush()
        writer.flush()
        if finish:
            writer.finish()


def numbers(records) -> list[int]:
    return [int.from_bytes(record.data, "little") for record in records]


def test_messages_come_in_the_order_of_log_time_across_overlapping_chunks(tmp_path):
    # Written in chunks of 10 with times that go back and forth far beyond a chunk.
    times = [(number * 37) % 100 for number in range(100)]
    make_mcap(tmp_path / "a.mcap", times)
    with BagReader(tmp_path / "a.mcap") as reader:
        found = list(reader.records())
    assert [record.time_ns for record in found] == sorted(times)
    assert numbers(found) == sorted(range(100), key=lambda number: times[number])
    assert found[0].publish_time_ns == 1


def test_messages_with_the_same_time_stay_in_the_order_of_writing(tmp_path):
    make_mcap(tmp_path / "a.mcap", [5] * 35 + [4] * 5)
    with BagReader(tmp_path / "a.mcap") as reader:
        assert numbers(reader.records()) == [35, 36, 37, 38, 39, *range(35)]


def test_the_interval_is_half_open(tmp_path):
    make_mcap(tmp_path / "a.mcap", list(range(100)))
    with BagReader(tmp_path / "a.mcap") as reader:
        assert numbers(reader.records(start_ns=10, stop_ns=20)) == list(range(10, 20))
        assert numbers(reader.records(start_ns=99)) == [99]
        assert numbers(reader.records(stop_ns=0)) == []
        assert numbers(reader.records(start_ns=20, stop_ns=20)) == []


def test_an_unknown_topic_lists_those_that_are_there(bag):
    with (
        BagReader(bag) as reader,
        pytest.raises(RecordingError, match=r"no topic /nope; there are: /bicycle/speed, "),
    ):
        list(reader.records(["/nope"]))


def test_no_topic_chosen_is_nothing(bag):
    with BagReader(bag) as reader:
        assert list(reader.records([])) == []


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.ZSTD},
        {"use_chunking": False},  # rosbag2's preset fastwrite
        {
            "use_chunking": False,
            "use_statistics": False,
            "index_types": IndexType.NONE,
            "repeat_channels": False,
        },
        {"index_types": IndexType.NONE},
        {"use_statistics": False},
        {"repeat_channels": False, "repeat_schemas": False},
        {"enable_crcs": False},
    ],
    ids=str,
)
@pytest.mark.parametrize("finish", [True, False])
def test_whatever_an_mcap_writer_leaves_out_the_messages_are_found(tmp_path, options, finish):
    times = [(number * 7) % 40 for number in range(40)]
    make_mcap(tmp_path / "a.mcap", times, finish, **options)
    with BagReader(tmp_path / "a.mcap") as reader:
        assert [tuple(topic) for topic in reader.topics] == [(TOPIC, "geometry_msgs/msg/Vector3", 40)]
        assert (reader.start_ns, reader.end_ns, reader.complete) == (0, 39, finish)
        assert [record.time_ns for record in reader.records()] == list(range(40))
        assert numbers(reader.records(start_ns=10, stop_ns=12)) == [times.index(10), times.index(11)]


def test_split_files_are_read_as_one_bag_in_the_order_of_their_numbers(tmp_path):
    for number in range(12):
        make_mcap(tmp_path / f"bag_{number}.mcap", [1000] if number else [999, 1000])
    with BagReader(tmp_path) as reader:
        assert reader.message_count == 13
        assert [record.time_ns for record in reader.records()] == [999] + [1000] * 12
        assert not reader.complete  # there is no metadata.yaml
        order = [file.path.name.rpartition("_")[2] for file in reader._files]
    assert order == [f"{number}.mcap" for number in range(12)]


def metadata_for(folder: Path, **changes) -> None:
    information = {
        "version": 9,
        "storage_identifier": "mcap",
        "relative_file_paths": ["a.mcap"],
        "custom_data": None,
    }
    (folder / "metadata.yaml").write_text(
        yaml.safe_dump({"rosbag2_bagfile_information": information | changes})
    )


@pytest.mark.parametrize(
    "name",
    ["../outside.mcap", "/etc/passwd", "..", ".", "", "sub/a.mcap", "a.mcap/..", "sub/../../outside.mcap"],
)
def test_a_path_that_leaves_the_bag_is_not_opened(tmp_path, name):
    folder = tmp_path / "bag"
    (folder / "sub").mkdir(parents=True)
    for path in (tmp_path / "outside.mcap", folder / "a.mcap", folder / "sub" / "a.mcap"):
        make_mcap(path, [1])
    metadata_for(folder, relative_file_paths=[name])
    with pytest.raises(RecordingError, match="in the folder of the bag"):
        BagReader(folder)


def test_a_link_that_leaves_the_bag_is_not_opened(tmp_path):
    make_mcap(tmp_path / "outside.mcap", [1])
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "a.mcap").symlink_to(tmp_path / "outside.mcap")
    with pytest.raises(RecordingError, match="link to elsewhere"):
        BagReader(folder)


def test_the_old_paths_with_the_name_of_the_folder_are_understood(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    make_mcap(folder / "a.mcap", [1])
    metadata_for(folder, version=3, relative_file_paths=["bag/a.mcap"])
    with BagReader(folder) as reader:
        assert reader.message_count == 1


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"storage_identifier": "tape"}, "ros2 bag convert"),
        ({"compression_mode": "FILE", "compression_format": "lzma"}, "compression_format 'lzma'"),
        ({"relative_file_paths": []}, "list of files"),
        ({"relative_file_paths": [["a"]]}, "list of files"),
        ({"relative_file_paths": "a.mcap"}, "list of files"),
        ({"relative_file_paths": ["gone.mcap"]}, "gone.mcap.* isn't there"),
    ],
)
def test_metadata_that_can_not_be_followed_is_refused(tmp_path, changes, expected):
    make_mcap(tmp_path / "a.mcap", [1])
    metadata_for(tmp_path, **changes)
    with pytest.raises(RecordingError, match=expected):
        BagReader(tmp_path)


@pytest.mark.parametrize(
    "text",
    ["", "- 1", "a: b", "rosbag2_bagfile_information: 3", "{", "\x00", "a: &a [*a]", "[" * 5000, "\xe9" * 9],
)
def test_metadata_that_is_no_metadata_is_refused(tmp_path, text):
    make_mcap(tmp_path / "a.mcap", [1])
    (tmp_path / "metadata.yaml").write_text(text, encoding="latin-1")
    with pytest.raises(RecordingError, match=r"metadata\.yaml: .*repair"):
        BagReader(tmp_path)


@pytest.mark.parametrize("root", ["other", "rosbag2_bagfile_information"])
def test_nested_aliases_do_not_eat_the_memory(tmp_path, root):
    make_mcap(tmp_path / "a.mcap", [1])
    levels = "".join(f"l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 9)}]\n" for n in range(1, 30))
    use = f"{root}: {{storage_identifier: mcap, relative_file_paths: [a.mcap], custom_data: {{x: *l29}}}}\n"
    (tmp_path / "metadata.yaml").write_text("l0: &l0 [x]\n" + levels + use)
    if root == "other":
        with pytest.raises(RecordingError, match="expected the key"):
            BagReader(tmp_path)
    else:
        with BagReader(tmp_path) as reader:
            assert len(reader.custom_data["x"]) < 1000


@pytest.mark.parametrize("what", ["nothing", "folder", "text folder", "fifo", "empty file", "text file"])
def test_what_is_no_bag_is_refused_in_one_clear_text(tmp_path, what):
    import os

    path = tmp_path / "it"
    if what.endswith("folder"):
        path.mkdir()
    if what == "text folder":
        (path / "notes.txt").write_text("x")
    if what == "fifo":
        os.mkfifo(path)
    if what.endswith("file"):
        path.write_text("" if what == "empty file" else "time,speed\n1,2\n")
    with pytest.raises(RecordingError, match=r"it: expected .*found"):
        BagReader(path)


def test_an_empty_file_in_a_split_bag_is_named(tmp_path):
    make_mcap(tmp_path / "bag_0.mcap", [1])
    (tmp_path / "bag_1.mcap").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"bag_1\.mcap: expected an MCAP file, found an empty file"):
        BagReader(tmp_path)


def test_messages_in_another_encoding_are_handed_on_but_not_decoded(tmp_path):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="")
        channel = writer.register_channel(
            "/text", "json", writer.register_schema("text", "jsonschema", b"{}")
        )
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with BagReader(tmp_path / "a.mcap") as reader:
        assert reader.topics[0].count == 1
        assert [record.data for record in reader.records()] == [b"{}"]
        with pytest.raises(RecordingError, match="encoding cdr, found 'json' on /text"):
            reader.columns({"/text": None})


def test_a_folder_is_read_without_its_metadata(bag, run, tmp_path):
    (bag / "metadata.yaml").unlink()
    with BagReader(bag) as reader:
        assert list(reader.records()) == run.records()
        assert reader.custom_data["seed"] == "1"  # from the record inside the file
        assert not reader.complete


def test_the_mcap_file_alone_is_read(bag, run, tmp_path):
    shutil.copy(bag / "bag_0.mcap", tmp_path / "alone")
    with BagReader(tmp_path / "alone") as reader:
        assert list(reader.records()) == run.records()
        assert reader.complete


def test_two_readings_at_once_do_not_disturb_each_other(bag, run):
    with BagReader(bag) as reader:
        pairs = list(itertools.zip_longest(reader.records(), reader.records(["/imu/data_raw"])))
    assert [first for first, _ in pairs] == run.records()
    second: list[Record] = [record for _, record in pairs if record]
    assert second == [record for record in run.records() if record.topic == "/imu/data_raw"]


def test_files_of_two_bags_in_a_folder_are_not_taken_for_one(tmp_path):
    make_mcap(tmp_path / "monday_0.mcap", [1, 2])
    make_mcap(tmp_path / "tuesday_0.mcap", [3])
    with pytest.raises(RecordingError, match="files of several: monday, tuesday; give one of the files"):
        BagReader(tmp_path)


def test_a_path_longer_than_the_system_allows_is_one_short_line():
    with pytest.raises(RecordingError, match="can't be read") as found:
        BagReader("a" * 5000)
    assert len(str(found.value)) < 300
