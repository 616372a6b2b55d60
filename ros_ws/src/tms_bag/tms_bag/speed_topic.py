"""Choice of the topic that holds the measured speed.

A bag made by this project has `bicycle/speed`. Other recordings name it otherwise: the only topic of a twist
with a stamp is taken, commands left out (a controller's `cmd_vel` has the same type and is no measurement).
"""

from __future__ import annotations

from dataclasses import dataclass

from tms_bag import topics
from tms_bag.errors import RecordingError
from tms_bag.reading.reader import BagReader

FLAG = "--speed-topic"
KINDS = {topics.TYPES[kind]: kind for kind in (topics.SPEED, topics.SPEED_COVARIANCE)}  # by message type
COMMAND_WORDS = ("cmd", "command", "target", "setpoint")  # in the last part of a command's name


@dataclass(frozen=True)
class SpeedTopic:
    """Topic of the measured speed, and those that were not taken."""

    name: str | None = None  # None: none was taken
    kind: str = topics.SPEED  # topics.SPEED or topics.SPEED_COVARIANCE, by its type
    candidates: tuple[str, ...] = ()  # several under other names, none of which was taken
    commands: tuple[str, ...] = ()  # of a speed's type, but named as a command
    chosen: bool = False  # by the user

    @property
    def is_usual(self) -> bool:
        """Whether the topic has the name that this project gives it."""
        usual = ("/" + topics.SPEED, "/" + topics.SPEED_COVARIANCE)
        return self.name is not None and self.name.endswith(usual)

    @property
    def flags(self) -> str:
        """The flag for each candidate."""
        return " or ".join(f"{FLAG} {name}" for name in self.candidates)

    @property
    def remark(self) -> str:
        """One line where another topic was taken, or none of several; else empty."""
        if self.name is not None and not self.is_usual and not self.chosen:
            return (
                f"the speed is that of {self.name}, the only topic that may hold a measured one; {FLAG} NAME"
                " takes another"
            )
        if self.candidates:
            return f"several topics may hold the speed, none was taken; choose one with {self.flags}"
        if self.name is None and self.commands:
            return (
                f"{', '.join(self.commands)}: a command by its name, not taken for the measured speed;"
                f" {FLAG} {self.commands[0]} takes it all the same"
            )
        return ""


NO_TOPIC = SpeedTopic()


def find_speed_topic(bag: BagReader, chosen: str | None = None, space: str = "/") -> SpeedTopic:
    """Topic of the measured speed.

    chosen: the user's choice; space: namespace to prefer, with a slash at both ends. The topics of the usual
    names come first, then the only one under another name. RecordingError where `chosen` isn't there, and for
    the usual name in several namespaces.
    """
    there = {topic.name: KINDS[topic.type] for topic in bag.topics if topic.type in KINDS and topic.count}
    commands = tuple(name for name in there if is_command(name))
    if chosen is not None:
        name = chosen if chosen.startswith("/") else "/" + chosen
        if name not in there:
            raise RecordingError(_missing(bag, name, tuple(there)))
        return SpeedTopic(name, there[name], commands=commands, chosen=True)
    usual = _usual(bag, there, space)
    if usual is not None:
        return SpeedTopic(usual, there[usual], commands=commands)
    found = tuple(name for name in there if not is_command(name))
    near = tuple(name for name in found if name.startswith(space))
    if len(near) == 1:
        found = near
    if len(found) == 1:
        return SpeedTopic(found[0], there[found[0]], commands=commands)
    return SpeedTopic(candidates=found, commands=commands)


def is_command(name: str) -> bool:
    """Whether a topic's name is that of a command, by its last part."""
    last = name.rsplit("/", 1)[-1].lower()
    return any(word in last for word in COMMAND_WORDS)


def _usual(bag: BagReader, there: dict[str, str], space: str) -> str | None:
    """Topic of a usual name, with the variance if there is one; None without one.

    RecordingError for several, none of which is in the namespace.
    """
    kinds = (topics.SPEED_COVARIANCE, topics.SPEED)  # the same speeds, the first with their variance
    for kind in kinds:
        if there.get(space + kind) == kind:
            return space + kind
    for kind in kinds:
        found = [name for name, one in there.items() if one == kind and name.endswith("/" + kind)]
        if len(found) > 1:
            raise RecordingError(
                f"{bag.path}: expected one topic {kind}, found {', '.join(found)}; choose one with"
                f" {FLAG} {found[0]}"
            )
        if found:
            return found[0]
    return None


def _missing(bag: BagReader, name: str, there: tuple[str, ...]) -> str:
    kinds = " or ".join(KINDS)
    if there:
        return (
            f"{bag.path}: expected a topic {name} of type {kinds} with messages, found of this type"
            f" {', '.join(there)}; use {FLAG} {there[0]}"
        )
    others = ", ".join(f"{entry.name} ({entry.type}, {entry.count})" for entry in bag.topics) or "no topics"
    return (
        f"{bag.path}: expected a topic {name} of type {kinds} with messages, found none; the bag holds"
        f" {others}: record that topic too"
    )
