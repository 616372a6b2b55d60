"""`bag record` and `bag play`: the nodes, with flags for their parameters."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from tms_bag.errors import RecordingError

COMPRESSIONS = ("zstd", "none", "fastwrite", "zstd_fast", "zstd_small")  # of tms_bag.writing.presets
POLICIES = ("history", "depth", "reliability", "durability")  # that may be overridden


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
    flag("--compression", choices=COMPRESSIONS, default="zstd", help="how files are packed (default zstd)")
    flag("--max-size", type=int, default=0, metavar="BYTES", help="go on in another file at this size")
    flag("--max-duration", type=float, default=0.0, metavar="S", help="go on in another file after so long")
    text = "keep only the last seconds, until the service ~/snapshot is called"
    flag("--snapshot", type=float, default=0.0, metavar="S", help=text)
    flag("--start-paused", action="store_true", help="record nothing before the service ~/resume is called")
    flag("--use-sim-time", action="store_true", help="stamp messages with /clock")


def add_play(commands: Any) -> None:
    """The parser of `bag play`."""
    parser = commands.add_parser("play", help="publish a bag's messages", description="Runs the player node.")
    flag = parser.add_argument
    flag("bag", help="folder of a bag, or an .mcap file")
    flag("-r", "--rate", type=float, default=1.0, help="times real time (default 1)")
    flag("--start-offset", type=float, default=0.0, metavar="S", help="start this much into the bag")
    flag("--duration", type=float, default=0.0, metavar="S", help="play so much of the bag (default: all)")
    flag("--topics", nargs="+", default=[], metavar="NAME", help="topics to play (default: all)")
    flag("-e", "--regex", default="", help="regular expression: topics to play beside those named")
    flag("--exclude-topics", nargs="+", default=[], metavar="NAME", help="topics to leave out")
    flag("-x", "--exclude-regex", default="", help="regular expression: topics to leave out")
    flag("-m", "--remap", nargs="+", default=[], metavar="FROM:=TO", help="publish topics by other names")
    flag(
        "--qos-profile-overrides-path", metavar="FILE", help="YAML: quality of service by topic, as rosbag2's"
    )
    flag("-l", "--loop", action="store_true", help="start anew at the end, until Ctrl-C")
    text = "wait before the start, and before each round of a loop, in real time"
    flag("-d", "--delay", type=float, default=0.0, metavar="S", help=text)
    flag(
        "-p", "--start-paused", action="store_true", help="play nothing before the service ~/resume is called"
    )
    text = "publish the bag's time on /clock, so often a second (default 100)"
    flag("--clock", nargs="?", type=float, const=100.0, metavar="HZ", help=text)
    text = "wait until so many subscriptions match, all topics together"
    flag("--wait-for-subscriptions", type=int, default=0, metavar="N", help=text)
    flag("--wait-timeout", type=float, default=30.0, metavar="S", help="longest wait (default 30)")
    text = "go no faster than the estimator (or who reports on --handled-topics) handles the messages"
    flag("--lossless", action="store_true", help=text)
    flag("--handled-topics", nargs="+", default=[], metavar="NAME", help="default: estimator/handled")


def record(arguments: argparse.Namespace) -> None:
    """Become the recorder."""
    parameters = {key: value for key, value in vars(arguments).items() if key != "command"}
    output = arguments.output or f"bag_{datetime.now():%Y-%m-%d_%H-%M-%S}"
    _become("recorder", {**parameters, "output": str(Path.cwd() / output)})


def play(arguments: argparse.Namespace) -> None:
    """Become the player."""
    from tms_bag.reading.reader import BagReader

    parameters = dict(vars(arguments))
    for key in ("command", "clock", "remap", "qos_profile_overrides_path"):
        del parameters[key]
    with BagReader(arguments.bag) as bag:  # what is wrong with it is said at once
        parameters["bag"] = str(Path.cwd() / bag.path)
    if arguments.clock is not None:
        parameters |= {"publish_clock": True, "clock_rate": arguments.clock}
    if arguments.qos_profile_overrides_path:
        parameters |= qos_overrides(Path(arguments.qos_profile_overrides_path))
    remaps = [word for rule in arguments.remap for word in ("-r", rule)]
    _become("player", parameters, remaps)


def qos_overrides(path: Path) -> dict[str, object]:
    """ROS parameters out of rosbag2's YAML file of overrides. RecordingError if it isn't one."""
    from tms_model.yaml_text import NOT_YAML, load_yaml

    try:
        content = load_yaml(path.read_text(encoding="utf-8"))
    except (OSError, *NOT_YAML) as error:
        raise RecordingError(
            f"{path}: can't be read as YAML ({' '.join(str(error).split())[:200]})"
        ) from error
    parameters: dict[str, object] = {}
    for topic, policies in content.items() if isinstance(content, dict) else [("", content)]:
        unknown = set(policies) - set(POLICIES) if isinstance(policies, dict) else {type(policies).__name__}
        if unknown or not str(topic).startswith("/"):
            raise RecordingError(
                f"{path}: expected topics (/imu) with {', '.join(POLICIES)}, found {topic!r}:"
                f" {', '.join(map(str, unknown)) or 'no full name'}"
            )
        parameters |= {
            f"qos_overrides.{topic}.publisher.{policy}": value for policy, value in policies.items()
        }
    return parameters


def _become(name: str, parameters: dict[str, Any], remaps: Sequence[str] = ()) -> None:
    """Become the node, so that signals and the exit code are the node's."""
    module = f"tms_bag.nodes.{name}"
    arguments = [sys.executable, "-m", "tms_bag.nodes.starting", module, "--ros-args", *remaps]
    for key, value in parameters.items():
        if value not in ([], ""):  # an empty list has no type for ROS; the node's default is empty
            # ROS reads the text as YAML, which knows no pairs of \u for a character.
            arguments += ["-p", f"{key}:={json.dumps(value, ensure_ascii=False)}"]
    sys.stdout.flush()
    os.execv(sys.executable, arguments)
