"""The topics of this project: names, message types, quality of service.

Names are relative, so that a namespace can stand before them; in a bag they stand with a leading slash.
"""

from __future__ import annotations

from tms_bag.qos import LATCHED, SENSOR, Qos

IMU = "imu/data_raw"
IMU_ORIENTED = "imu/data"
MAGNETIC = "imu/mag"
LEAN_YAW = "imu/lean_yaw"
SPEED = "bicycle/speed"
SPEED_COVARIANCE = "bicycle/speed_with_covariance"
STEER_TORQUE = "bicycle/steer_torque"
STATE = "bicycle/state"
EVENTS = "bicycle/events"
RUN_INFO = "run_info"

TYPES: dict[str, str] = {
    IMU: "sensor_msgs/msg/Imu",
    IMU_ORIENTED: "sensor_msgs/msg/Imu",
    MAGNETIC: "sensor_msgs/msg/MagneticField",
    LEAN_YAW: "tms_msgs/msg/LeanYaw",
    SPEED: "geometry_msgs/msg/TwistStamped",
    SPEED_COVARIANCE: "geometry_msgs/msg/TwistWithCovarianceStamped",
    STEER_TORQUE: "tms_msgs/msg/SteerTorque",
    STATE: "tms_msgs/msg/BicycleState",
    EVENTS: "tms_msgs/msg/Event",
    RUN_INFO: "tms_msgs/msg/RunInfo",
}

QOS: dict[str, Qos] = {topic: LATCHED if topic == RUN_INFO else SENSOR for topic in TYPES}


def qos_of(name: str) -> Qos:
    """Quality of service of one of these topics, by its full name in the root namespace."""
    return QOS[name.removeprefix("/")]
