"""Files as the MCAP specification allows them: every record type, with and without what may be left out.

Written record by record, as the conformance files of the MCAP project are: https://mcap.dev/spec
"""

import itertools
import json
import os
import struct
import zlib
from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import StreamReader
from tms_bag import BagReader
from tms_bag.reading.frames import MAGIC
from tms_bag.reading.index import scan

SCHEMA = Schema(1, b"\x04\x05\x06", "c", "Example")
CHANNEL = Channel(1, "example", "a", {"foo": "bar"}, 1)
ATTACHMENT = Attachment(2, 1, "myFile", "application/octet-stream", b"\x01\x02\x03")
METADATA = Metadata("myMetadata", {"foo": "bar"})
FEATURES = (
    "chunked",
    "message_index",
    "statistics",
    "repeated",
    "summary_offsets",
    "indexes",
    "padding",
    "unknown",
)


def record(item, padding: bytes = b"") -> bytes:
    builder = RecordBuilder()
    item.write(builder)
    data = builder.end()
    opcode, length = struct.unpack_from("<BQ", data)
    if opcode in (Opcode.FOOTER, Opcode.MESSAGE, Opcode.CHUNK, Opcode.ATTACHMENT):
        return data  # end with their data, or are of fixed length
    return struct.pack("<BQ", opcode, length + len(padding)) + data[9:] + padding


def packed(compression: str, data: bytes) -> bytes:
    return {"": lambda d: d, "zstd": zstandard.compress, "lz4": lz4.frame.compress}[compression](data)


def conforming(
    messages: int,
    features: frozenset[str],
    compression: str = "",
    extras: bool = False,
    times: Sequence[int] = range(2, 99),
    schemaless: bool = False,
) -> bytes:
    """A file with so many messages, perhaps an attachment and metadata (`extras`)."""
    channel = replace(CHANNEL, schema_id=0) if schemaless else CHANNEL
    schemas = b"" if schemaless else record(SCHEMA, b"\x01\x02\x03" if "padding" in features else b"")
    first, last = (min(times[:messages]), max(times[:messages])) if messages else (0, 0)
    padding = b"\x01\x02\x03" if "padding" in features else b""
    out = BytesIO()
    out.write(MAGIC + record(Header("", ""), padding))
    if "unknown" in features:
        out.write(struct.pack("<BQ", 0x7E, 4) + b"abcd" + struct.pack("<BQ", 0x80, 0))
    definitions = schemas + record(channel, padding) if messages else b""
    content, offsets = definitions, []
    for number in range(messages):
        offsets.append((times[number], len(content)))
        content += record(Message(1, times[number], b"\x01\x02\x03", 1, 10 + number))
    summary: list[bytes] = []
    if messages and "chunked" in features:
        start = out.tell()
        chunk = Chunk(
            compression, packed(compression, content), last, first, zlib.crc32(content), len(content)
        )
        out.write(record(chunk))
        length, at = out.tell() - start, out.tell()
        if "message_index" in features:
            out.write(record(MessageIndex(1, offsets), padding))
        if "indexes" in features:
            index_offsets = {1: at} if "message_index" in features else {}
            summary.append(
                record(
                    ChunkIndex(
                        length, start, compression, len(chunk.data), last, out.tell() - at,
                        index_offsets, first, len(content),
                    ),
                    padding,
                )
            )  # fmt: skip
    else:
        out.write(content)
    if extras:
        for item, opcode in ((ATTACHMENT, "a"), (METADATA, "m")):
            at = out.tell()
            out.write(record(item, padding))
            if "indexes" in features and opcode == "a":
                length = out.tell() - at
                summary.append(record(AttachmentIndex(at, length, 1, 2, 3, "myFile", "x"), padding))
            elif "indexes" in features:
                summary.append(record(MetadataIndex(at, out.tell() - at, "myMetadata"), padding))
    out.write(record(DataEnd(0), padding))
    if "repeated" in features and messages:
        summary = [*([schemas] if schemas else []), record(channel, padding), *summary]
    if "statistics" in features:
        counts = {1: messages} if messages else {}
        chunks = int(bool(messages) and "chunked" in features)
        summary.append(
            record(
                Statistics(
                    int(extras), int(bool(messages)), counts, chunks, messages, last,
                    int(extras), first, int(bool(schemas and messages)),
                ),
                padding,
            )
        )  # fmt: skip
    return out.getvalue() + _tail(out.tell(), summary, "summary_offsets" in features, padding)


def _tail(start: int, summary: list[bytes], with_offsets: bool, padding: bytes) -> bytes:
    data, offsets, at = b"".join(summary), b"", start
    if with_offsets:
        for item in summary:
            offsets += record(SummaryOffset(item[0], at, len(item)), padding)
            at += len(item)
    footer = Footer(start if summary else 0, start + len(data) if offsets else 0, 0)
    checked = data + offsets + record(footer)[:-4]
    footer = Footer(footer.summary_start, footer.summary_offset_start, zlib.crc32(checked) if summary else 0)
    return data + offsets + record(footer) + MAGIC


def combinations():
    for count in range(len(FEATURES) + 1):
        for chosen in itertools.combinations(FEATURES, count):
            yield frozenset(chosen)


@pytest.mark.parametrize("messages", [0, 1, 10])
def test_every_combination_of_what_a_file_may_hold_or_leave_out(tmp_path, messages):
    path = tmp_path / "it.mcap"
    for features in combinations():
        for extras, compression in ((False, ""), (True, "zstd"), (True, "lz4")):
            path.write_bytes(conforming(messages, features, compression, extras))
            with BagReader(path) as bag:
                what = sorted(features), extras, compression
                assert bag.complete, what
                assert bag.warnings == ()
                assert bag.message_count == messages, what
                assert [tuple(topic) for topic in bag.topics] == [("example", "Example", messages)] * bool(
                    messages
                )
                found = [(r.time_ns, r.publish_time_ns, r.data) for r in bag.records()]
            assert found == [(n + 2, 1, b"\x01\x02\x03") for n in range(messages)], what


@pytest.mark.parametrize("schemaless", [False, True])
def test_messages_out_of_order_and_of_time_0_come_in_order_and_equal_times_as_written(tmp_path, schemaless):
    path = tmp_path / "it.mcap"
    times = (0, 2, 1, 3, 3, 5, 4, 7, 8, 9)
    for features in combinations():
        path.write_bytes(conforming(10, features, times=times, schemaless=schemaless))
        with BagReader(path) as bag:
            assert (bag.complete, bag.message_count) == (True, 10), sorted(features)
            assert bag.topics[0].type == ("" if schemaless else "Example")
            assert [r.time_ns for r in bag.records()] == sorted(times), sorted(features)
            assert [r.time_ns for r in bag.records(start_ns=3, stop_ns=5)] == [3, 3, 4]


@pytest.fixture(scope="module")
def their_files() -> list[Path]:
    """The conformance files of the MCAP project, which aren't part of this one."""
    folder = os.environ.get("TMS_MCAP_CONFORMANCE", "")
    files = sorted(Path(folder).rglob("*.mcap")) if folder else []
    files = [path for path in files if path.with_suffix(".json").is_file()]
    if not files:
        pytest.skip(
            "no conformance files of the MCAP project here (tests/conformance/data of its repository, with"
            " Git LFS); say where with TMS_MCAP_CONFORMANCE"
        )
    return files


def test_the_files_of_the_mcap_project_are_read_as_their_json_tells(their_files):
    for path in their_files:
        document = json.loads(path.with_suffix(".json").read_text())
        described = [(entry["type"], dict(entry["fields"])) for entry in document["records"]]
        expected = sorted(
            (
                (int(each["log_time"]), int(each["publish_time"]), bytes(map(int, each["data"])))
                for kind, each in described
                if kind == "Message"
            ),
            key=lambda message: message[0],
        )
        with BagReader(path) as bag:
            assert (bag.complete, bag.warnings, bag.message_count) == (True, (), len(expected)), path
            assert [(r.time_ns, r.publish_time_ns, r.data) for r in bag.records()] == expected, path


@pytest.mark.parametrize("extras", [False, True])
def test_the_files_are_what_the_library_of_the_mcap_project_takes(extras):
    for features in combinations():
        if {"chunked", "padding"} <= features:
            continue  # which that library's reader doesn't skip inside of chunks
        data = conforming(3, features, "zstd", extras)
        found = [item for item in StreamReader(BytesIO(data)).records if isinstance(item, Message)]
        assert [message.log_time for message in found] == [2, 3, 4], sorted(features)


@pytest.mark.parametrize("features", [frozenset(), frozenset(FEATURES)], ids=["plain", "all"])
def test_what_stands_in_the_file_is_found_without_its_summary_too(tmp_path, features):
    path = tmp_path / "it.mcap"
    path.write_bytes(conforming(5, features, "zstd", extras=True))
    with path.open("rb") as file:
        index = scan(file, path.stat().st_size)
    assert (sum(index.counts.values()), index.complete, index.unread_bytes) == (5, True, 0)


def test_a_channel_without_schema_and_one_nobody_defined(tmp_path):
    path = tmp_path / "it.mcap"
    schemaless = Channel(7, "bare", "raw", {}, 0)
    body = record(Header("", "")) + record(schemaless)
    body += record(Message(7, 5, b"x", 5, 0)) + record(Message(9, 6, b"y", 6, 0)) + record(DataEnd(0))
    path.write_bytes(MAGIC + body + record(Footer(0, 0, 0)) + MAGIC)
    with BagReader(path) as bag:
        assert [tuple(topic) for topic in bag.topics] == [("bare", "", 1)]
        assert [r.data for r in bag.records()] == [b"x"]


def test_info_tells_of_a_file_that_holds_nothing(tmp_path, command):
    path = tmp_path / "it.mcap"
    path.write_bytes(conforming(0, frozenset()))
    answer = command("tms_bag", "info", path, "--json")
    assert answer.code == 0
    document = json.loads(answer.out)
    assert (document["message_count"], document["topics"]) == (0, [])
