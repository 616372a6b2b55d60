"""A simulated experiment: simulator, estimator and recorder.

ros2 launch tms_study experiment.launch.py output:=my_bag scenario:=tms_strike rate:=2.0
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# Their names begin with '/', so that a namespace alone would not part the clocks and frames of two bicycles.
PARTED = [("/clock", "clock"), ("/tf", "tf"), ("/tf_static", "tf_static")]


def generate_launch_description() -> LaunchDescription:
    """Arguments and nodes; the end of one node ends the others."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("output", description="bag to write"),
            DeclareLaunchArgument(
                "scenario", default_value="", description="name or .yaml file; empty: the simulator's default"
            ),
            DeclareLaunchArgument(
                "rate", default_value="", description="simulated seconds per real second; empty: the default"
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="of all nodes and topics, and of what is recorded"
            ),
            DeclareLaunchArgument(
                "params_file", default_value="", description="YAML file with parameters of the three nodes"
            ),
            OpaqueFunction(function=start_nodes),
        ]
    )


def start_nodes(context: LaunchContext) -> list[Node]:
    """The nodes, with what was given."""
    scenario = LaunchConfiguration("scenario").perform(context)
    rate = LaunchConfiguration("rate").perform(context)
    namespace = LaunchConfiguration("namespace").perform(context).strip("/")
    file = LaunchConfiguration("params_file").perform(context)
    recorder: dict[str, object] = {"output": LaunchConfiguration("output").perform(context)}
    if namespace:
        recorder["regex"] = f"^/{namespace}/|^/diagnostics$"
    # Nothing is simulated before recorder and estimator hear it.
    simulator: dict[str, object] = {"wait_for_subscribers": 1, "handled_topics": ["estimator/handled"]}
    if scenario:
        simulator["scenario"] = scenario
    if rate:
        simulator["rate"] = float(rate)
    nodes = (
        ("tms_bag", "recorder", recorder),
        ("tms_fit", "estimator", {}),
        ("tms_sim", "simulator", simulator),
    )
    return [
        Node(
            package=package,
            executable=executable,
            namespace=namespace,
            remappings=PARTED,
            parameters=[part for part in (file, parameters) if part],
            on_exit=Shutdown(reason=f"the {executable} has ended"),
        )
        for package, executable, parameters in nodes
    ]
