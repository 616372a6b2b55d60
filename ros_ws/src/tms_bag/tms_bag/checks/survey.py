"""What the checks look at: the recording's topics, its sensor and its speed, before anything is left out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tms_bag import conversion, topics
from tms_bag.checks.poses import RestPose
from tms_bag.errors import RecordingError
from tms_bag.reading.reader import BagReader
from tms_bag.recording import find_topic, run_info_of
from tms_bag.samples import (
    FloatArray,
    ImuSamples,
    IntArray,
    LeanYawSamples,
    RunInfo,
    SpeedSamples,
    in_time_order,
)
from tms_bag.speed_topic import KINDS, NO_TOPIC, SpeedTopic, find_speed_topic

SPEED_SAMPLES = {
    topics.SPEED: conversion.speed_samples,
    topics.SPEED_COVARIANCE: conversion.speed_covariance_samples,
}


@dataclass(frozen=True, eq=False)
class Stream:
    """Times of a topic's messages in the order of their arrival."""

    name: str
    type: str
    log_ns: IntArray  # (n,) [ns]
    stamp_ns: IntArray | None  # (n,) [ns] header.stamp; None: the type has no header
    frame_ids: tuple[str, ...] = ()

    @property
    def duration(self) -> float:
        """From the first to the last message by their stamps [s]."""
        times = self.log_ns if self.stamp_ns is None else self.stamp_ns
        return float(times.max() - times.min()) / 1e9 if times.size else 0.0


@dataclass(frozen=True, eq=False)
class Survey:
    """A recording as it is. Samples are sorted by time; `imu` is in the sensor's own axes."""

    path: Path
    warnings: tuple[str, ...]  # what is wrong with the files
    unreadable: dict[str, str]  # topics that can't be decoded, and why
    streams: dict[str, Stream]  # by topic
    imu_topic: str | None
    imu: ImuSamples | None
    speed_topic: str | None
    speed: SpeedSamples | None
    lean_yaw: LeanYawSamples | None
    run_info: RunInfo | None
    imu_topics: tuple[str, ...] = ()  # all of the type
    speed_topics: tuple[str, ...] = ()
    found_speed: SpeedTopic = NO_TOPIC  # what a fit takes without a flag, or with the one asked for
    poses: tuple[RestPose, ...] = ()  # the sensor at rest, from files of their own

    @property
    def seconds(self) -> FloatArray:
        """Times of the sensor's samples since the first of them (n,) [s]."""
        if self.imu is None or not self.imu.time_ns.size:
            return np.empty(0)
        return np.asarray((self.imu.time_ns - self.imu.time_ns[0]) / 1e9)


def survey(
    path: str | os.PathLike[str],
    imu_topic: str | None = None,
    speed_topic: str | None = None,
    poses: Sequence[RestPose] = (),
) -> Survey:
    """Look through a bag. RecordingError if it can't be opened, or if a topic asked for isn't there."""
    with BagReader(path) as bag:
        streams, unreadable = {}, {}
        for topic in bag.topics:
            if not topic.count:
                continue
            try:
                times = bag.columns({topic.name: ()})[topic.name]
            except RecordingError as error:
                unreadable[topic.name] = str(error)
                continue
            frames = times.texts.get("header.frame_id", ())
            streams[topic.name] = Stream(topic.name, topic.type, times.log_time_ns, times.stamp_ns, frames)
        imu_topics = _of_type(streams, topics.IMU)
        speed_topics = _of_type(streams, topics.SPEED, topics.SPEED_COVARIANCE)
        imu_name = _chosen(bag, topics.IMU, imu_topic, imu_topics, streams)
        space = imu_name.removesuffix(topics.IMU) if imu_name and imu_name.endswith("/" + topics.IMU) else "/"
        found_speed = find_speed_topic(bag, speed_topic, space)
        speed_name, speed_kind = _readable_speed(found_speed, streams)
        info_name = find_topic(bag, topics.RUN_INFO) if _of_type(streams, topics.RUN_INFO) else None
        lean_name = next(iter(_of_type(streams, topics.LEAN_YAW)), None)
        imu = bag.columns({imu_name: conversion.FIELDS[topics.IMU]})[imu_name] if imu_name else None
        speed = bag.columns({speed_name: conversion.FIELDS[speed_kind]})[speed_name] if speed_name else None
        lean = bag.columns({lean_name: conversion.FIELDS[topics.LEAN_YAW]})[lean_name] if lean_name else None
        return Survey(
            path=Path(path),
            warnings=bag.warnings,
            unreadable=unreadable,
            streams=streams,
            imu_topic=imu_name,
            imu=in_time_order(conversion.imu_samples(imu))[0] if imu else None,
            speed_topic=speed_name,
            speed=in_time_order(SPEED_SAMPLES[speed_kind](speed))[0] if speed else None,
            lean_yaw=in_time_order(conversion.lean_yaw_samples(lean))[0] if lean else None,
            run_info=run_info_of(bag, info_name) if info_name else None,
            imu_topics=imu_topics,
            speed_topics=speed_topics,
            found_speed=found_speed,
            poses=tuple(poses),
        )


def _of_type(streams: dict[str, Stream], *wanted: str) -> tuple[str, ...]:
    kinds = [topics.TYPES[topic] for topic in wanted]
    return tuple(stream.name for stream in streams.values() if stream.type in kinds)


def _readable_speed(found: SpeedTopic, streams: dict[str, Stream]) -> tuple[str | None, str]:
    """The speed's topic and its kind; of several candidates the one with most messages."""
    there = [name for name in ((found.name,) if found.name else found.candidates) if name in streams]
    name = max(there, key=lambda one: streams[one].log_ns.size, default=None)
    return name, KINDS[streams[name].type] if name else topics.SPEED


def _chosen(
    bag: BagReader, topic: str, asked: str | None, there: tuple[str, ...], streams: dict[str, Stream]
) -> str | None:
    """The topic asked for, else the one of the usual name, else the one with most messages."""
    if asked is not None:
        return find_topic(bag, topic, asked)
    usual = [name for name in there if name.endswith("/" + topic)]
    return max(usual or there, key=lambda name: streams[name].log_ns.size, default=None)
