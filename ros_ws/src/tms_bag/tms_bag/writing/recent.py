"""The last seconds of what has arrived, kept in memory until somebody asks for them."""

from __future__ import annotations

from collections import deque

from tms_bag.record import Record


class RecentRecords:
    """Keeps records that arrived within a duration [s] before the newest, and not more than `size` bytes."""

    def __init__(self, duration: float, size: int) -> None:
        self._duration_ns, self._size = round(duration * 1e9), size
        self._records: deque[tuple[int, Record]] = deque()
        self._bytes = 0

    @property
    def bytes(self) -> int:
        """Bytes of message data that are kept."""
        return self._bytes

    def add(self, record: Record, arrived_ns: int) -> None:
        """Keep a record, let go of what is too old or too much."""
        self._records.append((arrived_ns, record))
        self._bytes += len(record.data)
        while self._records[0][0] < arrived_ns - self._duration_ns or self._bytes > self._size:
            self._bytes -= len(self._records.popleft()[1].data)
            if not self._records:
                return

    def take_all(self) -> list[Record]:
        """What is kept, in the order of arrival; nothing is kept afterwards."""
        records = [record for _, record in self._records]
        self._records.clear()
        self._bytes = 0
        return records
