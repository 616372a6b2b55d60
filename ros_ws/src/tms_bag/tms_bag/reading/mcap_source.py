"""One MCAP file of a bag: what is where in it, and its parts."""

from __future__ import annotations

import os
from pathlib import Path

from tms_bag.errors import RecordingError
from tms_bag.reading.block import Block
from tms_bag.reading.frames import MAGIC
from tms_bag.reading.index import FileIndex, Span, block_at, index_file, scan
from tms_bag.reading.packed_file import opened


class McapSource:
    """An open MCAP file. RecordingError if it can't be opened or is none.

    With `salvage` its summary isn't believed; with `may_be_empty` whatever isn't MCAP holds nothing.
    """

    def __init__(self, path: Path, salvage: bool = False, may_be_empty: bool = False) -> None:
        self.path = path
        try:
            self._file = opened(path)
        except OSError as error:
            raise RecordingError(f"{path}: can't be opened ({error.strerror})") from error
        self.size = os.fstat(self._file.fileno()).st_size
        try:
            self.index = self._index(salvage, may_be_empty)
        except OSError as error:
            self._file.close()
            raise RecordingError(f"{path}: can't be read ({error.strerror})") from error
        except BaseException:
            self._file.close()
            raise

    def block(self, span: Span) -> Block:
        """Messages of a part. One of `frames.DAMAGE` if they can't be read."""
        return block_at(self._file, span)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _index(self, salvage: bool, may_be_empty: bool) -> FileIndex:
        magic = self._file.read(len(MAGIC))
        if magic != MAGIC and may_be_empty:
            return FileIndex(unread_bytes=self.size)
        if magic != MAGIC:
            found = "an empty file" if self.size == 0 else f"{self.size} bytes that start with {magic!r}"
            raise RecordingError(
                f"{self.path}: expected an MCAP file, found {found}; there is nothing to read in it"
            )
        return scan(self._file, self.size) if salvage else index_file(self._file, self.size)
