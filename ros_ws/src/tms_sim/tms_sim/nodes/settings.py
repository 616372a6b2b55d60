"""The simulator's parameters: the keys of its scenario, and how the run is published."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rclpy.node import Node
from tms_bag.nodes.parameters import declare, declare_names
from tms_model import ParameterError

from tms_sim.keys import KEYS
from tms_sim.scenario import Scenario, load_scenario


@dataclass(frozen=True)
class Settings:
    """What the simulator was started with. `rate`, `display_rate` and `faults` may change later."""

    scenario: Scenario
    own_clock: bool  # the run's time is published on /clock; else it is the node's own
    autostart: bool
    stay: bool  # go on answering services after the run's end
    wait_for_subscribers: int  # of each topic
    handled_topics: tuple[str, ...]  # of consumers to wait for
    wait_timeout: float  # [s]


def declare_settings(node: Node) -> Settings:
    """Declare and read all parameters. Raises ParameterError."""
    scenario = _scenario(node)
    declare(node, "rate", 1.0, "simulated seconds per real second", 0.01, 100.0, read_only=False)
    declare(node, "display_rate", 30.0, "postures shown a second, 0: none [Hz]", 0.0, 200.0, read_only=False)
    clock = declare(
        node,
        "clock",
        "simulated",
        "'simulated': own time from start_time_ns on, published on /clock; 'node': the node's",
    )
    if clock not in ("simulated", "node"):
        raise ParameterError(f"parameter clock: expected 'simulated' or 'node', found {clock!r}")
    settings = Settings(
        scenario=scenario,
        own_clock=clock == "simulated",
        autostart=declare(node, "autostart", True, "begin at once; false: wait for the service start"),
        stay=declare(node, "stay", False, "after the end wait for the services reset or strike"),
        wait_for_subscribers=declare(
            node, "wait_for_subscribers", 0, "subscribers of each topic to wait for", 0, 100
        ),
        handled_topics=tuple(
            declare_names(node, "handled_topics", "where consumers to wait for say what they hear")
        ),
        wait_timeout=declare(
            node, "wait_timeout", 30.0, "longest wait for subscribers and consumers [s]", 0.0, 3600.0
        ),
    )
    if settings.own_clock:
        return settings
    start = {"start_time_ns": node.get_clock().now().nanoseconds}
    return replace(settings, scenario=replace(scenario, values={**scenario.values, **start}))


def _scenario(node: Node) -> Scenario:
    """The scenario by name, each of its keys a parameter."""
    name = declare(node, "scenario", "tms_strike", "scenario by name, or the path of a .yaml file")
    changes = {}
    for key, value in load_scenario(name).values.items():
        rule = KEYS[key]
        default = list(value) if isinstance(value, tuple) else value
        one_or_more = rule.kind is list  # one number, or one for each strike
        ranged = isinstance(default, int | float) and not one_or_more
        low, high = (rule.low, rule.high) if ranged else (None, None)
        fixed = key != "faults"
        given = declare(node, key, default, rule.meaning, low, high, fixed, any_type=one_or_more)
        changes[key] = given if isinstance(given, str | bool | int | float) else list(given)
    return load_scenario(name, changes)
