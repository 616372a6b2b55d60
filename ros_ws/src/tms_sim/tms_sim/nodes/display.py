"""What viewers show of a simulated bicycle: /tf, joint states, a URDF and its path as a marker.

Publishes like robot_state_publisher would, so that RViz and Foxglove need no other node. Nothing of it is a
measurement: an experimenter has none of these topics.
"""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, String
from tf2_msgs.msg import TFMessage
from tms_bag.samples import RunInfo, StateSamples
from tms_model import ParameterError, WhippleParameters, load_bicycle
from tms_model.acceleration import parameters_under_acceleration
from tms_model.frames import flip_axes
from tms_model.pose import Pose, front_frame_pose, front_wheel_pose, rear_frame_pose, rear_wheel_pose
from tms_model.urdf import JOINTS, urdf
from visualization_msgs.msg import Marker

from tms_sim.run import SimulatedRun

PATH_STEP = 0.02  # [m] between drawn points of the path
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def make_display(node: Node, run: SimulatedRun) -> Display | None:
    """Display of a run; None, with a warning, for a bicycle of which only matrices are known."""
    try:
        p, _ = parameters_under_acceleration(load_bicycle(run.info.bicycle))
    except ParameterError as error:
        node.get_logger().warning(f"nothing is shown on /tf: {error}")
        return None
    return Display(node, p, run.info, run.state)


class Display:
    """Shows the truth of one run as time goes on."""

    def __init__(self, node: Node, p: WhippleParameters, info: RunInfo, state: StateSamples) -> None:
        self._p = p
        self._shown_ns = -(10**18)
        self.follow(state)
        self._tf = node.create_publisher(TFMessage, "/tf", 100)
        self._joints = node.create_publisher(JointState, "joint_states", 100)
        self._path = node.create_publisher(Marker, "bicycle/path", 10)
        self._fixed = node.create_publisher(TFMessage, "/tf_static", LATCHED)
        self._description = node.create_publisher(String, "robot_description", LATCHED)
        mounting = Pose(info.imu_position, info.imu_orientation)
        text = urdf(p, info.bicycle or "bicycle", mounting.position, mounting.orientation)
        self._description.publish(String(data=text))
        stamp = Time(nanoseconds=info.start_ns)
        self._fixed.publish(TFMessage(transforms=[_transform(stamp, "rear_frame", "imu_link", mounting)]))

    def follow(self, state: StateSamples) -> None:
        """Show these states from now on."""
        self._state = state
        self._travelled = np.concatenate([[0.0], np.cumsum(np.diff(state.time_ns) / 1e9 * state.speed[:-1])])

    def advance(self, time_ns: int, rate: float) -> None:
        """Publish the posture, if the last one is 1/rate [s] old or of a time still to come."""
        if rate > 0.0 and not 0 <= time_ns - self._shown_ns < 1e9 / rate:
            self._shown_ns = time_ns
            self.show(time_ns)

    def show(self, time_ns: int) -> None:
        """Publish the posture at a time of the run: that of the last state before it."""
        row = max(int(np.searchsorted(self._state.time_ns, time_ns, side="right")) - 1, 0)
        stamp = Time(nanoseconds=int(self._state.time_ns[row]))
        lean, steer = (float(angle) for angle in self._state.state[row, :2])
        turned = float(self._travelled[row])
        rear, front = (turned / radius if radius else 0.0 for radius in self._radii)
        poses = {
            ("world", "rear_frame"): rear_frame_pose(
                self._state.rear_contact[row], lean, float(self._state.yaw[row])
            ),
            ("rear_frame", "front_frame"): front_frame_pose(self._p, steer),
            ("rear_frame", "rear_wheel"): rear_wheel_pose(self._p, rear),
            ("front_frame", "front_wheel"): front_wheel_pose(self._p, front),
        }
        self._tf.publish(TFMessage(transforms=[_transform(stamp, *k, pose) for k, pose in poses.items()]))
        joints = JointState(name=list(JOINTS), position=[rear, -steer, front])
        joints.header.stamp = stamp.to_msg()
        self._joints.publish(joints)
        self._path.publish(self._line(row, stamp))

    @property
    def _radii(self) -> tuple[float, float]:
        return self._p.rear_wheel_radius, self._p.front_wheel_radius

    def _line(self, row: int, stamp: Time) -> Marker:
        """Path of the rear contact so far."""
        steps = np.arange(0.0, self._travelled[row] + PATH_STEP, PATH_STEP)
        rows = np.unique(np.searchsorted(self._travelled[: row + 1], steps).clip(max=row))
        places = flip_axes(np.pad(self._state.rear_contact[rows], ((0, 0), (0, 1))))
        marker = Marker(ns="rear_contact", type=Marker.LINE_STRIP, action=Marker.ADD)
        marker.header.frame_id, marker.header.stamp = "world", stamp.to_msg()
        marker.scale.x, marker.pose.orientation.w = 0.01, 1.0
        marker.color = ColorRGBA(r=0.8, g=0.45, b=0.1, a=1.0)
        marker.points = [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in places]
        return marker


def _transform(stamp: Time, parent: str, child: str, pose: Pose) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp.to_msg()
    place, turn = message.transform.translation, message.transform.rotation
    place.x, place.y, place.z = (float(value) for value in pose.position)
    turn.x, turn.y, turn.z, turn.w = (float(value) for value in pose.orientation)
    return message
