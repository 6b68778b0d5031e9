"""Start identify_node on the ground, where it publishes `imu_enu`.

`ros2 launch star_tracker earth.launch.py latitude_deg:=47.3 longitude_deg:=8.5`.
With `base_frame:=base_link` it is the robot's. `ekf:=true` starts robot_localization on it, with
config/ekf.yaml.
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from star_tracker.nodes.launch_arguments import files, number, switch
from star_tracker.resources import resource_path

#: Stands for an angle of the place that is not told, as in the node's parameters.
NOT_TOLD = -1000.0
ARGUMENTS = {
    "params_file": ("", "camera and parameters, a YAML file; empty = the node's defaults"),
    "namespace": ("", "in front of all topics but /diagnostics, /tf and /tf_static"),
    "latitude_deg": (str(NOT_TOLD), "where the camera stands; -1000 = take the place from fix"),
    "longitude_deg": (str(NOT_TOLD), "east positive; -1000 = take the place from fix"),
    "height_m": ("0.0", "above the ellipsoid WGS 84"),
    "ut1_utc_s": ("0.0", "UT1 - UTC, s, from IERS Bulletin A"),
    "pressure_hpa": ("0.0", "air pressure at the camera; 0 = do not correct refraction"),
    "temperature_c": ("10.0", "air temperature at the camera"),
    "base_frame": ("", "what carries the camera, by /tf_static; empty = the camera itself"),
    "centroids": ("centroids", "topic of the frames"),
    "camera_info": ("camera_info", "topic of the camera, where use_camera_info is true"),
    "use_camera_info": ("", "true or false; empty = as in the file"),
    "fix": ("fix", "topic of the place, a NavSatFix"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
    "ekf": ("false", "start robot_localization with config/ekf.yaml"),
}
NUMBERS = (
    "latitude_deg", "longitude_deg", "height_m", "ut1_utc_s", "pressure_hpa", "temperature_c",
)


def start(context: LaunchContext) -> list[Node | LogInfo]:
    """Return the node and, where it is wanted, the filter or a line that it is missing."""
    told = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    values: dict[str, object] = {name: number(name, told[name]) for name in NUMBERS}
    use_fix = NOT_TOLD in (values["latitude_deg"], values["longitude_deg"])
    values |= {"earth_frame": "enu", "base_frame": told["base_frame"], "use_fix": use_fix}
    if told["use_camera_info"]:
        values["use_camera_info"] = switch("use_camera_info", told["use_camera_info"])
    node = Node(
        package="star_tracker", executable="identify_node", output="screen",
        namespace=told["namespace"],
        parameters=[*files("params_file", told["params_file"]), values],
        remappings=[(topic, told[topic]) for topic in ("centroids", "camera_info", "fix")],
        ros_arguments=["--log-level", told["log_level"]],
    )
    return [node, ekf()] if switch("ekf", told["ekf"]) else [node]


def ekf() -> Node | LogInfo:
    """Return the filter in the node's namespace, or what to do where it is not installed."""
    try:
        get_package_prefix("robot_localization")
    except PackageNotFoundError:
        return LogInfo(
            msg="there is no robot_localization: install ros-jazzy-robot-localization, or leave "
            "out ekf:=true"
        )
    return Node(
        package="robot_localization", executable="ekf_node", name="ekf", output="screen",
        namespace=LaunchConfiguration("namespace"),
        parameters=[str(resource_path("config/ekf.yaml"))],
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
