"""A file that ends in the middle of a chunk: the messages before the cut are read and saved."""

import struct
import zlib
from io import BytesIO

import lz4.frame
import pytest
import zstandard
from mcap.exceptions import McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader
from tms_bag import BagReader, read_recording
from tms_bag.reading.frames import MAGIC
from tms_bag.reading.index import scan
from tms_bag.writing.repair import repair

COUNT = 2000
HEAD = struct.Struct("<QQQII")
PACK = {
    "": bytes,
    "zstd": zstandard.compress,
    "lz4": lz4.frame.compress,
}
UNPACK = {
    "": bytes,
    "zstd": lambda packed: zstandard.ZstdDecompressor().decompressobj().decompress(packed),
    "lz4": lambda packed: lz4.frame.LZ4FrameDecompressor().decompress(packed),
}


@pytest.fixture(scope="module")
def content(tmp_path_factory, make_run, write_bag) -> bytes:
    """What a chunk of all messages holds."""
    records = make_run(COUNT).records()
    bag = write_bag(tmp_path_factory.mktemp("bag") / "bag", records, preset="fastwrite")
    data = next(bag.glob("*.mcap")).read_bytes()
    place = len(MAGIC)
    kept = b""
    while data[place] != 0x0F:  # the end of the data
        (length,) = struct.unpack_from("<Q", data, place + 1)
        if data[place] in (0x03, 0x04, 0x05):
            kept += data[place : place + 9 + length]
        place += 9 + length
    return kept


def chunk(content: bytes, compression: str, times=None, size=None, checksum=None) -> bytes:
    packed = PACK[compression](content)
    found = messages_in(content)
    first, last = times or (min(m.log_time for m in found), max(m.log_time for m in found))
    checksum = zlib.crc32(content) if checksum is None else checksum
    head = HEAD.pack(first, last, len(content) if size is None else size, checksum, len(compression))
    record = head + compression.encode() + struct.pack("<Q", len(packed)) + packed
    return b"\x06" + struct.pack("<Q", len(record)) + record


def messages_in(content: bytes) -> list[Message]:
    """As far as the library of the MCAP project reads them."""
    found = []
    try:
        for record in StreamReader(BytesIO(MAGIC + content), validate_crcs=False).records:
            if isinstance(record, Message):
                found.append(record)
    except (McapError, struct.error):
        pass
    return found


def read(path):
    with BagReader(path) as bag:
        (index,) = bag.indexes
        found = list(bag.records())
        assert index.saved == len(found) == bag.message_count
        assert not bag.complete
        return [(record.time_ns, record.data) for record in found], bag.warnings[0]


@pytest.mark.parametrize("share", [0.05, 0.3, 0.7, 0.99])
@pytest.mark.parametrize("compression", PACK)
def test_messages_before_the_cut_are_those_that_the_unpacked_part_holds(
    tmp_path, content, compression, share
):
    whole = chunk(content, compression)
    cut = whole[: int(share * len(whole))]
    path = tmp_path / "cut.mcap"
    path.write_bytes(MAGIC + cut)
    head = 9 + HEAD.size + len(compression) + 8
    expected = [(m.log_time, m.data) for m in messages_in(UNPACK[compression](cut[head:]))]
    found, warning = read(path)
    assert found == sorted(expected, key=lambda entry: entry[0])
    assert f"{len(cut)} bytes at its end are an incomplete part" in warning
    if compression == "" or share > 0.3:
        assert len(found) > (share - 0.25) * len(messages_in(content))
        assert f"{len(found)} messages saved from it" in warning


@pytest.mark.parametrize("compression", PACK)
def test_repair_saves_what_a_bag_of_one_cut_chunk_holds(tmp_path, content, compression, command):
    whole = chunk(content, compression)
    path = tmp_path / "cut.mcap"
    path.write_bytes(MAGIC + whole[: int(0.8 * len(whole))])
    found, _ = read(path)
    done = repair(path, tmp_path / "new")
    assert done.saved == done.message_count == len(found) > 0
    imu = read_recording(tmp_path / "new").imu
    assert imu.time_ns.size > COUNT // 2
    answer = command("tms_bag", "repair", path, "-o", tmp_path / "again")
    assert f"{len(found)} messages saved from it" in answer.out


def test_a_message_whose_time_the_chunk_does_not_know_ends_the_reading(tmp_path, content):
    """As when other bytes than those that were written stand there."""
    times = sorted(m.log_time for m in messages_in(content))
    last = times[len(times) // 3]
    path = tmp_path / "cut.mcap"
    path.write_bytes(MAGIC + chunk(content, "", times=(times[0], last))[:-5])
    found, _ = read(path)
    assert found == [(m.log_time, m.data) for m in messages_in(content) if m.log_time <= last]


@pytest.mark.parametrize("times", [(0, 0), (2**64 - 1, 0)])
def test_a_chunk_whose_writer_fills_its_head_in_at_the_end(tmp_path, content, times):
    """Some writers put sizes, times and checksum there when the chunk is complete."""
    data = bytearray(chunk(content, "zstd", times=times, size=2**64 - 1, checksum=2**32 - 1)[:-20])
    data[1:9] = b"\xff" * 8
    place = 9 + HEAD.size + len("zstd")
    data[place : place + 8] = b"\xff" * 8
    path = tmp_path / "cut.mcap"
    path.write_bytes(MAGIC + data)
    assert len(read(path)[0]) > COUNT


def test_pages_that_a_power_failure_left_empty_are_no_messages(tmp_path, content):
    whole = chunk(content, "")
    path = tmp_path / "cut.mcap"
    path.write_bytes(MAGIC + whole[: len(whole) // 2] + bytes(len(whole) // 2 - 4096))
    found, _ = read(path)
    assert found == [(m.log_time, m.data) for m in messages_in(content)][: len(found)]
    assert len(found) > 0.4 * len(messages_in(content))


@pytest.mark.parametrize(
    "record",
    [
        b"",
        b"\x00" * 10,
        HEAD.pack(1, 2, 100, 0, 2**32 - 1) + b"zstd",
        HEAD.pack(1, 2, 100, 0, 4) + b"zstd" + bytes(8) + b"no zstd",
        HEAD.pack(1, 2, 100, 0, 3) + b"lz4" + bytes(8) + b"no lz4 at all",
        HEAD.pack(1, 2, 100, 0, 2) + b"xz" + bytes(8),
        HEAD.pack(1, 2, 4, 99, 0) + bytes(8) + b"abcdef",
    ],
    ids=["nothing", "zeros", "name", "zstd", "lz4", "unknown", "checksum"],
)
def test_the_begin_of_a_chunk_that_is_none_gives_nothing(tmp_path, record):
    path = tmp_path / "cut.mcap"
    path.write_bytes(MAGIC + b"\x06" + struct.pack("<Q", 10**6) + record)
    with path.open("rb") as file:
        index = scan(file, path.stat().st_size)
    assert (index.spans, index.saved, index.unread_bytes) == ([], 0, 9 + len(record))


def test_a_chunk_of_zeros_packed_to_nearly_nothing_is_unpacked_as_far_as_it_says(tmp_path):
    packed = zstandard.compress(bytes(2**28))
    record = HEAD.pack(1, 2, 2**64 - 1, 0, 4) + b"zstd" + struct.pack("<Q", 10**9) + packed
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MAGIC + b"\x06" + struct.pack("<Q", 10**9) + record)
    with BagReader(path) as bag:
        assert bag.message_count == 0
