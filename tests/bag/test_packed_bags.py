"""Bags that rosbag2 packed itself, files or messages: read as any other, and nothing left behind."""

import os
import signal
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from rosbags.rosbag2 import Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore
from tms_bag import BagReader, BagWriter, RecordingError, read_recording
from tms_bag.reading.packed_messages import MOST_UNPACKED
from tms_bag.writing.repair import repair


def pack(path: Path, known_size: bool = True) -> Path:
    """As rosbag2 does it, with the size told, or as the zstd command does it with a pipe, without."""
    compressor = zstandard.ZstdCompressor(write_content_size=known_size)
    packed = path.with_name(path.name + ".zstd")
    packed.write_bytes(compressor.compress(path.read_bytes()))
    path.unlink()
    return packed


def change_metadata(bag: Path, **changes) -> None:
    document = yaml.safe_load((bag / "metadata.yaml").read_text())
    document["rosbag2_bagfile_information"] |= changes
    (bag / "metadata.yaml").write_text(yaml.safe_dump(document))


@pytest.fixture
def temporary(tmp_path, monkeypatch) -> Path:
    """Where temporary files go."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.fixture
def packed_bag(bag) -> Path:
    """The file of a bag packed as a whole."""
    packed = pack(next(bag.glob("*.mcap")))
    change_metadata(
        bag, compression_mode="FILE", compression_format="zstd", relative_file_paths=[packed.name]
    )
    return bag


def written_by_rosbags(path: Path, run, plugin: StoragePlugin, mode: CompressionMode) -> Path:
    """All records of a run that rosbags knows the types of."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=8, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for record in known_records(run):
            if record.topic not in connections:
                connections[record.topic] = writer.add_connection(record.topic, record.type, typestore=store)
            writer.write(connections[record.topic], record.time_ns, record.data)
    return path


def known_records(run):
    return [record for record in run.records() if not record.type.startswith("tms_msgs")]


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("metadata", [True, False])
def test_what_another_library_packs_is_read(tmp_path, run, temporary, plugin, mode, metadata):
    path = written_by_rosbags(tmp_path / "bag", run, plugin, mode)
    if not metadata:
        (path / "metadata.yaml").unlink()
    with BagReader(path) as bag:
        expected = known_records(run)
        assert bag.message_count == len(expected)
        found = [(record.topic, record.time_ns, record.data) for record in bag.records()]
        assert found == [(record.topic, record.time_ns, record.data) for record in expected]
        assert list(temporary.iterdir()) == []  # no name, from the start
    imu = read_recording(path).imu
    assert np.array_equal(imu.angular_velocity, run.imu.angular_velocity)


@pytest.mark.parametrize("known_size", [True, False])
def test_a_packed_file_alone_is_a_bag(bag, run, known_size, temporary):
    packed = pack(next(bag.glob("*.mcap")), known_size)
    with BagReader(packed) as reader:
        assert list(reader.records()) == run.records()
        assert reader.complete
    assert list(temporary.iterdir()) == []


def test_a_packed_bag_becomes_one_that_isnt(packed_bag, run, tmp_path):
    repair(packed_bag, tmp_path / "new")
    with BagReader(tmp_path / "new") as reader:
        assert list(reader.records()) == run.records()
    assert [path.name for path in sorted((tmp_path / "new").iterdir())] == ["metadata.yaml", "new_0.mcap"]


def test_a_file_that_was_unpacked_by_hand_is_the_same(packed_bag, run):
    """Players leave it beside the packed one; people take the packed one away."""
    packed = next(packed_bag.glob("*.zstd"))
    packed.with_suffix("").write_bytes(zstandard.decompress(packed.read_bytes()))
    for gone in (None, "metadata.yaml", packed.name):
        if gone:
            (packed_bag / gone).unlink()
        with BagReader(packed_bag) as reader:
            assert reader.message_count == len(run.records())


@pytest.mark.parametrize("version", [3, 4])
def test_paths_of_old_bags_name_a_folder_that_may_have_been_renamed(packed_bag, run, version):
    packed = next(packed_bag.glob("*.zstd"))
    change_metadata(packed_bag, version=version, relative_file_paths=[f"as_recorded/{packed.name}"])
    with BagReader(packed_bag) as reader:
        assert reader.message_count == len(run.records())
    change_metadata(packed_bag, version=9)
    with pytest.raises(RecordingError, match="in the folder of the bag"):
        BagReader(packed_bag)


def test_another_way_to_pack_is_refused(packed_bag):
    change_metadata(packed_bag, compression_format="brotli")
    with pytest.raises(RecordingError, match="found compression_format 'brotli'; convert the bag"):
        BagReader(packed_bag)


@pytest.mark.parametrize("share", [0.2, 0.6, 0.95])
def test_a_packed_file_cut_short_is_read_as_far_as_it_goes(tmp_path, write_bag, make_run, temporary, share):
    records = make_run(5000).records()
    bag = write_bag(tmp_path / "long", records)
    packed = pack(next(bag.glob("*.mcap")))
    packed.write_bytes(packed.read_bytes()[: int(share * packed.stat().st_size)])
    with BagReader(packed) as reader:
        assert "unfinished" in reader.warnings[0]
        found = list(reader.records())
    assert found == records[: len(found)]
    assert len(found) > (share - 0.1) * len(records)


@pytest.mark.parametrize("name", ["bomb.mcap.zstd", "bomb.db3.zstd"])
def test_a_file_that_unpacks_to_what_no_recording_does_is_refused(tmp_path, temporary, refused, name):
    compressor = zstandard.ZstdCompressor().compressobj()
    packed = b"".join(compressor.compress(bytes(2**20)) for _ in range(256)) + compressor.flush()
    (tmp_path / name).write_bytes(packed)
    assert "unpacks to more than 1000 times its size" in refused("tms_bag", "info", tmp_path / name)
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("name", ["it.mcap.zstd", "it.db3.zstd"])
@pytest.mark.parametrize("content", [b"", b"no zstd at all", zstandard.compress(b"no recording")])
def test_a_packed_file_that_holds_no_recording_is_one_line(tmp_path, refused, name, content):
    (tmp_path / name).write_bytes(content)
    assert "expected an" in refused("tms_bag", "info", tmp_path / name)


def test_no_room_for_the_unpacked_file_is_one_line(packed_bag, refused, monkeypatch):
    """A disk that is always full stands in the place of the temporary file."""
    monkeypatch.setattr("tms_bag.reading.packed_file.TemporaryFile", partial(Path("/dev/full").open, "r+b"))
    assert "No space left on device); set TMPDIR to a folder with room" in refused(
        "tms_bag", "info", packed_bag
    )


def frame_that_says(size: int) -> bytes:
    """A zstd frame with a size of 8 bytes in its head, and nothing behind it."""
    return b"\x28\xb5\x2f\xfd" + bytes([0xE0]) + size.to_bytes(8, "little") + b"\x01\x00\x00"


def packed_zeros(size: int, known_size: bool = True) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=known_size).compress(bytes(size))


@pytest.mark.parametrize(
    "make",
    [
        partial(frame_that_says, 2**40),
        partial(frame_that_says, 2**63),
        partial(frame_that_says, 1000),
        partial(bytes, b"\x28\xb5\x2f\xfd"),
        partial(packed_zeros, MOST_UNPACKED + 1),
        partial(packed_zeros, MOST_UNPACKED + 1, known_size=False),
    ],
    ids=["2^40", "2^63", "1000", "nothing", "bomb", "bomb of unknown size"],
)
def test_a_message_that_cant_be_unpacked_stays_as_it_is_and_is_no_message(tmp_path, run, make):
    data = make()
    from tms_bag import Record

    record = next(record for record in run.records() if record.topic == "/imu/data_raw")
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(Record(record.topic, record.type, 1, zstandard.compress(record.data)))
        writer.write(Record(record.topic, record.type, 2, data))
    with BagReader(tmp_path / "bag") as bag:
        assert [found.data for found in bag.records()] == [record.data, data]
        with pytest.raises(RecordingError, match="/imu/data_raw at 2 ns: expected a sensor_msgs/msg/Imu"):
            bag.columns({"/imu/data_raw": None})


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_nothing_is_left_behind_when_the_program_is_ended(tmp_path, run, plugin, number):
    path = written_by_rosbags(tmp_path / "bag", run, plugin, CompressionMode.FILE)
    (tmp_path / "temporary").mkdir()
    program = """
import signal, sys, time
from tms_bag import BagReader
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a suite in the background
with BagReader(sys.argv[1]) as bag:
    records = bag.records()
    next(records)
    print("reading", flush=True)
    while True:
        time.sleep(1)
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program, path],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"TMPDIR": str(tmp_path / "temporary")},
    )
    assert process.stdout is not None
    with process.stdout:
        assert process.stdout.readline() == b"reading\n"
    process.send_signal(number)
    process.wait()
    assert list((tmp_path / "temporary").iterdir()) == []
