"""What the player can be asked for: its parameters, declared and checked against the bag."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.node import Node

from tms_bag.errors import RecordingError
from tms_bag.nodes.parameters import declare, declare_names
from tms_bag.reading.reader import BagReader
from tms_bag.selection import Selection


@dataclass(frozen=True)
class PlayerSettings:
    """A player's parameters; `rate` is asked for again whenever it is needed."""

    bag: BagReader
    start_ns: int  # [ns] first message to play
    end_ns: int  # [ns] last one
    selection: Selection
    loop: bool
    delay: float  # [s] of real time before each round
    start_paused: bool
    clock_period: float  # [s]; 0: no clock
    wait_for_subscriptions: int
    wait_timeout: float  # [s]
    lossless: bool
    window: int  # [messages]
    handled_topics: tuple[str, ...]


def declare_player_settings(node: Node) -> PlayerSettings:
    """Declare the parameters. ParameterError or RecordingError if one doesn't fit."""
    path = declare(node, "bag", "", "bag (a folder) or .mcap file to play")
    declare(node, "rate", 1.0, "times real time", 0.01, 1000.0, read_only=False)
    offset = declare(node, "start_offset", 0.0, "start this much into the bag [s]", 0.0, 1e9)
    duration = declare(node, "duration", 0.0, "play so much of the bag [s]; 0: to its end", 0.0, 1e9)
    loop = declare(node, "loop", False, "start anew at the end")
    delay = declare(node, "delay", 0.0, "wait before the start, and each round of a loop [s]", 0.0, 1e6)
    paused = declare(node, "start_paused", False, "play nothing before ~/resume")
    clock = declare(node, "publish_clock", False, "publish the bag's time on /clock")
    clock_rate = declare(node, "clock_rate", 100.0, "ticks of /clock in a second of real time", 1.0, 1000.0)
    selection = Selection(
        names=tuple(declare_names(node, "topics", "names of topics to play; empty: all")),
        pattern=declare(node, "regex", "", "regular expression: topics to play beside those named"),
        not_names=tuple(declare_names(node, "exclude_topics", "names of topics to leave out")),
        not_pattern=declare(node, "exclude_regex", "", "regular expression: topics to leave out"),
        hidden=True,
    )
    awaited = declare(
        node, "wait_for_subscriptions", 0, "subscriptions to wait for, all topics together", 0, 1000
    )
    patience = declare(
        node, "wait_timeout", 30.0, "longest wait for subscriptions, or for a consumer [s]", 0.0, 1e6
    )
    lossless = declare(node, "lossless", False, "send no faster than handled_topics say it is handled")
    window = declare(node, "window", 500, "messages of a topic under way when lossless", 1, 100_000)
    handled = declare_names(
        *(node, "handled_topics", "where consumers say what they have handled", ["estimator/handled"])
    )
    if not path:
        raise RecordingError("parameter bag: expected the path of a bag, found nothing; say -p bag:=PATH")
    bag = BagReader(path)
    length = (bag.end_ns - bag.start_ns) / 1e9
    if offset > length:
        raise RecordingError(f"parameter start_offset: expected at most {length:g} s, found {offset:g} s")
    start_ns = bag.start_ns + round(offset * 1e9)
    return PlayerSettings(
        bag=bag,
        start_ns=start_ns,
        end_ns=min(bag.end_ns, start_ns + round(duration * 1e9)) if duration else bag.end_ns,
        selection=selection,
        loop=loop,
        delay=delay,
        start_paused=paused,
        clock_period=1.0 / clock_rate if clock else 0.0,
        wait_for_subscriptions=awaited,
        wait_timeout=patience,
        lossless=lossless,
        window=window,
        handled_topics=tuple(handled),
    )
