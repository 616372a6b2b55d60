"""A simulated experiment: simulator, estimator and recorder. For a full ROS 2 install and its `ros2 launch`.

ros2 launch tms_sim experiment.launch.py output:=my_bag scenario:=tms_strike rate:=2.0
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """Nodes and arguments; the end of the run ends the recorder and the estimator."""
    namespace = LaunchConfiguration("namespace")
    simulator = {
        "scenario": LaunchConfiguration("scenario"),
        "rate": ParameterValue(LaunchConfiguration("rate"), value_type=float),
        "wait_for_subscribers": 1,
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument("output", description="bag to write"),
            DeclareLaunchArgument("scenario", default_value="tms_strike", description="name or .yaml file"),
            DeclareLaunchArgument(
                "rate", default_value="1.0", description="simulated seconds per real second"
            ),
            DeclareLaunchArgument("namespace", default_value="", description="of all nodes and topics"),
            Node(
                package="tms_bag",
                executable="recorder",
                namespace=namespace,
                parameters=[{"output": LaunchConfiguration("output")}],
            ),
            Node(package="tms_fit", executable="estimator", namespace=namespace),
            Node(
                package="tms_sim",
                executable="simulator",
                namespace=namespace,
                parameters=[simulator],
                on_exit=Shutdown(reason="the run has ended"),
            ),
        ]
    )
