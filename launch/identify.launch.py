"""Start one identify_node: `ros2 launch star_tracker identify.launch.py params_file:=my.yaml`.

Without a file it has the node's own defaults. For several cameras include this file once for each,
with a namespace of its own. `rviz:=true` shows the identified stars in RViz 2 and makes the node
publish them.
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from star_tracker.nodes.launch_arguments import files, switch
from star_tracker.resources import resource_path

ARGUMENTS = {
    "params_file": ("", "camera and parameters, a YAML file; empty = the node's defaults"),
    "namespace": ("", "in front of all topics but /diagnostics"),
    "centroids": ("centroids", "topic of the frames"),
    "camera_info": ("camera_info", "topic of the camera, where use_camera_info is true"),
    "use_camera_info": ("", "true or false; empty = as in the file"),
    "use_sim_time": ("", "true or false; empty = as in the file"),
    "log_frames": ("", "a line of the log for each frame: true or false; empty = as in the file"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
    "respawn": ("false", "start the node again when it has ended"),
    "rviz": ("false", "show the identified stars in RViz 2"),
}
#: Arguments that are parameters of the node.
SWITCHES = ("use_camera_info", "use_sim_time", "log_frames")


def parameters(told: dict[str, str]) -> list[object]:
    """Return the parameters of the node: of two that say the same, the later one holds.

    Raises ValueError, in one line, for a file that is not there.
    """
    found = files("params_file", told["params_file"])
    found += [{name: switch(name, told[name])} for name in SWITCHES if told[name]]
    if switch("rviz", told["rviz"]):
        found.append({"publish_markers": True})
    return found


def start(context: LaunchContext) -> list[Node | LogInfo]:
    """Return the node and, where it is wanted, RViz or a line that says that there is none."""
    told = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    node = Node(
        package="star_tracker", executable="identify_node", output="screen",
        namespace=told["namespace"], parameters=parameters(told),
        remappings=[(topic, told[topic]) for topic in ("centroids", "camera_info")],
        ros_arguments=["--log-level", told["log_level"]],
        respawn=switch("respawn", told["respawn"]), respawn_delay=1.0,
    )
    return [node, rviz(told["namespace"])] if switch("rviz", told["rviz"]) else [node]


def rviz(namespace: str) -> Node | LogInfo:
    """Return RViz in the node's namespace, or what to do where it is not installed."""
    try:
        get_package_prefix("rviz2")
    except PackageNotFoundError:
        return LogInfo(msg="there is no rviz2: install ros-jazzy-rviz2, or leave out rviz:=true")
    return Node(
        package="rviz2", executable="rviz2", namespace=namespace,
        arguments=["-d", str(resource_path("config/star_tracker.rviz"))],
    )


def generate_launch_description() -> LaunchDescription:
    """Start the node and let its end be the end of the launch."""
    return LaunchDescription([
        *(
            DeclareLaunchArgument(name, default_value=default, description=description)
            for name, (default, description) in ARGUMENTS.items()
        ),
        OpaqueFunction(function=start),
    ])
