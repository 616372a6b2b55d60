"""A recorded run through the estimator, without loss.

ros2 launch tms_fit replay.launch.py bag:=my_bag rate:=100.0
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# What an estimator said when the bag was recorded would get between what this one says.
SAID_BY_THE_ESTIMATOR = ["estimate", "filter_state", "/diagnostics"]


def generate_launch_description() -> LaunchDescription:
    """Arguments and nodes; the end of one node ends the other."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="bag to play"),
            DeclareLaunchArgument("rate", default_value="", description="times real time; empty: once"),
            DeclareLaunchArgument(
                "bicycle", default_value="", description="name; empty: what params_file or run_info says"
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="of the topics in the bag, and of the nodes"
            ),
            DeclareLaunchArgument(
                "params_file", default_value="", description="YAML file with parameters of the two nodes"
            ),
            OpaqueFunction(function=start_nodes),
        ]
    )


def start_nodes(context: LaunchContext) -> list[Node]:
    """The nodes, with what was given."""
    rate = LaunchConfiguration("rate").perform(context)
    bicycle = LaunchConfiguration("bicycle").perform(context)
    namespace = LaunchConfiguration("namespace").perform(context).strip("/")
    file = LaunchConfiguration("params_file").perform(context)
    player: dict[str, object] = {
        "bag": LaunchConfiguration("bag").perform(context),
        "lossless": True,
        "exclude_topics": SAID_BY_THE_ESTIMATOR,
    }
    if rate:
        player["rate"] = float(rate)
    estimator = {"bicycle": bicycle} if bicycle else {}
    nodes = (("tms_fit", "estimator", estimator), ("tms_bag", "player", player))
    return [
        Node(
            package=package,
            executable=executable,
            namespace=namespace,
            parameters=[part for part in (file, parameters) if part],
            on_exit=Shutdown(reason=f"the {executable} has ended"),
        )
        for package, executable, parameters in nodes
    ]
