"""Samples to serialised messages and back: the only place where the fields of messages are known.

A live node, a replayed bag and an offline run all go through these functions. Topics are written with a
leading slash. Variances stand on the diagonals of the covariances; a value of 0 says "unknown" there
(REP-145), so a variance of exactly 0 comes back as NaN. `imu/data_raw` says by orientation_covariance[0] = -1
that it has no orientation.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from tms_bag import topics
from tms_bag.errors import RecordingError
from tms_bag.messages import deserialize, message_type, serialize
from tms_bag.record import Record
from tms_bag.samples import (
    FloatArray,
    ImuSamples,
    IntArray,
    LeanYawSamples,
    RunInfo,
    SpeedSamples,
    StateSamples,
    SteerTorqueSamples,
)

LAST_STAMP_NS = 2**31 * 10**9  # builtin_interfaces/Time counts seconds in an int32
WORLD, REAR_FRAME, FRONT_FRAME = "world", "rear_frame", "front_frame"


def imu_records(samples: ImuSamples) -> Iterator[Record]:
    """sensor_msgs/Imu without orientation on /imu/data_raw."""
    kind, vector = message_type(topics.TYPES[topics.IMU]), message_type("geometry_msgs/msg/Vector3")
    orientation = message_type("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0)
    no_orientation = np.zeros(9)
    no_orientation[0] = -1.0
    rate_covariance = _covariance(samples.angular_velocity_variance)
    force_covariance = _covariance(samples.specific_force_variance)
    for time_ns, rate, force in zip(
        samples.time_ns.tolist(),
        samples.angular_velocity.tolist(),
        samples.specific_force.tolist(),
        strict=True,
    ):
        message = kind(
            header=_header(time_ns, samples.frame_id),
            orientation=orientation,
            orientation_covariance=no_orientation,
            angular_velocity=vector(*rate),
            angular_velocity_covariance=rate_covariance,
            linear_acceleration=vector(*force),
            linear_acceleration_covariance=force_covariance,
        )
        yield _record(topics.IMU, time_ns, message)


def imu_samples(records: Iterable[Record]) -> ImuSamples:
    """Angular velocity and specific force; NaN where the message says that it doesn't have one (REP-145)."""
    messages = [_message(record) for record in records]
    rates = np.array([_vector(m.angular_velocity) for m in messages]).reshape(-1, 3)
    forces = np.array([_vector(m.linear_acceleration) for m in messages]).reshape(-1, 3)
    rates[[m.angular_velocity_covariance[0] == -1.0 for m in messages]] = np.nan
    forces[[m.linear_acceleration_covariance[0] == -1.0 for m in messages]] = np.nan
    if not messages:
        return ImuSamples(_times([]), rates, forces)
    return ImuSamples(
        time_ns=_times(messages),
        angular_velocity=rates,
        specific_force=forces,
        angular_velocity_variance=_variance(messages[0].angular_velocity_covariance),
        specific_force_variance=_variance(messages[0].linear_acceleration_covariance),
        frame_id=messages[0].header.frame_id,
    )


def lean_yaw_records(samples: LeanYawSamples) -> Iterator[Record]:
    """tms_msgs/LeanYaw on /imu/lean_yaw; a NaN is marked as not valid."""
    kind = message_type(topics.TYPES[topics.LEAN_YAW])
    columns = (samples.time_ns, samples.lean, samples.lean_rate, samples.yaw_rate, samples.saturation)
    for time_ns, lean, lean_rate, yaw_rate, saturation in zip(*(c.tolist() for c in columns), strict=True):
        message = kind(
            header=_header(time_ns, REAR_FRAME),
            lean=lean,
            lean_rate=lean_rate,
            yaw_rate=yaw_rate,
            lean_valid=lean == lean,
            lean_rate_valid=lean_rate == lean_rate,
            yaw_rate_valid=yaw_rate == yaw_rate,
            saturation=saturation,
        )
        yield _record(topics.LEAN_YAW, time_ns, message)


def lean_yaw_samples(records: Iterable[Record]) -> LeanYawSamples:
    """Lean, lean rate and yaw rate; NaN where the message marks them as not valid."""
    messages = [_message(record) for record in records]
    return LeanYawSamples(
        time_ns=_times(messages),
        lean=_column(m.lean if m.lean_valid else np.nan for m in messages),
        lean_rate=_column(m.lean_rate if m.lean_rate_valid else np.nan for m in messages),
        yaw_rate=_column(m.yaw_rate if m.yaw_rate_valid else np.nan for m in messages),
        saturation=np.array([m.saturation for m in messages], dtype=np.uint8),
    )


def speed_records(samples: SpeedSamples) -> Iterator[Record]:
    """geometry_msgs/TwistStamped in rear_frame on /bicycle/speed: x forward, the rest 0."""
    kind = message_type(topics.TYPES[topics.SPEED])
    twist, vector = message_type("geometry_msgs/msg/Twist"), message_type("geometry_msgs/msg/Vector3")
    zero = vector(0.0, 0.0, 0.0)
    for time_ns, speed in zip(samples.time_ns.tolist(), samples.speed.tolist(), strict=True):
        message = kind(
            header=_header(time_ns, REAR_FRAME), twist=twist(linear=vector(speed, 0.0, 0.0), angular=zero)
        )
        yield _record(topics.SPEED, time_ns, message)


def speed_samples(records: Iterable[Record]) -> SpeedSamples:
    """Forward speed."""
    messages = [_message(record) for record in records]
    return SpeedSamples(_times(messages), _column(m.twist.linear.x for m in messages))


def steer_torque_records(samples: SteerTorqueSamples) -> Iterator[Record]:
    """tms_msgs/SteerTorque on /bicycle/steer_torque."""
    kind = message_type(topics.TYPES[topics.STEER_TORQUE])
    for time_ns, torque in zip(samples.time_ns.tolist(), samples.steer_torque.tolist(), strict=True):
        message = kind(header=_header(time_ns, FRONT_FRAME), steer_torque=torque)
        yield _record(topics.STEER_TORQUE, time_ns, message)


def steer_torque_samples(records: Iterable[Record]) -> SteerTorqueSamples:
    """Known steer torque."""
    messages = [_message(record) for record in records]
    return SteerTorqueSamples(_times(messages), _column(m.steer_torque for m in messages))


def state_records(samples: StateSamples) -> Iterator[Record]:
    """tms_msgs/BicycleState on /bicycle/state."""
    kind = message_type(topics.TYPES[topics.STATE])
    columns = (
        samples.time_ns,
        samples.speed,
        samples.state,
        samples.yaw,
        samples.yaw_rate,
        samples.steer_torque,
    )
    for time_ns, speed, state, yaw, yaw_rate, torque in zip(*(c.tolist() for c in columns), strict=True):
        lean, steer, lean_rate, steer_rate = state
        message = kind(
            header=_header(time_ns, WORLD),
            speed=speed,
            lean=lean,
            steer=steer,
            lean_rate=lean_rate,
            steer_rate=steer_rate,
            yaw=yaw,
            yaw_rate=yaw_rate,
            steer_torque=torque,
        )
        yield _record(topics.STATE, time_ns, message)


def state_samples(records: Iterable[Record]) -> StateSamples:
    """True state."""
    messages = [_message(record) for record in records]
    return StateSamples(
        time_ns=_times(messages),
        speed=_column(m.speed for m in messages),
        state=np.array([(m.lean, m.steer, m.lean_rate, m.steer_rate) for m in messages]).reshape(-1, 4),
        yaw=_column(m.yaw for m in messages),
        yaw_rate=_column(m.yaw_rate for m in messages),
        steer_torque=_column(m.steer_torque for m in messages),
    )


def run_info_records(info: RunInfo) -> Iterator[Record]:
    """One tms_msgs/RunInfo on /run_info."""
    vector, quaternion = (
        message_type("geometry_msgs/msg/Vector3"),
        message_type("geometry_msgs/msg/Quaternion"),
    )
    message = message_type(topics.TYPES[topics.RUN_INFO])(
        header=_header(info.start_ns, REAR_FRAME),
        bicycle=info.bicycle,
        parameter_names=list(info.parameters),
        parameter_values=np.array(list(info.parameters.values()), dtype=np.float64),
        speed=float(info.speed),
        imu_mounting=message_type("geometry_msgs/msg/Transform")(
            translation=vector(*map(float, info.imu_position)),
            rotation=quaternion(*map(float, info.imu_orientation)),
        ),
        simulated=info.simulated,
        seed=info.seed,
        source=info.source,
        version=info.version,
        source_sha256=info.source_sha256,
        configuration=info.configuration,
    )
    yield _record(topics.RUN_INFO, info.start_ns, message)


def run_info(record: Record) -> RunInfo:
    """RunInfo of a message."""
    m = _message(record)
    position, rotation = m.imu_mounting.translation, m.imu_mounting.rotation
    return RunInfo(
        start_ns=_stamp_ns(m),
        bicycle=m.bicycle,
        parameters=dict(zip(m.parameter_names, m.parameter_values.tolist(), strict=False)),
        speed=m.speed,
        imu_position=np.array(_vector(position)),
        imu_orientation=np.array([rotation.x, rotation.y, rotation.z, rotation.w]),
        simulated=m.simulated,
        seed=m.seed,
        source=m.source,
        version=m.version,
        source_sha256=m.source_sha256,
        configuration=m.configuration,
    )


def _record(topic: str, time_ns: int, message: Any) -> Record:
    return Record("/" + topic, topics.TYPES[topic], time_ns, serialize(message), time_ns)


def _header(time_ns: int, frame_id: str) -> Any:
    if not 0 <= time_ns < LAST_STAMP_NS:
        raise RecordingError(f"expected times from 0 to 2^31 s since 1970 (ROS stamps), found {time_ns} ns")
    stamp = message_type("builtin_interfaces/msg/Time")(sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return message_type("std_msgs/msg/Header")(stamp=stamp, frame_id=frame_id)


def _message(record: Record) -> Any:
    try:
        return deserialize(record.data, record.type)
    except RecordingError as error:
        raise RecordingError(f"{record.topic} at {record.time_ns} ns: {error}") from error


def _stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def _times(messages: Sequence[Any]) -> IntArray:
    return np.array([_stamp_ns(message) for message in messages], dtype=np.int64)


def _column(values: Iterable[float]) -> FloatArray:
    return np.fromiter(values, dtype=np.float64)


def _vector(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _covariance(variance: FloatArray) -> FloatArray:
    return np.diag(np.nan_to_num(variance, nan=0.0)).ravel()


def _variance(covariance: FloatArray) -> FloatArray:
    diagonal = np.asarray(covariance, dtype=np.float64)[[0, 4, 8]]
    return np.where(diagonal > 0.0, diagonal, np.nan)
