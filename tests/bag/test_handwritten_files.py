"""MCAP files put together byte by byte by the specification, with what libraries seldom write.

https://mcap.dev/spec: all messages are read, or one line says what isn't.
"""

import struct
import zlib

import lz4.frame
import pytest
import zstandard
from tms_bag import BagReader, RecordingError

MAGIC = b"\x89MCAP0\r\n"
TEXT = b"\0\1\0\0\2\0\0\0x\0"  # std_msgs/String "x"


def u16(value):
    return struct.pack("<H", value)


def u32(value):
    return struct.pack("<I", value)


def u64(value):
    return struct.pack("<Q", value)


def text(value):
    return u32(len(value)) + value.encode()


def record(opcode, content):
    return bytes([opcode]) + u64(len(content)) + content


def schema(number):
    definition = b"string data\n"
    return record(
        3, u16(number) + text("std_msgs/msg/String") + text("ros2msg") + u32(len(definition)) + definition
    )


def channel(number, schema_number):
    return record(4, u16(number) + u16(schema_number) + text("/a") + text("cdr") + u32(0))


def message(time, number=1, data=TEXT):
    return record(5, u16(number) + u32(0) + u64(time) + u64(time) + data)


def chunk(content, compression="", times=(0, 0), packed=None, padding=b""):
    pack = {"": bytes, "zstd": zstandard.compress, "lz4": lz4.frame.compress}[compression]
    packed = pack(content) if packed is None else packed
    head = u64(times[0]) + u64(times[1]) + u64(len(content)) + u32(zlib.crc32(content)) + text(compression)
    return record(6, head + u64(len(packed)) + packed + padding)


def whole(body, summary=b"", padding=b""):
    """A file that is closed properly."""
    data = MAGIC + record(1, text("ros2") + text("by hand")) + body + record(15, u32(0))
    start = len(data) if summary else 0
    return data + summary + record(2, u64(start) + u64(0) + u32(0) + padding) + MAGIC


def summarised(*parts):
    """A file whose summary tells of chunks only: parts are bytes, or content, times and index of a chunk."""
    body, indexes, chunks = b"", DEFINED, 0
    place = len(MAGIC) + len(record(1, text("ros2") + text("by hand")))
    for part in parts:
        if isinstance(part, bytes):
            body += part
            continue
        content, times, indexed = part
        start, packed = place + len(body), chunk(content, times=times)
        body += packed
        at, index = place + len(body), b""
        if indexed:  # as if all messages stood at the start: nothing here looks at the offsets
            index = record(7, u16(1) + u32(16) + u64(times[0]) + u64(0))
            body += index
        offsets = u16(1) + u64(at) if indexed else b""
        entry = u64(times[0]) + u64(times[1]) + u64(start) + u64(len(packed)) + u32(len(offsets)) + offsets
        indexes += record(8, entry + u64(len(index)) + text("") + u64(len(content)) + u64(len(content)))
        chunks += 1
    count = 3
    head = u64(count) + u16(1) + u32(1) + u32(0) + u32(0) + u32(chunks) + u64(0) + u64(3)
    return whole(body, indexes + record(11, head + u32(10) + u16(1) + u64(count)))


DEFINED = schema(1) + channel(1, 1)
THREE = message(1) + message(2) + message(3)
UNKNOWN = record(0x42, b"abc") + record(0x80, b"") + record(0xFF, b"q" * 300)
FILES = {
    "unknown_records": whole(UNKNOWN + DEFINED + UNKNOWN + THREE + UNKNOWN),
    "defined_again": whole(DEFINED + message(1) + DEFINED + message(2) + message(3)),
    "schema_number_0_isnt_one": whole(schema(0) + channel(1, 0) + THREE),
    "footer_with_more_to_come": whole(DEFINED + THREE, padding=b"more"),
    "no_header": MAGIC + DEFINED + THREE + record(15, u32(0)) + record(2, bytes(20)) + MAGIC,
    "channel_after_its_messages": whole(chunk(THREE) + chunk(DEFINED)),
    "messages_without_content": whole(DEFINED + b"".join(message(n, data=b"") for n in (1, 2, 3))),
    "latest_time_there_is": whole(DEFINED + message(1) + message(2) + message(2**64 - 1)),
    "indexed": summarised((DEFINED + message(1) + message(2), (1, 2), True), (message(3), (3, 3), True)),
    "loose_ones_before_chunks": summarised(DEFINED + message(1), (message(2) + message(3), (2, 3), True)),
    "loose_ones_after_chunks": summarised((DEFINED + message(1) + message(2), (1, 2), True), message(3)),
    "loose_ones_between_chunks": summarised(
        (DEFINED + message(1), (1, 1), True), message(2), (message(3), (3, 3), False)
    ),
    "a_chunk_the_summary_forgot": summarised(
        (DEFINED + message(1), (1, 1), True), chunk(message(2) + message(3))
    ),
    "time_0_without_message_index": summarised(
        (DEFINED + message(0), (0, 0), False), (message(2) + message(3), (2, 3), False)
    ),
    "chunk_of_definitions": summarised((DEFINED, (0, 0), False), (THREE, (1, 3), True)),
}
for name in ("", "lz4", "zstd"):
    FILES |= {
        f"chunk_{name}": whole(chunk(DEFINED + UNKNOWN + THREE, name)),
        f"chunk_with_more_to_come_{name}": whole(chunk(DEFINED + THREE, name, padding=b"more")),
        f"empty_chunk_{name}": whole(chunk(b"", name) + chunk(DEFINED + THREE, name)),
        f"chunk_of_no_bytes_{name}": whole(chunk(b"", name, packed=b"") + chunk(DEFINED + THREE, name)),
    }


@pytest.mark.parametrize("name", FILES)
def test_all_three_messages_are_read(tmp_path, name):
    path = tmp_path / "it.mcap"
    path.write_bytes(FILES[name])
    with BagReader(path) as bag:
        assert (bag.complete, bag.warnings, bag.message_count) == (True, (), 3)
        found = [record.time_ns for record in bag.records()]
        assert len(found) == 3
        assert (found[0], found[-1]) == (bag.start_ns, bag.end_ns)


def test_messages_of_a_channel_that_nobody_defined_are_counted_aloud(tmp_path):
    path = tmp_path / "it.mcap"
    path.write_bytes(whole(DEFINED + message(1) + message(2, number=7) + message(3, number=7)))
    with BagReader(path) as bag:
        assert len(list(bag.records())) == 1
        assert "2 messages are of channels that the file doesn't define" in bag.warnings[0]


def test_messages_without_a_type_are_told_in_one_line(tmp_path):
    path = tmp_path / "it.mcap"
    path.write_bytes(whole(channel(1, 0) + THREE))
    with BagReader(path) as bag:
        assert len(list(bag.records())) == 3
        with pytest.raises(RecordingError, match="found a topic without schema: /a"):
            bag.columns({"/a": None})


def test_a_file_that_cant_be_read_at_all_is_one_line():
    with pytest.raises(RecordingError, match="can't be read"):
        BagReader("/proc/self/mem")
