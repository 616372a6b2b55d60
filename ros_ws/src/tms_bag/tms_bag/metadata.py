"""metadata.yaml of a rosbag2 bag: written as version 9, read from any version.

Layout: rosbag2_storage/yaml.hpp of ROS 2 Jazzy.
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import yaml
from tms_model.yaml_text import NOT_YAML, load_yaml

from tms_bag.channel import Channel
from tms_bag.errors import RecordingError

FILE_NAME = "metadata.yaml"
ROOT = "rosbag2_bagfile_information"
VERSION = 9
EMPTY_BAG_START_NS = 2**63 - 1  # what rosbag2 writes when there is no message
LAST_WITH_FOLDER = 4  # version in which the files' paths could start with the name of the bag's folder
LARGEST_FILE = 4 * 2**20  # [bytes]; real ones are a few kilobytes


@dataclass(frozen=True)
class Metadata:
    """What this package uses of a metadata.yaml."""

    files: tuple[str, ...]  # relative to the folder of the bag
    custom_data: dict[str, str]


class _Dumper(yaml.SafeDumper):
    """Texts of several lines (a configuration) stay readable, repeated values are written out."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None)


_Dumper.add_representer(str, _represent_text)


@dataclass(frozen=True)
class FileInformation:
    """One file of a bag."""

    name: str
    time_range: tuple[int, int] | None  # earliest and latest log time [ns]; None without messages
    message_count: int


def bag_information(
    files: Sequence[FileInformation],
    channels: Sequence[Channel],
    counts: Sequence[int],
    custom_data: Mapping[str, str],
) -> dict[str, Any]:
    """The mapping under the root key; `counts` are messages by channel."""
    ranges = [file.time_range for file in files if file.time_range]
    whole = (min(start for start, _ in ranges), max(end for _, end in ranges)) if ranges else None
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        **_span(whole, sum(counts)),
        "topics_with_message_count": [
            {"topic_metadata": _topic_metadata(channel), "message_count": count}
            for channel, count in zip(channels, counts, strict=True)
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [{"path": file.name, **_span(file.time_range, file.message_count)} for file in files],
        "custom_data": dict(custom_data),
        "ros_distro": "jazzy",
    }


def _span(time_range: tuple[int, int] | None, message_count: int) -> dict[str, Any]:
    start, end = time_range if time_range else (EMPTY_BAG_START_NS, EMPTY_BAG_START_NS)
    return {
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": message_count,
    }


def _topic_metadata(channel: Channel) -> dict[str, Any]:
    return {
        "name": channel.name,
        "type": channel.type,
        "serialization_format": channel.encoding,
        "offered_qos_profiles": [qos.to_dict() for qos in channel.qos],
        "type_description_hash": channel.type_hash,
    }


def to_text(information: Mapping[str, Any]) -> str:
    """YAML text, the same for the same content on every machine."""
    return str(yaml.dump(dict(information), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=2**20))


def read_file(path: Path) -> Metadata:
    """What a metadata.yaml says. RecordingError if it can't be read, or is about files of another kind."""
    information = _load(path)
    storage = information.get("storage_identifier")
    if storage not in ("mcap", "sqlite3"):
        raise RecordingError(
            f"{path}: expected a bag stored as mcap or sqlite3, found storage {_short(storage)};"
            " convert it with `ros2 bag convert` (storage_id: mcap)"
        )
    packed = str(information.get("compression_mode") or "none").lower() != "none"
    if packed and information.get("compression_format") not in ("zstd", "", None):
        raise RecordingError(
            f"{path}: expected files or messages packed with zstd, found compression_format"
            f" {_short(information['compression_format'])}; convert the bag with `ros2 bag convert`"
        )
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise RecordingError(
            f"{path}: expected a list of files under relative_file_paths, found {_short(names)}"
        )
    version = information.get("version")
    named = isinstance(version, int) and version <= LAST_WITH_FOLDER
    return Metadata(
        tuple(_inside(name, path, named) for name in names), _texts(information.get("custom_data"))
    )


def custom_data_of_record(text: str) -> dict[str, str]:
    """custom_data of the `serialized_metadata` inside an MCAP file; empty if it can't be read."""
    if len(text) > LARGEST_FILE:
        return {}
    try:
        information = load_yaml(text)
    except NOT_YAML:
        return {}
    if isinstance(information, dict):
        information = information.get(ROOT, information)
    return _texts(information.get("custom_data")) if isinstance(information, dict) else {}


def _texts(custom_data: object) -> dict[str, str]:
    if not isinstance(custom_data, dict):
        return {}
    return {str(key): _text(value) for key, value in custom_data.items()}


def _text(value: object) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else _short(value)


def _load(path: Path) -> dict[str, Any]:
    hint = f"`tms bag repair` writes a new one (it needs only the .mcap files in {path.parent})"
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise RecordingError(
                f"{path}: expected a few kilobytes, found {path.stat().st_size} bytes; {hint}"
            )
        content = load_yaml(path.read_text(encoding="utf-8"))
    except (OSError, *NOT_YAML) as error:
        raise RecordingError(f"{path}: can't be read as YAML ({_first_line(error)}); {hint}") from error
    information = content.get(ROOT) if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise RecordingError(
            f"{path}: expected the key {ROOT} with a mapping, found {_short(content)}; {hint}"
        )
    return information


def _inside(name: str, path: Path, named: bool) -> str:
    """The name of a file of the bag, if it stays in the folder of the bag.

    Up to version 4 paths started with what was the name of the folder (`named`), which may have changed.
    """
    pure = PurePosixPath(name)
    parts = (
        pure.parts[1:]
        if len(pure.parts) == 2 and (named or pure.parts[0] == path.parent.name)
        else pure.parts
    )
    if len(parts) != 1 or {".", "..", "/", ""} & {*parts, *pure.parts}:
        raise RecordingError(
            f"{path}: expected file names in the folder of the bag, found {name!r}: not opened"
        )
    return parts[0]


def _short(value: object) -> str:
    """What stands there, in short; aliases may make it endless when written out."""
    shortener = reprlib.Repr()
    shortener.maxlevel, shortener.maxlist, shortener.maxdict = 2, 3, 3
    return shortener.repr(value)


def _first_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
