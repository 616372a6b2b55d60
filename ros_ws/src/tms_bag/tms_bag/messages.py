"""Messages between objects, CDR bytes and message definitions, without ROS at run time.

Bytes come from rosbags' serialisation, which fills padding with zeros, so that the same message is always the
same bytes; rclpy's leaves padding uninitialised. Standard types are those of Jazzy; all other types are read
from the .msg files of the packages on AMENT_PREFIX_PATH, as rosbag2 does. For a computer without ROS the
definitions of this project's topics are shipped, in the folder `definitions/`.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tms_bag.errors import RecordingError

SHIPPED = Path(__file__).parent / "definitions"  # PACKAGE/msg/NAME.msg
LONGEST_SEQUENCE = 2**24  # elements; a damaged message must not ask for more memory than a bag can hold

_TYPE_NAME = re.compile(r"([a-zA-Z]\w*)/(?:msg/)?([a-zA-Z]\w*)")
_FIELD_TYPE = re.compile(r"(?:^|\n)\s*([a-zA-Z0-9_/]+)(?:\[[^\]]*\])?\s+")  # rosbag2's own pattern
_PRIMITIVE_TYPE = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_DELIMITER = "=" * 80


def message_type(type_name: str) -> Any:
    """Message class (a dataclass) of a type such as sensor_msgs/msg/Imu. RecordingError if it isn't known."""
    return _store_with(type_name).types[type_name]


def serialize(message: Any) -> bytes:
    """CDR bytes, little endian, encapsulation header included, of an object of a `message_type`.

    Filled up with zeros to a multiple of 4 bytes, since RTPS aligns to 32 bits: bytes that have been through
    DDS are then the same as those that haven't. Readers ignore the filling.
    """
    data = bytes(_store().serialize_cdr(message, message.__msgtype__, little_endian=True))
    return data + bytes(-len(data) % 4)


def deserialize(data: bytes, type_name: str, store: Typestore | None = None) -> Any:
    """Object of `message_type(type_name)` from CDR bytes. RecordingError if the bytes don't fit the type.

    `store` knows other versions of the types than those that are installed.
    """
    try:
        return (store or _store_with(type_name)).deserialize_cdr(data, type_name)
    except (SerdeError, IndexError, AssertionError, UnicodeDecodeError) as error:
        raise RecordingError(
            f"expected a {type_name} message, found {len(data)} bytes that aren't one ({error}):"
            " the recording is damaged or was made with another version of this type"
        ) from error


def all_fields(type_name: str) -> Mapping[str, Any]:
    """Constants and fields of a message type and of all others that are known, as rosbags describes them."""
    return _store_with(type_name).fielddefs


def types_in(definition: Any) -> list[str]:
    """Names of the message types that a type consists of, of its constants and fields."""
    found = []
    for _, (kind, content) in definition[1]:
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind, content = content[0]
        if kind == Nodetype.NAME:
            found.append(str(content))
    return found


@cache
def type_hash(type_name: str) -> str:
    """Hash of the type's description (REP-2011), 'RIHS01_' and 64 hexadecimal digits."""
    installed = _installed_hash(type_name)
    return installed if installed else str(_store_with(type_name).hash_rihs01(type_name))


@cache
def schema_text(type_name: str) -> str:
    """Definition of a type and of all types in it, in the form of rosbag2's `ros2msg` schemas.

    The text of the .msg file, then each type it uses once, depth first and sorted, under a line of its own.
    Without the installed .msg files the definitions are written out anew, without their comments.
    """
    if _definition(type_name) is None:
        return str(_store_with(type_name).generate_msgdef(type_name, ros_version=2)[0])
    return _text_with_dependencies(type_name, set())


@lru_cache(maxsize=1)
def _store() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.max_sequence_length = LONGEST_SEQUENCE
    return store


def _store_with(type_name: str) -> Typestore:
    """The type store, after the type and all that it uses have been added to it."""
    store = _store()
    if type_name in store.types:
        return store
    text = _definition(type_name)
    if text is None:
        package = type_name.split("/")[0]
        raise RecordingError(
            f"message type {type_name} is not known: expected share/{package}/msg in a folder of"
            " AMENT_PREFIX_PATH;"
            f" build and source the workspace that holds {package} (here: ./tms build, then ./tms shell)"
        )
    for dependency in _dependencies(text, type_name):
        _store_with(_full_name(dependency))
    try:
        store.register(get_types_from_msg(text, type_name))
    except (TypesysError, SyntaxError) as error:
        raise RecordingError(f"the definition of {type_name} can't be understood: {error}") from error
    return store


def _text_with_dependencies(type_name: str, seen: set[str]) -> str:
    text = _definition(type_name) or ""
    for name in _dependencies(text, type_name):
        if name not in seen:
            seen.add(name)
            text += f"\n{_DELIMITER}\nMSG: {name}\n{_text_with_dependencies(_full_name(name), seen)}"
    return text


def _dependencies(text: str, type_name: str) -> list[str]:
    """Names (package/Type) of the message types in a definition, sorted."""
    package = type_name.split("/")[0]
    found = {name for name in _FIELD_TYPE.findall(text) if not _PRIMITIVE_TYPE.fullmatch(name)}
    return sorted(name if "/" in name else f"{package}/{name}" for name in found)


def _full_name(name: str) -> str:
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest.rpartition('/')[2]}"


@cache
def _definition(type_name: str) -> str | None:
    """Text of the .msg file, installed or shipped; None where there is none."""
    path = _installed(type_name, "msg") or _file_in(SHIPPED, type_name, "msg")
    return path.read_text(encoding="utf-8") if path else None


def _installed_hash(type_name: str) -> str | None:
    path = _installed(type_name, "json")
    if path is None:
        return None
    hashes = json.loads(path.read_text(encoding="utf-8"))["type_hashes"]
    return next((str(entry["hash_string"]) for entry in hashes if entry["type_name"] == type_name), None)


def _installed(type_name: str, extension: str) -> Path | None:
    """File of a message type in the first prefix of AMENT_PREFIX_PATH that its package is in."""
    package = type_name.split("/")[0]
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        share = Path(prefix) / "share"
        if (share / "ament_index" / "resource_index" / "packages" / package).is_file():
            return _file_in(share, type_name, extension)
    return None


def _file_in(folder: Path, type_name: str, extension: str) -> Path | None:
    """The file of a message type in a folder of packages, if it is there."""
    match = _TYPE_NAME.fullmatch(type_name)
    path = folder / match[1] / "msg" / f"{match[2]}.{extension}" if match else None
    return path if path and path.is_file() else None
