"""From a camera driver's images to an attitude: `ros2 launch star_tracker camera.launch.py`.

`image:=/camera/image_raw camera_info:=/camera/camera_info` names the driver's topics. A driver
without a calibration: `use_camera_info:=false width_px:=1936 height_px:=1216`; the field of view
is then found out from the stars. Both nodes run in one process, with `composed:=false` in two.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from star_tracker.nodes.launch_arguments import files, pixels, quality, resolved, switch

ARGUMENTS = {
    "image": ("image", "topic of the images; of compressed ones, without /compressed"),
    "camera_info": ("camera_info", "topic of the camera, where use_camera_info is true"),
    "use_camera_info": ("true", "take camera and size from camera_info"),
    "width_px": ("", "image width, where use_camera_info is false; empty = as in the file"),
    "height_px": ("", "image height, likewise"),
    "image_transport": ("raw", "raw or compressed"),
    "image_reliability": (
        "", "of the subscription: reliable or best_effort; empty = any driver's"
    ),
    "camera_info_durability": (
        "", "of the subscription: volatile or transient_local; empty = any driver's"
    ),
    "centroids_reliability": ("", "reliable or best_effort; empty = reliable, or as in the file"),
    "params_file": ("", "parameters of both nodes, a YAML file; empty = the nodes' defaults"),
    "namespace": ("", "in front of all topics but /diagnostics"),
    "composed": ("true", "both nodes in one process: centroids are handed over in memory"),
    "use_sim_time": ("", "true or false; empty = as in the file"),
    "log_frames": ("", "a line of the log for each frame: true or false; empty = as in the file"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
    "respawn": ("false", "start what has ended again"),
}


def parameters(told: dict[str, str]) -> tuple[list[object], list[object]]:
    """Return the parameters of centroid_node and of identify_node: the later ones hold.

    Raises ValueError, in one line, for a file that is not there.
    """
    file = files("params_file", told["params_file"])
    common: dict[str, object] = {}
    if told["use_sim_time"]:
        common["use_sim_time"] = switch("use_sim_time", told["use_sim_time"])
    use_info = switch("use_camera_info", told["use_camera_info"])
    # Both nodes count pixels alike: as camera_info does, or as identify_node does without it.
    origin = {"pixel_origin": "center" if use_info else "corner"}
    identify = {**common, "use_camera_info": use_info}
    identify |= {
        name: pixels(name, told[name]) for name in ("width_px", "height_px") if told[name]
    }
    if told["log_frames"]:
        identify["log_frames"] = switch("log_frames", told["log_frames"])
    centroid = {**common, "image_transport": told["image_transport"]}
    image, info, centroids = (
        resolved(told["namespace"], name)
        for name in (image_topic(told), told["camera_info"], "centroids")
    )
    for node, name, topic in (
        (centroid, "image_reliability", f"{image}.subscription"),
        (identify, "camera_info_durability", f"{info}.subscription"),
        (centroid, "centroids_reliability", f"{centroids}.publisher"),
    ):
        node.update(quality(name, told[name], topic))
    return [origin, *file, centroid], [*file, identify]


def image_topic(told: dict[str, str]) -> str:
    """Return the topic on which images come."""
    return told["image"] + ("/compressed" if told["image_transport"] == "compressed" else "")


def start(context: LaunchContext) -> list[Node]:
    """Return the nodes, or the one process with both."""
    told = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    centroid, identify = parameters(told)

    def node(executable: str, parameters: list[object]) -> Node:
        return Node(
            package="star_tracker", executable=executable, output="screen",
            namespace=told["namespace"], parameters=parameters,
            remappings=[
                ("image", told["image"]), ("image/compressed", f"{told['image']}/compressed"),
                ("camera_info", told["camera_info"]),
            ],
            ros_arguments=["--log-level", told["log_level"]],
            respawn=switch("respawn", told["respawn"]), respawn_delay=1.0,
        )

    if switch("composed", told["composed"]):
        return [node("camera_to_attitude", [*centroid, *identify])]
    return [node("centroid_node", centroid), node("identify_node", identify)]


def generate_launch_description() -> LaunchDescription:
    """Start the nodes and let their end be the end of the launch."""
    return LaunchDescription([
        *(
            DeclareLaunchArgument(name, default_value=default, description=description)
            for name, (default, description) in ARGUMENTS.items()
        ),
        OpaqueFunction(function=start),
    ])
