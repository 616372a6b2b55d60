"""Parameters of nodes: declared with description, unit and range, refused with a reason if they don't fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from tms_model import ParameterError


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    low: float | None = None,
    high: float | None = None,
    read_only: bool = True,
    any_type: bool = False,
) -> Any:
    """Declare a parameter and return its value; with `any_type` its type is left to who reads it to check.

    Numbers have a range from `low` to `high`, which ROS keeps to at any time. ParameterError if the value at
    start-up has the wrong type or is out of range.
    """
    descriptor = ParameterDescriptor(description=description, read_only=read_only, dynamic_typing=any_type)
    if isinstance(default, float) and low is not None and high is not None:
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    elif isinstance(default, int) and not isinstance(default, bool) and low is not None and high is not None:
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
    try:
        return node.declare_parameter(name, default, descriptor).value
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        expected = f"expected {description}" + (f", from {low:g} to {high:g}" if low is not None else "")
        without_point = isinstance(default, float) and "'INTEGER'" in str(error)
        hint = "; with a decimal point it is a DOUBLE" if without_point else ""
        raise ParameterError(f"parameter {name}: {expected}; {error}{hint}") from error


def refuse_unknown_parameters(node: Node) -> None:
    """Raise ParameterError if a parameter was given that the node does not have: a typo, most likely.

    To be called after publishers have been made, which declare their `qos_overrides`.
    """
    # rclpy keeps what was given to itself; undeclared names are otherwise passed over without a word.
    given = node._parameter_overrides
    unknown = [name for name in given if not node.has_parameter(name)]
    if unknown:
        own = sorted(
            name for name in node.get_parameters_by_prefix("") if name != "start_type_description_service"
        )
        raise ParameterError(f"unknown parameter {', '.join(unknown)}: expected of {', '.join(own)}")


def declare_texts(node: Node, name: str, description: str, default: Sequence[str] = ()) -> list[str]:
    """Declare a list of texts, return those that aren't empty."""
    # An empty list has no type for ROS; a list of one empty text stands for it.
    return [value for value in declare(node, name, list(default) or [""], description) if value]


def declare_names(node: Node, name: str, description: str, default: Sequence[str] = ()) -> list[str]:
    """Declare a list of topic names, return their full names. ParameterError if one can't be a name."""
    values = declare_texts(node, name, description, default)
    try:
        return [node.resolve_topic_name(value) for value in values]
    except Exception as error:  # rclpy raises classes of its C++ part, which have no common base
        raise ParameterError(f"parameter {name}: expected topic names, found {values}: {error}") from error
