"""`bag record` and `bag play`: the nodes, with flags for their parameters."""

from __future__ import annotations

import argparse
import json
import os
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

from tms_bag.presets import PRESETS
from tms_bag.reader import BagReader


def add_record(commands: Any) -> None:
    """The parser of `bag record`."""
    parser = commands.add_parser(
        "record", help="record topics until Ctrl-C", description="Runs the recorder node."
    )
    flag = parser.add_argument
    flag("-o", "--output", help="bag to write (default: bag_ and the time, in this folder)")
    flag("--topics", nargs="+", default=[], metavar="NAME", help="topics to record (default: all)")
    flag("-e", "--regex", default="", help="regular expression: topics to record beside those named")
    flag("--types", nargs="+", default=[], metavar="TYPE", help="types to record, sensor_msgs/msg/Imu")
    flag("--exclude-topics", nargs="+", default=[], metavar="NAME", help="topics to leave out")
    flag("--exclude-regex", default="", help="regular expression: topics to leave out")
    flag("--exclude-types", nargs="+", default=[], metavar="TYPE", help="types to leave out")
    flag("--include-hidden", action="store_true", help="also topics with a part that starts with _")
    flag("--include-unpublished", action="store_true", help="also topics that nobody publishes so far")
    flag("--compression", choices=tuple(PRESETS), default="zstd", help="how files are packed (default zstd)")
    flag("--max-size", type=int, default=0, metavar="BYTES", help="go on in another file at this size")
    flag("--max-duration", type=float, default=0.0, metavar="S", help="go on in another file after so long")
    text = "keep only the last seconds, until the service ~/snapshot is called"
    flag("--snapshot", type=float, default=0.0, metavar="S", help=text)
    flag("--start-paused", action="store_true", help="record nothing before the service ~/resume is called")
    flag("--use-sim-time", action="store_true", help="stamp messages with /clock")


def add_play(commands: Any) -> None:
    """The parser of `bag play`."""
    play = commands.add_parser("play", help="publish a bag's messages", description="Runs the player node.")
    play.add_argument("bag", help="folder of a bag, or an .mcap file")
    play.add_argument("--rate", type=float, default=1.0, help="times real time (default 1)")
    play.add_argument("--start-offset", type=float, default=0.0, help="start this much into the bag [s]")
    play.add_argument("--topics", nargs="+", default=[], help="topics to play (default: all)")
    play.add_argument("--loop", action="store_true", help="start anew at the end, until Ctrl-C")
    play.add_argument("--clock", action="store_true", help="publish the bag's time on /clock")


def record(arguments: argparse.Namespace) -> None:
    """Become the recorder."""
    parameters = {key: value for key, value in vars(arguments).items() if key != "command"}
    output = arguments.output or f"bag_{datetime.now():%Y-%m-%d_%H-%M-%S}"
    _become("recorder", {**parameters, "output": str(Path.cwd() / output)})


def play(arguments: argparse.Namespace) -> None:
    """Become the player."""
    with BagReader(arguments.bag) as bag:
        parameters = {
            "bag": str(Path.cwd() / bag.path),
            "rate": arguments.rate,
            "start_offset": arguments.start_offset,
            "loop": arguments.loop,
            "publish_clock": arguments.clock,
            "topics": arguments.topics,
        }
    _become("player", parameters)


def _become(name: str, parameters: dict[str, Any]) -> None:
    """Become the node, so that signals and the exit code are the node's."""
    arguments = [sys.executable, "-m", f"tms_bag.nodes.{name}", "--ros-args"]
    for key, value in parameters.items():
        if value not in ([], ""):  # an empty list has no type for ROS; the node's default is empty
            arguments += ["-p", f"{key}:={json.dumps(value)}"]
    sys.stdout.flush()
    os.execv(sys.executable, arguments)
