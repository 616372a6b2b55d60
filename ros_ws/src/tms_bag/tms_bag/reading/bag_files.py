"""Which files a bag consists of. Nothing outside its folder is opened, whatever metadata or links say."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from tms_bag import metadata
from tms_bag.errors import RecordingError
from tms_bag.reading.packed_file import SUFFIX, is_packed, kind_of

SUFFIXES = (".mcap", ".db3")


def files_of(path: Path, salvage: bool) -> tuple[list[Path], metadata.Metadata | None]:
    """The files of a bag, and its metadata.yaml if it has one (that can be read, for `salvage`)."""
    try:
        return _files_of(path, salvage)
    except OSError as error:  # no permission, a name longer than names may be
        raise RecordingError(f"{str(path)[:200]}: can't be read ({error.strerror})") from error


def _files_of(path: Path, salvage: bool) -> tuple[list[Path], metadata.Metadata | None]:
    if path.is_file():
        return [path], None
    if not path.is_dir():
        found = "something that isn't a file" if path.exists() else "nothing there"
        raise RecordingError(
            f"{path}: expected a bag (a folder) or an .mcap file, found {found}; check the path"
        )
    stored = _stored_metadata(path, salvage)
    if stored and not salvage:
        return [_inside(path, name) for name in stored.files], stored
    names = sorted((entry.name for entry in path.iterdir() if _counts(entry)), key=_split_number)
    if not names:
        entries = sorted(entry.name for entry in path.iterdir())[:5]
        raise RecordingError(
            f"{path}: expected a bag with metadata.yaml or .mcap files, found"
            f" {', '.join(entries) or 'an empty folder'};"
            " give the folder that `bag record`, `sim run` or `ros2 bag record -s mcap` made"
        )
    stems = stems_of(names)
    if stored is None and len(stems) > 1:
        raise RecordingError(
            f"{path}: expected the files of one bag, found no metadata.yaml and files of several:"
            f" {', '.join(stems[:5])}; give one of the files, or a folder for each bag"
        )
    return [_inside(path, name) for name in names], stored


def stems_of(names: Iterable[str]) -> list[str]:
    """What the names of files start with, but for the numbers of a recorder that splits: one for each bag."""
    return sorted({_split_number(name)[0] for name in names})


def _stored_metadata(path: Path, salvage: bool) -> metadata.Metadata | None:
    if not (path / metadata.FILE_NAME).is_file():
        return None
    try:
        return metadata.read_file(path / metadata.FILE_NAME)
    except RecordingError:
        if salvage:
            return None
        raise


def _counts(entry: Path) -> bool:
    """A file of a bag. Players leave an unpacked one beside the packed one, which is the same again."""
    return kind_of(entry) in SUFFIXES and not (is_packed(entry) and entry.with_suffix("").exists())


def _inside(folder: Path, name: str) -> Path:
    """A file of the bag; RecordingError if it is missing or a link leads out of the folder."""
    path = folder / name
    others = (folder / name.removesuffix(SUFFIX), folder / (name + SUFFIX))  # who has (un)packed it by hand
    path = next((there for there in (path, *others) if there.is_symlink() or there.exists()), path)
    if path.resolve().parent != folder.resolve():
        raise RecordingError(
            f"{path}: expected a file in the folder of the bag, found a link to elsewhere: not opened"
        )
    if not path.is_file():
        raise RecordingError(
            f"{path}: metadata.yaml names this file, but it isn't there; bring it back, or `tms bag repair`"
        )
    return path


def _split_number(name: str) -> tuple[str, int]:
    """Files in the order in which a recorder split them: bag_2 before bag_10."""
    stem, _, number = name.removesuffix(SUFFIX).removesuffix(".mcap").removesuffix(".db3").rpartition("_")
    return (stem, int(number)) if number.isdecimal() else (name, -1)
