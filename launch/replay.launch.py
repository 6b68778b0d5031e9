"""Replay the eight star maps into identify_node: `ros2 launch star_tracker replay.launch.py`.

Each frame's result is a line on the screen. The end of the replay ends the launch.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from star_tracker.nodes.launch_arguments import files, number, switch
from star_tracker.resources import resource_path

ARGUMENTS = {
    "params_file": (str(resource_path("config/fov12.yaml")), "parameters of identify_node"),
    "namespace": ("", "in front of all topics but /diagnostics"),
    "rate_hz": ("10.0", "frames per second"),
    "loop": ("false", "replay without end"),
    "noise_px": ("0.0", "noise added, px"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
}
#: After the last frame has been sent its answer is still to come.
_LAST_ANSWER_S = 1.0


def start(context: LaunchContext) -> list[Node | RegisterEventHandler]:
    """Return both nodes. Raises ValueError, in one line, for what cannot be used."""
    told = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    replay = Node(
        package="star_tracker", executable="replay_node", output="screen",
        namespace=told["namespace"], ros_arguments=["--log-level", told["log_level"]],
        parameters=[{
            "rate_hz": number("rate_hz", told["rate_hz"]), "loop": switch("loop", told["loop"]),
            "noise_px": number("noise_px", told["noise_px"]),
        }],
    )
    identify = Node(
        package="star_tracker", executable="identify_node", output="screen",
        namespace=told["namespace"], ros_arguments=["--log-level", told["log_level"]],
        parameters=[
            *files("params_file", told["params_file"]),
            {"use_camera_info": True, "log_frames": True},
        ],
    )
    end = TimerAction(period=_LAST_ANSWER_S, actions=[EmitEvent(event=Shutdown())])
    return [
        identify, replay,
        RegisterEventHandler(OnProcessExit(target_action=replay, on_exit=[end])),
    ]


def generate_launch_description() -> LaunchDescription:
    """Start both nodes; the end of the replay ends the launch."""
    return LaunchDescription([
        *(
            DeclareLaunchArgument(name, default_value=default, description=description)
            for name, (default, description) in ARGUMENTS.items()
        ),
        OpaqueFunction(function=start),
    ])
