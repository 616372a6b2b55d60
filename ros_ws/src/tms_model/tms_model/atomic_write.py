"""A file that appears whole or not at all."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from tms_model.errors import ParameterError


def atomic_write(path: Path, content: bytes) -> None:
    """Write a file; folders above it are made. It is on the disk, and whole, when it gets its name.

    Raises ParameterError for a place that can't be written, or that takes no more.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with unfinished.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        if not isinstance(error, OSError):
            raise
        raise ParameterError(f"{path}: expected a place to write a file, found: {error.strerror}") from error
