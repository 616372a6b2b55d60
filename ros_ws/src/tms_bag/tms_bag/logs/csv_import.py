"""A logger's CSV turned into the topics of this project."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from tms_model import load_bicycle
from tms_model.frames import flip_axes

from tms_bag import __version__, conversion, topics
from tms_bag.logs.csv_log import Log, read_csv
from tms_bag.logs.mapping import LogMapping
from tms_bag.record import Record, merged
from tms_bag.samples import (
    FloatArray,
    ImuSamples,
    LeanYawSamples,
    RunInfo,
    SpeedSamples,
    SteerTorqueSamples,
    selected,
)
from tms_bag.writing.writer import BagWriter

_IMU = ("angular_velocity", "specific_force")
_SUMMARY_RATES = {"lean_rate", "yaw_rate"}

__all__ = ["import_csv", "log_records", "read_csv", "run_info"]


@dataclass(frozen=True, eq=False)
class Import:
    """What became of a log."""

    log: Log
    counts: dict[str, int]  # messages by topic


def import_csv(
    log: str | os.PathLike[str], mapping: LogMapping, output: str | os.PathLike[str], overwrite: bool = False
) -> Import:
    """Write the bag of a log; returns what was done. After RecordingError or ParameterError none is left."""
    writer = BagWriter(output, overwrite=overwrite)
    content = read_csv(log, mapping)
    info = run_info(content, mapping)
    writer.custom_data.update(
        configuration=info.configuration,
        seed=str(info.seed),
        version=info.version,
        source_sha256=info.source_sha256,
    )
    with writer:
        for record in log_records(content, info):
            writer.write(record, topics.qos_of(record.topic))
    return Import(content, writer.counts)


def log_records(log: Log, info: RunInfo) -> Iterator[Record]:
    """All messages of a log, in the order of time: on each topic the rows that have something for it."""
    quantities = log.columns.keys()
    imu = {name for name in quantities if name.startswith(_IMU)}
    streams = [
        conversion.run_info_records(info),
        conversion.imu_records(selected(_imu(log), log.rows_with(imu | (quantities & _SUMMARY_RATES)))),
    ]
    if summary := quantities & {"lean", *_SUMMARY_RATES}:
        streams.append(conversion.lean_yaw_records(selected(_lean_yaw(log), log.rows_with(summary))))
    if "speed" in quantities:
        speed = SpeedSamples(log.time_ns, log.columns["speed"])
        streams.append(conversion.speed_records(selected(speed, log.rows_with({"speed"}))))
    if "steer_torque" in quantities:
        torque = SteerTorqueSamples(log.time_ns, log.columns["steer_torque"])
        streams.append(conversion.steer_torque_records(selected(torque, log.rows_with({"steer_torque"}))))
    return merged(*streams)


def run_info(log: Log, mapping: LogMapping) -> RunInfo:
    """What the run was. ParameterError if the bicycle isn't in the catalogue."""
    unknown = (math.nan, math.nan, math.nan)
    return RunInfo(
        start_ns=int(log.time_ns[0]),
        bicycle=mapping.bicycle,
        parameters=load_bicycle(mapping.bicycle).numbers if mapping.bicycle else {},
        speed=float(np.nanmedian(log.columns["speed"])) if "speed" in log.columns else math.nan,
        imu_position=np.array(mapping.imu_position or unknown),
        imu_orientation=np.array(mapping.imu_orientation or (0.0, 0.0, 0.0, 1.0)),
        source=f"{log.path.name}, mapping {mapping.name}",
        version=__version__,
        source_sha256=log.sha256,
        configuration=mapping.configuration,
    )


def _imu(log: Log) -> ImuSamples:
    """Readings in REP-103 axes of a sensor that is aligned with the rear frame."""
    rates = _vectors(log, "angular_velocity")
    # At small lean angles lean and yaw rate are first and last component of the frame's angular velocity.
    rates[:, 0] = log.columns.get("lean_rate", rates[:, 0])
    rates[:, 2] = log.columns.get("yaw_rate", rates[:, 2])
    return ImuSamples(log.time_ns, flip_axes(rates), flip_axes(_vectors(log, "specific_force")))


def _vectors(log: Log, name: str) -> FloatArray:
    absent = np.full(log.time_ns.size, np.nan)
    return np.stack([log.columns.get(f"{name}_{axis}", absent) for axis in "xyz"], axis=1)


def _lean_yaw(log: Log) -> LeanYawSamples:
    absent = np.full(log.time_ns.size, np.nan)
    return LeanYawSamples(
        time_ns=log.time_ns,
        lean=log.columns.get("lean", absent),
        lean_rate=log.columns.get("lean_rate", absent),
        yaw_rate=log.columns.get("yaw_rate", absent),
        saturation=np.zeros(log.time_ns.size, dtype=np.uint8),
    )
