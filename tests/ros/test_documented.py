"""docs/nodes.md says of every node what it really has: parameters, services, topics."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter
from tms_bag.nodes.player import Player
from tms_bag.nodes.recorder import Recorder
from tms_fit.nodes.estimator import Estimator
from tms_sim.keys import KEYS
from tms_sim.nodes.simulator import Simulator

NODES = {"Recorder": Recorder, "Player": Player, "Simulator": Simulator, "Estimator": Estimator}
DOCUMENT = Path(__file__).parents[2] / "docs" / "nodes.md"
EVERY_NODE = ("use_sim_time", "start_type_description_service")  # has these, from rclpy


def section(name: str) -> str:
    found = re.search(rf"^## {name}\n(.*?)(?=^## |\Z)", DOCUMENT.read_text(), re.MULTILINE | re.DOTALL)
    assert found, f"docs/nodes.md has no section {name}"
    return found[1]


def rows(node: Any) -> list[str]:
    """The table of a node's parameters, as it should stand in the document."""
    lines = []
    for name in sorted(node.get_parameters_by_prefix("")):
        of_scenario = isinstance(node, Simulator) and name in KEYS  # `tms sim` tells these
        if name in EVERY_NODE or of_scenario or name.startswith("qos_overrides."):
            continue
        descriptor = node.describe_parameter(name)
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        limits = f"{ranges[0].from_value:g} to {ranges[0].to_value:g}" if ranges else ""
        value = node.get_parameter(name).value
        shown = ", ".join(map(str, value)) if isinstance(value, list) else value
        text = descriptor.description.replace("|", "\\|")
        lines.append(f"| `{name}` | {'' if shown == '' else f'`{shown}`'} | {limits} | {text} |")
    return lines


@pytest.fixture
def make(domain_id: int, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes a node with nothing but what it needs; ends it with the test."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.chdir(tmp_path)
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    made = []

    def start(kind: Any) -> Any:
        needed = [Parameter("bag", value="bag")] if kind is Player else []
        made.append(kind(context=context, parameter_overrides=needed))
        return made[-1]

    yield start
    for node in made:
        node.close()
        node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.mark.parametrize("name", NODES)
def test_parameters_services_and_topics(make: Any, name: str, tmp_path: Path) -> None:
    node = make(NODES[name])
    text = section(name)
    expected = rows(node)
    if name == "Recorder":
        expected = [re.sub(r"`bag_[\d_-]+`", "", row) for row in expected]
    if name == "Player":
        expected = [row.replace("| `bag` | `bag` |", "| `bag` |  |") for row in expected]
    found = [line for line in text.splitlines() if re.match(r"\| `[a-z0-9_.]+` \|.*\|.*\|.*\|", line)]
    assert found == expected, "\n".join(["docs/nodes.md should say:", *expected])
    own = f"/{node.get_name()}/"
    for served, _ in node.get_service_names_and_types_by_node(node.get_name(), "/"):
        service = served.partition("/_action/")[0]  # an action is made of services and topics
        if service.startswith(own) and "parameter" not in service and "type_description" not in service:
            assert f"~/{service.removeprefix(own)}`" in text, f"{service} isn't documented"
    for topic, _ in node.get_publisher_names_and_types_by_node(node.get_name(), "/"):
        if topic not in ("/rosout", "/parameter_events", "/diagnostics") and name != "Player":
            shown = topic.partition("/_action/")[0].replace(own, "~/").removeprefix("/")
            assert f"`{shown}`" in text or f"`/{shown}`" in text, f"{topic} isn't documented"
    for parameter in expected:
        assert not parameter.endswith("|  |"), f"without a description: {parameter}"
