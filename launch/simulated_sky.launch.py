"""The whole chain without a camera: `ros2 launch star_tracker simulated_sky.launch.py`.

A sky is rendered, its stars are detected and identified; each frame's result is a line on the
screen. `truth/attitude` has the true attitude under the stamp of each `attitude`.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from star_tracker.nodes.launch_arguments import files, number, triple
from star_tracker.resources import resource_path

#: Numbers of the sky; what else sky_image_node is told comes in sky_params_file.
NUMBERS = {
    "ra_deg": ("83.0", "right ascension of the boresight at the first image"),
    "dec_deg": ("0.0", "its declination"),
    "roll_deg": ("0.0", "position angle of the image's up direction"),
    "fov_deg": ("20.0", "field of view across the width"),
    "rate_hz": ("5.0", "images per second"),
    "exposure_s": ("0.2", "time of exposure"),
}
ARGUMENTS = {
    **NUMBERS,
    "rate_deg_s": ("[0.0, 0.0, 0.0]", "rate of turn about the camera's x, y and z axis"),
    "sky_params_file": ("", "parameters of sky_image_node, a YAML file; arguments hold over it"),
    "params_file": ("", "parameters of centroid_node and identify_node, a YAML file"),
    "namespace": ("", "in front of all topics but /diagnostics"),
    "composed": ("true", "centroid_node and identify_node in one process"),
    "log_frames": ("true", "a line of the log for each frame"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
}
#: Arguments that camera.launch.py has too.
HANDED_ON = ("params_file", "namespace", "composed", "log_frames", "log_level")


def start(context: LaunchContext) -> list[Node | IncludeLaunchDescription]:
    """Return the sky and what makes attitudes of it."""
    told = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    values: dict[str, object] = {name: number(name, told[name]) for name in NUMBERS}
    values["rate_deg_s"] = triple("rate_deg_s", told["rate_deg_s"])
    sky = Node(
        package="star_tracker", executable="sky_image_node", output="screen",
        namespace=told["namespace"], ros_arguments=["--log-level", told["log_level"]],
        parameters=[*files("sky_params_file", told["sky_params_file"]), values],
    )
    camera = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(resource_path("launch/camera.launch.py"))),
        launch_arguments=[
            *((name, told[name]) for name in HANDED_ON), ("use_camera_info", "true"),
        ],
    )
    return [camera, sky]


def generate_launch_description() -> LaunchDescription:
    """Start the nodes and let their end be the end of the launch."""
    return LaunchDescription([
        *(
            DeclareLaunchArgument(name, default_value=default, description=description)
            for name, (default, description) in ARGUMENTS.items()
        ),
        OpaqueFunction(function=start),
    ])
