"""Start one identify_node: `ros2 launch star_tracker identify.launch.py params_file:=my.yaml`.

For several cameras include this file once for each, with a namespace of its own. `rviz:=true`
shows the identified stars in RViz 2 and makes the node publish them.
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from star_tracker.resources import resource_path

ARGUMENTS = {
    "params_file": (str(resource_path("config/fov12.yaml")), "camera and parameters, a YAML file"),
    "namespace": ("", "in front of all topics but /diagnostics"),
    "centroids": ("centroids", "topic of the frames"),
    "camera_info": ("camera_info", "topic of the camera, where use_camera_info is true"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
    "rviz": ("false", "show the identified stars in RViz 2"),
}


def start(context: LaunchContext) -> list[Node | LogInfo]:
    """Return the node and, where it is wanted, RViz or a line that says that there is none."""
    wanted = IfCondition(LaunchConfiguration("rviz")).evaluate(context)
    node = Node(
        package="star_tracker", executable="identify_node", output="screen",
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            LaunchConfiguration("params_file"), *([{"publish_markers": True}] if wanted else []),
        ],
        remappings=[
            (topic, LaunchConfiguration(topic)) for topic in ("centroids", "camera_info")
        ],
        ros_arguments=["--log-level", LaunchConfiguration("log_level")],
    )
    return [node, rviz()] if wanted else [node]


def rviz() -> Node | LogInfo:
    """Return RViz in the node's namespace, or what to do where it is not installed."""
    try:
        get_package_prefix("rviz2")
    except PackageNotFoundError:
        return LogInfo(msg="there is no rviz2: install ros-jazzy-rviz2, or leave out rviz:=true")
    return Node(
        package="rviz2", executable="rviz2", namespace=LaunchConfiguration("namespace"),
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
