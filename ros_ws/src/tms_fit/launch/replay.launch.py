"""A recorded run through the estimator, without loss. For a full ROS 2 install, with its `ros2 launch`.

ros2 launch tms_fit replay.launch.py bag:=my_bag rate:=100.0
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """Nodes and arguments; the end of the bag ends the estimator."""
    player = {
        "bag": LaunchConfiguration("bag"),
        "rate": ParameterValue(LaunchConfiguration("rate"), value_type=float),
        "lossless": True,
    }
    bicycle = {"bicycle": ParameterValue(LaunchConfiguration("bicycle"), value_type=str)}
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="bag to play"),
            DeclareLaunchArgument("rate", default_value="1.0", description="times real time"),
            DeclareLaunchArgument("bicycle", default_value="", description="name; empty: what run_info says"),
            Node(package="tms_fit", executable="estimator", parameters=[bicycle]),
            Node(
                package="tms_bag",
                executable="player",
                parameters=[player],
                on_exit=Shutdown(reason="the bag has ended"),
            ),
        ]
    )
