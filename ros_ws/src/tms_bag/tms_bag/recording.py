"""A recording as arrays: the topics of this project found in a bag and decoded."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tms_bag import conversion, topics
from tms_bag.errors import RecordingError
from tms_bag.reading.columns import Columns
from tms_bag.reading.definitions import message_of
from tms_bag.reading.reader import BagReader
from tms_bag.samples import (
    ImuSamples,
    Joining,
    LeanYawSamples,
    RunInfo,
    Samples,
    SpeedSamples,
    StateSamples,
    SteerTorqueSamples,
    in_time_order,
)
from tms_bag.speed_topic import NO_TOPIC, SpeedTopic, find_speed_topic

_DECODERS: dict[str, Callable[[Columns], Any]] = {
    topics.IMU: conversion.imu_samples,
    topics.SPEED: conversion.speed_samples,
    topics.SPEED_COVARIANCE: conversion.speed_covariance_samples,
    topics.STEER_TORQUE: conversion.steer_torque_samples,
    topics.LEAN_YAW: conversion.lean_yaw_samples,
    topics.STATE: conversion.state_samples,
}
FLAGS = {
    topics.IMU: "--imu-topic",
    topics.STEER_TORQUE: "--steer-torque-topic",
}


@dataclass(frozen=True, eq=False)
class Recording:
    """What a bag holds for the analysis of a run. Samples are sorted by time, each time occurs once."""

    path: Path
    imu: ImuSamples
    speed: SpeedSamples | None
    steer_torque: SteerTorqueSamples | None
    lean_yaw: LeanYawSamples | None
    state: StateSamples | None  # the truth, from the simulator only
    run_info: RunInfo | None
    start_ns: int  # [ns] log time of the bag's first message
    custom_data: dict[str, str]
    duplicates: int = 0  # samples left out because the topic has an earlier one with the same time
    warnings: tuple[str, ...] = ()  # what is wrong with the bag itself, for example that it's cut short
    speed_topic: SpeedTopic = NO_TOPIC  # of a bag; where no topic was taken, those that were not


def read_recording(
    path: str | os.PathLike[str],
    imu_topic: str | None = None,
    speed_topic: str | None = None,
    steer_torque_topic: str | None = None,
) -> Recording:
    """Recording from a bag. Times are those of the messages (`header.stamp`), not of their arrival.

    Without a name given, a topic is found by its type and the end of its name ('/imu/data_raw',
    '/bike1/imu/data_raw'); the others are then those of the same namespace. The only topic of a measured
    speed under another name is taken too, of several none; `speed_topic.remark` says so.
    RecordingError, with the topics that are there and the flag to use, if there is no IMU or a choice to
    make.
    """
    with BagReader(path) as bag:
        imu_name = find_topic(bag, topics.IMU, imu_topic)
        if imu_name is None:
            raise RecordingError(_missing(bag, topics.IMU))
        space = imu_name.removesuffix(topics.IMU) if imu_name.endswith("/" + topics.IMU) else "/"
        speeds = find_speed_topic(bag, speed_topic, space)
        torque_name = find_topic(bag, topics.STEER_TORQUE, steer_torque_topic, space)
        names = {topic: find_topic(bag, topic, None, space) for topic in (topics.LEAN_YAW, topics.STATE)}
        info_name = find_topic(bag, topics.RUN_INFO, None, space)
        names |= {topics.IMU: imu_name, speeds.kind: speeds.name, topics.STEER_TORQUE: torque_name}
        found = _samples_of(bag, {name: topic for topic, name in names.items() if name})
        if topics.IMU not in found:
            raise RecordingError(
                f"{bag.path}: expected the messages of {imu_name} that the bag counts, found none: it is"
                f" damaged; `tms bag repair {bag.path} -o NEW` saves what is there"
            )
        imu, repeated = found[topics.IMU]
        speed, repeated_speed = found.get(speeds.kind, (None, 0))
        torque, repeated_torque = found.get(topics.STEER_TORQUE, (None, 0))
        return Recording(
            path=Path(path),
            imu=imu,
            speed=speed,
            steer_torque=torque,
            lean_yaw=found.get(topics.LEAN_YAW, (None, 0))[0],
            state=found.get(topics.STATE, (None, 0))[0],
            run_info=run_info_of(bag, info_name) if info_name else None,
            start_ns=bag.start_ns,
            custom_data=bag.custom_data,
            duplicates=repeated + repeated_speed + repeated_torque,
            warnings=bag.warnings,
            speed_topic=speeds,
        )


def find_topic(bag: BagReader, topic: str, chosen: str | None = None, space: str = "/") -> str | None:
    """Name in the bag of one of the topics of `tms_bag.topics`; None if there is none with messages.

    `chosen` is the user's choice, `space` the namespace to prefer, with a slash at both ends.
    """
    there = [entry.name for entry in bag.topics if entry.type == topics.TYPES[topic] and entry.count]
    if chosen is not None:
        name = chosen if chosen.startswith("/") else "/" + chosen
        if name not in there:
            raise RecordingError(_missing(bag, topic, name))
        return name
    if space + topic in there:
        return space + topic
    found = [name for name in there if name.endswith("/" + topic)]
    if len(found) > 1:
        raise RecordingError(
            f"{bag.path}: expected one topic {topic}, found {', '.join(found)}; choose one"
            + (f" with {FLAGS[topic]} {found[0]}" if topic in FLAGS else " by --imu-topic in its namespace")
        )
    return found[0] if found else None


def _missing(bag: BagReader, topic: str, name: str | None = None) -> str:
    kind = topics.TYPES[topic]
    same = [entry.name for entry in bag.topics if entry.type == kind and entry.count]
    wanted = f"a topic {name or '/' + topic} of type {kind} with messages"
    if same:
        flag = FLAGS.get(topic)
        return f"{bag.path}: expected {wanted}, found of this type {', '.join(same)}" + (
            f"; use {flag} {same[0]}" if flag else ""
        )
    others = ", ".join(f"{entry.name} ({entry.type}, {entry.count})" for entry in bag.topics) or "no topics"
    cut = "".join(f"; {warning}" for warning in bag.warnings)
    return f"{bag.path}: expected {wanted}, found none; the bag holds {others}: record that topic too{cut}"


def _samples_of(bag: BagReader, names: dict[str, str]) -> dict[str, tuple[Any, int]]:
    """Samples by topic and how many were left out, in one go through the bag.

    `names` says which topic a name in the bag stands for.
    """
    wanted = {name: conversion.FIELDS[topic] for name, topic in names.items()}
    joining: dict[str, Joining[Any]] = {name: Joining(bag.expected(name)) for name in names}
    for part in bag.parts(wanted):
        joining[part.topic].add(_DECODERS[names[part.topic]](part))
    found = {}
    for name, topic in names.items():
        whole = joining.pop(name).whole()
        if whole is not None:
            found[topic] = _in_order(bag, name, whole)
    return found


def _in_order(bag: BagReader, name: str, samples: Samples) -> tuple[Samples, int]:
    if not samples.time_ns.any():
        raise RecordingError(
            f"{bag.path}: expected time stamps in {name} (header.stamp), found only 0; let the"
            " sensor's driver stamp its messages"
        )
    return in_time_order(samples)


def run_info_of(bag: BagReader, name: str) -> RunInfo | None:
    """What the run was, by the first message of the topic; None without one. RecordingError if it's none."""
    record = next(bag.records([name]), None)
    if record is None:
        return None
    channel = next(channel for channel in bag.channels if channel.name == name)
    try:
        return conversion.run_info(record, message_of(channel, record.data))
    except RecordingError as error:
        raise RecordingError(f"{bag.path}: {name} at {record.time_ns} ns: {error}") from error
