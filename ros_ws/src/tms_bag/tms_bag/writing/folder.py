"""The folder that a bag is written to: complete or not there at all."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from itertools import count
from pathlib import Path

from tms_bag.errors import RecordingError
from tms_bag.metadata import FILE_NAME
from tms_bag.reading.bag_files import stems_of


class Destination:
    """A folder in the making. Written beside `path` and renamed at the end, unless `in_place`.

    What stands at `path` already is replaced if `overwrite` says so, or moved to `keep_old_as` and kept.

    RecordingError, before anything is touched, if there is something at `path` already; with `overwrite` only
    if that is something else than a bag of .mcap files.
    """

    def __init__(
        self, path: Path, overwrite: bool = False, in_place: bool = False, keep_old_as: Path | None = None
    ) -> None:
        if in_place and (overwrite or keep_old_as):
            raise ValueError("a bag that is written in place can't replace another one")
        self.path = Path.cwd() / path
        self._replaces = os.path.lexists(self.path)
        self._keep_old_as = keep_old_as
        if self._replaces and keep_old_as is None:
            _check_replaceable(path, self.path, overwrite)
        self._folder = self.path if in_place else _hidden(self.path, "partial")
        self._made_parents: list[Path] = []

    @property
    def name(self) -> str:
        """Last part of the path; the files of the bag are named after it."""
        return self.path.name

    def create(self) -> Path:
        """Make the folder to write into. RecordingError if the system doesn't let us."""
        missing = [parent for parent in self.path.parents if not parent.exists()]
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._made_parents = missing
            self._folder.mkdir()
        except OSError as error:
            raise RecordingError(
                f"{self.path}: can't make this folder ({error.strerror}); choose another place for the bag"
            ) from error
        for made in (self._folder, *missing):
            sync_folder(made.parent)
        return self._folder

    def keep(self, beside: Callable[[], None] | None = None) -> None:
        """Move the finished folder to its place; `beside` is called while nothing stands there."""
        if self._folder == self.path:
            return
        old = self._keep_old_as or _hidden(self.path, "replaced")
        if self._replaces:
            self.path.rename(old)
        try:
            if beside:
                beside()
        except BaseException:
            self._put_back(old)
            raise
        try:
            self._folder.rename(self.path)
        except OSError as error:
            self._put_back(old)
            raise RecordingError(
                f"{self.path}: something else was put there while the bag was written ({error.strerror});"
                " run it again"
            ) from error
        sync_folder(self.path.parent)
        if self._replaces and old != self._keep_old_as:
            shutil.rmtree(old, ignore_errors=True)

    def _put_back(self, old: Path) -> None:
        if self._replaces:
            old.rename(self.path)
        self.discard()

    def discard(self) -> None:
        """Remove what was made."""
        shutil.rmtree(self._folder, ignore_errors=True)
        for parent in self._made_parents:
            try:
                parent.rmdir()
            except OSError:  # somebody else put something there
                return


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, where its file system lets one ask for that."""
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except PermissionError:  # one may write into it and not read it
        return
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)


def write_at_once(path: Path, text: str) -> None:
    """Write a file that is on the disk whole or, whatever happens meanwhile, not there at all."""
    unfinished = _unfinished(path)
    try:
        with unfinished.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        unfinished.rename(path)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def _hidden(path: Path, end: str) -> Path:
    """A free name beside `path`."""
    # In a container a process often has the number of one that was killed in the last.
    ends = (f"{again}.{end}" if again else end for again in count())
    names = (path.with_name(f".{path.name}.{os.getpid()}.{end}") for end in ends)
    return next(name for name in names if not os.path.lexists(name))


def _unfinished(path: Path) -> Path:
    """The name of a file while it is written; after a kill it may be left."""
    return path.with_name(f".{path.name}.partial")


def _check_replaceable(given: Path, path: Path, overwrite: bool) -> None:
    if not overwrite:
        raise RecordingError(
            f"{given}: exists already; choose another name (--force, where a command has it, replaces a bag"
            " of .mcap files)"
        )
    entries = sorted(path.iterdir()) if path.is_dir() and not path.is_symlink() else [path]
    strange = [entry.name for entry in entries if not _may_be_of_a_bag(entry)]
    if not (path / FILE_NAME).exists():  # a folder that holds several bags isn't one
        stems = stems_of(entry.name for entry in entries if entry.suffix == ".mcap")
        strange = strange or (stems if len(stems) > 1 else [])
    if strange or not path.is_dir():
        found = ", ".join(strange[:3]) if path.is_dir() else "a file"
        raise RecordingError(
            f"{given}: expected a bag of .mcap files to replace, found {found}; remove it yourself or choose"
            " another name"
        )


def _may_be_of_a_bag(entry: Path) -> bool:
    known = entry.name in (FILE_NAME, _unfinished(Path(FILE_NAME)).name) or entry.suffix == ".mcap"
    return known and not entry.is_dir()
