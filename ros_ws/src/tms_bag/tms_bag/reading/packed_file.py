"""Files that rosbag2 packed as a whole (`--compression-mode file`): unpacked into a temporary file.

The file has no name: whatever ends the program, nothing is left.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryFile
from typing import BinaryIO

import zstandard

from tms_bag.errors import RecordingError
from tms_bag.reading.frames import LARGEST_WINDOW

SUFFIX = ".zstd"
MOST_TIMES = 1000  # that a file may be larger than it is packed, some MiB aside; recordings are 2 to 50 times
_FREE = 2**26  # [bytes] that may be unpacked from any file
_PIECE = 2**20  # [bytes]


def is_packed(path: Path) -> bool:
    """Whether the name says that the file is packed as a whole."""
    return path.suffix == SUFFIX


def kind_of(path: Path) -> str:
    """What sort of file it is once it is unpacked: .mcap, .db3, or whatever its name ends with."""
    return Path(path.stem).suffix if is_packed(path) else path.suffix


def opened(path: Path) -> BinaryIO:
    """The file, unpacked if it is packed. OSError if it can't be opened.

    RecordingError if it unpacks to more than any recording does, or if there is no room for it.
    """
    if not is_packed(path):
        return path.open("rb")
    file = TemporaryFile()  # noqa: SIM115  # whoever asked for it closes it
    try:
        unpack(path, file)
        file.seek(0)
    except BaseException:
        file.close()
        raise
    return file


def unpack(path: Path, out: BinaryIO) -> None:
    """As far as the packed file goes: one that is cut short is as an unfinished one that isn't packed."""
    with path.open("rb") as packed:
        most = _FREE + MOST_TIMES * path.stat().st_size
        decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW)
        with decompressor.stream_reader(packed, read_across_frames=True) as reader:
            size = 0
            while True:
                try:
                    piece = reader.read(_PIECE)
                except zstandard.ZstdError:
                    return
                size += len(piece)
                if not piece:
                    return
                if size > most:
                    raise RecordingError(
                        f"{path}: expected a packed recording, found a file that unpacks to more than"
                        f" {MOST_TIMES} times its size: not unpacked"
                    )
                _write(path, out, piece)


def _write(path: Path, out: BinaryIO, piece: bytes) -> None:
    try:
        out.write(piece)
        out.flush()
    except OSError as error:
        raise RecordingError(
            f"{path}: can't be unpacked into a temporary file ({error.strerror}); set TMPDIR to a folder with"
            f" room for it, or unpack it yourself: `zstd -d {path.name}`"
        ) from error
