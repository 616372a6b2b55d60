"""Whoever asks for a secured network gets one, or no node."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import rclpy
from tms_model import ParameterError

# What rmw_fastrtps would say where Fast DDS was built without security; the text stands in its library then.
MARK = b"doesn't have the security libraries"
LIBRARY = "librmw_fastrtps_shared_cpp"


def refuse_without_security(args: Sequence[str] | None = None) -> None:
    """Raise ParameterError if security or an enclave is asked for and the DDS has none built in.

    ROS itself would go on without it unless ROS_SECURITY_STRATEGY is Enforce, or stop with several lines.
    """
    asked = security_asked_for(sys.argv[1:] if args is None else args, os.environ)
    if asked and not dds_has_security():
        raise ParameterError(
            f"{asked} asks for a secured network, and the Fast DDS used here was built without security;"
            " take ROS 2 from its own packages (see docs/nodes.md), or don't ask for it"
        )


def security_asked_for(args: Sequence[str], environment: Mapping[str, str]) -> str:
    """What asks for security; empty: nothing does."""
    if environment.get("ROS_SECURITY_ENABLE") == "true":
        return "ROS_SECURITY_ENABLE=true"
    if environment.get("ROS_SECURITY_ENCLAVE_OVERRIDE"):
        return "ROS_SECURITY_ENCLAVE_OVERRIDE"
    return "--enclave" if any(word in ("-e", "--enclave") for word in args) else ""


def dds_has_security() -> bool:
    """Whether the DDS that is loaded was built with security; only Fast DDS is known to lack it."""
    rclpy.get_rmw_implementation_identifier()  # loads it
    with Path("/proc/self/maps").open(encoding="utf-8", errors="replace") as maps:
        loaded = {line.split(maxsplit=5)[-1].strip() for line in maps if LIBRARY in line}
    return not any(MARK in Path(path).read_bytes() for path in loaded)
