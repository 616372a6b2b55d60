"""What the messages of a bag consist of: by the definitions in the bag, else by those installed here."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tms_bag import messages
from tms_bag.channel import Channel
from tms_bag.errors import RecordingError
from tms_bag.reading.layout import Fields

LONGEST_SCHEMA = 2**18  # [bytes]; sensor_msgs/Imu with all that it uses has 10,000

_EVENT = re.compile(r"\w+/srv/\w+_Event")
_EVENT_INFO = "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number"
_SEPARATOR = "=" * 80


def fields_of(channel: Channel) -> Fields:
    """Fields of a topic's type and of all types in it. RecordingError if nobody knows them.

    A bag of an older version of a package brings its own definitions: these count.
    """
    stored = _stored_fields(channel.type, channel.schema, channel.schema_encoding)
    if stored is not None:
        return stored
    try:
        return messages.all_fields(channel.type)
    except RecordingError:
        if channel.schema_encoding == "ros2msg" and not channel.schema.strip():
            return _nothing_in(channel.type)
        raise


def message_of(channel: Channel, data: bytes) -> Any:
    """A message as an object, by the bag's definition of its type. RecordingError if it isn't one."""
    return messages.deserialize(
        data, channel.type, _store(channel.type, channel.schema, channel.schema_encoding)
    )


@lru_cache(maxsize=64)
def _nothing_in(type_name: str) -> Fields:
    """Of a type whose definition is empty, as that of std_msgs/Empty."""
    return {type_name: ([], [])}


@lru_cache(maxsize=64)
def _store(type_name: str, schema: bytes, encoding: str) -> Typestore | None:
    """Types as a bag defines them; None if they are those that are installed. Raises RecordingError."""
    stored = _stored_fields(type_name, schema, encoding)
    if stored is None:
        return None
    try:
        known = messages.all_fields(type_name)
        if all(known.get(name) == fields for name, fields in stored.items()):
            return None
    except RecordingError:  # not installed
        pass
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(dict(stored))
    except TypesysError as error:  # for example another builtin_interfaces/Time than the library knows
        raise RecordingError(
            f"expected a definition of {type_name} that can be used, found that the bag defines it otherwise"
            f" ({error})"
        ) from error
    store.max_sequence_length = messages.LONGEST_SEQUENCE
    return store


@lru_cache(maxsize=256)
def _stored_fields(type_name: str, schema: bytes, encoding: str) -> Fields | None:
    """By the definition in a bag; None if there is none that can be understood."""
    parse = {"ros2msg": get_types_from_msg, "ros2idl": get_types_from_idl}.get(encoding)
    if parse is None or not schema.strip() or len(schema) > LONGEST_SCHEMA:
        return None
    try:
        text = schema.decode("utf-8")
        if encoding == "ros2msg" and _EVENT.fullmatch(type_name):
            text = _event_definition(type_name, text)
        found = parse(text, type_name) if parse is get_types_from_msg else get_types_from_idl(text)
        head, _, name = type_name.rpartition("/")
        renamed = f"{head}/msg/{name}"  # what the library makes of names of services and actions
        return _complete(type_name, {type_name: found[renamed], **found} if renamed in found else found)
    except (TypesysError, SyntaxError, ValueError, KeyError, IndexError, RecursionError, TypeError):
        return None
    except RecordingError:
        return None


def _event_definition(type_name: str, text: str) -> str:
    """Definition of a service's events out of that of the service, which is what bags hold."""
    service, *types = re.split(r"^={80}$", text, flags=re.MULTILINE)
    request, response = re.split(r"^---\s*$", service, flags=re.MULTILINE)
    package, _, name = type_name.removesuffix("_Event").split("/")
    parts = {
        f"{package}/{name}_Request": request,
        f"{package}/{name}_Response": response,
        "service_msgs/ServiceEventInfo": _EVENT_INFO,
    }
    event = (
        "service_msgs/ServiceEventInfo info\n"
        f"{package}/{name}_Request[<=1] request\n{package}/{name}_Response[<=1] response\n"
    )
    return (_SEPARATOR + "\n").join(
        [
            event,
            *(f"MSG: {part}\n{fields.strip()}\n" for part, fields in parts.items()),
            *(each.lstrip() for each in types),
        ]
    )


def _complete(type_name: str, found: Fields) -> Fields:
    """The type and all types in it, those that the bag doesn't define as installed.

    KeyError if one is unknown, ValueError if one has two fields of the same name.
    """
    whole: dict[str, Any] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop()
        if name in whole:
            continue
        whole[name] = found[name] if name in found else messages.all_fields(name)[name]
        names = [field for field, _ in whole[name][1]]
        if len(set(names)) < len(names):
            raise ValueError(f"{name} has two fields of the same name")
        waiting += messages.types_in(whole[name])
    return whole
