"""An sqlite3 file of a bag, made ready to be opened by its name: unpacked, and settled if it wasn't closed.

The library opens files as they stand. What a killed recorder left beside one, messages that weren't brought
into it yet or a change that was half made, sqlite itself brings in order in a copy: the bag isn't touched.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

from tms_bag.errors import RecordingError
from tms_bag.reading.packed_file import is_packed, unpack

_BESIDE = ("-wal", "-journal")
_NOT_IN_URIS = "?#%"  # the library makes one of the path without writing these as a URI has them

Opened = TypeVar("Opened")


def with_name(path: Path, read: Callable[[Path], Opened]) -> Opened:
    """What `read` makes of the file. Where it needs another one, that one is gone when it has been opened.

    RecordingError, OSError or sqlite3.Error if it can't be made ready.
    """
    if not (is_packed(path) or left_beside(path) or any(sign in str(path) for sign in _NOT_IN_URIS)):
        return read(path)
    with TemporaryDirectory(prefix="tms_bag_") as folder:
        ready = Path(folder) / "it.db3"
        if is_packed(path):
            with ready.open("wb") as file:
                unpack(path, file)
        elif left_beside(path):
            _settle(path, ready)
        else:
            ready.symlink_to(path.resolve())
        return read(ready)


def left_beside(path: Path) -> list[Path]:
    """Files of sqlite beside this one that say that it wasn't closed."""
    beside = (path.with_name(path.name + end) for end in _BESIDE)
    return [file for file in beside if file.is_file() and not file.is_symlink() and file.stat().st_size]


def _settle(path: Path, copy: Path) -> None:
    try:
        shutil.copyfile(path, copy)
        for file in left_beside(path):
            shutil.copyfile(file, copy.with_name(copy.name + file.name.removeprefix(path.name)))
    except OSError as error:
        raise RecordingError(
            f"{path}: wasn't closed, and can't be brought in order in a temporary copy ({error.strerror});"
            " set TMPDIR to a folder with room for it"
        ) from error
    with closing(sqlite3.connect(copy)) as database:
        database.execute("PRAGMA journal_mode = DELETE").fetchall()
