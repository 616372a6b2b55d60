"""Between what a bag says and what rclpy wants: message classes and quality of service."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions, QoSPolicyKind
from rosgraph_msgs.msg import Clock

from tms_bag.errors import RecordingError
from tms_bag.qos import INFINITE_NS, Qos

# What `qos_overrides./topic.publisher.*` parameters may change.
OVERRIDABLE = QoSOverridingOptions(
    policy_kinds=(
        QoSPolicyKind.HISTORY,
        QoSPolicyKind.DEPTH,
        QoSPolicyKind.RELIABILITY,
        QoSPolicyKind.DURABILITY,
    )
)
LEAST_DEPTH, MOST_DEPTH = 5000, 10**6  # [messages]; a bag may say anything, DDS takes less than 2^31


def message_class(type_name: str) -> Any:
    """Class of a message type such as sensor_msgs/msg/Imu. RecordingError if its package isn't installed."""
    package, _, name = type_name.replace("/", ".").rpartition(".")
    try:
        return getattr(import_module(package), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise RecordingError(
            f"message type {type_name} is not installed; build and source the workspace that holds it"
        ) from error


def clock_message(time_ns: int) -> Clock:
    """Message for /clock."""
    return Clock(clock=Time(sec=time_ns // 10**9, nanosec=time_ns % 10**9))


def recorded_qos(profile: QoSProfile) -> Qos:
    """What a publisher offers, as a bag keeps it."""
    return Qos(
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        history=profile.history.name.lower(),
        depth=profile.depth,
        deadline_ns=profile.deadline.nanoseconds,
        lifespan_ns=profile.lifespan.nanoseconds,
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_ns=profile.liveliness_lease_duration.nanoseconds,
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def offered_profile(recorded: Sequence[Qos], count: int) -> QoSProfile:
    """What to offer when `count` messages of a topic are played: what was recorded, with enough depth.

    The depth of a latched topic decides what late joiners get. Discovery doesn't tell it, so that recorded
    bags hold 0: then it is all messages, since there may have been several publishers with one each. On other
    topics it is only a buffer, which has to bear a higher rate than when it was recorded.
    """
    qos = recorded[0] if recorded else Qos()
    latched = qos.durability == "transient_local"
    said = min(max(qos.depth, 0), MOST_DEPTH)
    depth = (said or min(max(count, 1), 1000)) if latched else max(said, LEAST_DEPTH)
    profile = QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_ALL if qos.history == "keep_all" else HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.BEST_EFFORT
        if qos.reliability == "best_effort"
        else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        liveliness=LivelinessPolicy.AUTOMATIC,  # a manual one would have to be asserted by the original node
    )
    if 0 < qos.deadline_ns < INFINITE_NS:
        profile.deadline = Duration(nanoseconds=qos.deadline_ns)
    if 0 < qos.lifespan_ns < INFINITE_NS:
        profile.lifespan = Duration(nanoseconds=qos.lifespan_ns)
    return profile
