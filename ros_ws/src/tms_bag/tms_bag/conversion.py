"""Samples to serialised messages and back: the only place where the fields of messages are known.

A live node, a replayed bag and an offline run all go through these functions. Topics are written with a
leading slash. Variances stand on the diagonals of the covariances; 0 says "unknown" there (REP-145),
so that a variance of exactly 0 comes back as NaN. `imu/data_raw` says by orientation_covariance[0] = -1
that it has no orientation; samples with one go to `imu/data`. A number that is not finite, or too large for
any unit, is read as NaN.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tms_bag import topics
from tms_bag.errors import RecordingError
from tms_bag.messages import deserialize, message_type, serialize
from tms_bag.reading.columns import FRAME_ID, Columns
from tms_bag.reading.one_message import read_numbers
from tms_bag.reading.tables import MessageError, Table, new_table, read_table, rows, stamps
from tms_bag.record import Record
from tms_bag.samples import (
    FloatArray,
    ImuSamples,
    IntArray,
    LeanYawSamples,
    MagneticSamples,
    RunInfo,
    SpeedSamples,
    StateSamples,
    SteerTorqueSamples,
)

Vector: TypeAlias = tuple[float, float, float]
NUMBER_LIMIT = 1e100  # a larger one is no measurement in any unit, and sums of its square overflow
LAST_STAMP_NS = 2**31 * 10**9  # builtin_interfaces/Time counts seconds in an int32
Messages: TypeAlias = "Iterable[Record] | Columns"  # of one topic, as they come or read as arrays

WORLD, REAR_FRAME, FRONT_FRAME = "world", "rear_frame", "front_frame"

_STATE = ("lean", "steer", "lean_rate", "steer_rate")
_TRUTH = (
    "speed", "yaw", "yaw_rate", "steer_torque", "acceleration", "lean_acceleration", "steer_acceleration",
    "yaw_acceleration", "rear_slip", "front_slip",
)  # fmt: skip
_CONTACTS = ("rear_contact", "front_contact")
_LEAN_YAW = ("lean", "lean_rate", "yaw_rate")
_RUN_INFO: dict[str, object] = {
    "bicycle": "", "speed": 0.0, "simulated": False, "seed": 0, "source": "", "version": "",
    "source_sha256": "", "configuration": "",
}  # fmt: skip
_GYROSCOPES = (*(f"angular_velocity.{axis}" for axis in "xyz"), "angular_velocity_covariance")
_COVARIANCES = ("orientation_covariance", "angular_velocity_covariance", "linear_acceleration_covariance")

# What of each topic's messages becomes samples: the rest need not be read.
FIELDS: dict[str, tuple[str, ...]] = {
    topics.IMU: (
        *(f"{vector}.{axis}" for vector in ("angular_velocity", "linear_acceleration") for axis in "xyz"),
        *(f"orientation.{axis}" for axis in "xyzw"),
        *_COVARIANCES,
    ),
    topics.MAGNETIC: (*(f"magnetic_field.{axis}" for axis in "xyz"), "magnetic_field_covariance"),
    topics.LEAN_YAW: (*_LEAN_YAW, *(f"{name}_valid" for name in _LEAN_YAW), "saturation"),
    topics.SPEED: ("twist.linear.x",),
    topics.SPEED_COVARIANCE: ("twist.twist.linear.x", "twist.covariance"),
    topics.STEER_TORQUE: ("steer_torque",),
    topics.STATE: (*_STATE, *_TRUTH, *_CONTACTS, "phase"),
}


def imu_records(samples: ImuSamples) -> Iterator[Record]:
    """sensor_msgs/Imu: on /imu/data_raw without orientation, on /imu/data with one."""
    topic = topics.IMU if samples.orientation is None else topics.IMU_ORIENTED
    table = _table(topic, samples.time_ns, samples.frame_id)
    if samples.orientation is None:
        table["orientation.w"] = 1.0
        table["orientation_covariance"][:, 0] = -1.0
    else:
        for number, axis in enumerate("xyzw"):
            table[f"orientation.{axis}"] = samples.orientation[:, number]
        table["orientation_covariance"] = _covariance(samples.orientation_variance)
    _put_vectors(table, "angular_velocity", samples.angular_velocity)
    _put_vectors(table, "linear_acceleration", samples.specific_force)
    table["angular_velocity_covariance"] = _covariance(samples.angular_velocity_variance)
    table["linear_acceleration_covariance"] = _covariance(samples.specific_force_variance)
    return _records(topic, samples.time_ns, table)


def imu_samples(messages: Messages) -> ImuSamples:
    """Angular velocity, specific force and orientation; NaN where a message says that it has none (REP-145).

    Without orientation in any message it is None.
    """
    table = _read(topics.IMU, messages)
    rates, forces = _vectors(table, "angular_velocity"), _vectors(table, "linear_acceleration")
    turn_covariance, rate_covariance, force_covariance = (_column(table, name, (9,)) for name in _COVARIANCES)
    rates[rate_covariance[:, 0] == -1.0] = np.nan
    forces[force_covariance[:, 0] == -1.0] = np.nan
    if not len(table):
        return ImuSamples(table.time_ns, rates, forces)
    absent = turn_covariance[:, 0] == -1.0
    orientation = np.stack([_column(table, f"orientation.{axis}") for axis in "xyzw"], axis=1)
    orientation[absent] = np.nan
    return ImuSamples(
        time_ns=table.time_ns,
        angular_velocity=rates,
        specific_force=forces,
        angular_velocity_variance=_variance(rate_covariance[0]),
        specific_force_variance=_variance(force_covariance[0]),
        frame_id=table.frame_id,
        orientation=None if absent.all() else orientation,
        orientation_variance=_variance(turn_covariance[int(np.argmin(absent))]),
    )


def imu_reading(record: Record) -> tuple[int, Vector, Vector]:
    """Stamp [ns], angular velocity and its variance of one message, as `imu_samples` has them."""
    time_ns, *numbers = _reading(topics.IMU, _GYROSCOPES, record)
    absent = numbers[3] == -1.0  # REP-145
    x, y, z = (math.nan, math.nan, math.nan) if absent else numbers[:3]
    variance = tuple([value if value > 0.0 else math.nan for value in numbers[3::4]])
    return time_ns, (x, y, z), (variance[0], variance[1], variance[2])


def magnetic_records(samples: MagneticSamples) -> Iterator[Record]:
    """sensor_msgs/MagneticField on /imu/mag."""
    table = _table(topics.MAGNETIC, samples.time_ns, samples.frame_id)
    _put_vectors(table, "magnetic_field", samples.magnetic_field)
    table["magnetic_field_covariance"] = _covariance(samples.magnetic_field_variance)
    return _records(topics.MAGNETIC, samples.time_ns, table)


def magnetic_samples(messages: Messages) -> MagneticSamples:
    """Magnetic flux density."""
    table = _read(topics.MAGNETIC, messages)
    field = _vectors(table, "magnetic_field")
    if not len(table):
        return MagneticSamples(table.time_ns, field)
    return MagneticSamples(
        table.time_ns, field, _variance(_column(table, "magnetic_field_covariance", (9,))[0]), table.frame_id
    )


def lean_yaw_records(samples: LeanYawSamples) -> Iterator[Record]:
    """tms_msgs/LeanYaw on /imu/lean_yaw; a NaN is marked as not valid."""
    table = _table(topics.LEAN_YAW, samples.time_ns, REAR_FRAME)
    for name in _LEAN_YAW:
        table[name] = getattr(samples, name)
        table[f"{name}_valid"] = ~np.isnan(table[name])
    table["saturation"] = samples.saturation
    return _records(topics.LEAN_YAW, samples.time_ns, table)


def lean_yaw_samples(messages: Messages) -> LeanYawSamples:
    """Lean, lean rate and yaw rate; NaN where the message marks them as not valid."""
    table = _read(topics.LEAN_YAW, messages)
    lean, lean_rate, yaw_rate = (
        np.where(_column(table, f"{name}_valid") != 0.0, _column(table, name), np.nan) for name in _LEAN_YAW
    )
    return LeanYawSamples(table.time_ns, lean, lean_rate, yaw_rate, _flags(table, "saturation"))


def saturation_reading(record: Record) -> tuple[int, int]:
    """Stamp [ns] and flags of one tms_msgs/LeanYaw, as `lean_yaw_samples` has them."""
    time_ns, flags = _reading(topics.LEAN_YAW, ("saturation",), record)
    return time_ns, flags


def speed_records(samples: SpeedSamples) -> Iterator[Record]:
    """geometry_msgs/TwistStamped in rear_frame on /bicycle/speed: x forward, the rest 0."""
    table = _table(topics.SPEED, samples.time_ns, REAR_FRAME)
    table["twist.linear.x"] = samples.speed
    return _records(topics.SPEED, samples.time_ns, table)


def speed_samples(messages: Messages) -> SpeedSamples:
    """Forward speed."""
    table = _read(topics.SPEED, messages)
    return SpeedSamples(table.time_ns, _column(table, "twist.linear.x"))


def speed_reading(record: Record) -> tuple[int, float]:
    """Stamp [ns] and forward speed of one message, as `speed_samples` has them."""
    time_ns, speed = _reading(topics.SPEED, FIELDS[topics.SPEED], record)
    return time_ns, speed


def speed_covariance_records(samples: SpeedSamples) -> Iterator[Record]:
    """geometry_msgs/TwistWithCovarianceStamped in rear_frame on /bicycle/speed_with_covariance."""
    table = _table(topics.SPEED_COVARIANCE, samples.time_ns, REAR_FRAME)
    table["twist.twist.linear.x"] = samples.speed
    table["twist.covariance"][:, 0] = np.nan_to_num(samples.variance, nan=0.0)
    return _records(topics.SPEED_COVARIANCE, samples.time_ns, table)


def speed_covariance_samples(messages: Messages) -> SpeedSamples:
    """Forward speed and its variance."""
    table = _read(topics.SPEED_COVARIANCE, messages)
    variance = _column(table, "twist.covariance", (36,))[:, 0]
    variance[~(variance > 0.0)] = np.nan
    return SpeedSamples(table.time_ns, _column(table, "twist.twist.linear.x"), variance)


def speed_covariance_reading(record: Record) -> tuple[int, float, float]:
    """Stamp [ns], forward speed and its variance of one message, as `speed_covariance_samples` has them."""
    time_ns, speed, *covariance = _reading(topics.SPEED_COVARIANCE, FIELDS[topics.SPEED_COVARIANCE], record)
    return time_ns, speed, covariance[0] if covariance[0] > 0.0 else math.nan


def steer_torque_records(samples: SteerTorqueSamples) -> Iterator[Record]:
    """tms_msgs/SteerTorque on /bicycle/steer_torque."""
    table = _table(topics.STEER_TORQUE, samples.time_ns, FRONT_FRAME)
    table["steer_torque"] = samples.steer_torque
    return _records(topics.STEER_TORQUE, samples.time_ns, table)


def steer_torque_samples(messages: Messages) -> SteerTorqueSamples:
    """Known steer torque."""
    table = _read(topics.STEER_TORQUE, messages)
    return SteerTorqueSamples(table.time_ns, _column(table, "steer_torque"))


def steer_torque_reading(record: Record) -> tuple[int, float]:
    """Stamp [ns] and known steer torque of one message, as `steer_torque_samples` has them."""
    time_ns, torque = _reading(topics.STEER_TORQUE, FIELDS[topics.STEER_TORQUE], record)
    return time_ns, torque


def state_records(samples: StateSamples) -> Iterator[Record]:
    """tms_msgs/BicycleState on /bicycle/state."""
    table = _table(topics.STATE, samples.time_ns, WORLD)
    for name in (*_TRUTH, *_CONTACTS, "phase"):
        table[name] = getattr(samples, name)
    for number, name in enumerate(_STATE):
        table[name] = samples.state[:, number]
    return _records(topics.STATE, samples.time_ns, table)


def state_samples(messages: Messages) -> StateSamples:
    """True state."""
    table = _read(topics.STATE, messages)
    return StateSamples(
        time_ns=table.time_ns,
        state=np.stack([_column(table, name) for name in _STATE], axis=1),
        phase=_flags(table, "phase"),
        **{name: _column(table, name) for name in _TRUTH},
        **{name: _column(table, name, (2,)) for name in _CONTACTS},
    )


def run_info_records(info: RunInfo) -> Iterator[Record]:
    """One tms_msgs/RunInfo on /run_info."""
    _check_times(np.array([info.start_ns]))
    vector, quaternion = (
        message_type("geometry_msgs/msg/Vector3"),
        message_type("geometry_msgs/msg/Quaternion"),
    )
    stamp = message_type("builtin_interfaces/msg/Time")(*divmod(info.start_ns, 10**9))
    message = message_type(topics.TYPES[topics.RUN_INFO])(
        header=message_type("std_msgs/msg/Header")(stamp=stamp, frame_id=REAR_FRAME),
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
    yield Record(
        "/" + topics.RUN_INFO, topics.TYPES[topics.RUN_INFO], info.start_ns, serialize(message), info.start_ns
    )


def run_info(record: Record, message: Any = None) -> RunInfo:
    """RunInfo of a message; `message` is its object, by default made with the type installed here.

    RecordingError if a bag defines the type so that it can't be one.
    """
    m = deserialize(record.data, record.type) if message is None else message
    try:
        since = {name: getattr(m, name) for name in _RUN_INFO if hasattr(m, name)}  # a version may lack some
        for name, value in since.items():
            if type(value) is not type(_RUN_INFO[name]):
                raise TypeError(f"{name} is {value!r}"[:100])
        position, rotation = m.imu_mounting.translation, m.imu_mounting.rotation
        return RunInfo(
            start_ns=m.header.stamp.sec * 10**9 + m.header.stamp.nanosec,
            parameters={
                str(name): float(value)
                for name, value in zip(m.parameter_names, m.parameter_values.tolist(), strict=False)
            },
            imu_position=np.array([position.x, position.y, position.z], np.float64),
            imu_orientation=np.array([rotation.x, rotation.y, rotation.z, rotation.w], np.float64),
            **since,
        )
    except (AttributeError, TypeError, ValueError) as error:
        raise RecordingError(
            f"expected a {record.type}, found that the bag defines it otherwise ({error})"
        ) from error


def _table(topic: str, time_ns: IntArray, frame_id: str) -> Table:
    _check_times(time_ns)
    return new_table(topics.TYPES[topic], time_ns, frame_id)


def _records(topic: str, time_ns: IntArray, table: Table) -> Iterator[Record]:
    name, kind = "/" + topic, topics.TYPES[topic]
    return (
        Record(name, kind, time, data, time) for time, data in zip(time_ns.tolist(), rows(table), strict=True)
    )


def _reading(topic: str, names: tuple[str, ...], record: Record) -> tuple[Any, ...]:
    """Stamp [ns] and some numbers of one message. RecordingError if it isn't one of this topic's."""
    try:
        time_ns, *numbers = read_numbers(topics.TYPES[topic], names, record.data)
        low, high = -NUMBER_LIMIT, NUMBER_LIMIT
        return time_ns, *[number if low < number < high else math.nan for number in numbers]
    except MessageError as error:
        raise RecordingError(f"{record.topic} at {record.time_ns} ns: {error}") from error


def _read(topic: str, messages: Messages) -> Columns:
    if isinstance(messages, Columns):
        return messages
    listed = list(messages)
    try:
        table, frames = read_table(topics.TYPES[topic], [record.data for record in listed])
    except MessageError as error:
        wrong = listed[error.row]
        raise RecordingError(f"{wrong.topic} at {wrong.time_ns} ns: {error}") from error
    return Columns(
        topic=topic,
        type=topics.TYPES[topic],
        log_time_ns=np.array([record.time_ns for record in listed], np.int64),
        publish_time_ns=np.array([record.publish_time_ns or record.time_ns for record in listed], np.int64),
        stamp_ns=stamps(table),
        values={name: table[name] for name in table.dtype.names or ()},
        texts={FRAME_ID: tuple(dict.fromkeys(frames))},
    )


def _check_times(time_ns: IntArray) -> None:
    wrong = time_ns[(time_ns < 0) | (time_ns >= LAST_STAMP_NS)]
    if wrong.size:
        raise RecordingError(f"expected times from 0 to 2^31 s since 1970 (ROS stamps), found {wrong[0]} ns")


def _put_vectors(table: Table, name: str, vectors: FloatArray) -> None:
    for number, axis in enumerate("xyz"):
        table[f"{name}.{axis}"] = vectors[:, number]


def _vectors(table: Columns, name: str) -> FloatArray:
    return np.stack([_column(table, f"{name}.{axis}") for axis in "xyz"], axis=1)


def _column(table: Columns, name: str, shape: tuple[int, ...] = ()) -> FloatArray:
    """A number of each message; NaN where it is none, or an older version of the type doesn't have it."""
    if name not in table:
        return np.full((len(table), *shape), np.nan)
    if table[name].shape[1:] != shape:
        raise RecordingError(
            f"{table.topic}: expected {name} of a {table.type} to be {shape or 'a number'}, found"
            f" {table[name].shape[1:]}:"
            " the bag defines this type otherwise"
        )
    values = np.asarray(table[name], dtype=np.float64)
    return np.where(np.abs(values) < NUMBER_LIMIT, values, np.nan)


def _flags(table: Columns, name: str) -> NDArray[np.uint8]:
    """A number from 0 to 255 of each message; 0 where it is another one, or an older type doesn't have it."""
    found = _column(table, name)
    return np.where((found >= 0.0) & (found <= 255.0), found, 0.0).astype(np.uint8)


def _covariance(variance: FloatArray) -> FloatArray:
    return np.diag(np.nan_to_num(variance, nan=0.0)).ravel()


def _variance(covariance: Any) -> FloatArray:
    diagonal = np.asarray(covariance, dtype=np.float64)[[0, 4, 8]]
    return np.where(diagonal > 0.0, diagonal, np.nan)
