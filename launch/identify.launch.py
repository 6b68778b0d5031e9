"""Start one identify_node: `ros2 launch star_tracker identify.launch.py params_file:=my.yaml`.

For several cameras include this file once for each, with a namespace of its own.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from star_tracker.resources import resource_path

ARGUMENTS = {
    "params_file": (str(resource_path("config/fov12.yaml")), "camera and parameters, a YAML file"),
    "namespace": ("", "in front of all topics but /diagnostics"),
    "centroids": ("centroids", "topic of the frames"),
    "camera_info": ("camera_info", "topic of the camera, where use_camera_info is true"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
}


def generate_launch_description() -> LaunchDescription:
    """Start the node and let its end be the end of the launch."""
    node = Node(
        package="star_tracker", executable="identify_node", output="screen",
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("params_file")],
        remappings=[
            (topic, LaunchConfiguration(topic)) for topic in ("centroids", "camera_info")
        ],
        ros_arguments=["--log-level", LaunchConfiguration("log_level")],
    )
    return LaunchDescription([
        *(
            DeclareLaunchArgument(name, default_value=default, description=description)
            for name, (default, description) in ARGUMENTS.items()
        ),
        node,
    ])
