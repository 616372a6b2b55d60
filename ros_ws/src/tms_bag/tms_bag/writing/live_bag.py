"""A bag while it is recorded: on the disk within a second; paused, split, or in memory until asked for."""

from __future__ import annotations

import time
from threading import Event, Thread

from tms_bag.record import Record
from tms_bag.writing.recent import RecentRecords
from tms_bag.writing.writer import BagWriter

FLUSH_PERIOD = 0.25  # [s] between handing over to the operating system; with the fsync after it below 1 s


class LiveBag:
    """Takes messages as they arrive. OSError where the disk doesn't take them any more.

    Every FLUSH_PERIOD the chunk is completed and handed to the operating system, which a kill can't undo, and
    a thread calls fsync, which a power failure can't undo. With `recent` nothing is written but the last
    seconds, when `snapshot` is called, into a file of its own each time.
    """

    def __init__(self, writer: BagWriter, recent: RecentRecords | None = None, paused: bool = False) -> None:
        self.writer = writer
        self.recent = recent
        self.paused = paused
        self.left_out = 0  # messages that arrived while paused
        self._flushed = time.monotonic()
        self._failure: OSError | None = None
        self._wake, self._ending = Event(), False
        self._syncing = Thread(target=self._sync, name="fsync", daemon=True)
        writer.__enter__()
        self._syncing.start()

    def take(self, record: Record, arrived_ns: int) -> None:
        """Write a message, or keep it for a snapshot, or leave it out while paused."""
        if self.paused:
            self.left_out += 1
        elif self.recent is not None:
            self.recent.add(record, arrived_ns)
        else:
            self.writer.write(record)

    def flush_when_due(self) -> None:
        """Bring to safety what has been written; to be called often."""
        if self._failure:
            raise self._failure
        if time.monotonic() - self._flushed >= FLUSH_PERIOD:
            self.writer.flush()
            self._flushed = time.monotonic()
            self._wake.set()

    def snapshot(self) -> int:
        """Write what is kept in memory into a file of its own; returns the number of messages."""
        records = self.recent.take_all() if self.recent is not None else []
        self.writer.split()
        for record in records:
            self.writer.write(record)
        self.writer.flush()
        return len(records)

    def close(self) -> None:
        """Finish the bag."""
        self._ending = True
        self._wake.set()
        self._syncing.join()
        self.writer.__exit__(None, None, None)

    def _sync(self) -> None:
        while not self._ending:
            self._wake.wait()
            self._wake.clear()
            try:
                self.writer.sync()
            except OSError as error:
                self._failure = error
                return
