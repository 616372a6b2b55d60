"""Whatever is wrong with a file, it is read as far as it goes or refused in one text: no crash, no hang."""

import random
import resource
import struct
from contextlib import suppress

import lz4.frame
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk
from tms_bag import BagReader, RecordingError
from tms_bag.reading.frames import MAGIC
from tms_bag.reading.index import scan

SETTINGS = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    derandomize=True,
)


@pytest.fixture
def content(bag) -> bytes:
    return (bag / "bag_0.mcap").read_bytes()


def read_all(path) -> list:
    with BagReader(path) as reader:
        return list(reader.records())


@SETTINGS
@given(data=st.data())
def test_a_file_cut_anywhere_gives_a_beginning_of_it(tmp_path, run, unfinished_bag, data):
    content = next(unfinished_bag.glob("*.mcap")).read_bytes()
    length = data.draw(st.integers(0, len(content)))
    path = tmp_path / "cut.mcap"
    path.write_bytes(content[:length])
    if length < len(MAGIC):
        with pytest.raises(RecordingError, match="expected an MCAP file"):
            read_all(path)
        return
    found = read_all(path)
    assert found == run.records()[: len(found)]
    with BagReader(path) as reader:
        assert len(found) % 100 == reader.indexes[0].saved % 100  # whole chunks, and of the one that is cut
    if length == len(content):
        assert len(found) == len(run.records()) // 100 * 100


def test_each_chunk_is_found_as_soon_as_its_last_byte_is_there(tmp_path, unfinished_bag):
    content = next(unfinished_bag.glob("*.mcap")).read_bytes()
    counts = []
    path = tmp_path / "cut.mcap"
    for length in range(len(MAGIC), len(content), 997):
        path.write_bytes(content[:length])
        with BagReader(path) as reader:
            counts.append(reader.message_count)
            assert not reader.complete
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] >= 1000


@SETTINGS
@given(data=st.data())
def test_a_finished_file_cut_anywhere_gives_a_beginning_of_it(tmp_path, run, content, data):
    length = data.draw(st.integers(len(MAGIC), len(content) - 1))
    path = tmp_path / "cut.mcap"
    path.write_bytes(content[:length])
    with BagReader(path) as reader:
        found = list(reader.records())
        assert not reader.complete
    assert found == run.records()[: len(found)]


@SETTINGS
@given(data=st.data())
def test_wrong_bytes_anywhere_never_give_a_message_that_was_not_written(tmp_path, run, content, data):
    written = set(run.records())
    damaged = bytearray(content)
    for _ in range(data.draw(st.integers(1, 5))):
        place = data.draw(st.integers(0, len(content) - 1))
        damaged[place] = data.draw(st.integers(0, 255))
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damaged)
    for salvage in (False, True):
        with suppress(RecordingError), BagReader(path, salvage=salvage) as reader:
            assert set(reader.records()) <= written


@pytest.mark.parametrize("seed", range(5))
def test_noise_behind_the_magic_bytes_is_an_empty_bag(tmp_path, seed):
    path = tmp_path / "noise.mcap"
    path.write_bytes(MAGIC + random.Random(seed).randbytes(100_000))
    with BagReader(path) as reader:
        assert (reader.message_count, reader.complete, list(reader.records())) == (0, False, [])


def chunk(data: bytes, size: int, compression: str) -> bytes:
    builder = RecordBuilder()
    Chunk(
        compression,
        data,
        message_end_time=1,
        message_start_time=1,
        uncompressed_crc=0,
        uncompressed_size=size,
    ).write(builder)
    return builder.end()


def memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # [KiB]


@pytest.mark.parametrize("said", [10, 2**29, 2**40, 2**63])
@pytest.mark.parametrize("compression", ["zstd", "lz4", "", "other"])
def test_a_chunk_that_unpacks_to_another_size_than_it_says_is_left_out(tmp_path, said, compression):
    packed = {"zstd": zstandard.compress(bytes(2**26)), "lz4": lz4.frame.compress(bytes(2**20))}.get(
        compression, b"xx"
    )
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MAGIC + chunk(packed, said, compression))
    before = memory()
    with BagReader(path) as reader:
        assert (reader.message_count, reader.indexes[0].damaged_chunks) == (0, 1)
    assert memory() - before < 2 * 2**20  # less than 2 GiB even for a chunk that may have 512 MiB


def test_a_file_that_becomes_shorter_meanwhile_is_read_as_far_as_it_is_whole(tmp_path, content):
    path = tmp_path / "shorter.mcap"
    for length in (len(MAGIC), len(MAGIC) + 1, len(content) // 2):
        path.write_bytes(content[:length])
        with path.open("rb") as file:
            whole = [span for span in scan(file, length).spans if not span.begun]
            assert scan(file, len(content)).spans == whole


@pytest.mark.parametrize("opcode", [Opcode.CHUNK, Opcode.MESSAGE, Opcode.CHANNEL, 0x7F, 0xFF])
@pytest.mark.parametrize("length", [2**31, 2**62, 2**64 - 1])
def test_a_record_longer_than_the_file_ends_the_reading(tmp_path, opcode, length):
    path = tmp_path / "long.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", opcode, length) + bytes(1000))
    with BagReader(path) as reader:
        assert reader.message_count == 0
        assert reader.indexes[0].unread_bytes == 1009


def test_a_damaged_chunk_in_a_finished_file_says_how_to_save_the_rest(bag, content):
    place = len(content) // 2
    (bag / "bag_0.mcap").write_bytes(content[:place] + bytes(8) + content[place + 8 :])
    with BagReader(bag) as reader, pytest.raises(RecordingError, match=r"damaged .*tms bag repair .* -o NEW"):
        list(reader.records())
