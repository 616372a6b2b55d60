"""What a bag says about a topic: name, type, definition of the type, quality of service."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tms_bag import messages
from tms_bag.errors import RecordingError
from tms_bag.qos import Qos, from_yaml, to_yaml

ENCODING = "cdr"  # the only serialisation that ROS 2 uses


@dataclass(frozen=True)
class Channel:
    """A topic of a bag."""

    name: str  # with its leading slash
    type: str  # for example sensor_msgs/msg/Imu
    qos: tuple[Qos, ...]  # what its publishers offered, empty: unknown
    schema: bytes  # definition of the type
    schema_encoding: str  # ros2msg or ros2idl
    type_hash: str  # RIHS01_..., empty: unknown
    encoding: str = ENCODING

    @property
    def metadata(self) -> dict[str, str]:
        """The keys that rosbag2 keeps with an MCAP channel."""
        return {"offered_qos_profiles": to_yaml(self.qos), "topic_type_hash": self.type_hash}


def installed_channel(name: str, type_name: str, qos: tuple[Qos, ...]) -> Channel:
    """Channel of a type that is installed here. RecordingError if it isn't."""
    schema = messages.schema_text(type_name).encode()
    return Channel(name, type_name, qos, schema, "ros2msg", messages.type_hash(type_name))


def stored_channel(
    name: str, type_name: str, metadata: Mapping[str, str], schema: bytes, schema_encoding: str, encoding: str
) -> Channel:
    """Channel as it stands in an MCAP file."""
    qos = from_yaml(metadata.get("offered_qos_profiles", ""))
    return Channel(
        name, type_name, qos, schema, schema_encoding, metadata.get("topic_type_hash", ""), encoding
    )


def check_encoding(channel: Channel) -> None:
    """RecordingError if the messages aren't serialised as ROS 2 does it, or nothing says what they are."""
    if not channel.type:
        raise RecordingError(
            f"expected messages of a type with a name, found a topic without schema: {channel.name};"
            " choose topics without it"
        )
    if channel.encoding != ENCODING:
        raise RecordingError(
            f"expected messages in ROS 2's encoding {ENCODING}, found {channel.encoding!r} on {channel.name};"
            " choose topics without it"
        )
