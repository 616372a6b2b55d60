"""Quality of service of a recorded topic, in the form of rosbag2's metadata version 9."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import yaml
from tms_model.yaml_text import NOT_YAML, load_yaml

INFINITE_NS = 2**63 - 1  # how rmw spells "no deadline, no lifespan, no lease"

LONGEST_TEXT = 2**16  # [characters] of profiles; a publisher has about 400

# Bags older than version 9 write rmw's enumerations as integers.
_OLD = {
    "history": {0: "system_default", 1: "keep_last", 2: "keep_all", 3: "unknown"},
    "reliability": {0: "system_default", 1: "reliable", 2: "best_effort", 3: "unknown"},
    "durability": {0: "system_default", 1: "transient_local", 2: "volatile", 3: "unknown"},
    "liveliness": {
        0: "system_default",
        1: "automatic",
        2: "manual_by_node",
        3: "manual_by_topic",
        4: "unknown",
    },
}


@dataclass(frozen=True)
class Qos:
    """What a publisher offers. Policies carry rmw's names, durations are nanoseconds."""

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 100
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: str = "automatic"
    liveliness_lease_ns: int = INFINITE_NS
    avoid_ros_namespace_conventions: bool = False

    def to_dict(self) -> dict[str, Any]:
        """The mapping that stands in a version 9 metadata.yaml."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": _duration(self.deadline_ns),
            "lifespan": _duration(self.lifespan_ns),
            "liveliness": self.liveliness,
            "liveliness_lease_duration": _duration(self.liveliness_lease_ns),
            "avoid_ros_namespace_conventions": self.avoid_ros_namespace_conventions,
        }


SENSOR = Qos()
LATCHED = Qos(durability="transient_local", depth=1)


@lru_cache(maxsize=64)  # the topics of a bag share a few
def to_yaml(profiles: tuple[Qos, ...]) -> str:
    """The text that a channel of an MCAP file carries as `offered_qos_profiles`."""
    return yaml.safe_dump([qos.to_dict() for qos in profiles], sort_keys=False).strip() if profiles else ""


def from_yaml(text: str) -> tuple[Qos, ...]:
    """Profiles from the text of a channel, of any rosbag2 version; what can't be understood is left out."""
    if len(text) > LONGEST_TEXT:
        return ()
    try:
        return from_list(load_yaml(text))
    except NOT_YAML:
        return ()


def from_list(profiles: object) -> tuple[Qos, ...]:
    """Profiles from the list in a metadata.yaml; what can't be understood is left out."""
    if not isinstance(profiles, list):
        return ()
    understood = []
    for profile in profiles:
        try:
            understood.append(_from_dict(profile))
        except (KeyError, TypeError, ValueError, AttributeError):
            continue
    return tuple(understood)


def _from_dict(profile: dict[str, Any]) -> Qos:
    return Qos(
        reliability=_policy("reliability", profile["reliability"]),
        durability=_policy("durability", profile["durability"]),
        history=_policy("history", profile["history"]),
        depth=int(profile["depth"]),
        deadline_ns=_nanoseconds(profile["deadline"]),
        lifespan_ns=_nanoseconds(profile["lifespan"]),
        liveliness=_policy("liveliness", profile["liveliness"]),
        liveliness_lease_ns=_nanoseconds(profile["liveliness_lease_duration"]),
        avoid_ros_namespace_conventions=bool(profile["avoid_ros_namespace_conventions"]),
    )


def _policy(kind: str, value: object) -> str:
    if isinstance(value, int):
        return _OLD[kind][value]
    if not isinstance(value, str):
        raise TypeError(f"{kind} is neither a number nor a name")
    return value.lower()


def _duration(nanoseconds: int) -> dict[str, int]:
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}


def _nanoseconds(duration: dict[str, Any]) -> int:
    # Foxy's middlewares spelled "infinite" in several ways, all of them beyond 68 years.
    nanoseconds = int(duration["sec"]) * 10**9 + int(duration["nsec"])
    return INFINITE_NS if nanoseconds >= 0x7FFFFFFF * 10**9 else nanoseconds
