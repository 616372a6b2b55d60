"""Settings of a fit as ROS parameters, declared from the options table."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from tms_bag.nodes.parameters import declare
from tms_model.errors import ParameterError

from tms_fit.settings import OPTIONS, Option, Settings
from tms_fit.settings_parser import angles, assignment, each_once, prior

SMALLEST_POSITIVE = 1e-9  # lower limit of a parameter that must be positive


def declare_fit_settings(node: Node) -> Settings:
    """Settings from the declared parameters of a node. Raises ParameterError."""
    return Settings(
        **{name: _read(one, _declare(node, one)) for name, one in OPTIONS.items() if one.parameter}
    )


def _declare(node: Node, one: Option) -> Any:
    """Value of a declared parameter. ROS infers no type from an empty list: [''] or [0.0] replaces it."""
    if one.kind == "number":
        low = SMALLEST_POSITIVE if one.positive and one.default is not None else max(one.low, 0.0)
        return declare(node, one.parameter, one.default or 0.0, _description(one, "0"), low, one.high)
    if one.kind == "numbers":
        return declare(node, one.parameter, [0.0], _description(one, "0"))
    if one.kind == "choice":
        return declare(node, one.parameter, one.default, one.text)
    if one.kind == "angles":
        return declare(node, one.parameter, "", _description(one, "empty", ", as ROLL,PITCH,YAW"))
    written = {"values": ", as NAME=VALUE", "priors": ", as NAME=MEAN,STD"}.get(one.kind, "")
    return declare(node, one.parameter, list(one.default or [""]), _description(one, "empty", written))


def _description(one: Option, nothing: str, written: str = "") -> str:
    return f"{one.text}{written}{f'; {nothing}: {one.unset}' if one.unset else ''}"


def _read(one: Option, value: Any) -> Any:
    """Setting from the value of its parameter. Raises ParameterError."""
    if one.kind == "number":
        return value or one.default
    if one.kind == "choice":
        return value
    where = f"parameter {one.parameter}"
    if one.kind == "angles":
        try:
            return angles(value) if value else one.default
        except ArgumentTypeError as error:
            raise ParameterError(f"{where}: {error}") from error
    given = [item for item in value if item]
    if one.kind in ("names", "numbers"):
        return tuple(given) or one.default
    read: Callable[[str], tuple[str, Any]] = assignment if one.kind == "values" else prior
    try:
        return each_once([read(text) for text in given], where)
    except ArgumentTypeError as error:
        raise ParameterError(f"{where}: {error}") from error
