"""One sqlite3 file of a bag, as ROS 2 before Iron recorded by default; read by the `rosbags` library."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader

from tms_bag.channel import Channel, installed_channel
from tms_bag.errors import RecordingError
from tms_bag.reading.block import Block
from tms_bag.reading.db3_file import left_beside, with_name
from tms_bag.reading.frames import LARGEST_CHUNK, Frame
from tms_bag.reading.index import FileIndex, Span

PART, PART_SIZE = 4096, 2**22  # messages and [bytes] in a part, on the average
MOST_READ = 4 * LARGEST_CHUNK  # [bytes] of a part, whose messages may come in bursts
_LENGTH_LIMIT = 0  # SQLITE_LIMIT_LENGTH
_SQLITE = 0  # where an MCAP file's opcode stands in a Frame


class Db3Source:
    """An open sqlite3 file. RecordingError if it can't be opened or is none."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = Lock()  # parts may be read in advance by another thread
        try:
            self.size, self._reader = with_name(path, _open)
            self.index = self._index()
        except RecordingError:
            raise
        except Exception as error:  # whatever sqlite and rosbags find in a file that is none
            raise RecordingError(
                f"{path}: expected an sqlite3 file of rosbag2, found another one or a damaged one"
                f" ({' '.join(str(error).split())[:200]})"
            ) from error

    def block(self, span: Span) -> Block:
        """Messages of a part. ValueError if they can't be read."""
        found, size = [], 0
        with self._lock:
            try:
                messages = self._reader.messages(self._reader.connections, span.start_ns, span.end_ns + 1)
                for connection, time, data in messages:
                    found.append((connection.id, time, bytes(data)))
                    size += len(data)
                    if size > MOST_READ and span.start_ns < span.end_ns:
                        raise ValueError(f"more than {MOST_READ} bytes in {span.end_ns - span.start_ns} ns")
            except Exception as error:
                raise ValueError(" ".join(str(error).split())[:200]) from error
        sizes = np.array([len(data) for _, _, data in found], np.int64)
        times = np.array([time for _, time, _ in found], np.uint64)
        return Block(
            content=b"".join(data for _, _, data in found),
            start=np.cumsum(sizes) - sizes,
            size=sizes,
            channel=np.array([number for number, _, _ in found], np.uint16),
            log_time=times,
            publish_time=times,
        )

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def _index(self) -> FileIndex:
        reader = self._reader
        index = FileIndex(complete=not left_beside(self.path))
        for connection in reader.connections:
            index.channels[connection.id] = _channel(connection)
            index.counts[connection.id] = connection.msgcount
        if reader.message_count:
            if reader.duration <= 0:
                raise ValueError("its messages end before they begin")
            parts = math.ceil(max(reader.message_count / PART, self.size / PART_SIZE))
            parts = min(parts, max(reader.duration, 1), 2**20)
            edges = [reader.start_time + reader.duration * part // parts for part in range(parts + 1)]
            index.spans = [
                Span(Frame(_SQLITE, number, number), first, last - 1, loose=False)
                for number, (first, last) in enumerate(pairwise(edges))
            ]
        return index


def _open(path: Path) -> tuple[int, Reader]:
    """Size [bytes] and reader of an sqlite3 file; its name isn't needed any more."""
    reader = Reader(path)
    reader.open()
    storage: Any = reader.storage
    if hasattr(storage.dbconn, "limit"):  # a text or a message never is as long as a file may say
        storage.dbconn.limit(_LENGTH_LIMIT, LARGEST_CHUNK)
    return path.stat().st_size, reader


def _channel(connection: Any) -> Channel:
    """With the definition of the type in the file, else the one installed here, else none."""
    text, encoding = connection.msgdef.data, connection.ext.serialization_format
    schema_encoding = {"MSG": "ros2msg", "IDL": "ros2idl"}.get(connection.msgdef.format.name, "")
    if text:
        return Channel(
            connection.topic,
            connection.msgtype,
            (),
            text.encode(),
            schema_encoding,
            connection.digest,
            encoding,
        )
    try:
        return installed_channel(connection.topic, connection.msgtype, ())
    except RecordingError:
        return Channel(connection.topic, connection.msgtype, (), b"", "", "", encoding)
